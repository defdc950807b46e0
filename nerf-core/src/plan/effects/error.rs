//! Errors of effects.

use super::{Effects, ThinLens, Tone};
use crate::errors::errors;

errors! {
    /// An effect that is out of range or not in this build.
    EffectError:
    /// A number of rays a pixel outside 1 to [`Effects::MAX_RAYS`].
    AntiAliasing { found: u16 } =>
        "effects.anti_aliasing: expected 1 to {most} rays a pixel, found {found}", most = Effects::MAX_RAYS;
    /// An aperture radius that is negative, above [`ThinLens::LARGEST`] or NaN.
    Aperture { found: f32 } =>
        "effects.depth_of_field.aperture_radius: expected 0 to {largest} world units, found {found}",
        largest = ThinLens::LARGEST;
    /// A plane of focus outside [`ThinLens::NEAREST`] to [`ThinLens::LARGEST`].
    Focus { found: f32 } =>
        "effects.depth_of_field.focus_distance: expected {nearest} to {largest} world units, found {found}",
        nearest = ThinLens::NEAREST, largest = ThinLens::LARGEST;
    /// An exposure of more than [`Tone::MAX_STOPS`] up or down.
    Exposure { found: f32 } =>
        "effects.tone.exposure: expected -{most} to {most} stops, found {found}", most = Tone::MAX_STOPS;
    /// This build lacks the effect.
    NotBuilt { feature: &'static str } =>
        "effects: expected a build with the feature {feature}, found one without";
}
