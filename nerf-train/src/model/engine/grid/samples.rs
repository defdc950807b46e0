//! Kept samples of a chunk: the samples that are coloured and trained.

use super::evaluate::Evaluated;
use super::pass::{GATE, Job, ROULETTE_WEIGHT, T_MIN, grow};
use super::vector::{Transmitted, copy_row};
use crate::model::engine::Batch;
use crate::model::engine::graph::padded;
use nerf_core::sampling::{Purpose, uniform};

/// Kept samples of a chunk, ray after ray.
#[derive(Default)]
pub(super) struct Samples {
    /// Index of each kept sample's row in [`Evaluated`].
    pub row: Vec<u32>,
    /// Index in the chunk of each kept sample's ray.
    pub ray: Vec<u32>,
    pub weight: Vec<f32>,
    pub after: Vec<f32>,
    /// Inverse of the probability with which each sample was kept; 1 if the sample was sure to be kept.
    pub inverse_probability: Vec<f32>,
    pub counted: Vec<f32>,
    pub scale: Vec<f32>,
    /// Encoded positions, `[samples][padded channels]`.
    pub encoded: Vec<f32>,
    /// Outputs of each trunk layer, `[samples][padded outputs]`.
    pub hidden: Vec<Vec<f32>>,
    passed: Vec<f32>,
}

impl Samples {
    pub fn new(trunk: usize) -> Self {
        Self { hidden: vec![Vec::new(); trunk], ..Self::default() }
    }

    pub fn len(&self) -> usize {
        self.row.len()
    }

    /// Returns the features that density and colour read: outputs of the trunk or, without a trunk, encoded positions.
    pub fn features(&self) -> &[f32] {
        self.hidden.last().unwrap_or(&self.encoded)
    }

    /// Chooses the kept samples by compositing weight: all above [`GATE`] or, with Russian roulette, all above
    /// [`ROULETTE_WEIGHT`] and a random choice of those below. `first`: index in the batch of the chunk's first sample.
    pub fn keep(&mut self, job: &Job<'_>, batch: &Batch, evaluated: &mut Evaluated, first: usize) {
        let stride = padded(evaluated.index_of.len());
        grow(&mut self.passed, stride);
        grow(&mut evaluated.sigma, stride);
        grow(&mut evaluated.deltas, stride);
        let (a, b) = (&evaluated.sigma[..stride], &evaluated.deltas[..stride]);
        job.isa.run(Transmitted { a, b, out: &mut self.passed[..stride] });
        self.clear();
        let gate = if batch.roulette.is_some() { ROULETTE_WEIGHT } else { GATE };
        for (ray, state) in evaluated.rays.iter_mut().enumerate() {
            let mut transmittance = 1.0f32;
            let begin = self.len();
            for sample in state.first..state.first + state.evaluated {
                let row = evaluated.row_of[sample - first];
                let passed = self.passed[row as usize];
                let (weight, after) = (transmittance * (1.0 - passed), transmittance * passed);
                // NaN is kept, so that it shows in the loss.
                let heavy = weight > gate || weight.is_nan();
                let drawn =
                    |(seed, step)| uniform(seed, Purpose::Roulette, step, sample as u64) * gate < weight;
                if heavy || batch.roulette.is_some_and(drawn) {
                    let inverse_probability = if heavy { 1.0 } else { gate / weight };
                    self.push((row, ray as u32), (weight, after), inverse_probability);
                }
                transmittance = after;
                if transmittance < T_MIN {
                    break;
                }
            }
            state.transmittance = transmittance;
            state.kept = (begin, self.len());
        }
        self.take_rows(job, batch, evaluated);
    }

    /// Keeps the evaluated sample of each ray of a 2D field.
    pub fn keep_all(&mut self, job: &Job<'_>, batch: &Batch, evaluated: &Evaluated) {
        self.clear();
        for (ray, state) in evaluated.rays.iter().enumerate() {
            for row in state.kept.0..state.kept.1 {
                self.push((row as u32, ray as u32), (1.0, 0.0), 1.0);
            }
        }
        self.take_rows(job, batch, evaluated);
    }

    fn clear(&mut self) {
        self.row.clear();
        self.ray.clear();
        for list in [&mut self.weight, &mut self.after, &mut self.inverse_probability, &mut self.counted] {
            list.clear();
        }
    }

    fn push(&mut self, (row, ray): (u32, u32), (weight, after): (f32, f32), inverse_probability: f32) {
        self.row.push(row);
        self.ray.push(ray);
        self.weight.push(weight);
        self.after.push(after);
        self.inverse_probability.push(inverse_probability);
        self.counted.push(inverse_probability * weight);
    }

    fn take_rows(&mut self, job: &Job<'_>, batch: &Batch, evaluated: &Evaluated) {
        self.scale.clear();
        let scale = |&row: &u32| batch.gradient_scales.get(evaluated.index_of[row as usize] as usize);
        self.scale.extend(self.row.iter().map(|row| scale(row).copied().unwrap_or(1.0)));
        take_rows(&evaluated.encoded, padded(job.grid.outputs()), &self.row, &mut self.encoded);
        for (l, layer) in job.layers.trunk.iter().enumerate() {
            let across = padded(layer.main.outputs);
            take_rows(&evaluated.hidden[l], across, &self.row, &mut self.hidden[l]);
        }
    }
}

/// Copies the rows `rows` of `from`, `[…][width]`, to the start of `to`, which is enlarged if it is too short.
fn take_rows(from: &[f32], width: usize, rows: &[u32], to: &mut Vec<f32>) {
    grow(to, padded(rows.len()) * width);
    for (to, &row) in to.chunks_exact_mut(width).zip(rows) {
        copy_row(&from[row as usize * width..], to);
    }
}
