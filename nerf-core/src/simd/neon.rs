//! NEON leaf: four lanes, fused. Every 64-bit ARM processor has it, so that nothing is detected at run time.

use super::Op;
use super::gather::last_row;
use crate::simd::lanes::SQRT_HALF_BITS;
use crate::simd::table::{Format, Indices, Table, weighted_rows_by_lane};
use crate::simd::{Lanes, MAX_LANES};
use core::arch::aarch64::*;
use core::arch::asm;

/// Four f32 in a vector register.
#[derive(Clone, Copy)]
pub struct F32x4(float32x4_t);

/// An intrinsic: safe to call where its instructions exist.
macro_rules! neon {
    ($e:expr) => {
        // SAFETY: this file is compiled only where the target has NEON (`mod.rs`).
        unsafe { $e }
    };
}

/// Runs `op` with four lanes.
pub fn run<O: Op>(op: O) -> O::Output {
    op.run::<F32x4>()
}

impl super::lanes::sealed::Sealed for F32x4 {}
const _: () = super::lanes::divides::<F32x4>();

impl Lanes for F32x4 {
    const COUNT: usize = 4;
    const TILE_ROWS: usize = 4;
    const TILE_COLS: usize = 4;
    type Mask = uint32x4_t;
    type Indices = U32x4;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self(neon!(vdupq_n_f32(x)))
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        let from = &from[..4];
        // SAFETY: four values are in bounds.
        Self(unsafe { vld1q_f32(from.as_ptr()) })
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        let to = &mut to[..4];
        // SAFETY: four values are in bounds.
        unsafe { vst1q_f32(to.as_mut_ptr(), self.0) }
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self(neon!(vaddq_f32(self.0, b.0)))
    }
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self(neon!(vsubq_f32(self.0, b.0)))
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self(neon!(vmulq_f32(self.0, b.0)))
    }
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        Self(neon!(vdivq_f32(self.0, b.0)))
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self(neon!(vfmaq_f32(c.0, self.0, b.0)))
    }
    // NEON's own maximum and minimum are NaN if either is.
    #[inline(always)]
    fn max_of(self, b: Self) -> Self {
        Self::select(b.less(self), self, b)
    }
    #[inline(always)]
    fn min_of(self, b: Self) -> Self {
        Self::select(self.less(b), self, b)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(neon!(vsqrtq_f32(self.0)))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(neon!(vabsq_f32(self.0)))
    }
    #[inline(always)]
    fn round_even(self) -> Self {
        Self(neon!(vrndnq_f32(self.0)))
    }
    #[inline(always)]
    fn floor(self) -> Self {
        Self(neon!(vrndmq_f32(self.0)))
    }
    #[inline(always)]
    fn exp2_integer(self) -> Self {
        Self(neon!({
            let biased = vaddq_s32(vcvtq_s32_f32(self.0), vdupq_n_s32(127));
            vreinterpretq_f32_s32(vshlq_n_s32::<23>(biased))
        }))
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        neon!({
            let border = vdupq_n_s32(SQRT_HALF_BITS as i32);
            let shifted = vsubq_s32(vreinterpretq_s32_f32(self.0), border);
            let mantissa = vaddq_s32(vandq_s32(shifted, vdupq_n_s32(0x007f_ffff)), border);
            let exponent = vcvtq_f32_s32(vshrq_n_s32::<23>(shifted));
            (Self(vreinterpretq_f32_s32(mantissa)), Self(exponent))
        })
    }
    #[inline(always)]
    fn equals(self, b: Self) -> uint32x4_t {
        neon!(vceqq_f32(self.0, b.0))
    }
    #[inline(always)]
    fn less(self, b: Self) -> uint32x4_t {
        neon!(vcltq_f32(self.0, b.0))
    }
    #[inline(always)]
    fn select(mask: uint32x4_t, a: Self, b: Self) -> Self {
        Self(neon!(vbslq_f32(mask, a.0, b.0)))
    }
    #[inline(always)]
    fn to_indices(self) -> U32x4 {
        U32x4(neon!(vcvtq_u32_f32(self.0)))
    }
    #[inline(always)]
    fn from_f16(bits: &[u16; MAX_LANES]) -> Self {
        // SAFETY: sixteen values are in bounds, of which four are read.
        Self(widen(unsafe { vld1_u16(bits.as_ptr()) }))
    }
    #[inline(always)]
    fn to_f16(self) -> [u16; MAX_LANES] {
        let mut bits = [0; MAX_LANES];
        let halves: uint16x4_t;
        // SAFETY: every processor with NEON has the instruction, which reads and writes registers alone; there is room
        // for sixteen values, of which four are written.
        unsafe {
            asm!("fcvtn {halves:v}.4h, {x:v}.4s", halves = lateout(vreg) halves, x = in(vreg) self.0,
                options(pure, nomem, nostack, preserves_flags));
            vst1_u16(bits.as_mut_ptr(), halves);
        }
        bits
    }
    #[inline(always)]
    fn weighted_rows<T: Table, const ROWS: usize>(
        table: T,
        rows: &[U32x4; ROWS],
        weights: &[Self; ROWS],
        features: usize,
    ) -> [Self; 8] {
        let Some(last) = last_row(table, features) else {
            return weighted_rows_by_lane(table, rows, weights, features);
        };
        let (last, features_of_each) = (U32x4::splat(last), U32x4::splat(features as u32));
        let offsets = rows.map(|row| row.min(last).mul(features_of_each));
        let zero = Self::splat(0.0);
        let [a, b, c, d] = four::<T, ROWS>(table, &offsets, weights, 0);
        if features == 2 {
            return [a, b, c, d, zero, zero, zero, zero];
        }
        let [e, f, g, h] = four::<T, ROWS>(table, &offsets, weights, 4);
        [a, b, c, d, e, f, g, h]
    }
}

/// Four weighted values of each lane, from `plus` behind each of the `offsets` on.
///
/// A lane's four values lie in one register while they are summed; lanes and values change places after.
#[inline(always)]
fn four<T: Table, const ROWS: usize>(
    table: T,
    offsets: &[U32x4; ROWS],
    weights: &[F32x4; ROWS],
    plus: usize,
) -> [F32x4; 4] {
    let s0 = lane::<T, ROWS, 0>(table, offsets, weights, plus);
    let s1 = lane::<T, ROWS, 1>(table, offsets, weights, plus);
    let s2 = lane::<T, ROWS, 2>(table, offsets, weights, plus);
    let s3 = lane::<T, ROWS, 3>(table, offsets, weights, plus);
    neon!({
        let (a, b) = (vzip1q_f32(s0, s1), vzip2q_f32(s0, s1));
        let (c, d) = (vzip1q_f32(s2, s3), vzip2q_f32(s2, s3));
        let (a, b) = (vreinterpretq_f64_f32(a), vreinterpretq_f64_f32(b));
        let (c, d) = (vreinterpretq_f64_f32(c), vreinterpretq_f64_f32(d));
        [
            F32x4(vreinterpretq_f32_f64(vzip1q_f64(a, c))),
            F32x4(vreinterpretq_f32_f64(vzip2q_f64(a, c))),
            F32x4(vreinterpretq_f32_f64(vzip1q_f64(b, d))),
            F32x4(vreinterpretq_f32_f64(vzip2q_f64(b, d))),
        ]
    })
}

/// Lane `LANE`, its four values.
#[inline(always)]
fn lane<T: Table, const ROWS: usize, const LANE: i32>(
    table: T,
    offsets: &[U32x4; ROWS],
    weights: &[F32x4; ROWS],
    plus: usize,
) -> float32x4_t {
    let mut sum = neon!(vdupq_n_f32(0.0));
    for (offset, weight) in offsets.iter().zip(weights) {
        let offset = neon!(vgetq_lane_u32::<LANE>(offset.0)) as usize;
        let at = table.start().wrapping_add(T::FORMAT.bytes() * (offset + plus));
        let values = match T::FORMAT {
            // SAFETY: `last_row` keeps each row, and with it four values from `plus` on, inside the table.
            Format::F16 => widen(unsafe { vcreate_u16(at.cast::<u64>().read_unaligned()) }),
            // SAFETY: as above, with values of four bytes.
            Format::F32 => unsafe { at.cast::<float32x4_t>().read_unaligned() },
            Format::Int8 => {
                // SAFETY: as above, with values of one byte.
                let bytes = u64::from(unsafe { at.cast::<u32>().read_unaligned() });
                neon!(vcvtq_f32_s32(vmovl_s16(vget_low_s16(vmovl_s8(vcreate_s8(bytes))))))
            }
        };
        sum = neon!(vfmaq_laneq_f32::<LANE>(sum, values, weight.0));
    }
    sum
}

/// Four f16, widened. The intrinsic for it is younger than the oldest compiler that is supported.
#[inline(always)]
fn widen(bits: uint16x4_t) -> float32x4_t {
    let values: float32x4_t;
    // SAFETY: every processor with NEON has the instruction, which reads and writes registers alone.
    unsafe {
        asm!("fcvtl {values:v}.4s, {bits:v}.4h", values = lateout(vreg) values, bits = in(vreg) bits,
            options(pure, nomem, nostack, preserves_flags));
    }
    values
}

/// Four u32 in a vector register.
#[derive(Clone, Copy)]
pub struct U32x4(uint32x4_t);

impl Indices for U32x4 {
    #[inline(always)]
    fn splat(x: u32) -> Self {
        Self(neon!(vdupq_n_u32(x)))
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self(neon!(vaddq_u32(self.0, b.0)))
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self(neon!(vmulq_u32(self.0, b.0)))
    }
    #[inline(always)]
    fn xor(self, b: Self) -> Self {
        Self(neon!(veorq_u32(self.0, b.0)))
    }
    #[inline(always)]
    fn and(self, b: Self) -> Self {
        Self(neon!(vandq_u32(self.0, b.0)))
    }
    #[inline(always)]
    fn min(self, b: Self) -> Self {
        Self(neon!(vminq_u32(self.0, b.0)))
    }
    #[inline(always)]
    fn shift_right_15(self) -> Self {
        Self(neon!(vshrq_n_u32::<15>(self.0)))
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; MAX_LANES]) {
        // SAFETY: sixteen values are in bounds, of which four are written.
        unsafe { vst1q_u32(to.as_mut_ptr(), self.0) }
    }
}
