//! One accumulator's work: chunks of rays, forward and backward.
//!
//! One file, long as it is, since its methods share one state.

use super::distortion::distortion_gradient;
use super::layers::{Layer, LayerSums, Layers, padded};
use super::rays::{RaySamples, RayScratch};
use super::scatter::Kept;
use super::vector::{VECTOR, exponentials, mask, sigmoids, to_rows, transmitted};
use crate::model::engine::{Batch, Model, Phase, Phases, RayGradient, Surface};
use nerf_core::encoding::{
    DirectionEncoding, GridEncoding, GridTables, encode_block, encode_grid_block, encode_harmonics_block,
};
use nerf_core::math::MathBackend;
use nerf_core::matrix::Init;
use nerf_core::network::EXPONENTIAL_LIMIT;
use nerf_core::sampling::{Purpose, uniform};
use nerf_core::simd::Isa;
use std::ops::{Add, Range};
use std::time::Instant;

/// Samples of a ray that are evaluated before it is asked whether light is left.
const WAVE: usize = 8;
/// Transmittance below which the rest of a ray is left out.
pub(super) const T_MIN: f32 = 1e-3;
/// Samples whose weight is at most this are neither coloured nor trained.
pub(super) const GATE: f32 = 1e-3;
/// Where faint samples are drawn ([`Batch::faint`]): the weight below which a sample is kept with a chance of its share of
/// this, and then stands for all that were not.
pub(super) const FAINT: f32 = 3e-3;

/// Value from which on a photograph's channel counts as clipped at white.
const CLIPPED: f32 = 250.0 / 255.0;

/// What a chunk is computed from.
#[derive(Clone, Copy)]
pub(super) struct Job<'a> {
    pub isa: Isa,
    pub model: &'a Model,
    pub grid: &'a GridEncoding,
    pub tables: GridTables<'a>,
    pub layers: &'a Layers,
}

/// Sums over an accumulator's chunks.
#[derive(Clone, Copy, Default)]
pub(super) struct Totals {
    /// Of (C − rgb)² over rays and channels.
    pub squared: f64,
    /// Samples whose density was evaluated.
    pub evaluated: usize,
    /// Samples with a colour and a backward pass.
    pub kept: usize,
}

impl Add for Totals {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            squared: self.squared + other.squared,
            evaluated: self.evaluated + other.evaluated,
            kept: self.kept + other.kept,
        }
    }
}

/// A ray of the chunk under way.
#[derive(Clone, Copy, Default)]
struct RayState {
    /// Its first sample in the batch, and how many there are.
    first: usize,
    samples: usize,
    /// How many are evaluated.
    evaluated: usize,
    /// Optical depth of those.
    depth: f32,
    /// Its kept samples, in the chunk.
    kept: (usize, usize),
    /// Transmittance behind its last sample.
    left: f32,
}

/// What an accumulator adds up.
#[derive(Default)]
pub(super) struct Pass {
    pub totals: Totals,
    pub sums: LayerSums,
    pub kept: Kept,
    /// Gradients by log gain, with the photographs they are of.
    pub gains: Vec<(u32, [f32; 3])>,
    /// Index in the batch and colour error of each ray whose photograph is given.
    pub errors: Vec<(u32, [f32; 3])>,
    /// Gradients by rays, where those are asked for.
    pub rays: Vec<RayGradient>,
}

/// A thread's buffers for the chunk under way; all are reused from step to step.
#[derive(Default)]
pub(super) struct Scratch {
    rays: Vec<RayState>,
    alive: Vec<usize>,
    /// For each sample of the chunk, in the batch's order, its row among those evaluated.
    row_of: Vec<u32>,
    /// Evaluated samples in the order of evaluation: positions, bin widths, rows.
    points: Vec<f32>,
    channels: Vec<f32>,
    index_of: Vec<u32>,
    deltas: Vec<f32>,
    encoded: Vec<f32>,
    /// One array of rows a trunk layer.
    hidden: Vec<Vec<f32>>,
    raw: Vec<f32>,
    sigma: Vec<f32>,
    passed: Vec<f32>,
    /// Of the kept samples, in the rays' order.
    kept_row: Vec<u32>,
    kept_ray: Vec<u32>,
    weight: Vec<f32>,
    after: Vec<f32>,
    /// How many samples of its kind each stands for: 1, but of faint ones that were drawn.
    stands_for: Vec<f32>,
    /// Of the kept samples: weights as often as they count, the gaps in front of them, the gradient by weight of the
    /// terms that do not depend on colour.
    counted: Vec<f32>,
    gaps: Vec<f32>,
    by_weight: Vec<f32>,
    kept_encoded: Vec<f32>,
    kept_hidden: Vec<Vec<f32>>,
    coloured: Vec<Vec<f32>>,
    d_raw: Vec<f32>,
    upper: Vec<f32>,
    lower: Vec<f32>,
    /// Directions, `[rays][…]`.
    dirs: Vec<f32>,
    dir_channels: Vec<f32>,
    dir_rows: Vec<f32>,
    shares: Vec<f32>,
    of_rays: RayScratch,
    pub phases: Phases,
}

/// Makes room for `length` values; never shrinks.
fn grow(buffer: &mut Vec<f32>, length: usize) {
    if buffer.len() < length {
        buffer.resize(length, 0.0);
    }
}

impl Pass {
    pub fn new(layers: &Layers) -> Self {
        Self { sums: LayerSums::new(layers), ..Self::default() }
    }

    /// Forgets sums, totals and kept samples.
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
            hidden: vec![Vec::new(); layers.trunk.len()],
            kept_hidden: vec![Vec::new(); layers.trunk.len()],
            coloured: vec![Vec::new(); layers.colour.len()],
            ..Self::default()
        }
    }

    /// Adds the loss and gradients of `rays`, whose first sample is `first`.
    pub fn run(&mut self, job: &Job<'_>, batch: &Batch, rays: Range<usize>, first: usize, pass: &mut Pass) {
        pass.totals.evaluated += match &job.layers.density {
            Some(density) => {
                let evaluated = self.evaluate(job, density, batch, rays.clone(), first);
                let now = Instant::now();
                self.keep(job, batch.faint, evaluated, first);
                self.phases.lap(Phase::Composite, now);
                evaluated
            }
            None => self.opaque(job, batch, rays.clone(), first),
        };
        let (now, first_ray) = (Instant::now(), rays.start);
        let kept = self.kept_row.len();
        pass.totals.kept += kept;
        if kept > 0 {
            self.colour(job, batch, rays.clone());
        }
        let now = self.phases.lap(Phase::Forward, now);
        pass.totals.squared += self.loss(job, batch, rays, pass);
        let now = self.phases.lap(Phase::Composite, now);
        if kept > 0 {
            self.backward(job, batch, pass);
            if let Some(question) = &batch.question {
                let kept = RaySamples {
                    samples: self.kept_row.iter().map(|&row| self.index_of[row as usize]),
                    rays: &self.kept_ray,
                    gradients: &self.upper[..kept * pass.kept.width],
                    first_ray,
                };
                self.of_rays.gradients(job, batch, question, kept, &mut pass.rays);
            }
            self.phases.lap(Phase::Backward, now);
        }
    }

    /// Densities of the rays' samples, wave by wave; their number.
    fn evaluate(
        &mut self,
        job: &Job<'_>,
        density: &Layer,
        batch: &Batch,
        rays: Range<usize>,
        first: usize,
    ) -> usize {
        self.rays.clear();
        let mut next = first;
        for ray in &batch.rays[rays] {
            let samples = ray.samples as usize;
            self.rays.push(RayState { first: next, samples, left: 1.0, ..RayState::default() });
            next += samples;
        }
        self.row_of.clear();
        self.row_of.resize(next - first, 0);
        self.alive.clear();
        self.alive.extend((0..self.rays.len()).filter(|&ray| self.rays[ray].samples > 0));
        self.index_of.clear();
        let mut count = 0;
        let mut now = Instant::now();
        while !self.alive.is_empty() {
            for &ray in &self.alive {
                let RayState { first: start, samples, evaluated, .. } = self.rays[ray];
                for sample in start + evaluated..start + samples.min(evaluated + WAVE) {
                    self.row_of[sample - first] = self.index_of.len() as u32;
                    self.index_of.push(sample as u32);
                }
            }
            let end = self.index_of.len();
            self.phases.lap(Phase::Composite, now);
            self.densities(job, density, batch, count..end);
            now = Instant::now();
            let mut row = count;
            let (rays, sigma, deltas) = (&mut self.rays, &self.sigma, &self.deltas);
            self.alive.retain(|&ray| {
                let state = &mut rays[ray];
                let taken = WAVE.min(state.samples - state.evaluated);
                for i in row..row + taken {
                    state.depth += sigma[i] * deltas[i];
                }
                row += taken;
                state.evaluated += taken;
                state.evaluated < state.samples && state.depth < -T_MIN.ln()
            });
            count = end;
        }
        self.phases.lap(Phase::Composite, now);
        count
    }

    /// Evaluates and keeps the first sample of each ray of a 2D field, where every one is opaque; their number.
    fn opaque(&mut self, job: &Job<'_>, batch: &Batch, rays: Range<usize>, first: usize) -> usize {
        self.rays.clear();
        for list in [&mut self.index_of, &mut self.kept_row, &mut self.kept_ray] {
            list.clear();
        }
        let mut next = first;
        for (ray, of_batch) in batch.rays[rays].iter().enumerate() {
            let (begin, samples) = (self.index_of.len(), of_batch.samples as usize);
            if samples > 0 {
                self.kept_row.push(begin as u32);
                self.kept_ray.push(ray as u32);
                self.index_of.push(next as u32);
            }
            let kept = (begin, self.index_of.len());
            let left = if samples > 0 { 0.0 } else { 1.0 };
            self.rays.push(RayState { first: next, samples, left, kept, ..RayState::default() });
            next += samples;
        }
        let count = self.index_of.len();
        self.weight.clear();
        self.weight.resize(count, 1.0);
        self.after.clear();
        self.after.resize(count, 0.0);
        self.stands_for.clear();
        self.stands_for.resize(count, 1.0);
        if count > 0 {
            self.trunk(job, batch, 0..count);
        }
        std::mem::swap(&mut self.encoded, &mut self.kept_encoded);
        std::mem::swap(&mut self.hidden, &mut self.kept_hidden);
        count
    }

    /// Encodes samples `range` of those listed in `index_of`, and evaluates the trunk.
    fn trunk(&mut self, job: &Job<'_>, batch: &Batch, range: Range<usize>) {
        let now = Instant::now();
        let (count, stride) = (range.len(), padded(range.len()));
        grow(&mut self.points, 3 * stride);
        grow(&mut self.deltas, range.end.next_multiple_of(VECTOR) + VECTOR);
        for (i, &sample) in self.index_of[range.clone()].iter().enumerate() {
            let position = batch.positions[sample as usize];
            for (axis, &x) in position.iter().enumerate() {
                self.points[axis * stride + i] = x;
            }
            self.deltas[range.start + i] = batch.deltas[sample as usize];
        }
        for axis in 0..3 {
            let last = self.points[axis * stride + count - 1];
            self.points[axis * stride + count..(axis + 1) * stride].fill(last);
        }
        let outputs = job.grid.outputs();
        grow(&mut self.channels, outputs * stride);
        encode_grid_block(
            job.isa,
            job.grid,
            &job.tables,
            stride,
            &self.points[..3 * stride],
            &mut self.channels,
        );
        let width = padded(outputs);
        grow(&mut self.encoded, (range.start + stride) * width);
        let rows = &mut self.encoded[range.start * width..][..count * width];
        to_rows(&self.channels[..outputs * stride], stride, count, rows, width);
        let now = self.phases.lap(Phase::Encode, now);
        for (l, layer) in job.layers.trunk.iter().enumerate() {
            let (before, rest) = self.hidden.split_at_mut(l);
            let across = padded(layer.main.outputs);
            grow(&mut rest[0], (range.start + stride) * across);
            let (x, x_row) = match before.last() {
                Some(x) => (x, padded(layer.main.inputs)),
                None => (&self.encoded, width),
            };
            let y = &mut rest[0][range.start * across..];
            layer.main.forward(job.isa, count, &x[range.start * x_row..], x_row, y, Init::Zero, true);
        }
        self.phases.lap(Phase::Forward, now);
    }

    /// Densities of samples `range` of those listed in `index_of`.
    fn densities(&mut self, job: &Job<'_>, density: &Layer, batch: &Batch, range: Range<usize>) {
        self.trunk(job, batch, range.clone());
        let now = Instant::now();
        let (count, stride) = (range.len(), padded(range.len()));
        let across = padded(density.main.inputs);
        let h = &self.hidden[self.hidden.len() - 1][range.start * across..];
        grow(&mut self.raw, stride * VECTOR);
        density.main.forward(job.isa, count, h, across, &mut self.raw, Init::Zero, false);
        // The first column of each row, in place: reading runs ahead of writing.
        for i in 0..count {
            self.raw[i] = self.raw[i * VECTOR];
        }
        self.raw[count..stride].fill(0.0);
        grow(&mut self.sigma, range.start + stride);
        let sigma = &mut self.sigma[range.start..range.start + stride];
        exponentials(job.isa, &self.raw[..stride], job.layers.bias, EXPONENTIAL_LIMIT, sigma);
        self.phases.lap(Phase::Forward, now);
    }

    /// Weights along the rays; the samples that weigh more than the gate are kept, and of the others those that are drawn.
    fn keep(&mut self, job: &Job<'_>, faint: Option<(u64, u64)>, evaluated: usize, first: usize) {
        let stride = padded(evaluated);
        grow(&mut self.passed, stride);
        grow(&mut self.sigma, stride);
        grow(&mut self.deltas, stride);
        transmitted(job.isa, &self.sigma[..stride], &self.deltas[..stride], &mut self.passed[..stride]);
        for list in [&mut self.kept_row, &mut self.kept_ray] {
            list.clear();
        }
        self.weight.clear();
        self.after.clear();
        self.stands_for.clear();
        let gate = if faint.is_some() { FAINT } else { GATE };
        for (ray, state) in self.rays.iter_mut().enumerate() {
            let mut left = 1.0f32;
            let begin = self.kept_row.len();
            for sample in state.first..state.first + state.evaluated {
                let row = self.row_of[sample - first];
                let passed = self.passed[row as usize];
                let (weight, after) = (left * (1.0 - passed), left * passed);
                // NaN is kept, so that the loss shows it.
                let heavy = weight > gate || weight.is_nan();
                let drawn = |(seed, step)| uniform(seed, Purpose::Faint, step, sample as u64) * gate < weight;
                if heavy || faint.is_some_and(drawn) {
                    self.stands_for.push(if heavy { 1.0 } else { gate / weight });
                    self.kept_row.push(row);
                    self.kept_ray.push(ray as u32);
                    self.weight.push(weight);
                    self.after.push(after);
                }
                left = after;
                if left < T_MIN {
                    break;
                }
            }
            state.left = left;
            state.kept = (begin, self.kept_row.len());
        }
        let width = padded(job.grid.outputs());
        take_rows(&self.encoded, width, &self.kept_row, &mut self.kept_encoded);
        for (l, layer) in job.layers.trunk.iter().enumerate() {
            let across = padded(layer.main.outputs);
            take_rows(&self.hidden[l], across, &self.kept_row, &mut self.kept_hidden[l]);
        }
    }

    /// Colours of the kept samples.
    fn colour(&mut self, job: &Job<'_>, batch: &Batch, rays: Range<usize>) {
        let kept = self.kept_row.len();
        self.directions(job, batch, rays);
        for (l, layer) in job.layers.colour.iter().enumerate() {
            let (before, rest) = self.coloured.split_at_mut(l);
            let y = &mut rest[0];
            let across = padded(layer.main.outputs);
            grow(y, padded(kept) * across);
            let init = if layer.extra.is_some() {
                for (row, &ray) in y.chunks_exact_mut(across).zip(&self.kept_ray) {
                    copy_row(&self.shares[ray as usize * across..], row);
                }
                Init::Accumulate
            } else {
                Init::Zero
            };
            let x = before.last().unwrap_or(&self.kept_hidden[self.kept_hidden.len() - 1]);
            let relu = l + 1 < job.layers.colour.len();
            layer.main.forward(job.isa, kept, x, padded(layer.main.inputs), y, init, relu);
        }
        let rgb = self.coloured.last_mut().expect("a colour layer");
        sigmoids(job.isa, &mut rgb[..kept * VECTOR]);
    }

    /// The direction's share of the first colour layer, `[rays][padded outputs]`.
    fn directions(&mut self, job: &Job<'_>, batch: &Batch, rays: Range<usize>) {
        let Some(direction) = &job.model.architecture.direction else { return };
        let Some(extra) = job.layers.colour.iter().find_map(|layer| layer.extra.as_ref()) else { return };
        let (count, stride) = (rays.len(), padded(rays.len()));
        grow(&mut self.dirs, 3 * stride);
        for (i, ray) in batch.rays[rays].iter().enumerate() {
            for axis in 0..3 {
                self.dirs[axis * stride + i] = ray.dir[axis];
            }
        }
        let outputs = direction.outputs();
        grow(&mut self.dir_channels, outputs * stride);
        let (dirs, out) = (&self.dirs[..3 * stride], &mut self.dir_channels[..]);
        match direction {
            DirectionEncoding::Sinusoidal(encoding) => {
                encode_block(job.isa, MathBackend::Polynomial, encoding, stride, dirs, out);
            }
            DirectionEncoding::SphericalHarmonics { degree } => {
                encode_harmonics_block(job.isa, *degree, stride, dirs, out);
            }
        }
        let width = padded(outputs);
        grow(&mut self.dir_rows, count * width);
        let channels = &self.dir_channels[..outputs * stride];
        to_rows(channels, stride, count, &mut self.dir_rows[..count * width], width);
        grow(&mut self.shares, count * padded(extra.outputs));
        extra.forward(job.isa, count, &self.dir_rows, width, &mut self.shares, Init::Zero, false);
    }

    /// Puts the gradient of the distortion loss by the weight of each kept sample into `by_weight`.
    fn distort(&mut self, batch: &Batch) {
        let kept = self.kept_row.len();
        self.by_weight.clear();
        self.by_weight.resize(kept, 0.0);
        if batch.distortion == 0.0 {
            return;
        }
        let position = |i: usize| batch.positions[self.index_of[self.kept_row[i] as usize] as usize];
        // In front of a ray's first sample lies another ray's: nothing is made of that gap.
        let gap = |i: usize| {
            let (from, to) = (position(i.saturating_sub(1)), position(i));
            (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum::<f32>().sqrt()
        };
        self.counted.clear();
        self.counted.extend(self.stands_for.iter().zip(&self.weight).map(|(count, weight)| count * weight));
        self.gaps.clear();
        self.gaps.extend((0..kept).map(gap));
        for state in &self.rays {
            let kept = state.kept.0..state.kept.1;
            let gradient = &mut self.by_weight[kept.clone()];
            distortion_gradient(&self.counted[kept.clone()], &self.gaps[kept], gradient);
        }
        let weight = batch.distortion / batch.rays.len() as f32;
        self.by_weight.iter_mut().for_each(|g| *g *= weight);
    }

    /// Adds the gradient by weight of the known surface of the ray, of the chunk's number `ray` and the batch's `index`;
    /// gives that by the transmittance behind its last sample.
    fn draw_to_surface(&mut self, batch: &Batch, ray: usize, index: usize) -> f32 {
        let Some(surface) = batch.surfaces.get(index) else { return 0.0 };
        let weight = surface.weight / batch.rays.len() as f32;
        let kept = self.rays[ray].kept;
        for i in kept.0..kept.1 {
            let sample = self.index_of[self.kept_row[i] as usize] as usize;
            let along = batch.along.get(sample).copied().unwrap_or(surface.at);
            self.by_weight[i] += weight * (along - surface.at).abs().min(Surface::CLIP);
        }
        weight * Surface::CLIP
    }

    /// Sum of the pixels' squared errors; the gradients of colours before their sigmoid in `upper`, of raw densities in `d_raw`.
    fn loss(&mut self, job: &Job<'_>, batch: &Batch, rays: Range<usize>, pass: &mut Pass) -> f64 {
        let mut squared = 0.0;
        let kept = self.kept_row.len();
        grow(&mut self.upper, padded(kept) * VECTOR);
        self.upper[..kept * VECTOR].fill(0.0);
        grow(&mut self.d_raw, padded(kept) * VECTOR);
        self.d_raw[..kept * VECTOR].fill(0.0);
        self.distort(batch);
        let by_left: Vec<f32> =
            (0..self.rays.len()).map(|ray| self.draw_to_surface(batch, ray, rays.start + ray)).collect();
        let empty = Vec::new();
        let rgb = if kept > 0 { self.coloured.last().unwrap_or(&empty) } else { &empty };
        let scale = 2.0 / (3 * batch.rays.len()) as f32;
        for ((state, by_left), index) in self.rays.iter().zip(by_left).zip(rays) {
            let ray = &batch.rays[index];
            let mut seen = ray.background.map(|c| c * state.left);
            let range = state.kept.0..state.kept.1;
            for i in range.clone() {
                for (k, seen) in seen.iter_mut().enumerate() {
                    *seen += self.stands_for[i] * self.weight[i] * rgb[i * VECTOR + k];
                }
            }
            let gain = batch.gains.get(index).copied().unwrap_or([1.0; 3]);
            let error: [f32; 3] =
                std::array::from_fn(|k| clipped_error(gain[k] * seen[k], ray.rgb[k], gain[k]));
            let weight = batch.weights.get(index).copied().unwrap_or(1.0);
            squared += f64::from(weight) * error.iter().map(|&e| f64::from(e) * f64::from(e)).sum::<f64>();
            let gradient: [f32; 3] = std::array::from_fn(|k| scale * weight * error[k] * gain[k]);
            if let Some(&view) = batch.views.get(index) {
                pass.errors.push((index as u32, error));
                pass.gains.push((view, std::array::from_fn(|k| gradient[k] * seen[k])));
            }
            let mut behind = ray.background.map(|c| c * state.left);
            let mut behind_by_weight = by_left * state.left;
            for i in range.rev() {
                let (mut of_depth, stands_for) = (0.0, self.stands_for[i]);
                let row = self.kept_row[i] as usize;
                let scale = batch.gradient_scales.get(self.index_of[row] as usize).copied().unwrap_or(1.0);
                let weight = stands_for * self.weight[i];
                for k in 0..3 {
                    let colour = rgb[i * VECTOR + k];
                    of_depth += gradient[k] * (colour * self.after[i] - behind[k]);
                    behind[k] += weight * colour;
                    self.upper[i * VECTOR + k] = scale * gradient[k] * weight * colour * (1.0 - colour);
                }
                if job.layers.density.is_none() {
                    continue;
                }
                of_depth += self.by_weight[i] * self.after[i] - behind_by_weight;
                behind_by_weight += weight * self.by_weight[i];
                // sigma' = sigma below the limit of the exponential, and 0 above.
                let sigma = self.sigma[row];
                let slope = if sigma < EXPONENTIAL_LIMIT.exp() { sigma } else { 0.0 };
                // In this order: a density times a wide bin may overflow where nothing is left to be seen.
                self.d_raw[i * VECTOR] = scale * stands_for * slope * of_depth * self.deltas[row];
            }
        }
        squared
    }

    /// From `upper` and `d_raw` to the layers' sums and the tables' samples.
    fn backward(&mut self, job: &Job<'_>, batch: &Batch, pass: &mut Pass) {
        let (isa, kept) = (job.isa, self.kept_row.len());
        let (trunk, layers) = (job.layers.trunk.len(), job.layers);
        let h = &self.kept_hidden[trunk - 1];
        for (l, layer) in layers.colour.iter().enumerate().rev() {
            let at = trunk + usize::from(layers.density.is_some()) + l;
            let x = if l == 0 { h } else { &self.coloured[l - 1] };
            let x_row = padded(layer.main.inputs);
            layer.main.add_gradient(isa, kept, x, x_row, &self.upper, &mut pass.sums.main[at]);
            if let Some(extra) = &layer.extra {
                // A ray's samples have its direction: their gradients are summed first.
                let across = padded(extra.outputs);
                let rays = self.rays.len();
                self.shares[..rays * across].fill(0.0);
                for (row, &ray) in self.upper.chunks_exact(across).zip(&self.kept_ray) {
                    let share = &mut self.shares[ray as usize * across..][..across];
                    share.iter_mut().zip(row).for_each(|(share, row)| *share += row);
                }
                let width = padded(extra.inputs);
                extra.add_gradient(isa, rays, &self.dir_rows, width, &self.shares, &mut pass.sums.extra[at]);
            }
            grow(&mut self.lower, padded(kept) * x_row);
            layer.main.backward(isa, kept, &self.upper, &mut self.lower, Init::Zero);
            std::mem::swap(&mut self.upper, &mut self.lower);
            if l > 0 {
                mask(isa, &mut self.upper[..kept * x_row], &x[..kept * x_row]);
            }
        }
        if let Some(density) = &layers.density {
            let (density, across) = (&density.main, padded(density.main.inputs));
            density.add_gradient(isa, kept, h, across, &self.d_raw, &mut pass.sums.main[trunk]);
            density.backward(isa, kept, &self.d_raw, &mut self.upper, Init::Accumulate);
        }
        for (l, layer) in layers.trunk.iter().enumerate().rev() {
            let across = padded(layer.main.outputs);
            mask(isa, &mut self.upper[..kept * across], &self.kept_hidden[l][..kept * across]);
            let (x, x_row) = match l {
                0 => (&self.kept_encoded, padded(layer.main.inputs)),
                _ => (&self.kept_hidden[l - 1], padded(layer.main.inputs)),
            };
            layer.main.add_gradient(isa, kept, x, x_row, &self.upper, &mut pass.sums.main[l]);
            grow(&mut self.lower, padded(kept) * x_row);
            layer.main.backward(isa, kept, &self.upper, &mut self.lower, Init::Zero);
            std::mem::swap(&mut self.upper, &mut self.lower);
        }
        pass.kept.width = padded(job.grid.outputs());
        pass.kept.extend(isa, &self.upper[..kept * pass.kept.width]);
        pass.kept.weights.extend_from_slice(&self.weight[..kept]);
        for (axis, positions) in pass.kept.positions.iter_mut().enumerate() {
            let along = |&row: &u32| batch.positions[self.index_of[row as usize] as usize][axis];
            positions.extend(self.kept_row.iter().map(along));
        }
    }
}

/// Error of a channel that is `shown`, after its photograph's `gain`, where the photograph has `rgb`: none beyond white
/// where it was clipped.
fn clipped_error(shown: f32, rgb: f32, gain: f32) -> f32 {
    if gain != 1.0 && rgb >= CLIPPED && shown > 1.0 { 0.0 } else { shown - rgb }
}

/// Copies the `rows` of `from`, `[…][width]`, into `to`.
fn take_rows(from: &[f32], width: usize, rows: &[u32], to: &mut Vec<f32>) {
    grow(to, padded(rows.len()) * width);
    for (to, &row) in to.chunks_exact_mut(width).zip(rows) {
        copy_row(&from[row as usize * width..], to);
    }
}

/// Copies a row of whole vectors, `from` may be longer: of some 16 values, for which a call would take longer.
fn copy_row(from: &[f32], to: &mut [f32]) {
    for (to, from) in to.as_chunks_mut::<VECTOR>().0.iter_mut().zip(from.as_chunks::<VECTOR>().0) {
        *to = *from;
    }
}
