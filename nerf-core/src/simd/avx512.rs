//! AVX-512 F leaf: sixteen lanes.

use super::Op;
use super::gather::{Quads, address, last_word, weighted_rows_by_quads};
use crate::simd::lanes::{Indices, SQRT_HALF_BITS, bits_by_lane};
use crate::simd::table::{Format, Table, Value};
use crate::simd::{Lanes, MAX_LANES};
use core::arch::x86_64::*;

/// Sixteen f32 in a `zmm` register. Made only inside [`run`], whose caller guarantees the instructions.
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

/// Calls an intrinsic under the safety contract of [`run`].
macro_rules! avx512 {
    ($e:expr) => {
        // SAFETY: F32x16 exists only inside `run`, whose caller vouches for AVX-512 F.
        unsafe { $e }
    };
}

impl super::lanes::sealed::Sealed for F32x16 {}
const _: () = super::lanes::divides::<F32x16>();

impl Lanes for F32x16 {
    const COUNT: usize = 16;
    const TILE_ROWS: usize = 6;
    const TILE_COLS: usize = 4;
    type Mask = __mmask16;
    type Indices = U32x16;

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
    instructions! {
        add(a, b) = _mm512_add_ps(a, b);
        sub(a, b) = _mm512_sub_ps(a, b);
        mul(a, b) = _mm512_mul_ps(a, b);
        div(a, b) = _mm512_div_ps(a, b);
        mul_add(a, b, c) = _mm512_fmadd_ps(a, b, c);
        max_of(a, b) = _mm512_max_ps(a, b);
        min_of(a, b) = _mm512_min_ps(a, b);
        sqrt(a) = _mm512_sqrt_ps(a);
        abs(a) = _mm512_abs_ps(a);
        round_even(a) = _mm512_roundscale_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(a);
        floor(a) = _mm512_roundscale_ps::<{ _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC }>(a);
        exp2_integer(a) = {
            let biased = _mm512_add_epi32(_mm512_cvtps_epi32(a), _mm512_set1_epi32(127));
            _mm512_castsi512_ps(_mm512_slli_epi32::<23>(biased))
        };
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
    #[inline(always)]
    fn to_indices(self) -> U32x16 {
        U32x16(avx512!(_mm512_cvtps_epi32(self.0)))
    }
    #[inline(always)]
    fn from_f16(bits: &[u16; MAX_LANES]) -> Self {
        // SAFETY: sixteen values are in bounds. Features as above.
        Self(unsafe { _mm512_cvtph_ps(_mm256_loadu_si256(bits.as_ptr().cast())) })
    }
    #[inline(always)]
    fn to_f16(self) -> [u16; MAX_LANES] {
        let mut bits = [0; MAX_LANES];
        // SAFETY: there is room for sixteen values. Features as above.
        unsafe {
            let halves = _mm512_cvtps_ph::<_MM_FROUND_TO_NEAREST_INT>(self.0);
            _mm256_storeu_si256(bits.as_mut_ptr().cast(), halves);
        }
        bits
    }
    #[inline(always)]
    fn bits(bytes: &[u8], at: U32x16) -> u32 {
        let Some(last) = last_word(bytes) else {
            return bits_by_lane::<Self>(bytes, at);
        };
        // SAFETY: `last_word` keeps the four bytes of each lane inside `bytes`; unaligned reads. Features as above.
        unsafe {
            let from = _mm512_min_epu32(_mm512_srli_epi32::<3>(at.0), _mm512_set1_epi32(last as i32));
            let words = _mm512_i32gather_epi32::<1>(from, bytes.as_ptr().cast());
            // Beyond the last byte the shift exceeds a word: 0.
            let shift = _mm512_sub_epi32(at.0, _mm512_slli_epi32::<3>(from));
            u32::from(_mm512_test_epi32_mask(_mm512_srlv_epi32(words, shift), _mm512_set1_epi32(1)))
        }
    }
    weighted_rows_by_quads!();
}

impl Quads for F32x16 {
    // Through memory: extracting lanes from registers is slower.
    const OFFSETS_IN_MEMORY: bool = true;
    type Offsets = [u32; 16];

    #[inline(always)]
    fn offsets(indices: U32x16) -> [u32; 16] {
        let mut offsets = [0; 16];
        indices.store(&mut offsets);
        offsets
    }
    #[inline(always)]
    unsafe fn read_four<T: Value, const LANE: usize>(
        table: Table<'_, T>,
        at: &[u32; 16],
        plus: usize,
    ) -> Self {
        let [a, b, c, d] = [0, 4, 8, 12].map(|group| address(table, at[group + LANE], plus));
        // SAFETY: the caller vouches for four values at each address; unaligned reads. Features as above.
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
    #[inline(always)]
    fn repeat<const LANE: usize>(self) -> Self {
        Self(avx512!(match LANE {
            0 => _mm512_permute_ps::<0x00>(self.0),
            1 => _mm512_permute_ps::<0x55>(self.0),
            2 => _mm512_permute_ps::<0xaa>(self.0),
            _ => _mm512_permute_ps::<0xff>(self.0),
        }))
    }
    #[inline(always)]
    fn transpose([s0, s1, s2, s3]: [Self; 4]) -> [Self; 4] {
        avx512!({
            let (a, b) = (_mm512_unpacklo_ps(s0.0, s1.0), _mm512_unpackhi_ps(s0.0, s1.0));
            let (c, d) = (_mm512_unpacklo_ps(s2.0, s3.0), _mm512_unpackhi_ps(s2.0, s3.0));
            let (a, b) = (_mm512_castps_pd(a), _mm512_castps_pd(b));
            let (c, d) = (_mm512_castps_pd(c), _mm512_castps_pd(d));
            [
                Self(_mm512_castpd_ps(_mm512_unpacklo_pd(a, c))),
                Self(_mm512_castpd_ps(_mm512_unpackhi_pd(a, c))),
                Self(_mm512_castpd_ps(_mm512_unpacklo_pd(b, d))),
                Self(_mm512_castpd_ps(_mm512_unpackhi_pd(b, d))),
            ]
        })
    }
}
/// Sixteen u32 in a `zmm` register. Made only where `F32x16` is made.
#[derive(Clone, Copy)]
pub struct U32x16(__m512i);

impl Indices for U32x16 {
    #[inline(always)]
    fn splat(x: u32) -> Self {
        Self(avx512!(_mm512_set1_epi32(x as i32)))
    }
    instructions! {
        add(a, b) = _mm512_add_epi32(a, b);
        mul(a, b) = _mm512_mullo_epi32(a, b);
        xor(a, b) = _mm512_xor_si512(a, b);
        and(a, b) = _mm512_and_si512(a, b);
        min(a, b) = _mm512_min_epu32(a, b);
        shift_right_15(a) = _mm512_srli_epi32::<15>(a);
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; MAX_LANES]) {
        // SAFETY: sixteen values are in bounds; unaligned stores are allowed. Features as above.
        unsafe { _mm512_storeu_si512(to.as_mut_ptr().cast(), self.0) }
    }
}
