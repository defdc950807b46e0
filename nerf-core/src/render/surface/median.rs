//! Median distances of the rays in flight.

use crate::memory::Layout;
use crate::plan::Plan;
use crate::volume::{Accumulator, median_in_bin};

#[cfg(test)]
mod tests;

/// No half of the light is gone yet.
const NOT_YET: f32 = f32::INFINITY;

/// The rays' median distances, `[rays]`, or empty where they are not requested.
pub(in crate::render) struct Medians<'w> {
    distance: &'w mut [f32],
}

impl<'w> Medians<'w> {
    /// Whether this build has medians.
    pub const BUILT: bool = true;

    pub fn lay_out(layout: &mut impl Layout<'w>, plan: &Plan<'_>) -> Self {
        let rays = if plan.outputs.median_distance { plan.batch.rays } else { 0 };
        Self { distance: layout.slice(rays, NOT_YET) }
    }

    /// A new ray in place `ray`.
    pub fn begin(&mut self, ray: usize) {
        if let Some(distance) = self.distance.get_mut(ray) {
            *distance = NOT_YET;
        }
    }

    /// Looks whether the sample that `gathered` took last is where the light falls below one half.
    ///
    /// `thickness`: what was gathered before it. The rest as in [`Accumulator::add_density`].
    #[inline]
    pub fn look(&mut self, ray: u32, thickness: f32, gathered: &Accumulator, sigma: f32, t: f32, delta: f32) {
        let Some(distance) = self.distance.get_mut(ray as usize) else { return };
        // The test that ends rays, so that a cut of one half never comes first.
        if *distance == NOT_YET && gathered.transmittance() < 0.5 {
            *distance = median_in_bin(thickness, sigma, t, delta);
        }
    }

    /// The pixel's median distance, whose ray is counted from `start`; `ray` is `None` where nothing was met, and that
    /// is at `far`.
    pub fn finish(&self, ray: Option<usize>, plan: &Plan<'_>, start: f32, far: f32) -> f32 {
        if !plan.outputs.median_distance {
            return 0.0;
        }
        let found = ray.and_then(|ray| self.distance.get(ray)).copied();
        found.filter(|&distance| distance != NOT_YET).map_or(far, |distance| (start + distance).min(far))
    }
}
