//! Terms of the loss in addition to the squared error, on dfdx's tape.

use crate::model::engine::grid::kept::KeptSamples;
use crate::model::engine::grid::smoothness::{SOFT, Triple, disparity, triples};
use crate::model::engine::tape::{Matrix, Rows, Scalar, Taped, Vector};
use crate::model::engine::{Batch, EngineError, Surface};
use dfdx::prelude::*;
use std::ops::Range;

/// Returns `x` unchanged, but recorded so that the backward pass multiplies its gradient by `scale`.
pub(super) fn with_gradient_scaled<S: Shape>(
    x: Tensor<S, f32, Cpu, Taped>,
    scale: Tensor<S, f32, Cpu>,
) -> Result<Tensor<S, f32, Cpu, Taped>, EngineError> {
    let constant = x.device().try_tensor_from_vec(x.as_vec(), *x.shape())?;
    // The difference is 0: the value does not change by a bit.
    Ok(x.try_sub(constant.clone())?.try_mul(scale)?.try_add(constant)?)
}

/// Returns the depth loss of the known surfaces ([`Surface`]) of the rays `indices`, recorded on a new tape.
pub(super) fn surfaces(
    rows: &Rows,
    batch: &Batch,
    indices: Range<usize>,
    kept: &KeptSamples,
    weights: &Matrix<Taped>,
    transmittance: &Vector<Taped>,
) -> Result<Scalar, EngineError> {
    let weight =
        |ray: usize| batch.surfaces.get(ray).map_or(0.0, |surface| surface.weight) / batch.rays.len() as f32;
    let counted = indices.clone().zip(&kept.counts);
    let ray_of: Vec<usize> = counted.flat_map(|(ray, &count)| std::iter::repeat_n(ray, count)).collect();
    let cost = rows.constants(|i| {
        let (Some(surface), Some(along)) = (batch.surfaces.get(ray_of[i]), batch.along.get(kept.samples[i]))
        else {
            return 0.0;
        };
        weight(ray_of[i]) * (along - surface.at).abs().min(Surface::CLIP)
    })?;
    let passed = indices.map(|ray| weight(ray) * Surface::CLIP).collect::<Vec<_>>();
    let passed = transmittance.device().try_tensor_from_vec(passed, *transmittance.shape())?;
    let front = weights.with_empty_tape().try_mul(cost)?.try_sum::<Rank0, Axes2<0, 1>>()?;
    Ok(front.try_add(transmittance.with_empty_tape().try_mul(passed)?.try_sum::<Rank0, Axis<0>>()?)?)
}

/// Returns the smoothness loss ([`super::super::smoothness`]) of the lines that begin among the rays `indices`, on a
/// new tape. `None` if the batch has no smoothness loss, or if no line begins among these rays.
pub(super) fn smoothness(
    rows: &Rows,
    batch: &Batch,
    indices: Range<usize>,
    kept: &KeptSamples,
    weights: &Matrix<Taped>,
) -> Result<Option<Scalar>, EngineError> {
    let triples: Vec<Triple> = triples(batch, indices.clone()).collect();
    let (Some((_, contraction)), false) = (&batch.smoothness, triples.is_empty()) else { return Ok(None) };
    let counted = indices.clone().zip(&kept.counts);
    let ray_of: Vec<usize> = counted.flat_map(|(ray, &count)| std::iter::repeat_n(ray, count)).collect();
    let of_samples = rows.constants(|i| disparity(batch, contraction, ray_of[i], kept.samples[i]))?;
    let of_rays = weights.with_empty_tape().try_mul(of_samples)?.try_sum::<(usize,), Axis<1>>()?;
    let (device, shape) = (weights.device(), (indices.len(), triples.len()));
    let mut factors = vec![0.0; shape.0 * shape.1];
    for (at, triple) in triples.iter().enumerate() {
        for (k, factor) in triple.factors.iter().enumerate() {
            factors[(triple.first + k - indices.start) * triples.len() + at] = *factor;
        }
    }
    let residuals = of_rays.try_matmul(device.try_tensor_from_vec(factors, shape)?)?;
    let of_each = residuals.try_square()?.try_add(SOFT * SOFT)?.try_sqrt()?.try_sub(SOFT)?;
    let counts = triples.iter().map(|triple| triple.weight).collect();
    let of_each = of_each.try_mul(device.try_tensor_from_vec(counts, (triples.len(),))?)?;
    Ok(Some(of_each.try_sum::<Rank0, Axis<0>>()?))
}

/// Returns the distortion loss, `Σ_ij w_i w_j |s_i − s_j|` summed over rays. `along`: distances `s`, ascending per ray.
pub(super) fn distortion(rows: &Rows, weights: Matrix<Taped>, along: Matrix) -> Result<Scalar, EngineError> {
    let front = rows.sums_in_front(weights.with_empty_tape())?;
    let moments = rows.sums_in_front(weights.with_empty_tape().try_mul(along.clone())?)?;
    let pairs = weights.try_mul(front.try_mul(along)?.try_sub(moments)?)?;
    Ok(pairs.try_sum::<Rank0, Axes2<0, 1>>()?.try_mul(2.0)?)
}
