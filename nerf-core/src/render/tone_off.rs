//! In place of `tone.rs` in a build without it: colours stay as the network gives them.

#![expect(clippy::extra_unused_type_parameters, reason = "the interface of `tone.rs`")]

use crate::math::{Math, MathBackend};
use crate::plan::Tone;
use crate::simd::Isa;

/// The colours of a block's samples, as they are.
#[inline(always)]
pub(crate) fn samples_to_light(_: &Tone, _: MathBackend, _: Isa, _: &mut [f32]) {}

/// The background of rays, as it is.
#[inline(always)]
pub(crate) fn background<M: Math>(_: &Tone, rgb: [f32; 3]) -> [f32; 3] {
    rgb
}

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
