//! Deferred shading of several fields: each field's hidden features are composited along a ray and shaded once per ray.

use crate::memory::{Layout, at};
use crate::render::field::Field;
use crate::render::stages::RayNetworks;
use core::ops::Range;

/// Position of one field's values in the buffers of [`Deferred`], which hold the values of all fields. `rows`: number
/// of the field's hidden features; 0 without deferred shading.
#[derive(Clone, Copy, Default)]
struct Place {
    /// Index of the field's first value of `h` in `Deferred::parts`.
    h: usize,
    /// Index of the field's first value in `Deferred::sums`.
    sums: usize,
    rows: usize,
}

/// Weighted sums of hidden features `h` along the current tile's rays, for each field with deferred shading.
pub(super) struct Deferred<'w> {
    places: &'w mut [Place],
    /// Hidden features `h` of the sample in each ray's current bin: one table `[rays][rows]` for each field, where
    /// `rows` is the field's number of features.
    parts: &'w mut [f32],
    /// Sums along each ray: one table `[rays][rows + 1]` for each field. A row holds Σ weight · `h` for each hidden
    /// feature `h`, then Σ weight.
    sums: &'w mut [f32],
    pub networks: RayNetworks<'w>,
}

impl<'w> Deferred<'w> {
    /// Reserves memory in `layout` for the rays of all `fields`, and for blocks of `samples` samples.
    pub fn lay_out<'n>(
        layout: &mut impl Layout<'w>,
        fields: impl Iterator<Item = Field<'n>> + Clone,
        samples: usize,
    ) -> Self {
        let places = layout.slice(fields.clone().count(), Place::default());
        let (mut parts, mut sums, mut any) = (0usize, 0usize, false);
        for (member, Field { network, plan }) in fields.enumerate().filter(|(_, field)| field.shades_rays()) {
            let (rays, rows) = (plan.batch.rays, network.trunk_rows());
            // While memory is only measured, `places` is empty.
            if let Some(place) = places.get_mut(member) {
                *place = Place { h: parts, sums, rows };
            }
            parts = parts.saturating_add(rays.saturating_mul(rows));
            sums = sums.saturating_add(rays.saturating_mul(rows + 1));
            any = true;
        }
        Self {
            places,
            parts: layout.slice(parts, 0.0),
            sums: layout.slice(sums, 0.0),
            networks: RayNetworks::lay_out(layout, if any { samples } else { 0 }),
        }
    }

    /// Indices in `Deferred::sums` at which the sums of field `member` on the rays `ray..ray + count` are stored.
    fn sums(&self, member: usize, ray: usize, count: usize) -> Range<usize> {
        let Place { sums, rows, .. } = at(self.places, member);
        let row = if rows > 0 { rows + 1 } else { 0 };
        sums + ray * row..sums + (ray + count) * row
    }

    /// Returns the indices in `Deferred::parts` at which the hidden features of field `member` on ray `ray` are stored.
    fn h(&self, member: usize, ray: usize) -> Range<usize> {
        let Place { h, rows, .. } = at(self.places, member);
        h + ray * rows..h + (ray + 1) * rows
    }

    /// Zeroes the sums of all fields on the first `count` rays.
    pub fn begin(&mut self, count: usize) {
        for member in 0..self.places.len() {
            let sums = self.sums(member, 0, count);
            self.sums.get_mut(sums).unwrap_or_default().fill(0.0);
        }
    }

    /// Returns the memory for the hidden features of field `member` at the sample in ray `ray`'s current bin.
    pub fn h_mut(&mut self, member: usize, ray: usize) -> &mut [f32] {
        let range = self.h(member, ray);
        self.parts.get_mut(range).unwrap_or_default()
    }

    /// Adds the sample in ray `ray`'s current bin to the sums of field `member`: `weight` times the hidden features
    /// that the caller has written to [`Deferred::h_mut`], and `weight` itself.
    pub fn add(&mut self, member: usize, ray: usize, weight: f32) {
        let h = self.parts.get(self.h(member, ray)).unwrap_or_default();
        let sums = self.sums(member, ray, 1);
        if let Some([sums @ .., total]) = self.sums.get_mut(sums) {
            sums.iter_mut().zip(h).for_each(|(sum, h)| *sum += weight * h);
            *total += weight;
        }
    }

    /// Buffers of the colour branch, and the weighted sums of hidden features of field `member` for the first `count`
    /// rays.
    pub fn sums_of(&mut self, member: usize, count: usize) -> (&mut RayNetworks<'w>, &[f32]) {
        let sums = self.sums.get(self.sums(member, 0, count)).unwrap_or_default();
        (&mut self.networks, sums)
    }
}
