//! Forward and backward passes over chunks of a batch. A `Pass` sums loss and gradients over several chunks.

use super::accumulate::LayerSum;
use super::batch::Chunk;
use super::graph::{DIRECTION, FIRST, Graph, POSITION, block_of_mut, encode_points, mask_relu};
use super::volume_grad::{Samples, Scratch, squared_error};
use super::{Batch, SIGMA_LIMIT};
use nerf_core::network::{DensityActivation, EXPONENTIAL_LIMIT};
use nerf_core::simd::{BLOCK, Isa};
use std::ops::Range;

#[derive(Clone, Copy, Default)]
pub(super) struct ChunkLoss {
    /// Sum over rays and channels of (rendered − target)².
    pub(super) squared: f64,
    /// Sum of ln(1 + sigma) over points in empty cells.
    pub(super) empty: f64,
    /// Whether at least one sample on a ray had sigma ≠ 0; in a 2D field, whether there was a sample.
    pub(super) alive: bool,
}

#[derive(Clone, Copy)]
pub(super) struct Job<'a> {
    pub(super) graph: &'a Graph,
    pub(super) isa: Isa,
    pub(super) parameters: &'a [f32],
}

/// Accumulator of the loss and gradients of several chunks, with buffers for the current chunk.
#[derive(Default)]
pub(super) struct Pass {
    pub(super) loss: ChunkLoss,
    pub(super) sums: Vec<LayerSum>,
    slots: Vec<Vec<f32>>,
    /// Gradient of the loss with respect to the current layer's output, `[blocks][outputs][BLOCK]`.
    upper: Vec<f32>,
    /// Gradient of the loss with respect to the current layer's main inputs, `[blocks][main][BLOCK]`.
    lower: Vec<f32>,
    /// Sigma of each sample, padded to whole blocks.
    sigma: Vec<f32>,
    d_sigma: Vec<f32>,
    transposed: Vec<f32>,
    volume: Scratch,
    /// Index of each sample's ray among the rays of the batch, for the samples of the current chunk.
    ray_of: Vec<u32>,
}

impl Pass {
    pub(super) fn new(graph: &Graph) -> Self {
        let sums = graph.nodes.iter().map(|_| LayerSum::default()).collect();
        Self { sums, slots: vec![Vec::new(); FIRST + graph.nodes.len()], ..Self::default() }
    }

    pub(super) fn clear(&mut self) {
        self.loss = ChunkLoss::default();
        self.sums.iter_mut().for_each(LayerSum::clear);
    }

    pub(super) fn run(&mut self, job: Job<'_>, batch: &Batch, chunk: &Chunk) {
        match chunk {
            Chunk::Rays { rays, samples } => self.run_rays(job, batch, rays.clone(), samples.clone()),
            Chunk::Empty(points) => self.run_empty(job, batch, points.clone()),
        }
    }

    fn run_rays(&mut self, job: Job<'_>, batch: &Batch, rays: Range<usize>, samples: Range<usize>) {
        let graph = job.graph;
        let count = samples.len();
        self.encode_positions(job, &batch.positions[samples.clone()]);
        if let Some(direction) = graph.model.architecture.direction.as_ref().and_then(|d| d.sinusoidal()) {
            self.ray_of.clear();
            for ray in rays.clone() {
                self.ray_of.extend((0..batch.rays[ray].samples).map(|_| ray as u32));
            }
            grow(&mut self.slots[DIRECTION], direction.outputs(), count);
            for (block, rays) in self.ray_of.chunks(BLOCK).enumerate() {
                let out = block_of_mut(&mut self.slots[DIRECTION], direction.outputs(), block);
                let dirs = rays.iter().map(|&ray| &batch.rays[ray as usize].dir);
                encode_points(job.isa, direction, dirs, out);
            }
        }
        for l in 0..graph.nodes.len() {
            self.forward(job, l, count);
        }
        self.activate_density(job, count);
        self.zero_padding(count);
        let rgb = FIRST + graph.nodes.len() - 1;
        let colour = &mut self.slots[rgb][..3 * count.next_multiple_of(BLOCK)];
        colour.iter_mut().for_each(|c| *c = 1.0 / (1.0 + (-*c).exp()));
        let view =
            Samples { deltas: &batch.deltas[samples], sigma: graph.density.map(|_| &self.sigma[..]), colour };
        let scale = 1.0 / (3.0 * batch.rays.len() as f64);
        self.loss.squared += squared_error(
            &batch.rays[rays],
            &view,
            scale,
            &mut self.volume,
            &mut self.d_sigma,
            &mut self.upper,
        );
        self.loss.alive |= match graph.density {
            Some(_) => self.sigma[..count].iter().any(|&sigma| sigma != 0.0),
            None => count > 0,
        };
        if count == 0 {
            return;
        }
        for (d, c) in self.upper.iter_mut().zip(colour) {
            *d *= *c * (1.0 - *c);
        }
        self.backward_colour(job, count);
        self.backward_trunk(job, count, true);
    }

    fn run_empty(&mut self, job: Job<'_>, batch: &Batch, points: Range<usize>) {
        if job.graph.density.is_none() {
            return;
        }
        let count = points.len();
        self.encode_positions(job, &batch.empty[points]);
        for l in job.graph.trunk.clone().chain(job.graph.density) {
            self.forward(job, l, count);
        }
        self.activate_density(job, count);
        self.zero_padding(count);
        let scale = batch.empty_weight / batch.empty.len() as f32;
        for (d, &sigma) in self.d_sigma.iter_mut().zip(&self.sigma[..count]) {
            self.loss.empty += f64::from(sigma.ln_1p());
            *d = scale / (1.0 + sigma);
        }
        self.backward_trunk(job, count, false);
    }

    fn encode_positions(&mut self, job: Job<'_>, points: &[[f32; 3]]) {
        let encoding = job.graph.model.architecture.position.sinusoidal().expect("checked by the graph");
        let slot = &mut self.slots[POSITION];
        grow(slot, encoding.outputs(), points.len());
        for (block, points) in points.chunks(BLOCK).enumerate() {
            let out = block_of_mut(slot, encoding.outputs(), block);
            encode_points(job.isa, encoding, points.iter(), out);
        }
    }

    fn forward(&mut self, job: Job<'_>, layer: usize, samples: usize) {
        let (inputs, outputs) = self.slots.split_at_mut(FIRST + layer);
        let (out, node) = (&mut outputs[0], &job.graph.nodes[layer]);
        grow(out, node.dense.outputs, samples);
        node.forward(job.isa, job.parameters, inputs, out, samples);
    }

    /// Writes each sample's sigma, at most `SIGMA_LIMIT`, to `self.sigma`. Replaces the raw density by d sigma / d raw.
    fn activate_density(&mut self, job: Job<'_>, samples: usize) {
        let architecture = &job.graph.model.architecture;
        let (Some(layer), Some(activation)) = (job.graph.density, architecture.density) else { return };
        let scale = job.graph.model.density_scale;
        let raw = &mut self.slots[FIRST + layer];
        grow(&mut self.sigma, 1, samples);
        for (raw, sigma) in raw[..samples].iter_mut().zip(&mut self.sigma) {
            let (value, slope) = activate(activation, scale * *raw);
            (*sigma, *raw) = (value, slope * scale);
        }
    }

    /// Sets dL/d sigma and dL/d rgb to 0 in the lanes after the last sample, which then add nothing to the gradients.
    fn zero_padding(&mut self, samples: usize) {
        grow(&mut self.upper, 3, samples);
        grow(&mut self.d_sigma, 1, samples);
        self.d_sigma[samples..].fill(0.0);
        if !samples.is_multiple_of(BLOCK) {
            let last = block_of_mut(&mut self.upper, 3, samples / BLOCK);
            last.chunks_exact_mut(BLOCK).for_each(|d| d[samples % BLOCK..].fill(0.0));
        }
    }

    /// Does the colour branch's backward pass. Changes `self.upper` from dL/d (raw rgb) to dL/d (trunk output).
    fn backward_colour(&mut self, job: Job<'_>, samples: usize) {
        let Graph { nodes, colour, .. } = job.graph;
        for l in colour.clone().rev() {
            self.weight_gradient(job, l, samples);
            grow(&mut self.lower, nodes[l].dense.main, samples);
            nodes[l].backward(job.isa, job.parameters, &self.upper, &mut self.lower, false, samples);
            std::mem::swap(&mut self.upper, &mut self.lower);
            if l > colour.start && nodes[l - 1].relu {
                let channels = nodes[l].dense.main;
                mask_relu(&mut self.upper, &self.slots[nodes[l].main], channels, samples);
            }
        }
    }

    /// Does the backward pass of density head and trunk. `colour`: whether `self.upper` holds the gradient from the
    /// colour branch, to which the gradient from the density head is added.
    fn backward_trunk(&mut self, job: Job<'_>, samples: usize, colour: bool) {
        let Graph { nodes, trunk, density, .. } = job.graph;
        if let Some(l) = *density {
            let slopes = &self.slots[FIRST + l];
            for (d, &slope) in self.d_sigma[..samples].iter_mut().zip(slopes) {
                *d *= slope;
            }
            let node = &nodes[l];
            let (sums, slots) = (&mut self.sums[l], &self.slots);
            sums.add(job.isa, node, &self.d_sigma, slots, samples, &mut self.transposed);
            grow(&mut self.upper, node.dense.main, samples);
            node.backward(job.isa, job.parameters, &self.d_sigma, &mut self.upper, colour, samples);
        }
        for l in trunk.clone().rev() {
            mask_relu(&mut self.upper, &self.slots[FIRST + l], nodes[l].dense.outputs, samples);
            self.weight_gradient(job, l, samples);
            if l > 0 {
                grow(&mut self.lower, nodes[l].dense.main, samples);
                nodes[l].backward(job.isa, job.parameters, &self.upper, &mut self.lower, false, samples);
                std::mem::swap(&mut self.upper, &mut self.lower);
            }
        }
    }

    fn weight_gradient(&mut self, job: Job<'_>, layer: usize, samples: usize) {
        let node = &job.graph.nodes[layer];
        let slots = &self.slots;
        self.sums[layer].add(job.isa, node, &self.upper, slots, samples, &mut self.transposed);
    }
}

/// Returns sigma, at most `SIGMA_LIMIT`, and d sigma / d raw. For a `raw` of NaN, sigma is NaN, and so is the loss.
pub(super) fn activate(activation: DensityActivation, raw: f32) -> (f32, f32) {
    let (value, slope) = match activation {
        DensityActivation::Relu => {
            if raw <= 0.0 {
                (0.0, 0.0)
            } else {
                (raw, 1.0)
            }
        }
        DensityActivation::Exponential => {
            let value = if raw > EXPONENTIAL_LIMIT { EXPONENTIAL_LIMIT } else { raw }.exp();
            (value, if raw > EXPONENTIAL_LIMIT { 0.0 } else { value })
        }
        DensityActivation::ShiftedSoftplus => {
            let y = raw - 1.0;
            let tail = (-y.abs()).exp();
            let slope = if y > 0.0 { 1.0 / (1.0 + tail) } else { tail / (1.0 + tail) };
            let hinge = if y <= 0.0 { 0.0 } else { y };
            (hinge + tail.ln_1p(), slope)
        }
    };
    if value > SIGMA_LIMIT { (SIGMA_LIMIT, 0.0) } else { (value, slope) }
}

fn grow(buffer: &mut Vec<f32>, channels: usize, samples: usize) {
    let length = samples.div_ceil(BLOCK) * channels * BLOCK;
    if buffer.len() < length {
        buffer.resize(length, 0.0);
    }
}
