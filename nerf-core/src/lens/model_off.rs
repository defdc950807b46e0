//! In place of `model.rs` in a build without it: nothing moves.

use super::Lens;

impl Lens {
    /// Whether this build has lens distortion.
    pub(crate) const BUILT: bool = false;

    /// The ideal point that is seen at `(xd, yd)`: the same.
    #[inline(always)]
    pub(crate) fn straighten(&self, xd: f32, yd: f32) -> (f32, f32) {
        (xd, yd)
    }

    /// Whether nothing moves.
    #[inline(always)]
    pub(crate) fn is_gentle(&self, _radius: f32) -> bool {
        true
    }

    /// The ideal point that is seen at `(xd, yd)`: the same.
    #[inline(always)]
    pub(crate) fn invert(&self, xd: f32, yd: f32, _from_axis: bool) -> Option<(f32, f32)> {
        Some((xd, yd))
    }
}
