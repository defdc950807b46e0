//! Benchmark of position encodings: 63 encoded values (60 sines and cosines, and the 3 inputs) with every maths
//! backend, and learned grids with every instruction set.
//!
//! The share of a sinusoidal line counts the operations of the polynomial backend, even if the line's backend executes
//! other operations. Shares thus compare the speeds at which backends compute the same encoding. The share of a grid
//! line counts only the multiply-adds of the interpolation. Most of a grid line's time is spent on reading tables.

mod support;

use nerf_core::encoding::{GridEncoding, GridTables, TableValues, encode_block, encode_grid_block};
use nerf_core::simd::BLOCK;
use nerf_core::{MathBackend, Storage};
use std::hint::black_box;
use support::networks::pi;
use support::{Table, kernels, noise};

const SAMPLES: usize = 4096;
/// Floating-point operations of one interpolated feature: multiply-adds of four rows at both ends of x, and 3
/// operations to interpolate between the ends.
const FLOP_PER_FEATURE: usize = 2 * 4 * 2 + 3;
/// Floating-point operations of one `(sin πu, cos πu)` in `math/polynomial.rs`: reduction 9, polynomials 19, quadrant
/// 4, scaling 1.
const FLOP_PER_PAIR: usize = 33;

fn main() {
    let mut table = Table::new();
    let backends = [
        ("polynomial", MathBackend::Polynomial),
        #[cfg(feature = "libm")]
        ("libm", MathBackend::Libm),
        #[cfg(feature = "micromath")]
        ("micromath", MathBackend::Micromath),
        ("recurrence", MathBackend::Recurrence),
    ];
    grids(&mut table);
    let encoding = pi(10);
    let rows = encoding.outputs();
    let pairs = usize::from(encoding.inputs) * usize::from(encoding.levels);
    let positions = noise(3 * SAMPLES, 1);
    let mut encoded = vec![0.0; rows * BLOCK];
    for (backend, math) in backends {
        for kernel in kernels().filter(|kernel| kernel.storage == Storage::F32) {
            let name = format!("encoding {backend} {}, {SAMPLES} samples", kernel);
            table.line(&name, kernel, 1, (FLOP_PER_PAIR * pairs * SAMPLES) as f64, || {
                for positions in positions.chunks(3 * BLOCK) {
                    encode_block(kernel.isa, math, &encoding, BLOCK, positions, &mut encoded);
                    black_box(&mut encoded);
                }
            });
        }
    }
}

/// Measures grids with eight levels of 16 to 320 cells per side and two features per level. Positions are random, so
/// that samples read unrelated table entries at every level.
fn grids(table: &mut Table) {
    let unit: Vec<f32> = noise(3 * SAMPLES, 1).iter().map(|x| 0.5 + 0.5 * x).collect();
    let sides = [16u16, 24, 37, 57, 88, 135, 208, 320];
    for log2_entries in [6, 14, 16] {
        let resolutions = sides.iter().map(|&n| [n; 3]).collect();
        let grid = GridEncoding { inputs: 3, features: 2, log2_entries, resolutions };
        let values = noise(grid.values(), 2);
        let half: Vec<u8> = values.iter().flat_map(|&v| half::f16::from_f32(v).to_le_bytes()).collect();
        let steps: Vec<u8> = values.iter().map(|&v| (127.0 * v) as i8 as u8).collect();
        let scales = (1.0f32 / 127.0).to_le_bytes().repeat(sides.len());
        let mut encoded = vec![0.0; grid.outputs() * BLOCK];
        let int8 = TableValues::Int8 { values: &steps, scales: &scales };
        for (storage, values) in
            [("f16", TableValues::F16(&half)), ("int8", int8), ("f32", TableValues::F32(&values))]
        {
            let tables = GridTables::new(values, None);
            for kernel in kernels().filter(|kernel| kernel.storage == Storage::F32) {
                let name = format!("grid 8x2, 2^{log2_entries}, {storage}, {}, {SAMPLES} samples", kernel);
                let flop = (FLOP_PER_FEATURE * grid.outputs() * SAMPLES) as f64;
                table.line(&name, kernel, 1, flop, || {
                    for positions in unit.chunks(3 * BLOCK) {
                        encode_grid_block(kernel.isa, &grid, &tables, BLOCK, positions, &mut encoded);
                        black_box(&mut encoded);
                    }
                });
            }
        }
    }
}
