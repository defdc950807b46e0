//! Effects that cannot be.

use super::{Effects, ThinLens, Tone};

/// An effect that is out of range or not in this build.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum EffectError {
    /// Rays a pixel beyond 1 to [`Effects::MAX_RAYS`].
    AntiAliasing {
        /// What was asked for.
        found: u16,
    },
    /// An aperture that is negative, beyond [`ThinLens::LARGEST`] or no number.
    Aperture {
        /// What was asked for, world units.
        found: f32,
    },
    /// A plane of focus beyond [`ThinLens::NEAREST`] to [`ThinLens::LARGEST`].
    Focus {
        /// What was asked for, world units.
        found: f32,
    },
    /// An exposure of more than [`Tone::MAX_STOPS`] up or down.
    Exposure {
        /// What was asked for, stops.
        found: f32,
    },
    /// This build lacks the effect.
    NotBuilt {
        /// The cargo feature that brings it.
        feature: &'static str,
    },
}

impl core::fmt::Display for EffectError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::AntiAliasing { found } => write!(
                f,
                "effects.anti_aliasing: expected 1 to {} rays a pixel, found {found}",
                Effects::MAX_RAYS
            ),
            Self::Aperture { found } => write!(
                f,
                "effects.depth_of_field.aperture_radius: expected 0 to {} world units, found {found}",
                ThinLens::LARGEST
            ),
            Self::Focus { found } => write!(
                f,
                "effects.depth_of_field.focus_distance: expected {} to {} world units, found {found}",
                ThinLens::NEAREST,
                ThinLens::LARGEST
            ),
            Self::Exposure { found } => {
                write!(f, "effects.tone.exposure: expected -{0} to {0} stops, found {found}", Tone::MAX_STOPS)
            }
            Self::NotBuilt { feature } => {
                write!(f, "effects: expected a build with the feature {feature}, found one without")
            }
        }
    }
}

impl core::error::Error for EffectError {}
