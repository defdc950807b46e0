//! Volume rendering: densities and colours along a ray become one pixel.

use crate::math::{Math, Sum};
use crate::simd::Lanes;

#[cfg(feature = "train")]
mod composite;
#[cfg(feature = "median")]
mod median;
#[cfg(feature = "normals")]
mod normal;

pub(crate) mod side_by_side;
#[cfg(test)]
mod tests;

#[cfg(feature = "train")]
pub use composite::{VolumeError, composite, composite_with};
#[cfg(feature = "median")]
pub(crate) use median::median_in_bin;
#[cfg(feature = "normals")]
pub(crate) use normal::NormalSum;

/// At or below this opacity a pixel has no surface: its distances are `far`.
pub const OPACITY_EPSILON: f32 = 1e-4;

/// Optical thickness beyond which a sample is an opaque wall; `e^-100` is 0 in any picture.
const MAX_TAU: f32 = 100.0;

/// Optical thickness of a sample: `sigma` 1/world unit, `delta` world units.
#[inline(always)]
pub(crate) fn thickness(sigma: f32, delta: f32) -> f32 {
    (sigma.clamp(0.0, f32::MAX) * delta.clamp(0.0, f32::MAX)).min(MAX_TAU)
}

/// What a sample of optical thickness `tau` keeps of the light that reaches it.
#[inline(always)]
pub(crate) fn alpha<M: Math, V: Lanes>(tau: V) -> V {
    M::expm1(tau.neg()).neg()
}

/// Where in a bin an optical thickness of `left` is behind the ray: density is constant in there. `sigma`: not 0; `t`: the
/// bin's middle, `delta`: its width, world units along the ray. Rounding does not leave the bin; in a wall (`sigma = +inf`)
/// it is the front edge.
#[inline]
pub(crate) fn thickness_in_bin(left: f32, sigma: f32, t: f32, delta: f32) -> f32 {
    // Neither operand of the clamp is NaN: sigma is not 0, and the difference is finite.
    let inside = (left / sigma).clamp(0.0, delta.max(0.0));
    (t - 0.5 * delta) + inside
}

/// What is left of the light behind an optical thickness of `total`.
#[inline(always)]
pub(crate) fn light<M: Math, V: Lanes>(total: V) -> V {
    V::select(total.less(V::splat(MAX_TAU)), M::decay(total), V::splat(0.0))
}

/// Directions whose weighted mean is no longer than this cancel: what is left of them is rounding.
#[cfg(any(feature = "normals", feature = "anti-aliasing"))]
const MEAN_EPSILON: f32 = 1e-6;

/// The direction of `sum`, of normals whose weights add up to `weight`; 0 where `opacity` is at most
/// [`OPACITY_EPSILON`], and where the directions cancel.
#[cfg(any(feature = "normals", feature = "anti-aliasing"))]
pub(crate) fn mean_direction(sum: [f32; 3], weight: f32, opacity: f32) -> [f32; 3] {
    let sum = glam::Vec3::from(sum);
    let length = sum.length();
    if opacity > OPACITY_EPSILON && length > MEAN_EPSILON * weight {
        (sum / length).to_array()
    } else {
        [0.0; 3]
    }
}

/// One finished pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pixel {
    /// Colour over the background, display-encoded unless the frame's
    /// [`Tone`](crate::plan::Tone) is linear; 0 if colour was not asked for.
    pub rgb: [f32; 3],
    /// Σ weights, in `[0, 1]`.
    pub opacity: f32,
    /// Mean distance along the ray, world units; `far` where opacity is at most [`OPACITY_EPSILON`].
    pub ray_distance: f32,
    /// Mean distance along the view axis, world units; `far` where opacity is at most [`OPACITY_EPSILON`].
    pub z_depth: f32,
    /// First distance along the ray at which the transmittance is below one half, world units; `far` where
    /// there is none, 0 if it was not asked for.
    pub median_distance: f32,
    /// Mean of −∇sigma/|∇sigma| under the weights, world space, unit length; 0 where opacity is at most
    /// [`OPACITY_EPSILON`], where the directions cancel, and if it was not asked for.
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

/// What a ray has gathered so far, front to back.
///
/// `alpha = −expm1(−sigma delta)`, `transmittance = exp(−Σ sigma delta)` summed in log space with
/// compensation, `weight = transmittance · alpha`.
///
/// # Source
/// Mildenhall et al. 2020, eq. 3; deviation: the last bin is finite.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Accumulator {
    tau: Sum,
    rgb: [Sum; 3],
    opacity: Sum,
    distance: Sum,
    /// Weight that no colour has been asked for yet.
    uncoloured: f32,
    /// What is left of the light, `exp(−tau)`.
    left: f32,
}

impl Accumulator {
    /// A ray that has met nothing.
    pub const NONE: Self = {
        let zero = Sum::ZERO;
        Self { tau: zero, rgb: [zero; 3], opacity: zero, distance: zero, uncoloured: 0.0, left: 1.0 }
    };

    /// `Σ sigma delta` of everything gathered so far that had a weight.
    #[inline]
    pub fn optical_thickness(&self) -> f32 {
        self.tau.value
    }

    /// What is left of the light behind everything gathered so far: `exp(−Σ sigma delta)`.
    #[inline]
    pub fn transmittance(&self) -> f32 {
        self.left
    }

    /// Adds the density of the sample at `t` behind everything gathered so far; returns its weight.
    ///
    /// `sigma`: 1/world unit, clamped to `>= 0`; `delta`, `t`: world units along the ray, `t` finite.
    /// +inf is an opaque wall, but 0 times +inf is nothing. A NaN in `sigma` is the caller's to leave out.
    #[inline]
    pub fn add_density<M: Math>(&mut self, sigma: f32, t: f32, delta: f32) -> f32 {
        let tau = thickness(sigma, delta);
        let total = self.add_thickness(tau);
        self.add_alpha(alpha::<M, f32>(tau), light::<M, f32>(total), t)
    }

    /// The first half of [`Accumulator::add_density`]: adds the optical thickness of a sample; returns `Σ sigma delta` up
    /// to and with it.
    #[inline]
    pub(crate) fn add_thickness(&mut self, tau: f32) -> f32 {
        // Behind a term that was larger than all before it, Kahan's sum may move by an ulp when 0 is added: what
        // weighs nothing changes no bit.
        if tau > 0.0 {
            self.tau.add(tau);
        }
        self.tau.value
    }

    /// The second half: `alpha` of the sample at `t`, and the light behind it; returns its weight.
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

    /// A ray that has met nothing and collides once an optical thickness of `total` is behind it: its own counts from
    /// `-total` to 0.
    pub(crate) fn until(total: f32) -> Self {
        let mut ray = Self::NONE;
        ray.tau.add(-total);
        ray
    }

    /// Whether such a ray, at an optical thickness of `before`, collides in the bin of density `sigma` (not 0), middle `t`
    /// and width `delta`; then it sees that point alone.
    #[inline]
    pub(crate) fn collide(&mut self, before: f32, sigma: f32, t: f32, delta: f32) -> bool {
        let collides = -before < thickness(sigma, delta);
        if collides {
            self.opacity.add(1.0);
            self.distance.add(thickness_in_bin(-before, sigma, t, delta));
        }
        collides
    }

    /// The weight that still waits for a colour, if it is more than `cut`: the sample that was added last
    /// is worth asking for its colour, which goes to [`Accumulator::add_colour`] with this weight.
    ///
    /// Samples too light to ask thus take the colour of the next one behind them that is asked, and never
    /// more than `cut` of a ray is left without any. With a cut of 0 this is the last sample's own weight.
    #[inline]
    pub fn take_uncoloured(&mut self, cut: f32) -> Option<f32> {
        (self.uncoloured > cut).then(|| core::mem::take(&mut self.uncoloured))
    }

    /// Adds a colour with the weight that [`Accumulator::take_uncoloured`] gave, front to back.
    #[inline]
    pub fn add_colour(&mut self, weight: f32, rgb: [f32; 3]) {
        for (sum, c) in self.rgb.iter_mut().zip(rgb) {
            sum.add(weight * c);
        }
    }

    /// Gives all weight that was [taken](Accumulator::take_uncoloured) one colour.
    #[inline]
    pub(crate) fn colour_all(&mut self, rgb: [f32; 3]) {
        self.add_colour(self.opacity.value - self.uncoloured, rgb);
    }

    /// The pixel, over `background`, of samples whose `t` were counted from `start` along the ray; `z_per_distance` is the
    /// cosine between ray and view axis. No distance is beyond `far`. One that was `cut` is opaque: what is left of its light
    /// takes its mean colour too.
    ///
    /// Weight that is left without a colour takes the mean of the ray's colours, as long as it is the smaller part. Median
    /// distance and normal are not its business: they stay 0.
    ///
    /// # Source
    /// Müller et al. 2022, their renderer.
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

    /// Adds the sample at `t` behind everything gathered so far; returns its weight.
    ///
    /// [`Accumulator::add_density`] and [`Accumulator::add_colour`] in one, without a cut.
    #[cfg(feature = "train")]
    #[inline]
    pub(crate) fn add<M: Math>(&mut self, sigma: f32, rgb: [f32; 3], t: f32, delta: f32) -> f32 {
        let weight = self.add_density::<M>(sigma, t, delta);
        if let Some(weight) = self.take_uncoloured(0.0) {
            self.add_colour(weight, rgb);
        }
        weight
    }

    /// The pixel of all samples, over `background`.
    #[cfg(feature = "train")]
    pub(crate) fn finish(&self, background: [f32; 3], far: f32, z_per_distance: f32) -> Pixel {
        self.finish_from(0.0, false, background, far, z_per_distance)
    }

    /// Optical thickness, opacity and distance, each with what rounding lost of it, then the weight without a colour and the
    /// transmittance: all of it but the colour.
    #[inline]
    fn state(&self) -> [f32; side_by_side::ROWS] {
        let Self { tau, opacity, distance, uncoloured, left, .. } = self;
        [tau.value, tau.lost, opacity.value, opacity.lost, distance.value, distance.lost, *uncoloured, *left]
    }

    /// Sets what [`Accumulator::state`] gives.
    #[inline]
    fn set_state(
        &mut self,
        [tau, lost_tau, opacity, lost_opacity, distance, lost, uncoloured, left]: [f32; side_by_side::ROWS],
    ) {
        self.tau = Sum { value: tau, lost: lost_tau };
        self.opacity = Sum { value: opacity, lost: lost_opacity };
        self.distance = Sum { value: distance, lost };
        (self.uncoloured, self.left) = (uncoloured, left);
    }
}
