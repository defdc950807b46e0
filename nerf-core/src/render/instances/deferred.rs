//! Deferred shading of several fields: each composites its own `h` along a ray, and shades it with its own network.

use super::Instance;
use crate::memory::{Layout, at};
use crate::network::Scratch;
use crate::render::Counters;
use crate::render::field::Field;
use crate::render::march::RayState;
use crate::render::stages::RayNetworks;
use core::ops::Range;

/// Position of a field's values in the memory of all fields; no values if the field is not shaded once a ray.
#[derive(Clone, Copy, Default)]
struct Place {
    /// Index of the field's first value of `h`.
    h: usize,
    /// Index of the field's first sum.
    sums: usize,
    /// Number of values of `h` of a ray.
    rows: usize,
}

/// Sums of `h` of the rays in flight, for each field that is shaded once a ray.
pub(super) struct Deferred<'f, 'w> {
    instances: &'f [Instance<'f>],
    /// `[instances]`.
    places: &'w mut [Place],
    /// `h` of the bin that each ray is in: for each field `[rays][rows]`.
    parts: &'w mut [f32],
    /// Σ weight · h, and last in each row Σ weight: for each field `[rays][rows + 1]`.
    sums: &'w mut [f32],
    pub networks: RayNetworks<'w>,
}

impl<'f, 'w> Deferred<'f, 'w> {
    /// Memory for blocks of `samples` of any of `fields`.
    pub fn lay_out<'n>(
        layout: &mut impl Layout<'w>,
        instances: &'f [Instance<'f>],
        fields: impl Iterator<Item = Field<'n>> + Clone,
        samples: usize,
    ) -> Self {
        let places = layout.slice(fields.clone().count(), Place::default());
        let (mut parts, mut sums, mut direction_rows, mut any) = (0usize, 0usize, 0, false);
        for (member, Field { network, plan }) in fields.enumerate().filter(|(_, field)| field.shades_rays()) {
            let (rays, rows) = (plan.batch.rays, network.trunk_rows());
            // While memory is only measured, `places` is empty.
            if let Some(place) = places.get_mut(member) {
                *place = Place { h: parts, sums, rows };
            }
            parts = parts.saturating_add(rays.saturating_mul(rows));
            sums = sums.saturating_add(rays.saturating_mul(rows + 1));
            (direction_rows, any) = (direction_rows.max(network.direction_rows()), true);
        }
        Self {
            instances,
            places,
            parts: layout.slice(parts, 0.0),
            sums: layout.slice(sums, 0.0),
            networks: RayNetworks::lay_out(layout, direction_rows, if any { samples } else { 0 }),
        }
    }

    /// Index range of the sums of `count` rays of a field from `ray` on.
    fn sums(&self, member: usize, ray: usize, count: usize) -> Range<usize> {
        let Place { sums, rows, .. } = at(self.places, member);
        let row = if rows > 0 { rows + 1 } else { 0 };
        sums + ray * row..sums + (ray + count) * row
    }

    /// Index range of the `h` of the bin of a field that a ray is in.
    fn h(&self, member: usize, ray: usize) -> Range<usize> {
        let Place { h, rows, .. } = at(self.places, member);
        h + ray * rows..h + (ray + 1) * rows
    }

    /// Clears the sums of the first `count` rays.
    pub fn begin(&mut self, count: usize) {
        for member in 0..self.instances.len() {
            let sums = self.sums(member, 0, count);
            self.sums.get_mut(sums).unwrap_or_default().fill(0.0);
        }
    }

    /// Stores the `h` of a sample as that of the bin its ray is in.
    pub fn keep(&mut self, member: usize, ray: usize, scratch: &Scratch<'_>, column: usize) {
        let (range, Some(it)) = (self.h(member, ray), self.instances.get(member)) else { return };
        let h = self.parts.get_mut(range).unwrap_or_default();
        h.fill(0.0);
        it.renderer.network().add_h(scratch, column, 1.0, h);
    }

    /// Adds the `h` of the bin that a ray is in to the ray's sums.
    pub fn add(&mut self, member: usize, ray: usize, weight: f32) {
        let h = self.parts.get(self.h(member, ray)).unwrap_or_default();
        let sums = self.sums(member, ray, 1);
        if let Some([sums @ .., total]) = self.sums.get_mut(sums) {
            sums.iter_mut().zip(h).for_each(|(sum, h)| *sum += weight * h);
            *total += weight;
        }
    }

    /// Evaluates a field's colour branch for each of `rays` with a weight, and passes index, weight and colour to
    /// `put`.
    pub fn shade(
        &mut self,
        member: usize,
        scratch: &mut Scratch<'_>,
        rays: &mut [RayState],
        counters: &mut Counters,
        mut put: impl FnMut(usize, f32, [f32; 3]),
    ) {
        let Some(field) = self.instances.get(member).map(|it| it.field()) else { return };
        if field.shades_rays() {
            let sums = self.sums.get(self.sums(member, 0, rays.len())).unwrap_or_default();
            let put = |_: &mut RayState, ray, weight, rgb| put(ray, weight, rgb);
            self.networks.shade(field, scratch, sums, rays, counters, put);
        }
    }
}
