//! AVX-512 F leaf: sixteen lanes.

use super::Op;
use crate::math::lanes::{Lanes, SQRT_HALF_BITS};
use core::arch::x86_64::*;

/// Sixteen f32 in a `zmm` register. Made only inside [`run`], where the instructions are known to exist.
#[derive(Clone, Copy)]
pub struct F32x16(__m512);

/// Runs `op` with sixteen lanes.
///
/// # Safety
/// The CPU has AVX-512 F, and the OS saves its registers.
#[target_feature(enable = "avx512f")]
pub unsafe fn run<O: Op>(op: O) -> O::Output {
    op.run::<F32x16>()
}

/// An intrinsic that needs what [`run`]'s contract promises.
macro_rules! avx512 {
    ($e:expr) => {
        // SAFETY: F32x16 exists only inside `run`, whose caller vouches for AVX-512 F.
        unsafe { $e }
    };
}

impl Lanes for F32x16 {
    const COUNT: usize = 16;
    const TILE_ROWS: usize = 6;
    const TILE_COLS: usize = 4;
    type Mask = __mmask16;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self(avx512!(_mm512_set1_ps(x)))
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        let from = &from[..16];
        // SAFETY: sixteen values are in bounds; unaligned loads are allowed. Features as above.
        Self(unsafe { _mm512_loadu_ps(from.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        let to = &mut to[..16];
        // SAFETY: sixteen values are in bounds; unaligned stores are allowed. Features as above.
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self(avx512!(_mm512_add_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self(avx512!(_mm512_sub_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self(avx512!(_mm512_mul_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        Self(avx512!(_mm512_div_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self(avx512!(_mm512_fmadd_ps(self.0, b.0, c.0)))
    }
    #[inline(always)]
    fn max_of(self, b: Self) -> Self {
        Self(avx512!(_mm512_max_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn min_of(self, b: Self) -> Self {
        Self(avx512!(_mm512_min_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(avx512!(_mm512_abs_ps(self.0)))
    }
    #[inline(always)]
    fn round_even(self) -> Self {
        Self(avx512!(_mm512_roundscale_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(self.0)))
    }
    #[inline(always)]
    fn exp2_integer(self) -> Self {
        Self(avx512!({
            let biased = _mm512_add_epi32(_mm512_cvtps_epi32(self.0), _mm512_set1_epi32(127));
            _mm512_castsi512_ps(_mm512_slli_epi32::<23>(biased))
        }))
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        avx512!({
            let border = _mm512_set1_epi32(SQRT_HALF_BITS as i32);
            let shifted = _mm512_sub_epi32(_mm512_castps_si512(self.0), border);
            let mantissa = _mm512_and_si512(shifted, _mm512_set1_epi32(0x007f_ffff));
            let mantissa = _mm512_castsi512_ps(_mm512_add_epi32(mantissa, border));
            let exponent = _mm512_cvtepi32_ps(_mm512_srai_epi32::<23>(shifted));
            (Self(mantissa), Self(exponent))
        })
    }
    #[inline(always)]
    fn equals(self, b: Self) -> __mmask16 {
        avx512!(_mm512_cmp_ps_mask::<_CMP_EQ_OQ>(self.0, b.0))
    }
    #[inline(always)]
    fn less(self, b: Self) -> __mmask16 {
        avx512!(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, b.0))
    }
    #[inline(always)]
    fn select(mask: __mmask16, a: Self, b: Self) -> Self {
        Self(avx512!(_mm512_mask_blend_ps(mask, b.0, a.0)))
    }
}
