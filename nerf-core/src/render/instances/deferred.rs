//! Deferred shading of several fields: each field's `h` is composited along a ray, and shaded by the field's network.

use crate::memory::{Layout, at};
use crate::render::field::Field;
use crate::render::stages::RayNetworks;
use core::ops::Range;

/// Position of a field's values in the memory of all fields; no values if the field is not shaded once a ray.
#[derive(Clone, Copy, Default)]
struct Place {
    /// Index of the field's first value of `h`.
    h: usize,
    /// Index of the field's first value in `Deferred::sums`.
    sums: usize,
    /// Number of hidden features `h` of a sample.
    rows: usize,
}

/// Weighted sums of hidden features `h` of the current tile's rays, for each field that is shaded once a ray.
pub(super) struct Deferred<'w> {
    /// Positions of each field's values, `[instances]`.
    places: &'w mut [Place],
    /// `h` of the current bin of each ray: for each field `[rays][rows]`.
    parts: &'w mut [f32],
    /// Σ weight · h, followed in each row by Σ weight: for each field `[rays][rows + 1]`.
    sums: &'w mut [f32],
    pub networks: RayNetworks<'w>,
}

impl<'w> Deferred<'w> {
    /// Memory for the rays of all `fields`, and for blocks of `samples` samples of any field.
    pub fn lay_out<'n>(
        layout: &mut impl Layout<'w>,
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
            places,
            parts: layout.slice(parts, 0.0),
            sums: layout.slice(sums, 0.0),
            networks: RayNetworks::lay_out(layout, direction_rows, if any { samples } else { 0 }),
        }
    }

    /// Index range of the weighted sums of `h` of field `member` for `count` rays from `ray` on.
    fn sums(&self, member: usize, ray: usize, count: usize) -> Range<usize> {
        let Place { sums, rows, .. } = at(self.places, member);
        let row = if rows > 0 { rows + 1 } else { 0 };
        sums + ray * row..sums + (ray + count) * row
    }

    /// Index range of the `h` of field `member` in the current bin of `ray`.
    fn h(&self, member: usize, ray: usize) -> Range<usize> {
        let Place { h, rows, .. } = at(self.places, member);
        h + ray * rows..h + (ray + 1) * rows
    }

    /// Zeroes the weighted sums of `h` of the first `count` rays.
    pub fn begin(&mut self, count: usize) {
        for member in 0..self.places.len() {
            let sums = self.sums(member, 0, count);
            self.sums.get_mut(sums).unwrap_or_default().fill(0.0);
        }
    }

    /// Memory for the `h` of field `member` in the current bin of `ray`.
    pub fn h_mut(&mut self, member: usize, ray: usize) -> &mut [f32] {
        let range = self.h(member, ray);
        self.parts.get_mut(range).unwrap_or_default()
    }

    /// Adds `weight` times the `h` of field `member` in the current bin of `ray` to the ray's sums of `h`.
    pub fn add(&mut self, member: usize, ray: usize, weight: f32) {
        let h = self.parts.get(self.h(member, ray)).unwrap_or_default();
        let sums = self.sums(member, ray, 1);
        if let Some([sums @ .., total]) = self.sums.get_mut(sums) {
            sums.iter_mut().zip(h).for_each(|(sum, h)| *sum += weight * h);
            *total += weight;
        }
    }

    /// The [`RayNetworks`], and the weighted sums of `h` of field `member` for the first `count` rays.
    pub fn sums_of(&mut self, member: usize, count: usize) -> (&mut RayNetworks<'w>, &[f32]) {
        let sums = self.sums.get(self.sums(member, 0, count)).unwrap_or_default();
        (&mut self.networks, sums)
    }
}
