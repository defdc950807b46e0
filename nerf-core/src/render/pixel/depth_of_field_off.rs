//! Replaces `depth_of_field.rs` in a build without the feature `depth-of-field`: every lens is a pinhole.

use crate::camera::{Pose, Ray};
use crate::plan::Effects;

#[inline(always)]
pub(crate) fn area(_: &Effects, _ray: u32) -> u32 {
    0
}

#[inline(always)]
pub(crate) fn through_lens(_: &Effects, _: &Pose, pinhole: Ray, (_x, _y): (u32, u32), _area: u32) -> Ray {
    pinhole
}
