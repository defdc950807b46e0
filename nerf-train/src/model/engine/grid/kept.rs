//! Choice of the samples that get gradients in the reference engine, by the rule of [`super::samples`].

use super::pass::{GATE, ROULETTE_WEIGHT, T_MIN};
use crate::model::engine::BatchRay;
use nerf_core::sampling::{Purpose, uniform};

/// Kept samples of several rays, ray after ray. Only kept samples get colour and gradients. The transmittance through
/// the samples that are not kept is stored, too.
pub(super) struct KeptSamples {
    /// Index in the batch of each kept sample.
    pub samples: Vec<usize>,
    /// Number of kept samples of each ray.
    pub counts: Vec<usize>,
    /// Inverse of the probability with which each sample was kept.
    pub inverse: Vec<f32>,
    /// For each kept sample: transmittance through the samples in front of it that are not kept.
    pub front: Vec<f32>,
    /// For each ray: transmittance through its samples that are not kept, up to where the ray ends.
    pub unkept: Vec<f32>,
}

impl KeptSamples {
    /// Chooses the kept samples by compositing weight. Without `roulette`, all samples above `GATE` are kept. With
    /// `roulette` (seed and step), all samples above `ROULETTE_WEIGHT` are kept, and a random choice of those below. A
    /// ray ends when its transmittance is below `T_MIN`. `depths`: optical depth of each sample. `first`: index in the
    /// batch of the first sample.
    pub fn of(rays: &[BatchRay], depths: &[f32], first: usize, roulette: Option<(u64, u64)>) -> Self {
        let (mut samples, mut inverse, mut front) = (Vec::new(), Vec::new(), Vec::new());
        let (mut counts, mut unkept) = (Vec::new(), Vec::new());
        let gate = if roulette.is_some() { ROULETTE_WEIGHT } else { GATE };
        let mut next = 0;
        for ray in rays {
            let (mut transmittance, mut skipped, before) = (1.0, 0.0f32, samples.len());
            let of_ray = &depths[next..][..ray.samples as usize];
            for (i, depth) in of_ray.iter().enumerate() {
                let passed = (-depth).exp();
                let weight: f32 = transmittance * (1.0 - passed);
                let heavy = weight > gate || weight.is_nan();
                let index = first + next + i;
                let drawn =
                    |(seed, step)| uniform(seed, Purpose::Roulette, step, index as u64) * gate < weight;
                if heavy || roulette.is_some_and(drawn) {
                    samples.push(index);
                    inverse.push(if heavy { 1.0 } else { gate / weight });
                    front.push((-skipped).exp());
                } else {
                    skipped += depth;
                }
                transmittance *= passed;
                if transmittance < T_MIN {
                    break;
                }
            }
            next += of_ray.len();
            counts.push(samples.len() - before);
            unkept.push((-skipped).exp());
        }
        Self { samples, counts, inverse, front, unkept }
    }

    /// Returns each kept sample's distance from the ray's first kept sample, summed over straight lines from kept
    /// sample to kept sample. `positions`: positions of the kept samples.
    pub fn along(&self, positions: &[[f32; 3]]) -> Vec<f32> {
        let mut along = Vec::with_capacity(positions.len());
        for &count in &self.counts {
            let of_ray = &positions[along.len()..][..count];
            let mut distance = 0.0;
            for (i, to) in of_ray.iter().enumerate() {
                let from = of_ray[i.saturating_sub(1)];
                distance += (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum::<f32>().sqrt();
                along.push(distance);
            }
        }
        along
    }
}
