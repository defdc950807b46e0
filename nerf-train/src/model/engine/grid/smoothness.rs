//! Smoothness loss: penalises disparities that do not fit a plane, along lines of pixels of similar colour.
//!
//! Disparity is 1 / distance along a ray, in inverse radii of the uncontracted ball. The directions of three rays from
//! one camera whose pixels lie on a line satisfy `a dir_0 − b dir_1 + c dir_2 = 0`. If the rays meet a plane, disparity
//! is linear in the direction, so `a D_0 − b D_1 + c D_2 = 0`. The loss sums over every three neighbours on each line:
//!
//! ```text
//! L = Σ exp(−20 e) (√(r² + 0.01²) − 0.01)   e: largest difference of two neighbouring pixels in a channel
//! r = 2 (a D_0 − b D_1 + c D_2) / b         0 on a plane
//! a = |dir_1 × dir_2|, b = |dir_0 × dir_2|, c = |dir_0 × dir_1|
//! D_k = Σ_i w_i d_i                         disparity of ray k; sample i has compositing weight w_i, disparity d_i
//! ```
//!
//! # Source
//! Godard, Mac Aodha and Brostow 2017 (weights by colour), Niemeyer et al. 2022 (RegNeRF). Deviation: second
//! differences, since the first differences of a tilted plane are not 0.

use super::evaluate::Evaluated;
use super::samples::Samples;
use crate::model::engine::{Batch, LINE};
use glam::Vec3;
use nerf_core::space::Contraction;
use std::ops::Range;

/// Decay rate of a triple's weight `exp(−EDGE e)` with the colour difference `e`.
const EDGE: f32 = 20.0;
/// Second difference of a triple's disparities above which the smoothness loss is about linear, not quadratic. Its unit
/// is the inverse of the uncontracted ball's radius.
pub(super) const SOFT: f32 = 0.01;
/// Lower limit of a sample's distance from the camera in [`disparity`], in radii of the uncontracted ball.
const NEAREST: f32 = 1e-3;

/// Three neighbouring rays whose pixels lie on a line. Each triple adds a term to the smoothness loss.
pub(super) struct Triple {
    /// Index in the batch of the first ray; the other two come directly after it.
    pub first: usize,
    /// Factors `f_k` of the three rays' disparities `D_k` in the residual `r = Σ_k f_k D_k`, which is 0 on a plane.
    pub factors: [f32; 3],
    /// Weight in the batch's loss: exp(−20 · colour difference of the pixels) · smoothness weight / number of rays.
    pub weight: f32,
}

/// Returns the triples on those lines of the batch that begin within `rays`.
pub(super) fn triples(batch: &Batch, rays: Range<usize>) -> impl Iterator<Item = Triple> {
    let starts = |ray: usize| batch.lines.partition_point(|&line| (line as usize) < ray);
    let lines = &batch.lines[starts(rays.start)..starts(rays.end)];
    let weight = batch.smoothness.map_or(0.0, |(weight, _)| weight) / batch.rays.len() as f32;
    lines.iter().flat_map(|&line| line as usize..line as usize + LINE - 2).map(move |first| {
        let [from, mid, to] = [0, 1, 2].map(|k| &batch.rays[first + k]);
        let sine = |a: &[f32; 3], b: &[f32; 3]| Vec3::from(*a).cross(Vec3::from(*b)).length();
        let whole = sine(&from.dir, &to.dir);
        let edge = |k: usize| (from.rgb[k] - mid.rgb[k]).abs().max((mid.rgb[k] - to.rgb[k]).abs());
        let edge = edge(0).max(edge(1)).max(edge(2));
        // Three rays in one direction determine no plane.
        let of = |part: f32| if whole > 0.0 { 2.0 * part / whole } else { 0.0 };
        let factors = [of(sine(&mid.dir, &to.dir)), -of(whole), of(sine(&from.dir, &mid.dir))];
        Triple { first, factors, weight: weight * (-EDGE * edge).exp() }
    })
}

/// Returns the disparity of `sample` on `ray` (indices in the batch), in inverse radii of the uncontracted ball.
pub(super) fn disparity(batch: &Batch, contraction: &Contraction, ray: usize, sample: usize) -> f32 {
    let point = contraction.in_world(batch.positions[sample].into());
    let distance = (point - Vec3::from(batch.origins[ray])).dot(batch.rays[ray].dir.into());
    (distance / contraction.radius()).max(NEAREST).recip()
}

/// Adds the gradient of the smoothness loss with respect to each kept sample's weight to `by_weight`.
/// `rays`: indices in the batch of the chunk's rays. The chunk must hold whole lines.
pub(super) fn add_gradient(
    batch: &Batch,
    rays: Range<usize>,
    (evaluated, samples): (&Evaluated, &Samples),
    by_weight: &mut [f32],
) {
    let triples: Vec<Triple> = triples(batch, rays.clone()).collect();
    let (Some((_, contraction)), false) = (&batch.smoothness, triples.is_empty()) else { return };
    let of_sample = |(&row, &ray): (&u32, &u32)| {
        let sample = evaluated.index_of[row as usize] as usize;
        disparity(batch, contraction, rays.start + ray as usize, sample)
    };
    let disparities: Vec<f32> = samples.row.iter().zip(&samples.ray).map(of_sample).collect();
    let kept = |ray: usize| {
        let (first, end) = evaluated.rays[ray - rays.start].kept;
        first..end
    };
    for Triple { first, factors, weight } in triples {
        let mean = |ray: usize| -> f32 { kept(ray).map(|i| samples.counted[i] * disparities[i]).sum() };
        let residual: f32 = (0..3).map(|k| factors[k] * mean(first + k)).sum();
        let slope = weight * residual / residual.hypot(SOFT);
        for (k, factor) in factors.iter().enumerate() {
            for i in kept(first + k) {
                by_weight[i] += slope * factor * disparities[i];
            }
        }
    }
}
