//! One colour per ray (deferred shading): the colour branch takes the mean P of the samples' features h_i, weighted
//! with the compositing weights w_i. In a 2D field, P is the features of one sample.
//!
//! A: opacity of the ray; d: its direction; PE: encoding of the direction; o: output of the colour branch; L: loss.
//!
//! ```text
//! A = Σ w_i;  P = Σ w_i h_i / A;  shown = A · o,  o = sigmoid(branch [P, PE(d)])
//! dL/do = A · dL/dshown;  dL/dP through the branch;  D = dL/dP / A
//! dL/dw_i = dL/dshown · o + D · (h_i − P);  dL/dh_i = w_i D
//! ```

use super::directions::{Directions, harmonics_gradient};
use super::evaluate::RayState;
use super::layers::{LayerSums, Layers};
use super::pass::{Job, grow};
use super::samples::Samples;
use super::vector::{Mask, Sigmoids};
use crate::model::engine::graph::{VECTOR, padded};
use crate::model::engine::{Batch, BatchRay};
use glam::Vec3;
use nerf_core::encoding::DirectionEncoding;
use nerf_core::matrix::Init;
use nerf_core::simd::{Lanes, Op};
use std::ops::Range;

/// Chunk of rays whose colours are computed, with the rays' states and the kept samples.
#[derive(Clone, Copy)]
pub(super) struct Shaded<'a> {
    pub batch: &'a Batch,
    pub first_ray: usize,
    pub states: &'a [RayState],
    pub samples: &'a Samples,
}

impl<'a> Shaded<'a> {
    fn rays(&self) -> &'a [BatchRay] {
        &self.batch.rays[self.first_ray..]
    }
}

/// Forward and backward pass of the colour branch; its buffers have one row for each ray with kept samples.
#[derive(Default)]
pub(super) struct Shade {
    /// For each ray of the chunk: its row in the buffers; undefined for a ray without kept samples.
    row_of: Vec<usize>,
    rows: Vec<Row>,
    /// Mean features P, `[rows][padded features]`.
    mean: Vec<f32>,
    /// Outputs of each layer of the colour branch, `[rows][padded outputs]`.
    coloured: Vec<Vec<f32>>,
    directions: Directions,
    /// Gradient of the loss with respect to the encoded direction, `[rows][padded outputs]`.
    by_encoded_dir: Vec<f32>,
    upper: Vec<f32>,
    lower: Vec<f32>,
}

struct Row {
    ray: usize,
    samples: Range<usize>,
    /// Opacity A of the ray: the sum of its compositing weights.
    opacity: f32,
    /// Gradient dL/dA of the loss with respect to the opacity, at constant mean features P.
    by_opacity: f32,
}

impl Shade {
    pub fn new(layers: &Layers) -> Self {
        Self { coloured: vec![Vec::new(); layers.colour.len()], ..Self::default() }
    }

    /// Does the colour branch's backward pass, and adds the gradients of the branch's weights to `sums`. Before,
    /// `self.upper` is the gradient with respect to the branch's output before the sigmoid; afterwards, it is dL/dP. If
    /// `by_rays`, also sets `self.by_encoded_dir`.
    fn branch_backward(&mut self, job: &Job<'_>, by_rays: bool, sums: &mut LayerSums) {
        let (isa, count, layers) = (job.isa, self.rows.len(), job.layers);
        for (l, layer) in layers.colour.iter().enumerate().rev() {
            let at = layers.first_of_colour() + l;
            let x = if l == 0 { &self.mean } else { &self.coloured[l - 1] };
            let x_row = padded(layer.main.inputs);
            layer.main.add_gradient(isa, count, x, x_row, &self.upper, &mut sums.main[at]);
            if let Some(extra) = &layer.extra {
                let (rows, width) = (&self.directions.rows, padded(extra.inputs));
                extra.add_gradient(isa, count, rows, width, &self.upper, &mut sums.extra[at]);
                if by_rays {
                    grow(&mut self.by_encoded_dir, padded(count) * width);
                    extra.backward(isa, count, &self.upper, &mut self.by_encoded_dir, Init::Zero);
                }
            }
            grow(&mut self.lower, padded(count) * x_row);
            layer.main.backward(isa, count, &self.upper, &mut self.lower, Init::Zero);
            std::mem::swap(&mut self.upper, &mut self.lower);
            if l > 0 {
                isa.run(Mask { d: &mut self.upper[..count * x_row], h: &x[..count * x_row] });
            }
        }
    }

    /// Computes the colours of a chunk's rays. At least one ray must have a kept sample.
    pub fn forward(&mut self, job: &Job<'_>, chunk: Shaded<'_>) {
        let (rays, samples) = (chunk.rays(), chunk.samples);
        self.row_of.clear();
        self.rows.clear();
        for (ray, state) in chunk.states.iter().enumerate() {
            self.row_of.push(self.rows.len());
            let samples = state.kept.0..state.kept.1;
            if !samples.is_empty() {
                self.rows.push(Row { ray, samples, opacity: 0.0, by_opacity: 0.0 });
            }
        }
        let (count, width) = (self.rows.len(), padded(job.layers.features()));
        grow(&mut self.mean, padded(count) * width);
        job.isa.run(Mean { rows: &mut self.rows, samples, width, mean: &mut self.mean });
        self.directions.encode(job, self.rows.iter().map(|row| rays[row.ray].dir));
        for (l, layer) in job.layers.colour.iter().enumerate() {
            let (before, rest) = self.coloured.split_at_mut(l);
            let y = &mut rest[0];
            grow(y, padded(count) * padded(layer.main.outputs));
            let mut init = Init::Zero;
            if let Some(extra) = &layer.extra {
                let (rows, width) = (&self.directions.rows, padded(extra.inputs));
                extra.forward(job.isa, count, rows, width, y, init, false);
                init = Init::Accumulate;
            }
            let x = before.last().unwrap_or(&self.mean);
            let relu = l + 1 < job.layers.colour.len();
            layer.main.forward(job.isa, count, x, padded(layer.main.inputs), y, init, relu);
        }
        let rgb = self.coloured.last_mut().expect("a colour layer");
        job.isa.run(Sigmoids { x: &mut rgb[..count * VECTOR] });
    }

    /// Returns the composited colour of the chunk's ray `ray`, before gain and background; 0 without kept samples.
    pub fn shown(&self, ray: usize, chunk: Shaded<'_>) -> [f32; 3] {
        let (first, end) = chunk.states[ray].kept;
        if first == end {
            return [0.0; 3];
        }
        let (row, rgb) = (self.row_of[ray], self.coloured.last().expect("a colour layer"));
        [0, 1, 2].map(|k| self.rows[row].opacity * rgb[row * VECTOR + k])
    }

    /// Returns, for each ray with kept samples, the gradient of the loss with respect to the direction that the colour
    /// branch reads. Valid only after the backward pass of a batch that requests ray gradients.
    pub fn by_directions(&self, job: &Job<'_>, chunk: Shaded<'_>) -> impl Iterator<Item = Vec3> {
        let outputs = match job.model.architecture.direction {
            Some(direction @ DirectionEncoding::SphericalHarmonics { .. }) => direction.outputs(),
            _ => 0,
        };
        self.rows.iter().enumerate().map(move |(i, row)| {
            let by_encoded = &self.by_encoded_dir[i * padded(outputs)..][..outputs];
            harmonics_gradient(chunk.rays()[row.ray].dir, by_encoded)
        })
    }

    /// Does the backward pass from `by_shown`, dL/d (composited colour) of each ray. Adds dL/d (compositing weight) to
    /// `by_weight`, layer gradients to `sums`. Writes dL/d (features) to `by_features`, `[samples][padded features]`.
    pub fn backward(
        &mut self,
        job: &Job<'_>,
        chunk: Shaded<'_>,
        by_shown: &[[f32; 3]],
        sums: &mut LayerSums,
        by_weight: &mut [f32],
        by_features: &mut Vec<f32>,
    ) {
        let rgb = self.coloured.last().expect("a colour layer");
        grow(&mut self.upper, padded(self.rows.len()) * VECTOR);
        self.upper[..self.rows.len() * VECTOR].fill(0.0);
        for (i, row) in self.rows.iter_mut().enumerate() {
            row.by_opacity = 0.0;
            for (k, gradient) in by_shown[row.ray].iter().enumerate() {
                let colour = rgb[i * VECTOR + k];
                row.by_opacity += gradient * colour;
                self.upper[i * VECTOR + k] = row.opacity * gradient * colour * (1.0 - colour);
            }
        }
        self.branch_backward(job, chunk.batch.question.is_some(), sums);
        let width = padded(job.layers.features());
        grow(by_features, padded(chunk.samples.len()) * width);
        let Self { rows, mean, upper: by_mean, .. } = self;
        job.isa.run(OfSamples { rows, samples: chunk.samples, width, mean, by_mean, by_weight, by_features });
    }
}

struct Mean<'a> {
    rows: &'a mut [Row],
    samples: &'a Samples,
    width: usize,
    mean: &'a mut [f32],
}

impl Op for Mean<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { rows, samples, width, mean } = self;
        let (counted, features) = (&samples.counted, samples.features());
        for (row, mean) in rows.iter_mut().zip(mean.chunks_exact_mut(width)) {
            let weights = &counted[row.samples.clone()];
            row.opacity = weights.iter().sum();
            let features = &features[row.samples.start * width..row.samples.end * width];
            for at in (0..width).step_by(V::COUNT) {
                let mut sum = V::splat(0.0);
                for (&weight, features) in weights.iter().zip(features.chunks_exact(width)) {
                    sum = V::splat(weight).mul_add(V::load(&features[at..]), sum);
                }
                sum.div(V::splat(row.opacity)).store(&mut mean[at..]);
            }
        }
    }
}

/// Computes dL/dw_i and dL/dh_i of the kept samples from dL/dP; the module's documentation defines the symbols.
struct OfSamples<'a> {
    rows: &'a [Row],
    samples: &'a Samples,
    width: usize,
    mean: &'a [f32],
    by_mean: &'a mut [f32],
    by_weight: &'a mut [f32],
    by_features: &'a mut [f32],
}

impl Op for OfSamples<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { rows, samples, width, mean, by_mean, by_weight, by_features } = self;
        let features = samples.features();
        let by_mean = by_mean.chunks_exact_mut(width);
        for ((row, mean), by_sum) in rows.iter().zip(mean.chunks_exact(width)).zip(by_mean) {
            let inverse = V::splat(1.0 / row.opacity);
            for by_sum in by_sum.chunks_exact_mut(V::COUNT) {
                V::load(by_sum).mul(inverse).store(by_sum);
            }
            for i in row.samples.clone() {
                by_weight[i] += row.by_opacity + dot::<V>(by_sum, &features[i * width..][..width], mean);
                let weight = V::splat(samples.scale[i] * samples.counted[i]);
                let out = by_features[i * width..][..width].chunks_exact_mut(V::COUNT);
                for (out, by_sum) in out.zip(by_sum.chunks_exact(V::COUNT)) {
                    V::load(by_sum).mul(weight).store(out);
                }
            }
        }
    }
}

#[inline(always)]
fn dot<V: Lanes>(a: &[f32], b: &[f32], c: &[f32]) -> f32 {
    let mut sum = V::splat(0.0);
    let columns = a.chunks_exact(V::COUNT).zip(b.chunks_exact(V::COUNT)).zip(c.chunks_exact(V::COUNT));
    for ((a, b), c) in columns {
        sum = V::load(a).mul_add(V::load(b).sub(V::load(c)), sum);
    }
    let mut lanes = [0.0; VECTOR];
    sum.store(&mut lanes);
    let mut half = V::COUNT;
    while half > 1 {
        half /= 2;
        for i in 0..half {
            lanes[i] += lanes[i + half];
        }
    }
    lanes[0]
}
