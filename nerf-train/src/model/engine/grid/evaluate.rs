//! Densities of a chunk's samples, in waves: a wave is the next eight samples of every ray that has not ended.

use super::layers::Layer;
use super::pass::{Job, T_MIN, grow};
use super::vector::{Exponentials, to_rows};
use crate::model::engine::graph::{VECTOR, padded};
use crate::model::engine::{Batch, Phase, Phases};
use nerf_core::encoding::encode_grid_block;
use nerf_core::matrix::Init;
use nerf_core::network::EXPONENTIAL_LIMIT;
use std::ops::Range;
use std::time::Instant;

/// Largest number of samples of a ray in one wave of evaluations. After each wave, rays of low transmittance end.
const WAVE: usize = 8;

/// State of one ray of the current chunk while its samples are evaluated.
#[derive(Clone, Copy, Default)]
pub(super) struct RayState {
    /// Index in the batch of the ray's first sample.
    pub first: usize,
    samples: usize,
    pub evaluated: usize,
    depth: f32,
    pub kept: (usize, usize),
    /// Transmittance after the ray's last evaluated sample.
    pub transmittance: f32,
}

/// Evaluated samples of a chunk, one row per sample in every buffer. Rows are in order of evaluation: the first eight
/// samples of every ray, then the next eight, and so on.
#[derive(Default)]
pub(super) struct Evaluated {
    pub rays: Vec<RayState>,
    alive: Vec<usize>,
    /// For each sample of the chunk, in the order of the batch: its row in the buffers.
    pub row_of: Vec<u32>,
    /// For each row of the buffers: index of the row's sample in the batch.
    pub index_of: Vec<u32>,
    pub deltas: Vec<f32>,
    /// Encoded positions, `[rows][padded channels]`.
    pub encoded: Vec<f32>,
    /// Outputs of each trunk layer, `[rows][padded outputs]`.
    pub hidden: Vec<Vec<f32>>,
    pub sigma: Vec<f32>,
    points: Vec<f32>,
    channels: Vec<f32>,
    raw: Vec<f32>,
}

impl Evaluated {
    pub fn new(trunk: usize) -> Self {
        Self { hidden: vec![Vec::new(); trunk], ..Self::default() }
    }

    /// Evaluates sigma at the samples of `rays`, eight samples of each ray at a time, until the ray's transmittance is
    /// below `T_MIN`. `first`: index in the batch of the rays' first sample.
    pub fn densities(
        &mut self,
        job: &Job<'_>,
        density: &Layer,
        batch: &Batch,
        (rays, first): (Range<usize>, usize),
        phases: &mut Phases,
    ) {
        let mut now = Instant::now();
        let end = self.begin(batch, rays, first);
        self.row_of.clear();
        self.row_of.resize(end - first, 0);
        self.alive.clear();
        self.alive.extend((0..self.rays.len()).filter(|&ray| self.rays[ray].samples > 0));
        let mut count = 0;
        while !self.alive.is_empty() {
            for &ray in &self.alive {
                let RayState { first: start, samples, evaluated, .. } = self.rays[ray];
                for sample in start + evaluated..start + samples.min(evaluated + WAVE) {
                    self.row_of[sample - first] = self.index_of.len() as u32;
                    self.index_of.push(sample as u32);
                }
            }
            let end = self.index_of.len();
            phases.lap(Phase::Composite, now);
            self.wave(job, density, batch, count..end, phases);
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
        phases.lap(Phase::Composite, now);
    }

    /// Evaluates the trunk for a 2D field, at the first sample of each ray: this sample is opaque and hides all others.
    pub fn picture(
        &mut self,
        job: &Job<'_>,
        batch: &Batch,
        (rays, first): (Range<usize>, usize),
        phases: &mut Phases,
    ) {
        self.begin(batch, rays, first);
        for state in &mut self.rays {
            let begin = self.index_of.len();
            if state.samples > 0 {
                self.index_of.push(state.first as u32);
                state.transmittance = 0.0;
            }
            state.kept = (begin, self.index_of.len());
        }
        if !self.index_of.is_empty() {
            self.trunk(job, batch, 0..self.index_of.len(), phases);
        }
    }

    /// Resets the states of `rays`, whose samples begin at index `first` of the batch. Returns the index of their end.
    fn begin(&mut self, batch: &Batch, rays: Range<usize>, first: usize) -> usize {
        self.rays.clear();
        self.index_of.clear();
        let mut next = first;
        for ray in &batch.rays[rays] {
            let samples = ray.samples as usize;
            self.rays.push(RayState { first: next, samples, transmittance: 1.0, ..RayState::default() });
            next += samples;
        }
        next
    }

    /// Encodes the samples of `rows`, and evaluates the trunk at them.
    fn trunk(&mut self, job: &Job<'_>, batch: &Batch, rows: Range<usize>, phases: &mut Phases) {
        let now = Instant::now();
        let (count, stride) = (rows.len(), padded(rows.len()));
        grow(&mut self.points, 3 * stride);
        grow(&mut self.deltas, rows.end.next_multiple_of(VECTOR) + VECTOR);
        for (i, &sample) in self.index_of[rows.clone()].iter().enumerate() {
            let position = batch.positions[sample as usize];
            for (axis, &x) in position.iter().enumerate() {
                self.points[axis * stride + i] = x;
            }
            self.deltas[rows.start + i] = batch.deltas[sample as usize];
        }
        for axis in 0..3 {
            let last = self.points[axis * stride + count - 1];
            self.points[axis * stride + count..(axis + 1) * stride].fill(last);
        }
        let outputs = job.grid.outputs();
        grow(&mut self.channels, outputs * stride);
        let (points, channels) = (&self.points[..3 * stride], &mut self.channels[..]);
        encode_grid_block(job.isa, job.grid, &job.tables, stride, points, channels);
        let width = padded(outputs);
        grow(&mut self.encoded, (rows.start + stride) * width);
        let encoded = &mut self.encoded[rows.start * width..][..count * width];
        to_rows(&self.channels[..outputs * stride], stride, count, encoded, width);
        let now = phases.lap(Phase::Encode, now);
        for (l, layer) in job.layers.trunk.iter().enumerate() {
            let (before, rest) = self.hidden.split_at_mut(l);
            let across = padded(layer.main.outputs);
            grow(&mut rest[0], (rows.start + stride) * across);
            let (x, x_row) = match before.last() {
                Some(x) => (x, padded(layer.main.inputs)),
                None => (&self.encoded, width),
            };
            let y = &mut rest[0][rows.start * across..];
            layer.main.forward(job.isa, count, &x[rows.start * x_row..], x_row, y, Init::Zero, true);
        }
        phases.lap(Phase::Forward, now);
    }

    fn wave(&mut self, job: &Job<'_>, head: &Layer, batch: &Batch, rows: Range<usize>, phases: &mut Phases) {
        self.trunk(job, batch, rows.clone(), phases);
        let now = Instant::now();
        let (count, stride) = (rows.len(), padded(rows.len()));
        let across = padded(head.main.inputs);
        let h = &self.hidden.last().unwrap_or(&self.encoded)[rows.start * across..];
        grow(&mut self.raw, stride * VECTOR);
        head.main.forward(job.isa, count, h, across, &mut self.raw, Init::Zero, false);
        // Moves the first column of all rows to the buffer's beginning; each value is read before it is overwritten.
        for i in 0..count {
            self.raw[i] = self.raw[i * VECTOR];
        }
        self.raw[count..stride].fill(0.0);
        grow(&mut self.sigma, rows.start + stride);
        let (x, out) = (&self.raw[..stride], &mut self.sigma[rows.start..rows.start + stride]);
        job.isa.run(Exponentials { x, bias: job.layers.bias, limit: EXPONENTIAL_LIMIT, out });
        phases.lap(Phase::Forward, now);
    }
}
