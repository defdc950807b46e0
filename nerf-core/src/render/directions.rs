//! The direction's share of the colour branch, where colours are worked out at samples.

use super::frame::columns_of;
use super::march::RayState;
use super::tone;
use crate::math::MathBackend;
use crate::memory::{at, head, head_mut, put, put_column, tail};
use crate::network::{Network, Scratch};
use crate::plan::Plan;

/// The direction's share of the colour branch, once a ray: `[rays][direction_rows]`, room for whole blocks of rays.
pub(super) struct DirectionShares<'w> {
    pub values: &'w mut [f32],
    /// Rays that are encoded together.
    pub block: usize,
}

impl DirectionShares<'_> {
    /// Works them out for some rays; what `scratch` and `triples` (`[3][block]`) held is lost.
    pub fn fill(
        &mut self,
        network: &Network<'_>,
        math: MathBackend,
        scratch: &mut Scratch<'_>,
        triples: &mut [f32],
        rays: &[RayState],
    ) {
        let (rows, block) = (network.direction_rows(), self.block);
        let Scratch { encoded, front, back, .. } = scratch;
        let shares = self.values.chunks_exact_mut((rows * block).max(1));
        for (states, out) in rays.chunks(block.max(1)).zip(shares) {
            let stride = columns_of(network, states.len());
            let mut scratch = Scratch { stride, encoded, front, back: &mut [] };
            for (column, state) in states.iter().enumerate() {
                put_column(triples, stride, column, state.ray.dir.to_array());
            }
            network.direction(math, &mut scratch, triples, back);
            // Each ray's side by side: they are copied to every sample of it.
            for (column, share) in out.chunks_exact_mut(rows.max(1)).take(states.len()).enumerate() {
                for (to, from) in share.iter_mut().zip(back.chunks_exact(stride.max(1))) {
                    *to = at(from, column);
                }
            }
        }
    }

    /// Colours of the samples whose `h` is in `scratch.front`; `owner` says whose they are.
    ///
    /// `rgb`: `[3][scratch.stride]`.
    pub fn colour(
        &self,
        network: &Network<'_>,
        plan: &Plan<'_>,
        scratch: &mut Scratch<'_>,
        owner: &[u32],
        rgb: &mut [f32],
    ) {
        let (stride, rows) = (scratch.stride, network.direction_rows());
        let spread = |to: &mut [f32]| {
            for (column, &ray) in owner.iter().enumerate() {
                let share = head(tail(self.values, ray as usize * rows), rows);
                for (to, &value) in to.chunks_exact_mut(stride.max(1)).zip(share) {
                    put(to, column, value);
                }
            }
        };
        network.colour(plan.math, scratch, spread, rgb);
        tone::samples_to_light(&plan.effects.tone, plan.math, network.isa(), head_mut(rgb, 3 * stride));
    }
}
