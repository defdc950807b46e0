//! AVX2 + FMA leaf: eight lanes.

use super::Op;
use super::gather::{Quads, address, last_word, weighted_rows_by_quads};
use crate::simd::lanes::{Indices, SQRT_HALF_BITS, bits_by_lane};
use crate::simd::portable::Portable;
use crate::simd::table::{Format, Table, Value};
use crate::simd::{Lanes, MAX_LANES};
use core::arch::x86_64::*;

/// Eight f32 in a `ymm` register. Made only inside [`run`], whose caller guarantees the instructions.
#[derive(Clone, Copy)]
pub struct F32x8(__m256);

/// Runs `op` with eight lanes.
///
/// # Safety
/// The CPU has AVX2, FMA and F16C, and the OS saves their registers.
#[target_feature(enable = "avx2,fma,f16c")]
pub unsafe fn run<O: Op>(op: O) -> O::Output {
    op.run::<F32x8>()
}

/// Runs `op` with portable lanes in `ymm` registers. Products and sums are not fused, so that results have the
/// portable bits.
///
/// # Safety
/// As for [`run`].
#[target_feature(enable = "avx2")]
pub unsafe fn run_portable<O: Op>(op: O) -> O::Output {
    op.run::<Portable>()
}

/// Calls an intrinsic under the safety contract of [`run`].
macro_rules! avx2 {
    ($e:expr) => {
        // SAFETY: F32x8 exists only inside `run`, whose caller vouches for AVX2, FMA and F16C.
        unsafe { $e }
    };
}

impl super::lanes::sealed::Sealed for F32x8 {}
const _: () = super::lanes::divides::<F32x8>();

impl Lanes for F32x8 {
    const COUNT: usize = 8;
    const TILE_ROWS: usize = 6;
    const TILE_COLS: usize = 2;
    type Mask = __m256;
    type Indices = U32x8;

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
    instructions! {
        add(a, b) = _mm256_add_ps(a, b);
        sub(a, b) = _mm256_sub_ps(a, b);
        mul(a, b) = _mm256_mul_ps(a, b);
        div(a, b) = _mm256_div_ps(a, b);
        mul_add(a, b, c) = _mm256_fmadd_ps(a, b, c);
        max_of(a, b) = _mm256_max_ps(a, b);
        min_of(a, b) = _mm256_min_ps(a, b);
        sqrt(a) = _mm256_sqrt_ps(a);
        abs(a) = _mm256_andnot_ps(_mm256_set1_ps(-0.0), a);
        round_even(a) = _mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(a);
        floor(a) = _mm256_floor_ps(a);
        exp2_integer(a) = {
            let biased = _mm256_add_epi32(_mm256_cvtps_epi32(a), _mm256_set1_epi32(127));
            _mm256_castsi256_ps(_mm256_slli_epi32::<23>(biased))
        };
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
    #[inline(always)]
    fn to_indices(self) -> U32x8 {
        U32x8(avx2!(_mm256_cvtps_epi32(self.0)))
    }
    #[inline(always)]
    fn from_f16(bits: &[u16; MAX_LANES]) -> Self {
        // SAFETY: sixteen values are in bounds, of which eight are read. Features as above.
        Self(unsafe { _mm256_cvtph_ps(_mm_loadu_si128(bits.as_ptr().cast())) })
    }
    #[inline(always)]
    fn to_f16(self) -> [u16; MAX_LANES] {
        let mut bits = [0; MAX_LANES];
        // SAFETY: there is room for sixteen values, of which eight are written. Features as above.
        unsafe {
            let halves = _mm256_cvtps_ph::<_MM_FROUND_TO_NEAREST_INT>(self.0);
            _mm_storeu_si128(bits.as_mut_ptr().cast(), halves);
        }
        bits
    }
    #[inline(always)]
    fn bits(bytes: &[u8], at: U32x8) -> u32 {
        let Some(last) = last_word(bytes) else {
            return bits_by_lane::<Self>(bytes, at);
        };
        // SAFETY: `last_word` keeps the four bytes of each lane inside `bytes`; unaligned reads. Features as above.
        unsafe {
            let from = _mm256_min_epu32(_mm256_srli_epi32::<3>(at.0), _mm256_set1_epi32(last as i32));
            let words = _mm256_i32gather_epi32::<1>(bytes.as_ptr().cast(), from);
            // Beyond the last byte the shift exceeds a word: 0.
            let shift = _mm256_sub_epi32(at.0, _mm256_slli_epi32::<3>(from));
            let bit = _mm256_slli_epi32::<31>(_mm256_srlv_epi32(words, shift));
            _mm256_movemask_ps(_mm256_castsi256_ps(bit)) as u32
        }
    }
    weighted_rows_by_quads!();
}

impl Quads for F32x8 {
    // Through memory: extracting lanes from registers is slower.
    const OFFSETS_IN_MEMORY: bool = true;
    type Offsets = [u32; 8];

    #[inline(always)]
    fn offsets(indices: U32x8) -> [u32; 8] {
        let mut offsets = [0; 8];
        // SAFETY: there is room for eight values; unaligned stores are allowed. Features as above.
        unsafe { _mm256_storeu_si256(offsets.as_mut_ptr().cast(), indices.0) }
        offsets
    }
    #[inline(always)]
    unsafe fn read_four<T: Value, const LANE: usize>(
        table: Table<'_, T>,
        at: &[u32; 8],
        plus: usize,
    ) -> Self {
        let [low, high] = [LANE, 4 + LANE].map(|lane| address(table, at[lane], plus));
        // SAFETY: the caller vouches for four values at each address; unaligned reads. Features as above.
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
    #[inline(always)]
    fn repeat<const LANE: usize>(self) -> Self {
        Self(avx2!(match LANE {
            0 => _mm256_permute_ps::<0x00>(self.0),
            1 => _mm256_permute_ps::<0x55>(self.0),
            2 => _mm256_permute_ps::<0xaa>(self.0),
            _ => _mm256_permute_ps::<0xff>(self.0),
        }))
    }
    #[inline(always)]
    fn transpose([s0, s1, s2, s3]: [Self; 4]) -> [Self; 4] {
        avx2!({
            let (a, b) = (_mm256_unpacklo_ps(s0.0, s1.0), _mm256_unpackhi_ps(s0.0, s1.0));
            let (c, d) = (_mm256_unpacklo_ps(s2.0, s3.0), _mm256_unpackhi_ps(s2.0, s3.0));
            let (a, b) = (_mm256_castps_pd(a), _mm256_castps_pd(b));
            let (c, d) = (_mm256_castps_pd(c), _mm256_castps_pd(d));
            [
                Self(_mm256_castpd_ps(_mm256_unpacklo_pd(a, c))),
                Self(_mm256_castpd_ps(_mm256_unpackhi_pd(a, c))),
                Self(_mm256_castpd_ps(_mm256_unpacklo_pd(b, d))),
                Self(_mm256_castpd_ps(_mm256_unpackhi_pd(b, d))),
            ]
        })
    }
}
/// Eight u32 in a `ymm` register. Made only where `F32x8` is made.
#[derive(Clone, Copy)]
pub struct U32x8(__m256i);

impl Indices for U32x8 {
    #[inline(always)]
    fn splat(x: u32) -> Self {
        Self(avx2!(_mm256_set1_epi32(x as i32)))
    }
    instructions! {
        add(a, b) = _mm256_add_epi32(a, b);
        mul(a, b) = _mm256_mullo_epi32(a, b);
        xor(a, b) = _mm256_xor_si256(a, b);
        and(a, b) = _mm256_and_si256(a, b);
        min(a, b) = _mm256_min_epu32(a, b);
        shift_right_15(a) = _mm256_srli_epi32::<15>(a);
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; MAX_LANES]) {
        // SAFETY: sixteen values are in bounds, of which eight are written; unaligned stores are allowed. Features as above.
        unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), self.0) }
    }
}
