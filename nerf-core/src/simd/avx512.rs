//! AVX-512 F implementation of the vector traits [`Lanes`] and [`Indices`]: sixteen lanes.

use super::lanes::{Indices, SQRT_HALF_BITS, bits_by_lane};
use super::leaf::{Quads, address, instructions, lanes_in_memory, last_word};
use super::table::{Format, Table, Value};
use super::{Lanes, MAX_LANES, Op};
use core::arch::x86_64::*;
use core::mem::transmute;

/// Sixteen f32 in a `zmm` register. Used only inside [`run`], whose caller guarantees that the CPU has the
/// instructions.
#[derive(Clone, Copy)]
pub struct F32x16(__m512);

/// Runs `op` with sixteen lanes.
///
/// # Safety
/// The caller must ensure that the CPU has AVX-512 F, and that the OS saves the `zmm` and mask registers.
#[target_feature(enable = "avx512f")]
pub unsafe fn run<O: Op>(op: O) -> O::Output {
    op.run::<F32x16>()
}

impl super::sealed::Sealed for F32x16 {}

impl Lanes for F32x16 {
    const TILE_ROWS: usize = 6;
    const TILE_COLS: usize = 4;
    type Mask = __mmask16;
    type Indices = U32x16;

    lanes_in_memory!(16, _mm512_loadu_ps, _mm512_storeu_ps);
    instructions! {
        fn splat(x: f32) -> Self = Self(_mm512_set1_ps(x));
        fn add(self, b: Self) -> Self = Self(_mm512_add_ps(self.0, b.0));
        fn sub(self, b: Self) -> Self = Self(_mm512_sub_ps(self.0, b.0));
        fn mul(self, b: Self) -> Self = Self(_mm512_mul_ps(self.0, b.0));
        fn div(self, b: Self) -> Self = Self(_mm512_div_ps(self.0, b.0));
        fn mul_add(self, b: Self, c: Self) -> Self = Self(_mm512_fmadd_ps(self.0, b.0, c.0));
        fn max_of(self, b: Self) -> Self = Self(_mm512_max_ps(self.0, b.0));
        fn min_of(self, b: Self) -> Self = Self(_mm512_min_ps(self.0, b.0));
        fn sqrt(self) -> Self = Self(_mm512_sqrt_ps(self.0));
        fn abs(self) -> Self = Self(_mm512_abs_ps(self.0));
        fn round_even(self) -> Self =
            Self(_mm512_roundscale_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(self.0));
        fn floor(self) -> Self =
            Self(_mm512_roundscale_ps::<{ _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC }>(self.0));
        fn exp2_integer(self) -> Self = {
            let biased = _mm512_add_epi32(_mm512_cvtps_epi32(self.0), _mm512_set1_epi32(127));
            Self(_mm512_castsi512_ps(_mm512_slli_epi32::<23>(biased)))
        };
        fn split_exponent(self) -> (Self, Self) = {
            let border = _mm512_set1_epi32(SQRT_HALF_BITS as i32);
            let shifted = _mm512_sub_epi32(_mm512_castps_si512(self.0), border);
            let mantissa = _mm512_and_si512(shifted, _mm512_set1_epi32(0x007f_ffff));
            let mantissa = _mm512_castsi512_ps(_mm512_add_epi32(mantissa, border));
            (Self(mantissa), Self(_mm512_cvtepi32_ps(_mm512_srai_epi32::<23>(shifted))))
        };
        fn equals(self, b: Self) -> __mmask16 = _mm512_cmp_ps_mask::<_CMP_EQ_OQ>(self.0, b.0);
        fn less(self, b: Self) -> __mmask16 = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, b.0);
        fn select(mask: __mmask16, a: Self, b: Self) -> Self = Self(_mm512_mask_blend_ps(mask, b.0, a.0));
        fn to_indices(self) -> U32x16 = U32x16(_mm512_cvtps_epi32(self.0));
        // SAFETY: both types have 256 bits, and any bits are valid.
        fn to_f16(self) -> [u16; MAX_LANES] =
            transmute(_mm512_cvtps_ph::<_MM_FROUND_TO_NEAREST_INT>(self.0));
    }
    #[inline(always)]
    fn bits(bytes: &[u8], at: U32x16) -> u32 {
        let Some(last) = last_word(bytes) else {
            return bits_by_lane::<Self>(bytes, at);
        };
        // SAFETY: `last_word` keeps the four bytes of each lane inside `bytes`. Reads may be unaligned. The CPU has
        // AVX-512 F, as [`run`] requires.
        unsafe {
            let from = _mm512_min_epu32(_mm512_srli_epi32::<3>(at.0), _mm512_set1_epi32(last as i32));
            let words = _mm512_i32gather_epi32::<1>(from, bytes.as_ptr().cast());
            // For a bit beyond the last byte the shift is at least 32, which gives 0.
            let shift = _mm512_sub_epi32(at.0, _mm512_slli_epi32::<3>(from));
            u32::from(_mm512_test_epi32_mask(_mm512_srlv_epi32(words, shift), _mm512_set1_epi32(1)))
        }
    }
}

impl Quads for F32x16 {
    // Extracting lanes from registers is slower than reading them from memory.
    const OFFSETS_IN_MEMORY: bool = true;
    type Offsets = [u32; 16];

    #[inline(always)]
    unsafe fn read_four<T: Value, const LANE: usize>(
        table: Table<'_, T>,
        at: &[u32; 16],
        plus: usize,
    ) -> Self {
        let [a, b, c, d] = [0, 4, 8, 12].map(|group| address(table, at[group + LANE], plus));
        // SAFETY: the caller guarantees four values at each address. Reads may be unaligned. The CPU has AVX-512 F, as
        // [`run`] requires.
        Self(unsafe {
            match T::FORMAT {
                Format::F16 => {
                    let low = _mm_loadh_pd(_mm_load_sd(a.cast()), b.cast());
                    let high = _mm_loadh_pd(_mm_load_sd(c.cast()), d.cast());
                    _mm512_cvtph_ps(_mm256_castpd_si256(_mm256_set_m128d(high, low)))
                }
                Format::F32 => {
                    let low = _mm512_castps128_ps512(_mm_loadu_ps(a.cast()));
                    let low = _mm512_insertf32x4::<1>(low, _mm_loadu_ps(b.cast()));
                    let low = _mm512_insertf32x4::<2>(low, _mm_loadu_ps(c.cast()));
                    _mm512_insertf32x4::<3>(low, _mm_loadu_ps(d.cast()))
                }
                Format::Int8 => {
                    let [a, b, c, d] = [a, b, c, d].map(|at| at.cast::<i32>().read_unaligned());
                    _mm512_cvtepi32_ps(_mm512_cvtepi8_epi32(_mm_set_epi32(d, c, b, a)))
                }
            }
        })
    }
    instructions! {
        // SAFETY: both types have 512 bits, and any bits are valid.
        fn offsets(indices: U32x16) -> [u32; 16] = transmute(indices.0);
        fn repeat<const LANE: usize>(self) -> Self = Self(match LANE {
            0 => _mm512_permute_ps::<0x00>(self.0),
            1 => _mm512_permute_ps::<0x55>(self.0),
            2 => _mm512_permute_ps::<0xaa>(self.0),
            _ => _mm512_permute_ps::<0xff>(self.0),
        });
        fn zip(self, b: Self) -> [Self; 2] =
            [Self(_mm512_unpacklo_ps(self.0, b.0)), Self(_mm512_unpackhi_ps(self.0, b.0))];
        fn zip_pairs(self, b: Self) -> [Self; 2] =
            [Self(_mm512_shuffle_ps::<0x44>(self.0, b.0)), Self(_mm512_shuffle_ps::<0xee>(self.0, b.0))];
    }
}

/// Sixteen u32 in a `zmm` register. Used only inside [`run`], whose caller guarantees that the CPU has the
/// instructions.
#[derive(Clone, Copy)]
pub struct U32x16(__m512i);

impl Indices for U32x16 {
    instructions! {
        fn splat(x: u32) -> Self = Self(_mm512_set1_epi32(x as i32));
        fn add(self, b: Self) -> Self = Self(_mm512_add_epi32(self.0, b.0));
        fn mul(self, b: Self) -> Self = Self(_mm512_mullo_epi32(self.0, b.0));
        fn xor(self, b: Self) -> Self = Self(_mm512_xor_si512(self.0, b.0));
        fn and(self, b: Self) -> Self = Self(_mm512_and_si512(self.0, b.0));
        fn min(self, b: Self) -> Self = Self(_mm512_min_epu32(self.0, b.0));
        fn shift_right_15(self) -> Self = Self(_mm512_srli_epi32::<15>(self.0));
        // SAFETY: `to` has room for sixteen values. Unaligned stores are allowed.
        fn store(self, to: &mut [u32; MAX_LANES]) = _mm512_storeu_si512(to.as_mut_ptr().cast(), self.0);
    }
}
