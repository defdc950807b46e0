//! AVX2 and FMA implementation of the vector traits [`Lanes`] and [`Indices`]: eight lanes.

use super::lanes::{Indices, SQRT_HALF_BITS, bits_by_lane};
use super::leaf::{Quads, address, instructions, lanes_in_memory, last_word};
use super::portable::Portable;
use super::table::{Format, Table, Value};
use super::{Lanes, MAX_LANES, Op};
use core::arch::x86_64::*;
use core::mem::transmute;

/// Eight f32 in a `ymm` register. Used only inside [`run`], whose caller guarantees that the CPU has the instructions.
#[derive(Clone, Copy)]
pub struct F32x8(__m256);

/// Runs `op` with eight lanes.
///
/// # Safety
/// The caller must ensure that the CPU has AVX2, FMA and F16C, and that the OS saves the `ymm` registers.
#[target_feature(enable = "avx2,fma,f16c")]
pub unsafe fn run<O: Op>(op: O) -> O::Output {
    op.run::<F32x8>()
}

/// Runs `op` with the vector type [`Portable`], compiled for AVX2. Multiply-adds are not fused, so that results equal
/// those of [`Portable`] without AVX2 bit for bit.
///
/// # Safety
/// The caller must ensure that the CPU has AVX2, and that the OS saves the `ymm` registers.
#[target_feature(enable = "avx2")]
pub unsafe fn run_portable<O: Op>(op: O) -> O::Output {
    op.run::<Portable>()
}

impl super::sealed::Sealed for F32x8 {}

impl Lanes for F32x8 {
    const TILE_ROWS: usize = 6;
    const TILE_COLS: usize = 2;
    type Mask = __m256;
    type Indices = U32x8;

    lanes_in_memory!(8, _mm256_loadu_ps, _mm256_storeu_ps);
    instructions! {
        fn splat(x: f32) -> Self = Self(_mm256_set1_ps(x));
        fn add(self, b: Self) -> Self = Self(_mm256_add_ps(self.0, b.0));
        fn sub(self, b: Self) -> Self = Self(_mm256_sub_ps(self.0, b.0));
        fn mul(self, b: Self) -> Self = Self(_mm256_mul_ps(self.0, b.0));
        fn div(self, b: Self) -> Self = Self(_mm256_div_ps(self.0, b.0));
        fn mul_add(self, b: Self, c: Self) -> Self = Self(_mm256_fmadd_ps(self.0, b.0, c.0));
        fn max_of(self, b: Self) -> Self = Self(_mm256_max_ps(self.0, b.0));
        fn min_of(self, b: Self) -> Self = Self(_mm256_min_ps(self.0, b.0));
        fn sqrt(self) -> Self = Self(_mm256_sqrt_ps(self.0));
        fn abs(self) -> Self = Self(_mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0));
        fn round_even(self) -> Self =
            Self(_mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(self.0));
        fn floor(self) -> Self = Self(_mm256_floor_ps(self.0));
        fn exp2_integer(self) -> Self = {
            let biased = _mm256_add_epi32(_mm256_cvtps_epi32(self.0), _mm256_set1_epi32(127));
            Self(_mm256_castsi256_ps(_mm256_slli_epi32::<23>(biased)))
        };
        fn split_exponent(self) -> (Self, Self) = {
            let border = _mm256_set1_epi32(SQRT_HALF_BITS as i32);
            let shifted = _mm256_sub_epi32(_mm256_castps_si256(self.0), border);
            let mantissa = _mm256_and_si256(shifted, _mm256_set1_epi32(0x007f_ffff));
            let mantissa = _mm256_castsi256_ps(_mm256_add_epi32(mantissa, border));
            (Self(mantissa), Self(_mm256_cvtepi32_ps(_mm256_srai_epi32::<23>(shifted))))
        };
        fn equals(self, b: Self) -> __m256 = _mm256_cmp_ps::<_CMP_EQ_OQ>(self.0, b.0);
        fn less(self, b: Self) -> __m256 = _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, b.0);
        fn select(mask: __m256, a: Self, b: Self) -> Self = Self(_mm256_blendv_ps(b.0, a.0, mask));
        fn to_indices(self) -> U32x8 = U32x8(_mm256_cvtps_epi32(self.0));
        // SAFETY: both types have 256 bits, and any bits are valid.
        fn to_f16(self) -> [u16; MAX_LANES] =
            transmute([_mm256_cvtps_ph::<_MM_FROUND_TO_NEAREST_INT>(self.0), _mm_setzero_si128()]);
    }
    #[inline(always)]
    fn bits(bytes: &[u8], at: U32x8) -> u32 {
        let Some(last) = last_word(bytes) else {
            return bits_by_lane::<Self>(bytes, at);
        };
        // SAFETY: `last_word` keeps the four bytes of each lane inside `bytes`. Reads may be unaligned. The CPU has
        // AVX2, as [`run`] requires.
        unsafe {
            let from = _mm256_min_epu32(_mm256_srli_epi32::<3>(at.0), _mm256_set1_epi32(last as i32));
            let words = _mm256_i32gather_epi32::<1>(bytes.as_ptr().cast(), from);
            // For a bit beyond the last byte the shift is at least 32, which gives 0.
            let shift = _mm256_sub_epi32(at.0, _mm256_slli_epi32::<3>(from));
            let bit = _mm256_slli_epi32::<31>(_mm256_srlv_epi32(words, shift));
            _mm256_movemask_ps(_mm256_castsi256_ps(bit)) as u32
        }
    }
}

impl Quads for F32x8 {
    // Extracting lanes from registers is slower than reading them from memory.
    const OFFSETS_IN_MEMORY: bool = true;
    type Offsets = [u32; 8];

    #[inline(always)]
    unsafe fn read_four<T: Value, const LANE: usize>(
        table: Table<'_, T>,
        at: &[u32; 8],
        plus: usize,
    ) -> Self {
        let [low, high] = [LANE, 4 + LANE].map(|lane| address(table, at[lane], plus));
        // SAFETY: the caller guarantees four values at each address. Reads may be unaligned. The CPU has AVX2 and F16C,
        // as [`run`] requires.
        Self(unsafe {
            match T::FORMAT {
                Format::F16 => {
                    _mm256_cvtph_ps(_mm_castpd_si128(_mm_loadh_pd(_mm_load_sd(low.cast()), high.cast())))
                }
                Format::F32 => _mm256_set_m128(_mm_loadu_ps(high.cast()), _mm_loadu_ps(low.cast())),
                Format::Int8 => {
                    let high = high.cast::<i32>().read_unaligned();
                    let both = _mm_insert_epi32::<1>(_mm_loadu_si32(low), high);
                    _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(both))
                }
            }
        })
    }
    instructions! {
        // SAFETY: both types have 256 bits, and any bits are valid.
        fn offsets(indices: U32x8) -> [u32; 8] = transmute(indices.0);
        fn repeat<const LANE: usize>(self) -> Self = Self(match LANE {
            0 => _mm256_permute_ps::<0x00>(self.0),
            1 => _mm256_permute_ps::<0x55>(self.0),
            2 => _mm256_permute_ps::<0xaa>(self.0),
            _ => _mm256_permute_ps::<0xff>(self.0),
        });
        fn zip(self, b: Self) -> [Self; 2] =
            [Self(_mm256_unpacklo_ps(self.0, b.0)), Self(_mm256_unpackhi_ps(self.0, b.0))];
        fn zip_pairs(self, b: Self) -> [Self; 2] =
            [Self(_mm256_shuffle_ps::<0x44>(self.0, b.0)), Self(_mm256_shuffle_ps::<0xee>(self.0, b.0))];
    }
}

/// Eight u32 in a `ymm` register. Used only inside [`run`], whose caller guarantees that the CPU has the instructions.
#[derive(Clone, Copy)]
pub struct U32x8(__m256i);

impl Indices for U32x8 {
    instructions! {
        fn splat(x: u32) -> Self = Self(_mm256_set1_epi32(x as i32));
        fn add(self, b: Self) -> Self = Self(_mm256_add_epi32(self.0, b.0));
        fn mul(self, b: Self) -> Self = Self(_mm256_mullo_epi32(self.0, b.0));
        fn xor(self, b: Self) -> Self = Self(_mm256_xor_si256(self.0, b.0));
        fn and(self, b: Self) -> Self = Self(_mm256_and_si256(self.0, b.0));
        fn min(self, b: Self) -> Self = Self(_mm256_min_epu32(self.0, b.0));
        fn shift_right_15(self) -> Self = Self(_mm256_srli_epi32::<15>(self.0));
        // SAFETY: `to` has room for sixteen values, of which eight are written. Unaligned stores are allowed.
        fn store(self, to: &mut [u32; MAX_LANES]) = _mm256_storeu_si256(to.as_mut_ptr().cast(), self.0);
    }
}
