//! The median distance: where half of the light is gone.

use super::thickness_in_bin;
use core::f32::consts::LN_2;

/// Where in a bin the transmittance falls to one half, world units along the ray.
///
/// `thickness`: Σ sigma·delta of the bins in front, below ln 2 up to rounding. `sigma`: the bin's density,
/// not 0. `t`: its middle, `delta`: its width, world units along the ray. Density is constant within a
/// bin, so that there
///
/// `t_edge + (ln 2 − thickness) / sigma`
///
/// is exact; rounding does not leave the bin. In a wall (`sigma = +inf`) it is the front edge.
///
/// # Examples
/// ```
/// use nerf_core::volume::median_in_bin;
/// // A medium of density 1 that begins at 2, in bins of 0.5: half is left at 2 + ln 2 = 2.693.
/// let t = median_in_bin(0.5, 1.0, 2.75, 0.5);
/// assert!((t - (2.0 + core::f32::consts::LN_2)).abs() < 1e-6);
/// ```
#[inline(never)]
pub fn median_in_bin(thickness: f32, sigma: f32, t: f32, delta: f32) -> f32 {
    thickness_in_bin(LN_2 - thickness, sigma, t, delta)
}
