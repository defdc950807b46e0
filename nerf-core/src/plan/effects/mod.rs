//! What a frame does beyond one ray through each pixel's centre: nothing, unless it is asked for.
//!
//! | effect | feature | costs |
//! | --- | --- | --- |
//! | [`Jitter`] | `jitter` | a hash for each bin that is looked at |
//! | anti-aliasing | `anti-aliasing` | its rays, and a sum a pixel in flight |
//! | [`ThinLens`] | `depth-of-field` | a few dozen operations a ray |
//! | [`Tone`] | `tone-map` | three powers a ray, three more a pixel; linear output three a coloured sample |
//!
//! What is asked for here is checked by [`Plan::with_effects`](crate::plan::Plan::with_effects). Each effect is a stage of
//! the frame ([`crate::render`], of [`Jitter`] in [`crate::sampling`]) with a sibling `*_off.rs` of the same interface, which
//! takes its place in a build without the feature and does nothing. Lens distortion is the camera's
//! ([`Lens`](crate::camera::Lens), feature `lens`).

mod error;

#[cfg(test)]
mod tests;

use crate::names::names;

pub use error::EffectError;

/// What is asked for beyond the plain picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effects {
    /// Whether a sample lies anywhere in its bin in place of the middle.
    pub jitter: Option<Jitter>,
    /// Rays a pixel, 1 to [`Effects::MAX_RAYS`]; 1 is one ray through its centre.
    pub anti_aliasing: u16,
    /// A lens that is no pinhole.
    pub depth_of_field: Option<ThinLens>,
    /// Exposure, tone curve, linear output.
    pub tone: Tone,
}

/// Samples at random places in their bins: what would be bands becomes noise, without a bias.
///
/// The bin's density is taken where the sample lies, its width stays: the expectation of the optical
/// thickness is the integral of the density.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Jitter {
    /// Another seed is another noise.
    pub seed: u64,
}

/// A thin lens: what is not in the plane of focus is blurred.
///
/// # Source
/// Cook, Porter and Carpenter 1984.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThinLens {
    /// Radius of the aperture's disc, world units, 0 to [`ThinLens::LARGEST`]; 0 is a pinhole.
    pub aperture_radius: f32,
    /// From the camera's centre to the plane of focus along the view axis, world units,
    /// [`ThinLens::NEAREST`] to [`ThinLens::LARGEST`].
    pub focus_distance: f32,
}

impl ThinLens {
    /// The nearest plane of focus, world units.
    pub const NEAREST: f32 = 1e-6;
    /// The largest aperture and the furthest plane of focus, world units.
    pub const LARGEST: f32 = 1e9;
}

/// From the network's display-encoded colours to light, and back: exposure, tone curve, linear output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// Doublings of the light, −[`Tone::MAX_STOPS`] to [`Tone::MAX_STOPS`]; 0 leaves it as it is.
    pub exposure: f32,
    /// What brings light beyond 1 back into the picture.
    pub map: ToneMap,
    /// Whether colour is linear light, unbounded above, composited as such, in place of sRGB in `[0, 1]`: each sample's
    /// colour is decoded, or of a field shaded once a ray the one colour of the ray, and the background.
    pub linear: bool,
}

impl Tone {
    /// Colours stay as the network gives them.
    pub const NONE: Self = Self { exposure: 0.0, map: ToneMap::None, linear: false };
    /// The largest exposure, stops.
    pub const MAX_STOPS: f32 = 32.0;
}

names! {
    /// A curve from `[0, ∞)` to `[0, 1]`, channel by channel on linear light.
    #[derive(Default)]
    #[non_exhaustive]
    pub enum ToneMap {
        /// None: what is beyond 1 is cut off where the colour is encoded.
        #[default]
        None = "none",
        /// `x / (1 + x)`.
        ///
        /// # Source
        /// Reinhard et al. 2002, eq. 3; deviation: on each channel, not on luminance.
        Reinhard = "reinhard",
        /// A film's shoulder and toe: `x (2.51 x + 0.03) / (x (2.43 x + 0.59) + 0.14)`, at most 1.
        ///
        /// # Source
        /// Narkowicz 2016, "ACES Filmic Tone Mapping Curve": a fit to the ACES reference for displays of 80 to
        /// 100 nits.
        Filmic = "filmic",
    }
}

impl Default for Effects {
    fn default() -> Self {
        Self::NONE
    }
}

impl Effects {
    /// No effect: one ray through each pixel's centre, samples in the middle of their bins, colours as the
    /// network gives them.
    pub const NONE: Self = Self { jitter: None, anti_aliasing: 1, depth_of_field: None, tone: Tone::NONE };
    /// Most rays a pixel.
    pub const MAX_RAYS: u16 = 256;

    /// What is asked for, without what asks for nothing.
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
        let asked = [
            ("jitter", self.jitter.is_some(), cfg!(feature = "jitter")),
            ("anti-aliasing", self.anti_aliasing > 1, cfg!(feature = "anti-aliasing")),
            ("depth-of-field", self.depth_of_field.is_some(), cfg!(feature = "depth-of-field")),
            ("tone-map", self.tone != Tone::NONE, cfg!(feature = "tone-map")),
        ];
        match asked.into_iter().find(|&(_, asked, built)| asked && !built) {
            Some((feature, ..)) => Err(EffectError::NotBuilt { feature }),
            None => Ok(self),
        }
    }
}
