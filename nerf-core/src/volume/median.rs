//! The median distance, at which half of the light is absorbed.

use super::thickness_in_bin;
use core::f32::consts::LN_2;

/// Distance along the ray, world units, at which the transmittance falls to one half inside a bin.
///
/// `thickness`: Σ sigma·delta of the bins in front, below ln 2 up to rounding. `sigma`: the bin's density,
/// not 0. `t`: its middle, `delta`: its width, world units along the ray. Density is constant within a
/// bin, so that there
///
/// `t_edge + (ln 2 − thickness) / sigma`
///
/// is exact. The result is clamped to the bin; if `sigma` is +inf it is the front edge.
#[inline(never)]
pub(crate) fn median_in_bin(thickness: f32, sigma: f32, t: f32, delta: f32) -> f32 {
    thickness_in_bin(LN_2 - thickness, sigma, t, delta)
}
