//! Replaces `tone.rs` in a build without the feature `tone-map`: colours stay as the network outputs them.

#![expect(clippy::extra_unused_type_parameters, reason = "the interface of `tone.rs`")]

use crate::math::{Math, MathBackend};
use crate::plan::Tone;
use crate::simd::Isa;

#[inline(always)]
pub(crate) fn samples_to_light(_: &Tone, _: MathBackend, _: Isa, _: &mut [f32]) {}

#[inline(always)]
pub(crate) fn background<M: Math>(_: &Tone, rgb: [f32; 3]) -> [f32; 3] {
    rgb
}

#[inline(always)]
pub(crate) fn to_light<M: Math>(_: &Tone, rgb: [f32; 3]) -> [f32; 3] {
    rgb
}

#[inline(always)]
pub(crate) fn to_display<M: Math>(_: &Tone, rgb: [f32; 3]) -> [f32; 3] {
    rgb
}
