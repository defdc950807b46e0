//! In the place of `spherical_harmonics` where the feature `grid` is off: networks that need them are refused.

use crate::simd::Isa;

/// Whether this build has spherical harmonics.
pub(crate) const BUILT: bool = false;

/// Most bands of spherical harmonics.
pub const MAX_HARMONICS_DEGREE: u8 = 4;

/// Nothing: no network that asks for it is made.
pub(crate) fn encode_harmonics_block(_: Isa, _: u8, _: usize, _: &[f32], _: &mut [f32]) {}
