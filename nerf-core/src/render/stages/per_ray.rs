//! Deferred shading. The trunk's output `h` is composited along each ray with the samples' weights `w`. After the
//! march, the colour branch is evaluated once per ray, at the mean of `h`.
//!
//! ```text
//! march:            picked samples ─► Σ w h and Σ w of each ray
//! after the march:  mean h = Σ w h / Σ w ─► colour branch ─► colour of the ray
//! ```

use super::TileState;
use super::compositing::Compositing;
use crate::memory::{Layout, at, column, head, head_mut, put, put_column, tail, tail_mut};
use crate::network::{PER_RAY_BUILT, Scratch};
use crate::render::Counters;
use crate::render::field::Field;
use crate::render::march::RayState;
use crate::render::pixel::samples_to_light;

/// Weighted sums of hidden features `h` along the current tile's rays. All buffers are empty without deferred shading.
pub(in crate::render) struct Deferred<'w> {
    /// Sums of each ray, `[rays][row]`: Σ weight · `h`, one sum per hidden feature, then Σ weight.
    sums: &'w mut [f32],
    row: usize,
    pub networks: RayNetworks<'w>,
}

impl<'w> Deferred<'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, field: Field<'_>) -> Self {
        let row = Self::row(field);
        let samples = if row > 0 { field.block_samples() } else { 0 };
        Self {
            sums: layout.slice(field.plan.batch.rays.saturating_mul(row), 0.0),
            row,
            networks: RayNetworks::lay_out(layout, samples),
        }
    }

    /// Number of sums per ray: one per hidden feature, and the sum of weights. 0 without deferred shading.
    pub fn row(field: Field<'_>) -> usize {
        if field.shades_rays() { field.network.trunk_rows() + 1 } else { 0 }
    }

    pub fn put(&mut self, ray: usize, sums: impl Iterator<Item = f32>) {
        let row = head_mut(tail_mut(self.sums, ray * self.row), self.row);
        row.iter_mut().zip(sums).for_each(|(to, sum)| *to = sum);
    }

    pub fn is_on(&self) -> bool {
        PER_RAY_BUILT && self.row > 0
    }

    /// Zeroes the weighted sums of hidden features `h` for the first `count` rays.
    pub fn begin(&mut self, count: usize) {
        if self.is_on() {
            head_mut(self.sums, count * self.row).fill(0.0);
        }
    }

    /// Adds each picked sample to the sums of the sample's ray: the sample's weight, and the weight times the hidden
    /// features, which are read from the density stage's scratch memory.
    pub fn add(&mut self, TileState { field, density, .. }: &TileState<'_, '_>, picks: &Compositing<'_>) {
        for (column, weight) in picks.iter() {
            let first = at(density.owner, column) as usize * self.row;
            if let Some([sums @ .., total]) = self.sums.get_mut(first..first + self.row) {
                field.network.add_h(&density.scratch, column, weight, sums);
                *total += weight;
            }
        }
    }

    /// Evaluates the colour branch for each ray whose sum of weights is above 0, and sets the ray's colour.
    pub fn shade(&mut self, tile: &mut TileState<'_, '_>, counters: &mut Counters) {
        if self.is_on() {
            let TileState { field, rays, density, .. } = tile;
            let sums = head(self.sums, rays.hits * self.row);
            let (scratch, rays) = (&mut density.scratch, head_mut(rays.states, rays.hits));
            self.networks.shade(*field, scratch, sums, rays, counters, |state, _, _, rgb| {
                state.pixel.gathered.colour_all(rgb);
            });
        }
    }
}

/// Buffers for evaluating the colour branch once per ray, a block of rays at a time.
pub(in crate::render) struct RayNetworks<'w> {
    /// Index of the ray in each column of a block, `[samples]`.
    owner: &'w mut [u32],
    /// Direction of each column's ray, `[3][samples]`.
    dirs: &'w mut [f32],
    /// Colour of each column's ray, `[3][samples]`.
    rgb: &'w mut [f32],
}

impl<'w> RayNetworks<'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, samples: usize) -> Self {
        Self {
            owner: layout.slice(samples, 0),
            dirs: layout.slice(3 * samples, 0.0),
            rgb: layout.slice(3 * samples, 0.0),
        }
    }

    /// Evaluates the colour branch for each of `rays` whose sum of weights is above 0, at the ray's mean hidden
    /// features. Passes the ray, its index, its sum of weights and its colour to `put_colour`.
    ///
    /// `sums`: for each ray, Σ weight · `h` for each hidden feature `h`, then Σ weight. A NaN colour becomes black.
    pub fn shade(
        &mut self,
        field: Field<'_>,
        scratch: &mut Scratch<'_>,
        sums: &[f32],
        rays: &mut [RayState],
        counters: &mut Counters,
        mut put_colour: impl FnMut(&mut RayState, usize, f32, [f32; 3]),
    ) {
        let network = field.network;
        let (rows, row) = (network.trunk_rows(), network.trunk_rows() + 1);
        let weight = |ray: usize| at(sums, ray * row + rows);
        let mut lit = (0..rays.len()).filter(|&ray| weight(ray) > 0.0);
        loop {
            let mut n = 0;
            for (owner, ray) in self.owner.iter_mut().zip(lit.by_ref()) {
                *owner = ray as u32;
                n += 1;
            }
            if n == 0 {
                return;
            }
            let stride = field.columns(n);
            scratch.stride = stride;
            for (column, &ray) in head(self.owner, n).iter().enumerate() {
                let (mean_of, weight) = (head(tail(sums, ray as usize * row), rows), weight(ray as usize));
                for (to, sum) in scratch.front.chunks_exact_mut(stride.max(1)).zip(mean_of) {
                    put(to, column, sum / weight);
                }
            }
            network.take_h(scratch);
            self.run(field, scratch, rays, n, counters);
            for i in 0..n {
                let (ray, rgb) = (at(self.owner, i) as usize, column(self.rgb, stride, i));
                if let Some(state) = rays.get_mut(ray) {
                    put_colour(state, ray, weight(ray), counters.or_black(rgb));
                }
            }
        }
    }

    /// Returns the colours `[3][stride]` of samples, one sample per ray: sample `i` is on ray `i` of `rays`. The caller
    /// has stored the trunk outputs of the samples in `scratch.front`.
    pub fn of_samples(
        &mut self,
        field: Field<'_>,
        scratch: &mut Scratch<'_>,
        rays: &[RayState],
        counters: &mut Counters,
    ) -> &mut [f32] {
        self.owner.iter_mut().zip(0..).for_each(|(owner, ray)| *owner = ray);
        self.run(field, scratch, rays, rays.len(), counters);
        self.rgb
    }

    /// Computes the colours of the first `n` columns into `self.rgb`, from the trunk outputs in `scratch.front`.
    fn run(
        &mut self,
        field: Field<'_>,
        scratch: &mut Scratch<'_>,
        rays: &[RayState],
        n: usize,
        counters: &mut Counters,
    ) {
        let (network, plan, stride) = (field.network, field.plan, scratch.stride);
        // Padding columns may have any direction.
        for (column, &ray) in head(self.owner, n).iter().enumerate() {
            put_column(self.dirs, stride, column, at(rays, ray as usize).pixel.ray.dir.to_array());
        }
        if !(n == 1 && network.colour_of_one(plan.math, scratch, self.dirs, self.rgb)) {
            let (math, dirs) = (plan.math, &*self.dirs);
            let direction = |encoded: &mut [f32], to: &mut [f32]| {
                network.direction(math, stride, encoded, dirs, to);
            };
            network.colour(math, scratch, direction, self.rgb);
        }
        samples_to_light(&plan.effects.tone, plan.math, network.isa(), head_mut(self.rgb, 3 * stride));
        counters.add_colour(network, n);
        counters.macs += (n * network.direction_macs()) as u64;
    }
}
