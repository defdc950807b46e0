//! Replacement of `model.rs` in builds without the feature `lens`, which do not support lens distortion.

use super::Lens;
use glam::Vec3;

impl Lens {
    /// Whether this build supports lens distortion.
    pub(crate) const BUILT: bool = false;

    /// Returns the direction (right, down, forward) that is seen at the normalised image coordinates `(xd, yd)` without
    /// distortion: `(xd, yd, 1)`.
    #[inline(always)]
    pub(crate) fn straighten(&self, xd: f32, yd: f32) -> Vec3 {
        Vec3::new(xd, yd, 1.0)
    }

    /// Whether the distortion is weak: always true, since this build does not support lens distortion.
    #[inline(always)]
    pub(crate) fn is_gentle(&self, _radius: f32) -> bool {
        true
    }

    /// Returns `(xd, yd, 1)`, as [`Lens::straighten`] does. Never `None`, since this build supports no lens distortion.
    #[inline(always)]
    pub(crate) fn invert(&self, xd: f32, yd: f32, _from_axis: bool) -> Option<Vec3> {
        Some(Vec3::new(xd, yd, 1.0))
    }

    /// Projects a direction (right, down, forward) to normalised image coordinates; `None` unless `dir` points forward.
    pub fn project(&self, dir: Vec3) -> Option<(f32, f32)> {
        (dir.z > 0.0).then(|| (dir.x / dir.z, dir.y / dir.z))
    }
}
