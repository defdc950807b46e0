//! Normals: density gradients at the samples that compositing picked. Samples are queued and evaluated in blocks.

use super::TileState;
use super::compositing::Compositing;
use super::density::{Density, narrow};
use crate::memory::{Layout, at, column, head, put, put_column};
use crate::network::{GradientScratch, Network, Scratch};
use crate::render::Counters;
use crate::render::field::Field;
use glam::Vec3;

#[cfg(test)]
mod tests;

/// Queue of the samples whose gradient will be evaluated; all buffers are empty if normals are not requested.
pub(in crate::render) struct Normals<'w> {
    /// Index of each queued sample's ray, `[samples]`.
    owner: &'w mut [u32],
    /// Position of each queued sample along its ray, `[samples]`: world units, or the warped distance `s` in an unbounded
    /// scene, as in [`Density::t`].
    t: &'w mut [f32],
    weight: &'w mut [f32],
    queued: usize,
    gradients: Gradients<'w>,
}

impl<'w> Normals<'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, field: Field<'_>) -> Self {
        let samples = if field.plan.outputs.normals { field.block_samples() } else { 0 };
        Self {
            owner: layout.slice(samples, 0),
            t: layout.slice(samples, 0.0),
            weight: layout.slice(samples, 0.0),
            queued: 0,
            gradients: Gradients::lay_out(layout, [field.network].into_iter(), samples),
        }
    }

    /// Queues the samples that compositing picked from a block. Calls [`Normals::flush`] whenever the queue is full.
    pub fn queue(&mut self, tile: &mut TileState<'_, '_>, picks: &Compositing<'_>, counters: &mut Counters) {
        if !tile.field.plan.outputs.normals {
            return;
        }
        for (column, weight) in picks.iter() {
            put(self.owner, self.queued, at(tile.density.owner, column));
            put(self.t, self.queued, at(tile.density.t, column));
            put(self.weight, self.queued, weight);
            self.queued += 1;
            if self.queued == self.owner.len() {
                self.flush(tile, counters);
            }
        }
    }

    /// Empties the queue: evaluates the density gradients at the queued samples, and adds the samples' normals to the
    /// sums of their rays. Overwrites positions and scratch of `tile.density`.
    pub fn flush(&mut self, tile: &mut TileState<'_, '_>, counters: &mut Counters) {
        let n = core::mem::take(&mut self.queued);
        if n == 0 {
            return;
        }
        let TileState { field, rays, density, surface } = tile;
        let (field, stride) = (*field, field.columns(n));
        for (column, (&owner, &t)) in head(self.owner, n).iter().zip(&*self.t).enumerate() {
            let p = field.plan.point(&at(rays.states, owner as usize).pixel.ray, t);
            put_column(density.positions, stride, column, p.to_array());
        }
        density.scratch.stride = stride;
        self.gradients.run(field, density, n, counters, |i, gradient| {
            if let Some(sum) = surface.normals.get_mut(at(self.owner, i) as usize) {
                sum.add(at(self.weight, i), gradient);
            }
        });
    }
}

/// Gradients of the raw density (before its activation) with respect to position, at a block of positions.
pub(in crate::render) struct Gradients<'w> {
    memory: GradientScratch<'w>,
    /// Gradient of the raw density at each position, `[3][samples]`.
    gradient: &'w mut [f32],
}

impl<'w> Gradients<'w> {
    /// Reserves memory for blocks of `samples` samples, enough for any of `networks`.
    pub fn lay_out<'n>(
        layout: &mut impl Layout<'w>,
        networks: impl Iterator<Item = &'n Network<'n>> + Clone,
        samples: usize,
    ) -> Self {
        let most = |of: &dyn Fn(&Network<'n>) -> usize| networks.clone().map(of).max().unwrap_or(0);
        Self {
            memory: GradientScratch {
                signs: layout.slice(most(&|network| network.sign_words(samples)), 0),
                encoded: layout.slice(most(&|network| network.gradient_rows()) * samples, 0.0),
            },
            gradient: layout.slice(3 * samples, 0.0),
        }
    }

    /// Computes the gradient of the raw density at each of the block's first `n` positions. Passes each position's
    /// index, and the gradient with respect to the position in the field's uncontracted space, to `put_gradient`.
    pub fn run(
        &mut self,
        field: Field<'_>,
        density: &mut Density<'_>,
        n: usize,
        counters: &mut Counters,
        mut put_gradient: impl FnMut(usize, Vec3),
    ) {
        let (Field { network, plan }, stride) = (field, field.columns(n));
        let positions = &mut *density.positions;
        narrow(positions, 3, [density.scratch.stride, stride], n);
        // Padding columns are copies of the block's last sample.
        let last: [f32; 3] = column(positions, stride, n.saturating_sub(1));
        (n..stride).for_each(|column| put_column(positions, stride, column, last));
        density.scratch.stride = stride;
        let Scratch { encoded, front, back, .. } = &mut density.scratch;
        let mut scratch = Scratch { stride, encoded, front, back };
        let blur = plan.normal_deviation();
        network.gradient(plan.math, &mut scratch, &mut self.memory, positions, blur, self.gradient);
        counters.add_normals(network, n);
        for i in 0..n {
            let mut gradient = Vec3::from(column(self.gradient, stride, i));
            if let Some(contraction) = &plan.contraction {
                gradient = contraction.gradient_in_world(column::<3>(positions, stride, i).into(), gradient);
            }
            counters.invalid_samples += u64::from(!gradient.is_finite());
            put_gradient(i, gradient);
        }
    }
}
