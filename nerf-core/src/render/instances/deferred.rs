//! Deferred shading of several fields: each gathers its own `h` of a ray, and has a network of its own for it.

use super::Instance;
use crate::memory::{Layout, head};
use crate::network::{Network, Scratch};
use crate::plan::Plan;
use crate::render::Counters;
use crate::render::deferred::{RayNetworks, is_deferred};
use crate::render::march::RayState;

/// What the rays in flight have gathered of each field that is shaded once a ray; of the others there is nothing.
pub(super) struct Deferred<'f, 'w> {
    instances: &'f [Instance<'f>],
    rays: usize,
    /// `h` of the part that a ray is in: of each field `[rays][rows]`.
    parts: &'w mut [f32],
    /// Σ weight · h, and behind it Σ weight: of each field `[rays][rows + 1]`.
    sums: &'w mut [f32],
    pub networks: RayNetworks<'w>,
}

/// Values of `h` of a field that is shaded once a ray; 0 of another.
fn rows(network: &Network<'_>, plan: &Plan<'_>) -> usize {
    if is_deferred(network, plan) { network.trunk_rows() } else { 0 }
}

impl<'f, 'w> Deferred<'f, 'w> {
    pub fn lay_out<'n>(
        layout: &mut impl Layout<'w>,
        instances: &'f [Instance<'f>],
        networks: impl Iterator<Item = &'n Network<'n>> + Clone,
        plan: &Plan<'_>,
        samples: usize,
    ) -> Self {
        let fields = networks.filter(|network| is_deferred(network, plan));
        let values: usize = fields.clone().map(|network| network.trunk_rows()).sum();
        let count = fields.clone().count();
        let direction_rows = fields.map(|network| network.direction_rows()).max().unwrap_or(0);
        let rays = plan.batch.rays;
        Self {
            instances,
            rays,
            parts: layout.slice(rays.saturating_mul(values), 0.0),
            sums: layout.slice(rays.saturating_mul(values + count), 0.0),
            networks: RayNetworks::lay_out(layout, direction_rows, if count > 0 { samples } else { 0 }),
        }
    }

    /// Whether a field is shaded once a ray.
    pub fn is_on(&self, member: usize) -> bool {
        self.rows(member) > 0
    }

    fn rows(&self, member: usize) -> usize {
        self.instances.get(member).map_or(0, |it| rows(it.renderer.network(), it.plan))
    }

    /// Where the values of a field begin: those of `h`, and of the sums.
    fn first(&self, member: usize) -> [usize; 2] {
        let before = |member: usize| [self.rows(member), self.rows(member) + usize::from(self.is_on(member))];
        (0..member).map(before).fold([0; 2], |[h, sums], [a, b]| [h + self.rays * a, sums + self.rays * b])
    }

    /// A new ray in place `ray`.
    pub fn begin(&mut self, ray: usize) {
        for member in 0..self.instances.len() {
            let (rows, [_, first]) = (self.rows(member), self.first(member));
            if rows > 0
                && let Some(sums) =
                    self.sums.get_mut(first + ray * (rows + 1)..first + (ray + 1) * (rows + 1))
            {
                sums.fill(0.0);
            }
        }
    }

    /// Keeps the `h` of a sample: that of the part its ray is in.
    pub fn keep(&mut self, member: usize, ray: usize, scratch: &Scratch<'_>, column: usize) {
        let Some(it) = self.instances.get(member) else { return };
        let (rows, [first, _]) = (self.rows(member), self.first(member));
        if let Some(h) = self.parts.get_mut(first + ray * rows..first + (ray + 1) * rows) {
            h.fill(0.0);
            it.renderer.network().add_h(scratch, column, 1.0, h);
        }
    }

    /// Adds the part that a ray is in.
    pub fn add(&mut self, member: usize, ray: usize, weight: f32) {
        let (rows, [first, first_sum]) = (self.rows(member), self.first(member));
        let h = self.parts.get(first + ray * rows..first + (ray + 1) * rows).unwrap_or_default();
        let place = first_sum + ray * (rows + 1);
        if let Some([sums @ .., total]) = self.sums.get_mut(place..place + rows + 1) {
            sums.iter_mut().zip(h).for_each(|(sum, h)| *sum += weight * h);
            *total += weight;
        }
    }

    /// Runs a field's network for each of its `rays` that has a weight, and hands weight and colour to `put`.
    pub fn shade(
        &mut self,
        member: usize,
        scratch: &mut Scratch<'_>,
        rays: &mut [RayState],
        counters: &mut Counters,
        mut put: impl FnMut(usize, f32, [f32; 3]),
    ) {
        let Some(Instance { renderer, plan, .. }) = self.instances.get(member) else { return };
        let (row, [_, first]) = (self.rows(member) + 1, self.first(member));
        let sums = self.sums.get(first..).map_or(&[][..], |sums| head(sums, rays.len() * row));
        let networks = &mut self.networks;
        networks.shade(renderer.network(), plan, scratch, sums, rays, counters, |_, ray, weight, rgb| {
            put(ray, weight, rgb);
        });
    }
}
