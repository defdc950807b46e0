//! Replaces `spherical_harmonics` in builds without the feature `grid`: networks that need them are refused.

use crate::simd::Isa;

/// Whether this build has spherical harmonics.
pub(crate) const BUILT: bool = false;

/// Maximum number of bands of spherical harmonics.
pub const MAX_HARMONICS_DEGREE: u8 = 4;

/// Does nothing: no network that needs spherical harmonics passes the check.
pub(crate) fn encode_harmonics_block(_: Isa, _: u8, _: usize, _: &[f32], _: &mut [f32]) {}
