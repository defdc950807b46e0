//! In place of `tone.rs` in a build without it: colours stay as the network gives them.

#![expect(clippy::extra_unused_type_parameters, reason = "the interface of `tone.rs`")]

use crate::math::Math;
use crate::plan::Tone;

/// A ray's colour, as it is.
#[inline(always)]
pub(crate) fn to_light<M: Math>(_: &Tone, rgb: [f32; 3]) -> [f32; 3] {
    rgb
}

/// A pixel's colour, as it is.
#[inline(always)]
pub(crate) fn to_display<M: Math>(_: &Tone, rgb: [f32; 3]) -> [f32; 3] {
    rgb
}
