//! Gradients of the loss with respect to rays, from the gradients with respect to the samples' encoded positions.

use super::evaluate::Evaluated;
use super::pass::Job;
use super::shade::{Shade, Shaded};
use crate::model::engine::graph::padded;
use crate::model::engine::{RayGradient, RayQuestion};
use glam::Vec3;

#[derive(Default)]
pub(super) struct RayScratch {
    /// Positions of the kept samples, `[3][stride]`. `stride`: number of the samples, padded to whole vectors.
    points: Vec<f32>,
    by_point: Vec<f32>,
    /// Gradient of the loss with respect to the encoded positions, `[outputs][stride]`, with the `stride` of `points`.
    by_encoded: Vec<f32>,
}

impl RayScratch {
    /// Appends to `found`, for each ray with kept samples, the gradient of the loss with respect to the ray.
    ///
    /// A sample is at `p = origin + t dir`. The gradient dL/d origin is Σ dL/dp. The gradient dL/d dir is Σ t dL/dp
    /// plus the gradient from the colour branch, which reads the direction. `by_encoded`: gradient with respect to the
    /// kept samples' encoded positions, `[samples][padded outputs]`.
    pub fn gradients(
        &mut self,
        job: &Job<'_>,
        chunk: Shaded<'_>,
        (evaluated, shade): (&Evaluated, &Shade),
        question: &RayQuestion,
        by_encoded: &[f32],
        found: &mut Vec<RayGradient>,
    ) {
        let Shaded { batch, first_ray, samples, .. } = chunk;
        let mut by_directions = shade.by_directions(job, chunk);
        let (count, outputs) = (samples.len(), job.grid.outputs());
        let (stride, width) = (padded(count), padded(outputs));
        self.points.clear();
        self.points.resize(3 * stride, 0.0);
        for (i, &row) in samples.row.iter().enumerate() {
            let sample = evaluated.index_of[row as usize];
            for (axis, &x) in batch.positions[sample as usize].iter().enumerate() {
                self.points[axis * stride + i] = x;
            }
        }
        self.by_encoded.clear();
        self.by_encoded.resize(outputs * stride, 0.0);
        for (i, row) in by_encoded.chunks_exact(width).take(count).enumerate() {
            for (channel, &g) in row[..outputs].iter().enumerate() {
                self.by_encoded[channel * stride + i] = g;
            }
        }
        self.by_point.resize(3 * stride, 0.0);
        let (points, by_encoded) = (&self.points[..], &self.by_encoded[..]);
        let by_point = &mut self.by_point[..3 * stride];
        job.grid.gradient(&job.tables, job.isa, stride, points, by_encoded, question.blur, by_point);
        let along =
            |values: &[f32], i: usize| Vec3::from_array([0, 1, 2].map(|axis| values[axis * stride + i]));
        for (i, &ray) in samples.ray.iter().enumerate() {
            let ray = first_ray as u32 + ray;
            if found.last().is_none_or(|last| last.ray != ray) {
                let by_dir = by_directions.next().unwrap_or_default();
                found.push(RayGradient { ray, by_origin: Vec3::ZERO, by_dir });
            }
            let Some(of_ray) = found.last_mut() else { continue };
            let point = along(points, i);
            let gradient = question.contraction.gradient_in_world(point, along(&self.by_point, i));
            let origin = Vec3::from(batch.origins[ray as usize]);
            let t = (question.contraction.in_world(point) - origin).dot(batch.rays[ray as usize].dir.into());
            of_ray.by_origin += gradient;
            of_ray.by_dir += t * gradient;
        }
    }
}

/// Writes dL/dw of the distortion loss for each sample of a ray to `gradient`. The loss is small if the weights are
/// concentrated in one place on the ray; fog and several surfaces on one ray increase it.
///
/// ```text
/// L = Σ_ij w_i w_j |s_i − s_j|     s: distance along the samples, in the space that the grid spans
/// dL/dw_i = 2 Σ_j w_j |s_i − s_j|
/// ```
///
/// All slices are `[samples]`, front to back. `gaps`: distance from the sample before; any finite number for the first.
///
/// # Source
/// Barron et al. 2022 (mip-NeRF 360), section 4. Deviation: no term 1/3 Σ w_i² δ_i, since the batch fixes widths δ_i.
pub(super) fn distortion_gradient(weights: &[f32], gaps: &[f32], gradient: &mut [f32]) {
    // Two sums over the samples in front: of weights, and of weights times distances.
    let (mut sum, mut moment) = (0.0, 0.0);
    for ((g, w), gap) in gradient.iter_mut().zip(weights).zip(gaps) {
        moment += sum * gap;
        sum += w;
        *g = 2.0 * moment;
    }
    // Two sums over the samples behind: of weights, and of weights times distances.
    let (mut sum, mut moment) = (0.0, 0.0);
    for ((g, w), gap) in gradient.iter_mut().zip(weights).zip(gaps).rev() {
        *g += 2.0 * moment;
        sum += w;
        moment += sum * gap;
    }
}
