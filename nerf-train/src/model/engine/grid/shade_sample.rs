//! A colour a sample: the branch takes each kept sample's features, and colours are composited.

use super::directions::Directions;
use super::layers::{LayerSums, Layers, padded};
use super::pass::{Job, grow};
use super::shade::{Shade, Shaded};
use super::vector::{VECTOR, copy_row, mask, sigmoids};
use nerf_core::matrix::Init;

/// A thread's buffers.
pub(super) struct ShadeSample {
    /// Outputs of each layer, `[samples][padded outputs]`.
    coloured: Vec<Vec<f32>>,
    directions: Directions,
    /// The direction's share of the layer that it joins, `[rays][padded outputs]`.
    shares: Vec<f32>,
    lower: Vec<f32>,
}

impl ShadeSample {
    pub fn new(layers: &Layers) -> Self {
        Self {
            coloured: vec![Vec::new(); layers.colour.len()],
            directions: Directions::default(),
            shares: Vec::new(),
            lower: Vec::new(),
        }
    }
}

impl Shade for ShadeSample {
    fn forward(&mut self, job: &Job<'_>, chunk: Shaded<'_>) {
        let Shaded { rays, samples, .. } = chunk;
        let kept = samples.len();
        self.directions.encode(job, rays.iter().map(|ray| ray.dir));
        for (l, layer) in job.layers.colour.iter().enumerate() {
            let (before, rest) = self.coloured.split_at_mut(l);
            let y = &mut rest[0];
            let across = padded(layer.main.outputs);
            grow(y, padded(kept) * across);
            let init = if let Some(extra) = &layer.extra {
                grow(&mut self.shares, rays.len() * across);
                let (rows, width) = (&self.directions.rows, padded(extra.inputs));
                extra.forward(job.isa, rays.len(), rows, width, &mut self.shares, Init::Zero, false);
                for (row, &ray) in y.chunks_exact_mut(across).zip(&samples.ray) {
                    copy_row(&self.shares[ray as usize * across..], row);
                }
                Init::Accumulate
            } else {
                Init::Zero
            };
            let x = before.last().map_or(samples.features(), Vec::as_slice);
            let relu = l + 1 < job.layers.colour.len();
            layer.main.forward(job.isa, kept, x, padded(layer.main.inputs), y, init, relu);
        }
        let rgb = self.coloured.last_mut().expect("a colour layer");
        sigmoids(job.isa, &mut rgb[..kept * VECTOR]);
    }

    fn shown(&self, ray: usize, Shaded { states, samples, .. }: Shaded<'_>) -> [f32; 3] {
        let rgb = self.coloured.last().expect("a colour layer");
        let mut shown = [0.0; 3];
        for i in states[ray].kept.0..states[ray].kept.1 {
            for (k, shown) in shown.iter_mut().enumerate() {
                *shown += samples.counted[i] * rgb[i * VECTOR + k];
            }
        }
        shown
    }

    fn backward(
        &mut self,
        job: &Job<'_>,
        chunk: Shaded<'_>,
        by_shown: &[[f32; 3]],
        sums: &mut LayerSums,
        by_weight: &mut [f32],
        upper: &mut Vec<f32>,
    ) {
        let Shaded { samples, .. } = chunk;
        let (isa, kept, layers) = (job.isa, samples.len(), job.layers);
        let rgb = self.coloured.last().expect("a colour layer");
        grow(upper, padded(kept) * VECTOR);
        upper[..kept * VECTOR].fill(0.0);
        for (i, &ray) in samples.ray.iter().enumerate() {
            let scale = samples.scale[i] * samples.counted[i];
            for (k, gradient) in by_shown[ray as usize].iter().enumerate() {
                let colour = rgb[i * VECTOR + k];
                by_weight[i] += gradient * colour;
                upper[i * VECTOR + k] = scale * gradient * colour * (1.0 - colour);
            }
        }
        for (l, layer) in layers.colour.iter().enumerate().rev() {
            let at = layers.first_of_colour() + l;
            let x = if l == 0 { samples.features() } else { &self.coloured[l - 1] };
            let x_row = padded(layer.main.inputs);
            layer.main.add_gradient(isa, kept, x, x_row, upper, &mut sums.main[at]);
            if let Some(extra) = &layer.extra {
                // A ray's samples have its direction: their gradients are summed first.
                let across = padded(extra.outputs);
                let rays = chunk.rays.len();
                self.shares[..rays * across].fill(0.0);
                for (row, &ray) in upper.chunks_exact(across).zip(&samples.ray) {
                    let share = &mut self.shares[ray as usize * across..][..across];
                    share.iter_mut().zip(row).for_each(|(share, row)| *share += row);
                }
                let (rows, width) = (&self.directions.rows, padded(extra.inputs));
                extra.add_gradient(isa, rays, rows, width, &self.shares, &mut sums.extra[at]);
            }
            grow(&mut self.lower, padded(kept) * x_row);
            layer.main.backward(isa, kept, upper, &mut self.lower, Init::Zero);
            std::mem::swap(upper, &mut self.lower);
            if l > 0 {
                mask(isa, &mut upper[..kept * x_row], &x[..kept * x_row]);
            }
        }
    }
}
