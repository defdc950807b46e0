//! Optional effects of a frame: jitter, anti-aliasing, depth of field and tone. All effects are off by default.
//!
//! | effect | feature | costs |
//! | --- | --- | --- |
//! | [`Jitter`] | `jitter` | a hash for each bin that is tested for occupancy |
//! | anti-aliasing | `anti-aliasing` | several rays per pixel, and memory for the sums of a tile's pixels |
//! | [`ThinLens`] | `depth-of-field` | a few dozen operations per ray |
//! | [`Tone`] | `tone-map` | powers `x^p`, for conversion between sRGB and linear light |
//!
//! [`Tone`] computes 3 powers `x^p` per ray and 3 per pixel; with linear output, 3 per ray and 3 per coloured sample.
//!
//! [`Plan::with_effects`](crate::plan::Plan::with_effects) checks the effects. Each effect is a stage of the frame in
//! [`crate::render`], except [`Jitter`], which is in [`crate::sampling`]. In a build without an effect's feature, a
//! file `*_off.rs` with the same interface replaces the effect's file, and does nothing. Lens distortion is a setting
//! of the camera ([`Lens`](crate::camera::Lens), feature `lens`).

#[cfg(test)]
mod tests;

use crate::errors::errors;
use crate::names::names;

/// Optional effects of a frame; [`Effects::NONE`] has none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effects {
    /// Random positions of samples in their bins; `None` places each sample in the middle of its bin.
    pub jitter: Option<Jitter>,
    /// Number of rays per pixel, 1 to [`Effects::MAX_RAYS`]. With 1, the ray passes through the pixel's centre.
    pub anti_aliasing: u16,
    /// A thin lens with an aperture; `None` for a pinhole, which is sharp at all distances.
    pub depth_of_field: Option<ThinLens>,
    /// Exposure, choice of tone curve, and choice between linear and display-encoded (sRGB) colours.
    pub tone: Tone,
}

/// Random positions of samples in their bins. Noise replaces banding, and the optical thickness is right on average.
///
/// The density at a random sample is used for the sample's whole bin. The mean of the optical thickness over all
/// random positions therefore equals the integral of the density.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Jitter {
    /// Seed of the random positions of samples; equal seeds give equal positions.
    pub seed: u64,
}

/// A thin lens: points outside the plane of focus are blurred.
///
/// # Source
/// Cook, Porter and Carpenter 1984.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThinLens {
    /// Radius of the aperture's disc, world units, 0 to [`ThinLens::LARGEST`]; 0 is a pinhole.
    pub aperture_radius: f32,
    /// Distance from the camera's centre to the plane of focus along the view axis, world units,
    /// [`ThinLens::NEAREST`] to [`ThinLens::LARGEST`].
    pub focus_distance: f32,
}

impl ThinLens {
    /// Least distance from the camera's centre to the plane of focus, world units.
    pub const NEAREST: f32 = 1e-6;
    /// Largest aperture radius and largest focus distance, world units.
    pub const LARGEST: f32 = 1e9;
}

/// Exposure, tone curve and linear output. All act on linear light: the network's sRGB colours are decoded first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// Exposure, stops (doublings of the light): −[`Tone::MAX_STOPS`] to [`Tone::MAX_STOPS`]; 0 changes nothing.
    pub exposure: f32,
    /// Tone curve, which maps light above 1 into the displayable range.
    pub map: ToneMap,
    /// Whether the output is linear light, unbounded above (`true`), or sRGB in `[0, 1]` (`false`).
    ///
    /// For linear output, the background and the colours of samples are decoded from sRGB to linear light before
    /// compositing. With [`Shading::PerRay`](crate::network::Shading), samples have no colours: each ray's shaded
    /// colour is decoded before the background is added.
    pub linear: bool,
}

impl Tone {
    /// No conversion: colours stay as the network gives them.
    pub const NONE: Self = Self { exposure: 0.0, map: ToneMap::None, linear: false };
    /// Largest absolute value of [`Tone::exposure`], stops.
    pub const MAX_STOPS: f32 = 32.0;
}

names! {
    /// A tone curve, applied to each channel of linear light. All curves except `None` map `[0, ∞)` to `[0, 1]`.
    #[derive(Default)]
    #[non_exhaustive]
    pub enum ToneMap {
        /// No curve: light above 1 is clipped when the colour is encoded.
        #[default]
        None = "none",
        /// `x / (1 + x)`.
        ///
        /// # Source
        /// Reinhard et al. 2002, eq. 3; deviation: on each channel, not on luminance.
        Reinhard = "reinhard",
        /// S-shaped curve, like the response of film: `x (2.51 x + 0.03) / (x (2.43 x + 0.59) + 0.14)`, at most 1.
        ///
        /// # Source
        /// Narkowicz 2016, "ACES Filmic Tone Mapping Curve": a fit to the ACES reference for displays of 80 to
        /// 100 nits.
        Filmic = "filmic",
    }
}

impl Effects {
    /// No effect: one ray through each pixel's centre, samples in the middle of their bins, the network's own colours.
    pub const NONE: Self = Self { jitter: None, anti_aliasing: 1, depth_of_field: None, tone: Tone::NONE };
    /// Maximum number of rays per pixel.
    pub const MAX_RAYS: u16 = 256;

    /// Returns these effects if all are valid, with `depth_of_field` set to `None` if the aperture's radius is 0.
    ///
    /// # Errors
    /// [`EffectError`] names the first setting that is out of range or not in this build.
    pub(crate) fn checked(mut self) -> Result<Self, EffectError> {
        if !(1..=Self::MAX_RAYS).contains(&self.anti_aliasing) {
            return Err(EffectError::AntiAliasing { found: self.anti_aliasing });
        }
        if let Some(ThinLens { aperture_radius, focus_distance }) = self.depth_of_field {
            if !(0.0..=ThinLens::LARGEST).contains(&aperture_radius) {
                return Err(EffectError::Aperture { found: aperture_radius });
            }
            if aperture_radius == 0.0 {
                self.depth_of_field = None;
            } else if !(ThinLens::NEAREST..=ThinLens::LARGEST).contains(&focus_distance) {
                return Err(EffectError::Focus { found: focus_distance });
            }
        }
        if !(-Tone::MAX_STOPS..=Tone::MAX_STOPS).contains(&self.tone.exposure) {
            return Err(EffectError::Exposure { found: self.tone.exposure });
        }
        for (feature, asked, built) in [
            ("jitter", self.jitter.is_some(), cfg!(feature = "jitter")),
            ("anti-aliasing", self.anti_aliasing > 1, cfg!(feature = "anti-aliasing")),
            ("depth-of-field", self.depth_of_field.is_some(), cfg!(feature = "depth-of-field")),
            ("tone-map", self.tone != Tone::NONE, cfg!(feature = "tone-map")),
        ] {
            if asked && !built {
                return Err(EffectError::NotBuilt { feature });
            }
        }
        Ok(self)
    }
}

errors! {
    /// An effect with a setting that is out of range, or an effect that is not in this build.
    EffectError:
    /// A number of rays per pixel outside 1 to [`Effects::MAX_RAYS`].
    AntiAliasing { found: u16 } =>
        "effects.anti_aliasing: expected 1 to {most} rays a pixel, found {found}", most = Effects::MAX_RAYS;
    /// An aperture radius that is negative, above [`ThinLens::LARGEST`] or NaN.
    Aperture { found: f32 } =>
        "effects.depth_of_field.aperture_radius: expected 0 to {largest} world units, found {found}",
        largest = ThinLens::LARGEST;
    /// A focus distance outside [`ThinLens::NEAREST`] to [`ThinLens::LARGEST`].
    Focus { found: f32 } =>
        "effects.depth_of_field.focus_distance: expected {nearest} to {largest} world units, found {found}",
        nearest = ThinLens::NEAREST, largest = ThinLens::LARGEST;
    /// An exposure whose absolute value is above [`Tone::MAX_STOPS`], or NaN.
    Exposure { found: f32 } =>
        "effects.tone.exposure: expected -{most} to {most} stops, found {found}", most = Tone::MAX_STOPS;
    NotBuilt { feature: &'static str } =>
        "effects: expected a build with the feature {feature}, found one without";
}
