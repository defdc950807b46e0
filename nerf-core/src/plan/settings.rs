//! The settings of a frame, in one value.

use super::{Batch, Effects, Outputs, Plan, PlanError, Quality};
use crate::blob::Blob;

/// The settings of a frame: all that a [`Plan`] is made of, except the scene, the outputs and the batch.
///
/// Defaults: no visible approximation, no limit of the distance, the scene's own background, no effects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Approximations that save time, such as fewer samples, early ray termination and skipping of empty cells.
    pub quality: Quality,
    /// Jitter, anti-aliasing, depth of field, tone mapping.
    pub effects: Effects,
    /// Background colour (red, green, blue), display-encoded, 0 to 1; `None` for the scene's own.
    pub background: Option<[f32; 3]>,
    /// Nearest and farthest visible distance along a ray, world units ([`Plan::with_range`]).
    pub range: (f32, f32),
    /// Width of the blur of normals, in bins; 0 for no blur ([`Plan::with_normal_blur`]).
    pub normal_blur: f32,
    /// Whether samples lie only in the bins used in training, from near to far ([`Plan::with_own_bins`]).
    pub own_bins: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            quality: Quality::default(),
            effects: Effects::NONE,
            background: None,
            range: (0.0, f32::MAX),
            normal_blur: Plan::NORMAL_BLUR,
            own_bins: false,
        }
    }
}

impl Settings {
    /// Returns the plan of a frame of the scene in `blob` with these settings.
    ///
    /// # Errors
    /// [`PlanError`] names the setting that is invalid, or that the scene or this build does not support.
    pub fn plan<'a>(&self, blob: &Blob<'a>, outputs: Outputs, batch: Batch) -> Result<Plan<'a>, PlanError> {
        let mut plan = Plan::new(blob, &self.quality, outputs, batch)?
            .with_normal_blur(self.normal_blur)?
            .with_range(self.range.0, self.range.1)?;
        if self.own_bins {
            plan = plan.with_own_bins();
        }
        if let Some(background) = self.background {
            plan = plan.with_background(background)?;
        }
        plan.with_effects(self.effects)
    }
}
