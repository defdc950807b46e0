//! Densities of a network at many points, evaluated on all cores.

use nerf_core::encoding::{GridTables, TableValues};
use nerf_core::math::MathBackend;
use nerf_core::memory::{Arena, Layout, Line, lines_for};
use nerf_core::network::{Architecture, Network, Scratch, Weights};
use nerf_core::simd::{BLOCK, Isa};
use nerf_core::space::SceneBox;
use rayon::prelude::*;

/// Returns sigma, 1/world unit, at each of `points`. `parameters`: layer parameters in the architecture's order, then
/// the values of the grid's tables, if there is a grid. `bounds`: box that the grid spans. Panics if the parameters do
/// not fit the architecture.
pub fn densities(
    isa: Isa,
    architecture: &Architecture,
    parameters: &[f32],
    bounds: &SceneBox,
    points: &[[f32; 3]],
) -> Vec<f32> {
    let (layers, tables) = parameters.split_at(architecture.parameters());
    let tables = GridTables::new(TableValues::F32(tables), Some(bounds));
    let network = Network::with_grid(architecture, Weights::Prepared(layers), tables, isa);
    let network = network.expect("parameters fit the architecture");
    let (encoded, rows) = (network.encoded_rows() * BLOCK, network.activation_rows() * BLOCK);
    let lines = 2 * lines_for::<f32>(rows) + lines_for::<f32>(encoded);
    let mut sigma = vec![0.0; points.len()];
    sigma.par_chunks_mut(BLOCK).zip(points.par_chunks(BLOCK)).for_each_init(
        || vec![Line::UNINIT; lines],
        |memory, (sigma, points)| {
            let mut arena = Arena::new(memory);
            let mut floats = |count| arena.slice(count, 0.0f32);
            let (encoded, front, back) = (floats(encoded), floats(rows), floats(rows));
            let mut scratch = Scratch { stride: BLOCK, encoded, front, back };
            let mut positions = [0.0; 3 * BLOCK];
            for (i, p) in points.iter().enumerate() {
                for axis in 0..3 {
                    positions[axis * BLOCK + i] = p[axis];
                }
            }
            let mut block = [0.0; BLOCK];
            network.trunk(MathBackend::Polynomial, &mut scratch, &positions);
            network.density(MathBackend::Polynomial, &scratch, &mut block);
            sigma.copy_from_slice(&block[..points.len()]);
        },
    );
    sigma
}
