//! Evaluation of the colour branch at the samples that compositing picked. If picked samples fill most of a block, the
//! branch is evaluated for the whole block; otherwise picked samples of several blocks are collected in a separate
//! block. The part of the branch that depends on the direction alone is evaluated once per ray.

use super::TileState;
use super::compositing::Compositing;
use super::density::narrow;
use crate::memory::{Layout, at, column, head, head_mut, put, put_column, tail};
use crate::network::Scratch;
use crate::render::Counters;
use crate::render::field::Field;
use crate::render::march::RayState;
use crate::render::pixel::samples_to_light;

/// Fraction of a block, as (numerator, denominator). If a smaller fraction of a block's samples is picked, the picked
/// samples are queued; otherwise their colours are evaluated immediately.
const QUEUED_BELOW: (usize, usize) = (3, 4);

/// Stage that evaluates the colour branch at samples; has no buffers if shading is deferred or no colour is requested.
pub(in crate::render) struct Colour<'w> {
    shares: &'w mut [f32],
    /// Trunk outputs `h` of the queued samples, `[activation_rows][samples]`; the colour branch overwrites them. If a
    /// block has room for only one sample, nothing is queued: `h`, `owner` and `weight` are then empty.
    h: &'w mut [f32],
    /// Index of each queued sample's ray, `[samples]`.
    owner: &'w mut [u32],
    weight: &'w mut [f32],
    queued: usize,
    /// Buffer, `[3][stride]`: first the directions of a block of rays, later the colours of a block of samples.
    rgb: &'w mut [f32],
}

impl<'w> Colour<'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, field: Field<'_>) -> Self {
        let samples = if field.shades_samples() { field.block_samples() } else { 0 };
        // A block of one sample needs no queue.
        let queue = if samples > 1 { samples } else { 0 };
        Self {
            shares: layout.slice(DirectionShares::values(field, field.block_samples()), 0.0),
            h: layout.slice(field.network.activation_rows() * queue, 0.0),
            owner: layout.slice(queue, 0),
            weight: layout.slice(queue, 0.0),
            queued: 0,
            rgb: layout.slice(3 * samples, 0.0),
        }
    }

    /// Returns two buffers: contributions of ray directions to the colour branch, and a buffer `[3][stride]` that holds
    /// directions of rays first and colours of samples later.
    pub fn shares(&mut self, field: Field<'_>) -> (DirectionShares<'_>, &mut [f32]) {
        (DirectionShares { values: self.shares, block: field.block_samples() }, self.rgb)
    }

    /// Evaluates the colours of the samples that compositing picked from a block, and adds each colour to its sample's
    /// ray. If the picked samples fill less than [`QUEUED_BELOW`] of the block, queues the samples instead.
    pub fn run(&mut self, tile: &mut TileState<'_, '_>, picks: &Compositing<'_>, counters: &mut Counters) {
        if picks.count * QUEUED_BELOW.1 < tile.density.owner.len() * QUEUED_BELOW.0 {
            return self.queue(tile, picks, counters);
        }
        self.flush(tile, counters);
        let TileState { field, rays, density, .. } = tile;
        let (shares, rgb) = self.shares(*field);
        shares.evaluate(*field, &mut density.scratch, head(density.owner, density.count), rgb);
        counters.add_colour(field.network, picks.count);
        for (from, weight) in picks.iter() {
            let rgb = column(self.rgb, density.scratch.stride, from);
            add_colour(rays.states, at(density.owner, from), weight, rgb, counters);
        }
    }

    /// Queues the block's samples that compositing picked; evaluates the colour branch whenever the queue is full.
    fn queue(&mut self, tile: &mut TileState<'_, '_>, picks: &Compositing<'_>, counters: &mut Counters) {
        let (room, stride) = (self.owner.len(), tile.density.scratch.stride);
        for (column, weight) in picks.iter() {
            let TileState { field, density, .. } = &*tile;
            let from = density.scratch.front.chunks_exact(stride.max(1));
            let rows = from.zip(self.h.chunks_exact_mut(room.max(1)));
            for (h, to) in rows.take(field.network.trunk_rows()) {
                put(to, self.queued, at(h, column));
            }
            put(self.owner, self.queued, at(density.owner, column));
            put(self.weight, self.queued, weight);
            self.queued += 1;
            if self.queued == room {
                self.flush(tile, counters);
            }
        }
    }

    /// Empties the queue: evaluates the colour branch for the queued samples and adds each sample's colour to its ray.
    /// Leaves the trunk outputs of the current block unchanged.
    pub fn flush(&mut self, tile: &mut TileState<'_, '_>, counters: &mut Counters) {
        let n = core::mem::take(&mut self.queued);
        if n == 0 {
            return;
        }
        let TileState { field, rays, density, .. } = tile;
        let (field, room, stride) = (*field, self.owner.len(), field.columns(n));
        narrow(self.h, field.network.trunk_rows(), [room, stride], n);
        let Scratch { encoded, back, .. } = &mut density.scratch;
        let mut scratch = Scratch { stride, encoded, front: self.h, back };
        let shares = DirectionShares { values: self.shares, block: field.block_samples() };
        shares.evaluate(field, &mut scratch, head(self.owner, n), self.rgb);
        counters.add_colour(field.network, n);
        for (i, (&owner, &weight)) in head(self.owner, n).iter().zip(&*self.weight).enumerate() {
            add_colour(rays.states, owner, weight, column(self.rgb, stride, i), counters);
        }
    }
}

/// Adds `weight` times a sample's colour to the ray of index `owner`. A NaN colour is replaced by black.
#[inline]
fn add_colour(rays: &mut [RayState], owner: u32, weight: f32, colour: [f32; 3], counters: &mut Counters) {
    let colour = counters.or_black(colour);
    if let Some(state) = rays.get_mut(owner as usize) {
        state.pixel.gathered.add_colour(weight, colour);
    }
}

/// Contribution of each ray's direction to the colour branch, `[rays][direction_rows]`: the bias of the layer that
/// takes the encoded direction, plus the products of this layer's weights with the encoded direction.
pub(in crate::render) struct DirectionShares<'w> {
    pub values: &'w mut [f32],
    /// Number of rays whose directions are encoded together.
    pub block: usize,
}

impl DirectionShares<'_> {
    /// Number of elements of the buffer `values` for the rays of a batch (`field.plan.batch.rays`, rounded up to a
    /// multiple of `block`). Returns 0 if the colour branch is not evaluated at samples. `block`: number of rays whose
    /// directions are encoded together.
    pub fn values(field: Field<'_>, block: usize) -> usize {
        let rows = if field.shades_samples() { field.network.direction_rows() } else { 0 };
        rows.saturating_mul(field.plan.batch.rays.div_ceil(block.max(1)) * block)
    }

    /// Computes `values` for `rays`: the contribution of each ray's direction to the colour branch. Overwrites
    /// `scratch` and the buffer `dirs`, `[3][block]`.
    pub fn fill(
        &mut self,
        field: Field<'_>,
        scratch: &mut Scratch<'_>,
        dirs: &mut [f32],
        rays: &[RayState],
        counters: &mut Counters,
    ) {
        if self.values.is_empty() {
            return;
        }
        let (network, block) = (field.network, self.block);
        let rows = network.direction_rows();
        let Scratch { encoded, back, .. } = scratch;
        let shares = self.values.chunks_exact_mut((rows * block).max(1));
        for (states, out) in rays.chunks(block.max(1)).zip(shares) {
            let stride = field.columns(states.len());
            for (column, state) in states.iter().enumerate() {
                put_column(dirs, stride, column, state.pixel.ray.dir.to_array());
            }
            network.direction(field.plan.math, stride, encoded, dirs, back);
            // The values of a ray are contiguous, since they are copied to each of its samples.
            for (column, share) in out.chunks_exact_mut(rows.max(1)).take(states.len()).enumerate() {
                for (to, from) in share.iter_mut().zip(back.chunks_exact(stride.max(1))) {
                    *to = at(from, column);
                }
            }
        }
        counters.macs += rays.len() as u64 * network.direction_macs() as u64;
    }

    /// Computes the colours of samples into `rgb`, `[3][scratch.stride]`. The caller has stored the trunk outputs of
    /// the samples in `scratch.front`. `owner`: index of each sample's ray.
    pub fn evaluate(&self, field: Field<'_>, scratch: &mut Scratch<'_>, owner: &[u32], rgb: &mut [f32]) {
        let (network, plan) = (field.network, field.plan);
        let (stride, rows) = (scratch.stride, network.direction_rows());
        let spread = |_: &mut [f32], to: &mut [f32]| {
            for (column, &ray) in owner.iter().enumerate() {
                let share = head(tail(self.values, ray as usize * rows), rows);
                for (to, &value) in to.chunks_exact_mut(stride.max(1)).zip(share) {
                    put(to, column, value);
                }
            }
        };
        network.colour(plan.math, scratch, spread, rgb);
        samples_to_light(&plan.effects.tone, plan.math, network.isa(), head_mut(rgb, 3 * stride));
    }
}
