//! Median distances of the current tile's rays.

use crate::memory::Layout;
use crate::plan::Plan;
use crate::volume::{Accumulator, thickness_in_bin};
use core::f32::consts::LN_2;

#[cfg(test)]
mod tests;

/// Stored distance of a ray whose transmittance has not yet fallen below one half.
const NOT_YET: f32 = f32::INFINITY;

/// Median distances, `[rays]`, world units, counted from `PixelRay::start`; empty if not requested.
pub(in crate::render) struct Medians<'w> {
    distance: &'w mut [f32],
}

impl<'w> Medians<'w> {
    /// Whether this build computes median distances.
    pub const BUILT: bool = true;

    pub fn lay_out(layout: &mut impl Layout<'w>, plan: &Plan<'_>) -> Self {
        let rays = if plan.outputs.median_distance { plan.batch.rays } else { 0 };
        Self { distance: layout.slice(rays, NOT_YET) }
    }

    /// Sets the median distances of the first `count` rays to [`NOT_YET`].
    pub fn begin(&mut self, count: usize) {
        self.distance.iter_mut().take(count).for_each(|distance| *distance = NOT_YET);
    }

    /// Whether the sample last added to `gathered` is the first to lower the transmittance of `ray` below one half. The
    /// caller then calls [`Medians::put`]. Always `false` if median distances are not requested.
    ///
    /// The comparison is `<`, as in the test that ends a ray below the transmittance cut. Therefore, a ray with a cut
    /// of one half does not end before its median.
    #[inline]
    pub fn passes(&self, ray: u32, gathered: &Accumulator) -> bool {
        let distance = self.distance.get(ray as usize);
        distance.is_some_and(|&distance| distance == NOT_YET && gathered.transmittance() < 0.5)
    }

    /// Stores the median distance of `ray`, which lies in the interval of middle `mid` and width `delta`, world units.
    /// `sigma`: density of the interval, 1/world unit. `before`: optical thickness in front of the interval.
    pub fn put(&mut self, ray: u32, before: f32, sigma: f32, [mid, delta]: [f32; 2]) {
        if let Some(distance) = self.distance.get_mut(ray as usize) {
            *distance = median_in_bin(before, sigma, mid, delta);
        }
    }

    /// Returns `start` plus the stored median distance of `ray`, at most `far`. If the ray has no median distance,
    /// returns `far`. If median distances are not requested, returns 0.
    pub fn finish(&self, ray: usize, start: f32, far: f32) -> f32 {
        self.distance.get(ray).map_or(0.0, |&distance| (start + distance).min(far))
    }
}

/// Returns the distance along the ray, world units, at which the transmittance falls to one half inside a bin of
/// constant density: `t_edge + (ln 2 − thickness) / sigma`, where t_edge is the bin's near edge. The result is clamped
/// to the bin, and is the near edge if `sigma` is +inf.
///
/// `thickness`: Σ sigma·delta of the bins in front, below ln 2 up to rounding. `sigma`: density of the bin, not 0. `t`:
/// middle of the bin, world units along the ray. `delta`: width of the bin, world units along the ray.
#[inline(never)]
fn median_in_bin(thickness: f32, sigma: f32, t: f32, delta: f32) -> f32 {
    thickness_in_bin(LN_2 - thickness, sigma, t, delta)
}
