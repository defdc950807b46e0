//! Errors in the settings of a frame.

use super::{Batch, EffectError};
use crate::blob::MAX_SAMPLES;
use crate::errors::errors;
use crate::simd::BLOCK;
use crate::space::BoundsError;

errors! {
    /// A setting of a frame that is invalid, or that the scene or this build does not support.
    PlanError:
    NotAScene => "blob: expected a scene, found a 2D field";
    OccupancyRequired =>
        "quality.occupancy: this scene's occupancy is part of its model (outside of it the network was never trained), \
         so it cannot be switched off";
    Samples { found: u16 } => "quality.samples: expected at most {MAX_SAMPLES} a ray, found {found}";
    TransmittanceCut { found: f32 } => "quality.transmittance_cut: expected 0 <= cut < 1, found {found}";
    MedianBehindCut { found: f32 } =>
        "quality.transmittance_cut: expected at most 0.5, since median_distance is asked for and rays would end in front \
         of it, found {found}";
    Range { t_min: f32, t_max: f32 } =>
        "near/far: expected 0 <= near <= far, found near {t_min}, far {t_max}";
    NormalBlur { found: f32 } => "normal_blur: expected a finite number of bins, at least 0, found {found}";
    NotBuilt { effect: &'static str } =>
        "{effect}: not built in: expected a build with its feature, found one without";
    ColourCut { found: f32 } => "quality.colour_cut: expected 0 <= cut < 1, found {found}";
    Background { found: [f32; 3] } => "background: expected channels in 0..=1, found {found:?}";
    /// A batch with a number of rays outside 1 to [`Batch::MAX_RAYS`], or a number of samples outside 1 to 64.
    Batch { found: Batch } =>
        "batch: expected 1 to {most} rays and 1 to {BLOCK} samples, found {found:?}", most = Batch::MAX_RAYS;
    /// A near and a far distance between which no valid bins can be made.
    Bounds(error: BoundsError) => "{error}";
    /// An effect with a setting that is out of range, or an effect that is not in this build.
    Effects(error: EffectError) => "{error}";
}
