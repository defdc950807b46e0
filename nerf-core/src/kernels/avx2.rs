//! AVX2 + FMA leaf: eight lanes.

use super::Op;
use crate::math::lanes::{Lanes, SQRT_HALF_BITS};
use core::arch::x86_64::*;

/// Eight f32 in a `ymm` register. Made only inside [`run`], where the instructions are known to exist.
#[derive(Clone, Copy)]
pub struct F32x8(__m256);

/// Runs `op` with eight lanes.
///
/// # Safety
/// The CPU has AVX2 and FMA, and the OS saves their registers.
#[target_feature(enable = "avx2,fma")]
pub unsafe fn run<O: Op>(op: O) -> O::Output {
    op.run::<F32x8>()
}

/// An intrinsic that needs what [`run`]'s contract promises.
macro_rules! avx2 {
    ($e:expr) => {
        // SAFETY: F32x8 exists only inside `run`, whose caller vouches for AVX2 and FMA.
        unsafe { $e }
    };
}

impl Lanes for F32x8 {
    const COUNT: usize = 8;
    const TILE_ROWS: usize = 6;
    const TILE_COLS: usize = 2;
    type Mask = __m256;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self(avx2!(_mm256_set1_ps(x)))
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        let from = &from[..8];
        // SAFETY: eight values are in bounds; unaligned loads are allowed. Features as above.
        Self(unsafe { _mm256_loadu_ps(from.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        let to = &mut to[..8];
        // SAFETY: eight values are in bounds; unaligned stores are allowed. Features as above.
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self(avx2!(_mm256_add_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self(avx2!(_mm256_sub_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self(avx2!(_mm256_mul_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        Self(avx2!(_mm256_div_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self(avx2!(_mm256_fmadd_ps(self.0, b.0, c.0)))
    }
    #[inline(always)]
    fn max_of(self, b: Self) -> Self {
        Self(avx2!(_mm256_max_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn min_of(self, b: Self) -> Self {
        Self(avx2!(_mm256_min_ps(self.0, b.0)))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(avx2!(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0)))
    }
    #[inline(always)]
    fn round_even(self) -> Self {
        Self(avx2!(_mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(self.0)))
    }
    #[inline(always)]
    fn exp2_integer(self) -> Self {
        Self(avx2!({
            let biased = _mm256_add_epi32(_mm256_cvtps_epi32(self.0), _mm256_set1_epi32(127));
            _mm256_castsi256_ps(_mm256_slli_epi32::<23>(biased))
        }))
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        avx2!({
            let border = _mm256_set1_epi32(SQRT_HALF_BITS as i32);
            let shifted = _mm256_sub_epi32(_mm256_castps_si256(self.0), border);
            let mantissa = _mm256_and_si256(shifted, _mm256_set1_epi32(0x007f_ffff));
            let mantissa = _mm256_castsi256_ps(_mm256_add_epi32(mantissa, border));
            let exponent = _mm256_cvtepi32_ps(_mm256_srai_epi32::<23>(shifted));
            (Self(mantissa), Self(exponent))
        })
    }
    #[inline(always)]
    fn equals(self, b: Self) -> __m256 {
        avx2!(_mm256_cmp_ps::<_CMP_EQ_OQ>(self.0, b.0))
    }
    #[inline(always)]
    fn less(self, b: Self) -> __m256 {
        avx2!(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, b.0))
    }
    #[inline(always)]
    fn select(mask: __m256, a: Self, b: Self) -> Self {
        Self(avx2!(_mm256_blendv_ps(b.0, a.0, mask)))
    }
}
