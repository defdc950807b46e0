//! Deferred shading: `h` is composited along each ray, and one network a ray makes a colour of its mean.
//!
//! ```text
//! march: samples that count ─► Σ w h, Σ w of their ray       behind the march: P = Σ w h / Σ w ─► colour branch ─► ray
//! ```

use super::frame::{block_samples, columns_of};
use super::march::{Picks, RayState};
use super::{Counters, tone};
use crate::memory::{Layout, at, column, head, head_mut, put, put_column, tail, tail_mut};
use crate::network::{Network, PER_RAY_BUILT, Scratch, Shading};
use crate::plan::Plan;
use glam::Vec3;

/// Whether colours of a frame are worked out once a ray.
pub(super) fn is_deferred(network: &Network<'_>, plan: &Plan<'_>) -> bool {
    PER_RAY_BUILT && plan.outputs.rgb && network.architecture().shading == Shading::PerRay
}

/// What the rays in flight have gathered of `h`; all empty where colours are worked out at samples, or not at all.
pub(super) struct Deferred<'w> {
    /// `[rays][row]`: Σ weight · h, and behind it Σ weight.
    sums: &'w mut [f32],
    row: usize,
    pub networks: RayNetworks<'w>,
}

impl<'w> Deferred<'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, network: &Network<'_>, plan: &Plan<'_>) -> Self {
        let row = Self::row(network, plan);
        let samples = if row > 0 { block_samples(network, plan) } else { 0 };
        Self {
            sums: layout.slice(plan.batch.rays.saturating_mul(row), 0.0),
            row,
            networks: RayNetworks::lay_out(layout, network.direction_rows(), samples),
        }
    }

    /// Values that a ray gathers: a sum a row of `h`, and that of the weights.
    pub fn row(network: &Network<'_>, plan: &Plan<'_>) -> usize {
        if is_deferred(network, plan) { network.trunk_rows() + 1 } else { 0 }
    }

    /// What ray `ray` has gathered is `sums` from now on.
    pub fn put(&mut self, ray: usize, sums: impl Iterator<Item = f32>) {
        let row = head_mut(tail_mut(self.sums, ray * self.row), self.row);
        row.iter_mut().zip(sums).for_each(|(to, sum)| *to = sum);
    }

    pub fn is_on(&self) -> bool {
        PER_RAY_BUILT && self.row > 0
    }

    /// A new ray in place `ray`.
    pub fn begin(&mut self, ray: usize) {
        if self.is_on()
            && let Some(sums) = self.sums.get_mut(ray * self.row..(ray + 1) * self.row)
        {
            sums.fill(0.0);
        }
    }

    /// Adds the `h` of a block's first `n` picks, which is in `scratch.front`, to their rays.
    pub fn add(&mut self, network: &Network<'_>, scratch: &Scratch<'_>, picks: &Picks<'_>, n: usize) {
        let picked = head(picks.owner, n).iter().zip(&*picks.column).zip(&*picks.weight);
        for ((&owner, &column), &weight) in picked {
            let first = owner as usize * self.row;
            if let Some([sums @ .., total]) = self.sums.get_mut(first..first + self.row) {
                network.add_h(scratch, column as usize, weight, sums);
                *total += weight;
            }
        }
    }

    /// Gives each of `rays` that gathered something the colour of its network.
    pub fn shade(
        &mut self,
        network: &Network<'_>,
        plan: &Plan<'_>,
        scratch: &mut Scratch<'_>,
        rays: &mut [RayState],
        counters: &mut Counters,
    ) {
        if !self.is_on() {
            return;
        }
        let sums = head(self.sums, rays.len() * self.row);
        self.networks.shade(network, plan, scratch, sums, rays, counters, |rays, ray, _, rgb| {
            if let Some(state) = rays.get_mut(ray) {
                state.gathered.colour_all(rgb);
            }
        });
    }
}

/// Where the networks of rays are run, a block of rays at a time.
pub(super) struct RayNetworks<'w> {
    /// Which ray each column is, `[samples]`.
    owner: &'w mut [u32],
    /// `[3][samples]` each.
    dirs: &'w mut [f32],
    pub rgb: &'w mut [f32],
    /// The directions' share of the colour branch, `[direction_rows][samples]`.
    share: &'w mut [f32],
}

impl<'w> RayNetworks<'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, direction_rows: usize, samples: usize) -> Self {
        Self {
            owner: layout.slice(samples, 0),
            dirs: layout.slice(3 * samples, 0.0),
            rgb: layout.slice(3 * samples, 0.0),
            share: layout.slice(direction_rows * samples, 0.0),
        }
    }

    /// Runs the network of every one of `rays` that has a weight, and hands its index, weight and colour to `put`.
    ///
    /// `sums`: a row a ray, Σ weight · h and behind it Σ weight. A colour that is NaN is counted and black.
    #[allow(clippy::too_many_arguments, reason = "the frame's parts, which it has beside this stage")]
    pub fn shade(
        &mut self,
        network: &Network<'_>,
        plan: &Plan<'_>,
        scratch: &mut Scratch<'_>,
        sums: &[f32],
        rays: &mut [RayState],
        counters: &mut Counters,
        mut put_colour: impl FnMut(&mut [RayState], usize, f32, [f32; 3]),
    ) {
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
            let stride = columns_of(network, n);
            scratch.stride = stride;
            for (column, &ray) in head(self.owner, n).iter().enumerate() {
                let (mean_of, weight) = (head(tail(sums, ray as usize * row), rows), weight(ray as usize));
                for (to, sum) in scratch.front.chunks_exact_mut(stride.max(1)).zip(mean_of) {
                    put(to, column, sum / weight);
                }
            }
            network.take_h(scratch);
            let owner = &*self.owner;
            let dir = |column: usize| at(rays, at(owner, column) as usize).ray.dir;
            put_dirs(self.dirs, scratch.stride, n, dir);
            self.run(network, plan, scratch, n, counters);
            for i in 0..n {
                let (ray, rgb) = (at(self.owner, i) as usize, column(self.rgb, scratch.stride, i));
                let invalid = rgb.iter().any(|c: &f32| c.is_nan());
                counters.invalid_samples += u64::from(invalid);
                put_colour(rays, ray, weight(ray), if invalid { [0.0; 3] } else { rgb });
            }
        }
    }

    /// Colours of `n` samples whose `h` is in `scratch.front`, each seen along its `dir`: as of rays that see them alone.
    pub fn of_samples(
        &mut self,
        network: &Network<'_>,
        plan: &Plan<'_>,
        scratch: &mut Scratch<'_>,
        (n, dir): (usize, impl Fn(usize) -> Vec3),
        counters: &mut Counters,
    ) {
        put_dirs(self.dirs, scratch.stride, n, dir);
        self.run(network, plan, scratch, n, counters);
    }

    fn run(
        &mut self,
        network: &Network<'_>,
        plan: &Plan<'_>,
        scratch: &mut Scratch<'_>,
        n: usize,
        counters: &mut Counters,
    ) {
        let stride = scratch.stride;
        if !(n == 1 && network.colour_of_one(plan.math, scratch, self.dirs, self.rgb)) {
            network.direction(plan.math, scratch, self.dirs, self.share);
            let share = &*self.share;
            let fill = |to: &mut [f32]| to.iter_mut().zip(share).for_each(|(to, &share)| *to = share);
            network.colour(plan.math, scratch, fill, self.rgb);
        }
        tone::samples_to_light(&plan.effects.tone, plan.math, network.isa(), head_mut(self.rgb, 3 * stride));
        counters.add_colour(network, n);
        counters.macs += (n * network.direction_macs()) as u64;
    }
}

/// The directions of `n` columns; what only fills the block up keeps any.
fn put_dirs(dirs: &mut [f32], stride: usize, n: usize, dir: impl Fn(usize) -> Vec3) {
    for column in 0..n {
        put_column(dirs, stride, column, dir(column).to_array());
    }
}
