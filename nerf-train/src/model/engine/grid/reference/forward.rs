//! Encoding, trunk and heads of a grid field on dfdx's tape.

use super::GridReferenceEngine;
use crate::model::engine::tape::{Matrix, Taped, Vector, Weights};
use crate::model::engine::{Dense, EngineError, Part};
use crate::model::quantise::STEPS;
use dfdx::prelude::*;
use half::f16;
use nerf_core::encoding::{DirectionEncoding, GridLevel, encode_block, encode_harmonics_block};
use nerf_core::math::MathBackend;
use nerf_core::network::EXPONENTIAL_LIMIT;
use nerf_core::simd::Isa;

/// Parameters of the field as dfdx tensors.
pub(super) struct Network {
    pub layers: Vec<(Dense, Weights)>,
    /// Table values of all levels, `[entries][features]`, rounded to the values that a renderer reads. The gradient
    /// with respect to the rounded values updates the parameters, which are not rounded (straight-through estimator).
    pub table: Matrix,
}

pub(super) fn network(engine: &GridReferenceEngine) -> Result<Network, EngineError> {
    let parameters = &engine.state.parameters;
    let of = |dense: Dense| Ok((dense, Weights::of(&engine.device, &dense, parameters)?));
    let layers = engine.model.layers().into_iter().map(of).collect::<Result<_, EngineError>>()?;
    let mut table = parameters[engine.model.layer_parameters()..].to_vec();
    let features = usize::from(engine.grid.features);
    for (i, level) in engine.grid.levels().enumerate() {
        for value in &mut table[level.first * features..][..level.entries * features] {
            if let Some(scale) = engine.state.scales.get(i) {
                *value = (*value / scale).round_ties_even().clamp(-STEPS, STEPS) * scale;
            }
            *value = f16::from_f32(*value).to_f32();
        }
    }
    let entries = table.len() / features;
    Ok(Network { layers, table: engine.device.try_tensor_from_vec(table, (entries, features))? })
}

/// Returns the encoded positions, `[samples][levels · features]`: `Σ_corners weight · table[entry]`.
fn encode<T: Tape<f32, Cpu>>(
    engine: &GridReferenceEngine,
    table: &Matrix,
    positions: &[[f32; 3]],
) -> Result<Matrix<T>, EngineError> {
    let (mut entries, mut weights) = (Vec::new(), Vec::new());
    let sides = (engine.bounds.max - engine.bounds.min).to_array();
    for x in positions {
        let unit: [f32; 3] =
            std::array::from_fn(|axis| ((x[axis] - engine.bounds.min[axis]) / sides[axis]).clamp(0.0, 1.0));
        for level in engine.grid.levels() {
            for (entry, weight) in corners(&level, unit) {
                entries.push(entry);
                weights.push(weight);
            }
        }
    }
    let (reads, features) = (entries.len(), usize::from(engine.grid.features));
    let (samples, levels) = (positions.len(), engine.grid.resolutions.len());
    let entries = engine.device.try_tensor_from_vec(entries, (reads,))?;
    let weights = engine.device.try_tensor_from_vec(weights, (reads,))?;
    let read: Matrix<T> = table.retaped::<T>().try_gather(entries)?;
    let read = read.try_mul(weights.try_broadcast_like::<_, Axis<1>>(&(reads, features))?)?;
    let corners = read.try_reshape_like(&(samples * levels, reads / (samples * levels), features))?;
    let sums = corners.try_sum::<(usize, usize), Axis<1>>()?;
    Ok(sums.try_reshape_like(&(samples, levels * features))?)
}

/// Returns the trunk's output at `positions`, `[samples][width]`.
pub(super) fn trunk<T: Tape<f32, Cpu>>(
    engine: &GridReferenceEngine,
    network: &Network,
    positions: &[[f32; 3]],
) -> Result<Matrix<T>, EngineError> {
    let mut h = encode::<T>(engine, &network.table, positions)?;
    for (_, weights) in network.layers.iter().filter(|(d, _)| matches!(d.part, Part::Trunk(_))) {
        h = weights.apply(h, None)?.try_relu()?;
    }
    Ok(h)
}

/// Returns sigma of each sample, recorded on a new tape. `h`: output of the trunk. Fails for a 2D field.
pub(super) fn density<T: Tape<f32, Cpu>>(network: &Network, h: &Matrix<T>) -> Result<Vector<T>, EngineError> {
    let density = network.layers.iter().find(|(d, _)| d.part == Part::Density);
    let (_, weights) = density.ok_or(EngineError::NoDensity)?;
    let raw = weights.apply(h.with_empty_tape(), None)?;
    let samples = raw.shape().0;
    Ok(raw.try_reshape_like(&(samples,))?.try_clamp(f32::MIN, EXPONENTIAL_LIMIT)?.try_exp()?)
}

/// Returns the colours, `[rows][3]`, on a new tape. `h`: features of each row; `dirs`: viewing direction of each row.
pub(super) fn colour(
    engine: &GridReferenceEngine,
    network: &Network,
    h: &Matrix<Taped>,
    dirs: &[[f32; 3]],
) -> Result<Matrix<Taped>, EngineError> {
    let dirs = directions(engine, dirs)?;
    let mut h = h.with_empty_tape();
    for (dense, weights) in &network.layers {
        h = match dense.part {
            Part::Colour(_) => weights.apply(h, dirs.as_ref())?.try_relu()?,
            Part::Rgb => weights.apply(h, dirs.as_ref())?.try_sigmoid()?,
            Part::Trunk(_) | Part::Density | Part::Feature => h,
        };
    }
    Ok(h)
}

fn directions(engine: &GridReferenceEngine, dirs: &[[f32; 3]]) -> Result<Option<Matrix>, EngineError> {
    let Some(encoding) = &engine.model.architecture.direction else { return Ok(None) };
    let channels = encoding.outputs();
    let mut values = vec![0.0; dirs.len() * channels];
    for (dir, out) in dirs.iter().zip(values.chunks_exact_mut(channels)) {
        match encoding {
            DirectionEncoding::Sinusoidal(encoding) => {
                encode_block(Isa::Portable, MathBackend::Polynomial, encoding, 1, dir, out);
            }
            DirectionEncoding::SphericalHarmonics { degree } => {
                encode_harmonics_block(Isa::Portable, *degree, 1, dir, out);
            }
        }
    }
    Ok(Some(engine.device.try_tensor_from_vec(values, (dirs.len(), channels))?))
}

/// Returns two values for each corner of the cell around `unit` ∈ [0, 1]³: the index of the corner's entry among the
/// entries of all levels, and the corner's trilinear weight.
fn corners(level: &GridLevel, unit: [f32; 3]) -> [(usize, f32); 8] {
    let at: [(u32, f32); 3] = std::array::from_fn(|axis| {
        let along = unit[axis] * level.cells[axis] as f32;
        let cell = along.floor().min(level.cells[axis] as f32 - 1.0);
        (cell as u32, along - cell)
    });
    std::array::from_fn(|corner| {
        let far = [0, 1, 2].map(|axis| corner as u32 >> axis & 1);
        let [x, y, z] = [0, 1, 2].map(|axis| at[axis].0 + far[axis]);
        let weight = (0..3).map(|axis| if far[axis] == 1 { at[axis].1 } else { 1.0 - at[axis].1 }).product();
        (level.first + (level.row(y, z) + x) as usize, weight)
    })
}
