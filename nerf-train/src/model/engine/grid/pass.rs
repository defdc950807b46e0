//! Forward and backward passes over chunks of rays. An accumulator (`Pass`) sums loss and gradients of several chunks.

use super::evaluate::Evaluated;
use super::layers::{LayerSums, Layers};
use super::rays::{RayScratch, distortion_gradient};
use super::samples::Samples;
use super::scatter::Kept;
use super::shade::{Shade, Shaded};
use super::smoothness;
use super::vector::Mask;
use crate::model::engine::graph::{VECTOR, padded};
use crate::model::engine::{Batch, Model, Phase, Phases, RayGradient, Surface};
use nerf_core::encoding::{GridEncoding, GridTables};
use nerf_core::matrix::Init;
use nerf_core::network::EXPONENTIAL_LIMIT;
use nerf_core::simd::Isa;
use std::ops::Range;
use std::time::Instant;

/// Transmittance below which a ray ends (early ray termination).
pub(super) const T_MIN: f32 = 1e-3;
/// Compositing weight up to which, without Russian roulette, a sample is neither coloured nor trained.
pub(super) const GATE: f32 = 1e-3;
/// Largest compositing weight of the samples that are subject to Russian roulette ([`Batch::roulette`]). A sample is
/// kept with probability weight / `ROULETTE_WEIGHT`. A kept sample's weight is then divided by that probability.
pub(super) const ROULETTE_WEIGHT: f32 = 3e-3;

/// Smallest display-encoded value of a photograph's channel that [`clipped_error`] treats as clipped at white.
const CLIPPED: f32 = 250.0 / 255.0;

#[derive(Clone, Copy)]
pub(super) struct Job<'a> {
    pub isa: Isa,
    pub model: &'a Model,
    pub grid: &'a GridEncoding,
    pub tables: GridTables<'a>,
    pub layers: &'a Layers,
}

#[derive(Clone, Copy, Default)]
pub(super) struct Totals {
    /// Sum over rays and channels of (rendered − target)², times the weight of each ray.
    pub squared: f64,
    pub evaluated: usize,
    /// Number of samples that get a colour and a backward pass.
    pub kept: usize,
}

#[derive(Default)]
pub(super) struct Pass {
    pub totals: Totals,
    pub sums: LayerSums,
    pub kept: Kept,
    /// For each ray with a known photograph: the photograph's index, and dL/d (log gain) for the loss L.
    pub gains: Vec<(u32, [f32; 3])>,
    /// For each ray with a known photograph: index of the ray in the batch, and rendered minus target colour.
    pub errors: Vec<(u32, [f32; 3])>,
    /// Gradients of the loss with respect to the rays; empty if not requested.
    pub rays: Vec<RayGradient>,
}

/// Buffers of a thread for the current chunk, reused from step to step.
#[derive(Default)]
pub(super) struct Scratch {
    evaluated: Evaluated,
    samples: Samples,
    shade: Shade,
    /// Gradient of the loss with respect to each ray's composited colour, before gain and background.
    by_shown: Vec<[f32; 3]>,
    /// Gradient of the loss with respect to the transmittance after each ray's last sample.
    by_transmittance: Vec<f32>,
    /// Gradient of the loss with respect to each kept sample's compositing weight.
    by_weight: Vec<f32>,
    /// Distance of each kept sample from the kept sample before it.
    gaps: Vec<f32>,
    /// Gradient with respect to each kept sample's raw density, `[samples][VECTOR]`; all columns but the first are 0.
    d_raw: Vec<f32>,
    upper: Vec<f32>,
    lower: Vec<f32>,
    of_rays: RayScratch,
    pub phases: Phases,
}

pub(super) fn grow(buffer: &mut Vec<f32>, length: usize) {
    if buffer.len() < length {
        buffer.resize(length, 0.0);
    }
}

impl Pass {
    pub fn new(layers: &Layers) -> Self {
        Self { sums: LayerSums::new(layers), ..Self::default() }
    }

    pub fn clear(&mut self) {
        self.totals = Totals::default();
        self.sums.clear();
        self.kept.clear();
        self.gains.clear();
        self.errors.clear();
        self.rays.clear();
    }
}

impl Scratch {
    pub fn new(layers: &Layers) -> Self {
        Self {
            evaluated: Evaluated::new(layers.trunk.len()),
            samples: Samples::new(layers.trunk.len()),
            shade: Shade::new(layers),
            ..Self::default()
        }
    }

    /// Adds loss and gradients of `rays`, whose first sample has index `first` in the batch, to `pass`.
    pub fn run(&mut self, job: &Job<'_>, batch: &Batch, rays: Range<usize>, first: usize, pass: &mut Pass) {
        let Self { evaluated, samples, phases, .. } = self;
        match &job.layers.density {
            Some(density) => {
                evaluated.densities(job, density, batch, (rays.clone(), first), phases);
                let now = Instant::now();
                samples.keep(job, batch, evaluated, first);
                phases.lap(Phase::Composite, now);
            }
            None => {
                evaluated.picture(job, batch, (rays.clone(), first), phases);
                samples.keep_all(job, batch, evaluated);
            }
        }
        let now = Instant::now();
        let kept = samples.len();
        pass.totals.evaluated += evaluated.index_of.len();
        pass.totals.kept += kept;
        if kept > 0 {
            let states = &evaluated.rays;
            self.shade.forward(job, Shaded { batch, first_ray: rays.start, states, samples });
        }
        let now = self.phases.lap(Phase::Forward, now);
        pass.totals.squared += self.loss(batch, rays.clone(), pass);
        let now = self.phases.lap(Phase::Composite, now);
        if kept > 0 {
            self.backward(job, batch, rays.start, pass);
            if let Some(question) = &batch.question {
                let (states, samples) = (&self.evaluated.rays, &self.samples);
                let chunk = Shaded { batch, first_ray: rays.start, states, samples };
                let passes = (&self.evaluated, &self.shade);
                self.of_rays.gradients(job, chunk, passes, question, &self.upper, &mut pass.rays);
            }
            self.phases.lap(Phase::Backward, now);
        }
    }

    /// Returns the weighted sum of squared errors of `rays`. Sets `by_shown`, `by_transmittance` and `by_weight`. The
    /// gradient in `by_weight` is of the distortion, smoothness and depth losses; `backward` adds the squared error's
    /// gradient.
    fn loss(&mut self, batch: &Batch, rays: Range<usize>, pass: &mut Pass) -> f64 {
        self.distort(batch);
        let read = (&self.evaluated, &self.samples);
        smoothness::add_gradient(batch, rays.clone(), read, &mut self.by_weight);
        self.by_shown.clear();
        self.by_transmittance.clear();
        let mut squared = 0.0;
        let (states, samples) = (&self.evaluated.rays, &self.samples);
        let chunk = Shaded { batch, first_ray: rays.start, states, samples };
        let scale = 2.0 / (3 * batch.rays.len()) as f32;
        for (i, index) in rays.enumerate() {
            let (ray, transmittance) = (&batch.rays[index], self.evaluated.rays[i].transmittance);
            let shown = self.shade.shown(i, chunk);
            let gain = batch.gains.get(index).copied().unwrap_or([1.0; 3]);
            let error: [f32; 3] = std::array::from_fn(|k| {
                let seen = gain[k] * shown[k] + ray.background[k] * transmittance;
                clipped_error(seen, ray.rgb[k], gain[k])
            });
            let weight = batch.weights.get(index).copied().unwrap_or(1.0);
            squared += f64::from(weight) * error.iter().map(|&e| f64::from(e) * f64::from(e)).sum::<f64>();
            let by_seen: [f32; 3] = std::array::from_fn(|k| scale * weight * error[k]);
            let gradient: [f32; 3] = std::array::from_fn(|k| by_seen[k] * gain[k]);
            if let Some(&view) = batch.views.get(index) {
                pass.errors.push((index as u32, error));
                pass.gains.push((view, std::array::from_fn(|k| gradient[k] * shown[k])));
            }
            self.by_shown.push(gradient);
            let of_background: f32 = by_seen.iter().zip(ray.background).map(|(g, c)| g * c).sum();
            let read = (&self.evaluated, &self.samples);
            let of_surface = draw_to_surface(batch, index, i, read, &mut self.by_weight);
            self.by_transmittance.push(of_background + of_surface);
        }
        squared
    }

    /// Sets `by_weight` to the gradient of the distortion loss with respect to each kept sample's compositing weight.
    fn distort(&mut self, batch: &Batch) {
        let Self { samples, evaluated, by_weight, gaps, .. } = self;
        let kept = samples.len();
        by_weight.clear();
        by_weight.resize(kept, 0.0);
        if batch.distortion == 0.0 {
            return;
        }
        let position = |i: usize| batch.positions[evaluated.index_of[samples.row[i] as usize] as usize];
        // A ray's first gap is measured from a sample of another ray, and is not used.
        let gap = |i: usize| {
            let (from, to) = (position(i.saturating_sub(1)), position(i));
            (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum::<f32>().sqrt()
        };
        gaps.clear();
        gaps.extend((0..kept).map(gap));
        for state in &evaluated.rays {
            let kept = state.kept.0..state.kept.1;
            let gradient = &mut by_weight[kept.clone()];
            distortion_gradient(&samples.counted[kept.clone()], &gaps[kept], gradient);
        }
        let weight = batch.distortion / batch.rays.len() as f32;
        by_weight.iter_mut().for_each(|g| *g *= weight);
    }

    /// Does the backward pass from the gradients that `loss` sets. Adds layers' gradients and kept samples to `pass`.
    /// `first_ray`: index in the batch of the chunk's first ray.
    fn backward(&mut self, job: &Job<'_>, batch: &Batch, first_ray: usize, pass: &mut Pass) {
        let Self { evaluated, samples, shade, by_weight, upper, lower, .. } = self;
        let chunk = Shaded { batch, first_ray, states: &evaluated.rays, samples };
        shade.backward(job, chunk, &self.by_shown, &mut pass.sums, by_weight, upper);
        let (isa, kept, layers) = (job.isa, samples.len(), job.layers);
        if let Some(density) = &layers.density {
            raw_densities(evaluated, samples, by_weight, &self.by_transmittance, &mut self.d_raw);
            let (density, across) = (&density.main, padded(density.main.inputs));
            let sum = &mut pass.sums.main[layers.trunk.len()];
            density.add_gradient(isa, kept, samples.features(), across, &self.d_raw, sum);
            density.backward(isa, kept, &self.d_raw, upper, Init::Accumulate);
        }
        for (l, layer) in layers.trunk.iter().enumerate().rev() {
            let across = padded(layer.main.outputs);
            isa.run(Mask { d: &mut upper[..kept * across], h: &samples.hidden[l][..kept * across] });
            let x = if l == 0 { &samples.encoded } else { &samples.hidden[l - 1] };
            let x_row = padded(layer.main.inputs);
            layer.main.add_gradient(isa, kept, x, x_row, upper, &mut pass.sums.main[l]);
            grow(lower, padded(kept) * x_row);
            layer.main.backward(isa, kept, upper, lower, Init::Zero);
            std::mem::swap(upper, lower);
        }
        pass.kept.width = padded(job.grid.outputs());
        pass.kept.extend(isa, &upper[..kept * pass.kept.width]);
        pass.kept.weights.extend_from_slice(&samples.weight);
        for (axis, positions) in pass.kept.positions.iter_mut().enumerate() {
            let along = |&row: &u32| batch.positions[evaluated.index_of[row as usize] as usize][axis];
            positions.extend(samples.row.iter().map(along));
        }
    }
}

/// Adds the gradient dL/dw of a ray's depth loss L, with respect to the compositing weights, to `by_weight`. Returns
/// dL/dT for the transmittance T after the last sample; 0 if the ray has no known surface. `index`: index of the ray in
/// the batch; `ray`: index of the ray in the chunk.
fn draw_to_surface(
    batch: &Batch,
    index: usize,
    ray: usize,
    (evaluated, samples): (&Evaluated, &Samples),
    by_weight: &mut [f32],
) -> f32 {
    let Some(surface) = batch.surfaces.get(index) else { return 0.0 };
    let weight = surface.weight / batch.rays.len() as f32;
    let (first, end) = evaluated.rays[ray].kept;
    for (by_weight, &row) in by_weight[first..end].iter_mut().zip(&samples.row[first..end]) {
        let sample = evaluated.index_of[row as usize] as usize;
        let along = batch.along.get(sample).copied().unwrap_or(surface.at);
        *by_weight += weight * (along - surface.at).abs().min(Surface::CLIP);
    }
    weight * Surface::CLIP
}

/// Writes to `d_raw` the gradient of the loss with respect to each kept sample's raw density: a term for the colour
/// that the sample adds, minus a term for the colour behind the sample, which it hides.
fn raw_densities(
    evaluated: &Evaluated,
    samples: &Samples,
    by_weight: &[f32],
    by_transmittance: &[f32],
    d_raw: &mut Vec<f32>,
) {
    grow(d_raw, padded(samples.len()) * VECTOR);
    for (state, by_transmittance) in evaluated.rays.iter().zip(by_transmittance) {
        let mut behind = by_transmittance * state.transmittance;
        for i in (state.kept.0..state.kept.1).rev() {
            let row = samples.row[i] as usize;
            let of_depth = by_weight[i] * samples.after[i] - behind;
            behind += samples.counted[i] * by_weight[i];
            // d sigma / d raw is sigma below the limit of the exponential, and 0 above.
            let sigma = evaluated.sigma[row];
            let slope = if sigma < EXPONENTIAL_LIMIT.exp() { sigma } else { 0.0 };
            // In this order of factors: sigma times the length of a wide bin alone may overflow.
            d_raw[i * VECTOR] =
                samples.scale[i] * samples.inverse_probability[i] * slope * of_depth * evaluated.deltas[row];
        }
    }
}

/// Returns a channel's error `shown − rgb`, or 0 if `gain` is not 1, `rgb` is clipped at white and `shown` is above 1.
fn clipped_error(shown: f32, rgb: f32, gain: f32) -> f32 {
    if gain != 1.0 && rgb >= CLIPPED && shown > 1.0 { 0.0 } else { shown - rgb }
}
