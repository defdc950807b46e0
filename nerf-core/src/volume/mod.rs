//! Volume rendering: densities and colours along a ray become one pixel.

use crate::math::{Math, MathBackend, Sum, with_math};
use crate::simd::{BLOCK, Lanes};
use side_by_side::Rows;

#[cfg(feature = "train")]
mod composite;
#[cfg(feature = "normals")]
mod normal;

pub(crate) mod side_by_side;
#[cfg(test)]
mod tests;

#[cfg(feature = "train")]
pub use composite::{VolumeError, composite};
#[cfg(feature = "normals")]
pub(crate) use normal::NormalSum;

/// Opacity up to which a pixel counts as having no surface. The distances of such a pixel are the frame's far distance.
pub const OPACITY_EPSILON: f32 = 1e-4;

/// Largest optical thickness of a sample; a larger one is clamped. A transmittance of `e^-100` is 0 in any image.
const MAX_TAU: f32 = 100.0;

/// Returns the optical thickness of a sample, at most [`MAX_TAU`]. `sigma`: density, 1/world unit. `delta`: width,
/// world units, of the sample's bin: the interval of the ray over which the density is taken as constant.
#[inline(always)]
pub(crate) fn thickness(sigma: f32, delta: f32) -> f32 {
    (sigma.clamp(0.0, f32::MAX) * delta.clamp(0.0, f32::MAX)).min(MAX_TAU)
}

/// Returns the opacity `1 − e^−tau` of a sample of optical thickness `tau`.
#[inline(always)]
pub(crate) fn alpha<M: Math, V: Lanes>(tau: V) -> V {
    M::expm1(tau.neg()).neg()
}

/// Returns the distance along the ray at which the optical thickness, summed from a bin's front edge, reaches `left`.
/// The result is clamped to the bin, and is the front edge if `sigma` is +inf. `sigma`: constant density in the bin,
/// not 0. `t`: middle of the bin, world units along the ray. `delta`: width of the bin, world units along the ray.
#[inline]
pub(crate) fn thickness_in_bin(left: f32, sigma: f32, t: f32, delta: f32) -> f32 {
    // Neither operand of the clamp is NaN, since `left` is finite and `sigma` is not 0.
    let inside = (left / sigma).clamp(0.0, delta.max(0.0));
    (t - 0.5 * delta) + inside
}

/// Returns the transmittance `e^−total` after an optical thickness of `total`; 0 from [`MAX_TAU`] on.
#[inline(always)]
pub(crate) fn light<M: Math, V: Lanes>(total: V) -> V {
    V::select(total.less(V::splat(MAX_TAU)), M::decay(total), V::splat(0.0))
}

/// Returns the unit vector in the direction of `sum`, a weighted sum of normals; zeros if the pixel's `opacity` is at
/// most [`OPACITY_EPSILON`], or if the normals cancel. `weight`: sum of the normals' weights.
#[cfg(any(feature = "normals", feature = "anti-aliasing"))]
pub(crate) fn mean_direction(sum: [f32; 3], weight: f32, opacity: f32) -> [f32; 3] {
    // Length at or below which a mean of unit vectors is rounding noise.
    const MEAN_EPSILON: f32 = 1e-6;
    let sum = glam::Vec3::from(sum);
    let length = sum.length();
    if opacity > OPACITY_EPSILON && length > MEAN_EPSILON * weight {
        (sum / length).to_array()
    } else {
        [0.0; 3]
    }
}

/// Outputs of one pixel, composited along its ray. If a pixel has several rays, each output is a mean over the rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pixel {
    /// Colour over the background, display-encoded unless the frame's [`Tone`](crate::plan::Tone) is linear; 0 if not
    /// requested.
    pub rgb: [f32; 3],
    /// Opacity: the sum of the compositing weights, in `[0, 1]`.
    pub opacity: f32,
    /// Mean distance along the ray, world units; the frame's far distance if opacity is at most [`OPACITY_EPSILON`].
    pub ray_distance: f32,
    /// Mean distance along the view axis, world units; the frame's far distance if opacity is at most
    /// [`OPACITY_EPSILON`].
    pub z_depth: f32,
    /// First distance along the ray at which the transmittance is below one half, world units; the frame's far distance
    /// if there is none, 0 if not requested.
    pub median_distance: f32,
    /// Weighted mean of −∇sigma/|∇sigma|, scaled to unit length, world space; 0 if opacity is at most
    /// [`OPACITY_EPSILON`], if the directions cancel, or if not requested.
    pub normal: [f32; 3],
}

impl Pixel {
    /// A pixel of zeros.
    pub const BLANK: Self = Self {
        rgb: [0.0; 3],
        opacity: 0.0,
        ray_distance: 0.0,
        z_depth: 0.0,
        median_distance: 0.0,
        normal: [0.0; 3],
    };
}

/// Sums of optical thickness, colour, opacity and distance over a ray's composited samples, front to back.
///
/// For each sample: `alpha = −expm1(−sigma delta)`, `weight = transmittance · alpha`. Here `transmittance` is
/// `exp(−Σ sigma delta)`, summed over the samples in front of this sample. Sums are compensated (Kahan).
///
/// # Source
/// Mildenhall et al. 2020, eq. 3; deviation: the last bin is finite.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Accumulator {
    tau: Sum,
    rgb: [Sum; 3],
    opacity: Sum,
    distance: Sum,
    /// Summed weights of the samples since the last added colour.
    uncoloured: f32,
    left: f32,
}

impl Accumulator {
    /// State of a ray without samples.
    pub const NONE: Self = {
        let zero = Sum::ZERO;
        Self { tau: zero, rgb: [zero; 3], opacity: zero, distance: zero, uncoloured: 0.0, left: 1.0 }
    };

    /// Optical thickness of the samples added so far, `Σ sigma delta`.
    #[inline]
    pub fn optical_thickness(&self) -> f32 {
        self.tau.value
    }

    /// Transmittance behind the samples added so far: `exp(−Σ sigma delta)`.
    #[inline]
    pub fn transmittance(&self) -> f32 {
        self.left
    }

    /// Adds the density of the next sample, at distance `t`, and returns the sample's weight.
    ///
    /// `sigma`: 1/world unit, clamped to `>= 0`; must not be NaN. `t`: world units along the ray, finite. `delta`:
    /// width of its bin, world units. If `sigma` or `delta` is +inf, the sample is opaque, unless the other is 0.
    #[inline]
    pub fn add_density(&mut self, math: MathBackend, sigma: f32, t: f32, delta: f32) -> f32 {
        let tau = thickness(sigma, delta);
        let total = self.add_thickness(tau);
        let (alpha, light) = with_math!(math, M => (alpha::<M, f32>(tau), light::<M, f32>(total)));
        self.add_alpha(alpha, light, t)
    }

    /// Adds the optical thickness `tau` of a sample; the first half of [`Accumulator::add_density`]. Returns the sum of
    /// optical thickness up to and including this sample.
    #[inline]
    pub(crate) fn add_thickness(&mut self, tau: f32) -> f32 {
        // A sample of thickness 0 must leave the sum bit-identical. Adding 0 to a Kahan sum may change it by an ulp, if
        // the last term was larger than the sum before it.
        if tau > 0.0 {
            self.tau.add(tau);
        }
        self.tau.value
    }

    /// Adds a sample of opacity `alpha` at distance `t` (world units) and returns the sample's weight; the second half
    /// of [`Accumulator::add_density`]. `light`: transmittance behind the sample.
    #[inline]
    pub(crate) fn add_alpha(&mut self, alpha: f32, light: f32, t: f32) -> f32 {
        let weight = self.left * alpha;
        self.left = light;
        if weight == 0.0 {
            return weight;
        }
        self.opacity.add(weight);
        self.distance.add(weight * t);
        self.uncoloured += weight;
        weight
    }

    /// Returns the state of a ray that carries one photon, which collides with the medium where the optical thickness
    /// reaches `total`. The state's sum of optical thickness starts at `-total`, so that it is 0 at the collision.
    pub(crate) fn until(total: f32) -> Self {
        let mut ray = Self::NONE;
        ray.tau.add(-total);
        ray
    }

    /// Whether the photon of a ray made by [`Accumulator::until`] collides in a bin. If so, adds opacity 1 and the
    /// distance of the collision. The caller must already have added the bin's optical thickness.
    ///
    /// `before`: result of [`Accumulator::optical_thickness`] in front of the bin. `-before` is the optical thickness
    /// from the bin's front edge to the collision. `sigma`: density of the bin, 1/world unit, not 0. `t`: middle of the
    /// bin, world units along the ray. `delta`: width of the bin, world units along the ray.
    #[inline]
    pub(crate) fn collide(&mut self, before: f32, sigma: f32, t: f32, delta: f32) -> bool {
        let collides = -before < thickness(sigma, delta);
        if collides {
            self.opacity.add(1.0);
            self.distance.add(thickness_in_bin(-before, sigma, t, delta));
        }
        collides
    }

    /// Decides whether the colour of the sample that was just added is evaluated. The accumulator holds the sum of the
    /// weights of all samples since the last evaluated colour, this sample's included. If this sum exceeds `cut`,
    /// returns the sum and resets it to 0; else returns `None`.
    ///
    /// If a sum is returned, the caller must evaluate this sample's colour, and pass the sum and the colour to
    /// [`Accumulator::add_colour`]. With deferred shading, the sum is instead the weight of this sample's features in the
    /// features of the ray, and the caller calls [`Accumulator::colour_all`] once, at the end of the ray.
    ///
    /// Samples of low weight thus get the colour of the next evaluated sample. At the end of the ray, samples without a
    /// colour have a total weight of at most `cut`. If `cut` is 0 at every call, the result is this sample's own
    /// weight, or `None` for a weight of 0.
    #[inline]
    pub fn take_uncoloured(&mut self, cut: f32) -> Option<f32> {
        (self.uncoloured > cut).then(|| core::mem::take(&mut self.uncoloured))
    }

    /// Adds `weight` times `rgb` to the ray's colour. `weight`: result of [`Accumulator::take_uncoloured`].
    #[inline]
    pub fn add_colour(&mut self, weight: f32, rgb: [f32; 3]) {
        for (sum, c) in self.rgb.iter_mut().zip(rgb) {
            sum.add(weight * c);
        }
    }

    /// Adds the only colour of a ray with deferred shading: `rgb` times the sum of all weights that
    /// [`Accumulator::take_uncoloured`] has returned. This sum is computed from the state.
    #[inline]
    pub(crate) fn colour_all(&mut self, rgb: [f32; 3]) {
        self.add_colour(self.opacity.value - self.uncoloured, rgb);
    }

    /// Returns the ray's pixel, over `background`. `start`: distance along the ray from which the samples' `t` is
    /// measured; added to the mean of `t`. `far`: distance of a pixel without a surface, and upper limit of the mean
    /// distance along the ray. `z_per_distance`: cosine between ray and view axis. `cut`: whether the ray was
    /// terminated early. If so, the pixel is opaque: the ray's mean colour replaces the background.
    ///
    /// Samples at the end of the ray may have no evaluated colour. If their weights add up to less than the weights of
    /// the coloured samples, they get the ray's mean colour; else they stay black. The pixel's median distance and
    /// normal are 0.
    ///
    /// # Source
    /// Müller et al. 2022, the authors' renderer: opaque pixels of terminated rays.
    pub(crate) fn finish_from(
        &self,
        start: f32,
        cut: bool,
        background: [f32; 3],
        far: f32,
        z_per_distance: f32,
    ) -> Pixel {
        let opacity = if cut { 1.0 } else { self.opacity.value.clamp(0.0, 1.0) };
        let through = 1.0 - opacity;
        let coloured = self.opacity.value - self.uncoloured;
        let scale = if self.uncoloured < coloured { opacity / coloured } else { 1.0 };
        let rgb = core::array::from_fn(|c| self.rgb[c].value * scale + through * background[c]);
        let (ray_distance, z_depth) = if opacity > OPACITY_EPSILON {
            let mean = (start + self.distance.value / self.opacity.value).min(far);
            (mean, mean * z_per_distance)
        } else {
            (far, far)
        };
        Pixel { rgb, opacity, ray_distance, z_depth, ..Pixel::BLANK }
    }

    /// Adds the next sample with its colour `rgb` and returns the sample's weight. `sigma`, `t`, `delta`: as in
    /// [`Accumulator::add_density`].
    #[cfg(feature = "train")]
    #[inline]
    pub(crate) fn add(&mut self, math: MathBackend, sigma: f32, rgb: [f32; 3], t: f32, delta: f32) -> f32 {
        let weight = self.add_density(math, sigma, t, delta);
        if let Some(weight) = self.take_uncoloured(0.0) {
            self.add_colour(weight, rgb);
        }
        weight
    }

    /// Writes the state of the ray, except its colour, to column `column` of `rows`, the state of a block of rays.
    #[inline]
    pub(crate) fn put_column(&self, rows: &mut Rows, column: usize) {
        let Self { tau, opacity, distance, uncoloured, left, .. } = *self;
        let values = [
            tau.value,
            tau.lost,
            opacity.value,
            opacity.lost,
            distance.value,
            distance.lost,
            uncoloured,
            left,
        ];
        for (row, value) in rows.iter_mut().zip(values) {
            row[column % BLOCK] = value;
        }
    }

    /// Reads the state of the ray, except its colour, from column `column` of `rows` ([`Accumulator::put_column`]).
    #[inline]
    pub(crate) fn take_column(&mut self, rows: &Rows, column: usize) {
        let [tau, lost_tau, opacity, lost_opacity, distance, lost, uncoloured, left] =
            rows.each_ref().map(|row| row[column % BLOCK]);
        self.tau = Sum { value: tau, lost: lost_tau };
        self.opacity = Sum { value: opacity, lost: lost_opacity };
        self.distance = Sum { value: distance, lost };
        (self.uncoloured, self.left) = (uncoloured, left);
    }
}
