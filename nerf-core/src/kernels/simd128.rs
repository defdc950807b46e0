//! WebAssembly SIMD leaf: four lanes, unfused, so that it gives bit for bit what the scalar tier gives.
//!
//! Without run-time detection: a module with these instructions loads only where they exist, so that the
//! tier is there if the build has the target feature. Relaxed SIMD could fuse, but what it computes is up
//! to the engine.

use super::Op;
use crate::math::gather::Indices;
use crate::math::lanes::{Lanes, MAX_LANES, SQRT_HALF_BITS};
use core::arch::wasm32::*;

/// Four f32 in a `v128`.
#[derive(Clone, Copy)]
pub struct F32x4(v128);

/// Runs `op` with four lanes.
pub fn run<O: Op>(op: O) -> O::Output {
    op.run::<F32x4>()
}

impl Lanes for F32x4 {
    const COUNT: usize = 4;
    const TILE_ROWS: usize = 2;
    const TILE_COLS: usize = 4;
    type Mask = v128;
    type Indices = U32x4;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self(f32x4_splat(x))
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        let from = &from[..4];
        // SAFETY: four values are in bounds; unaligned loads are allowed.
        Self(unsafe { v128_load(from.as_ptr().cast()) })
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        let to = &mut to[..4];
        // SAFETY: four values are in bounds; unaligned stores are allowed.
        unsafe { v128_store(to.as_mut_ptr().cast(), self.0) }
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self(f32x4_add(self.0, b.0))
    }
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self(f32x4_sub(self.0, b.0))
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self(f32x4_mul(self.0, b.0))
    }
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        Self(f32x4_div(self.0, b.0))
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        self.mul(b).add(c)
    }
    // `pmax(b, a)` is `b < a ? a : b`, one instruction on x86; the plain `max` would spread NaNs.
    #[inline(always)]
    fn max_of(self, b: Self) -> Self {
        Self(f32x4_pmax(b.0, self.0))
    }
    #[inline(always)]
    fn min_of(self, b: Self) -> Self {
        Self(f32x4_pmin(b.0, self.0))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(f32x4_sqrt(self.0))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(f32x4_abs(self.0))
    }
    #[inline(always)]
    fn round_even(self) -> Self {
        // + 0: the scalar tier has no negative zero here.
        Self(f32x4_add(f32x4_nearest(self.0), f32x4_splat(0.0)))
    }
    #[inline(always)]
    fn exp2_integer(self) -> Self {
        let biased = i32x4_add(i32x4_trunc_sat_f32x4(self.0), i32x4_splat(127));
        Self(i32x4_shl(biased, 23))
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        let border = i32x4_splat(SQRT_HALF_BITS as i32);
        let shifted = i32x4_sub(self.0, border);
        let mantissa = i32x4_add(v128_and(shifted, i32x4_splat(0x007f_ffff)), border);
        (Self(mantissa), Self(f32x4_convert_i32x4(i32x4_shr(shifted, 23))))
    }
    #[inline(always)]
    fn equals(self, b: Self) -> v128 {
        f32x4_eq(self.0, b.0)
    }
    #[inline(always)]
    fn less(self, b: Self) -> v128 {
        f32x4_lt(self.0, b.0)
    }
    #[inline(always)]
    fn select(mask: v128, a: Self, b: Self) -> Self {
        Self(v128_bitselect(a.0, b.0, mask))
    }
    #[inline(always)]
    fn to_indices(self) -> U32x4 {
        U32x4(u32x4_trunc_sat_f32x4(self.0))
    }
}

/// Four u32 in a `v128`. Made only where `F32x4` is.
#[derive(Clone, Copy)]
pub struct U32x4(v128);

impl Indices for U32x4 {
    #[inline(always)]
    fn splat(x: u32) -> Self {
        Self(u32x4_splat(x))
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self(i32x4_add(self.0, b.0))
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self(i32x4_mul(self.0, b.0))
    }
    #[inline(always)]
    fn xor(self, b: Self) -> Self {
        Self(v128_xor(self.0, b.0))
    }
    #[inline(always)]
    fn and(self, b: Self) -> Self {
        Self(v128_and(self.0, b.0))
    }
    #[inline(always)]
    fn min(self, b: Self) -> Self {
        Self(u32x4_min(self.0, b.0))
    }
    #[inline(always)]
    fn shift_right_15(self) -> Self {
        Self(u32x4_shr(self.0, 15))
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; MAX_LANES]) {
        // SAFETY: sixteen values are in bounds, of which four are written; unaligned stores are allowed.
        unsafe { v128_store(to.as_mut_ptr().cast(), self.0) }
    }
}
