//! NEON implementation of the vector traits [`Lanes`] and [`Indices`]: four lanes, with fused multiply-adds. There is
//! no run-time detection, since every 64-bit ARM processor has NEON.

use super::lanes::{Indices, SQRT_HALF_BITS};
use super::leaf::{Quads, address, instructions, lanes_in_memory};
use super::table::{Format, Table, Value};
use super::{Lanes, MAX_LANES, Op};
use core::arch::aarch64::*;
use core::arch::asm;

#[derive(Clone, Copy)]
pub struct F32x4(float32x4_t);

pub fn run<O: Op>(op: O) -> O::Output {
    op.run::<F32x4>()
}

impl super::sealed::Sealed for F32x4 {}

impl Lanes for F32x4 {
    const TILE_ROWS: usize = 4;
    const TILE_COLS: usize = 4;
    type Mask = uint32x4_t;
    type Indices = U32x4;

    lanes_in_memory!(4, vld1q_f32, vst1q_f32);
    instructions! {
        fn splat(x: f32) -> Self = Self(vdupq_n_f32(x));
        fn add(self, b: Self) -> Self = Self(vaddq_f32(self.0, b.0));
        fn sub(self, b: Self) -> Self = Self(vsubq_f32(self.0, b.0));
        fn mul(self, b: Self) -> Self = Self(vmulq_f32(self.0, b.0));
        fn div(self, b: Self) -> Self = Self(vdivq_f32(self.0, b.0));
        fn mul_add(self, b: Self, c: Self) -> Self = Self(vfmaq_f32(c.0, self.0, b.0));
        // NEON's own maximum and minimum are NaN if either operand is.
        fn max_of(self, b: Self) -> Self = Self(vbslq_f32(vcltq_f32(b.0, self.0), self.0, b.0));
        fn min_of(self, b: Self) -> Self = Self(vbslq_f32(vcltq_f32(self.0, b.0), self.0, b.0));
        fn sqrt(self) -> Self = Self(vsqrtq_f32(self.0));
        fn abs(self) -> Self = Self(vabsq_f32(self.0));
        fn round_even(self) -> Self = Self(vrndnq_f32(self.0));
        fn floor(self) -> Self = Self(vrndmq_f32(self.0));
        fn exp2_integer(self) -> Self = {
            let biased = vaddq_s32(vcvtq_s32_f32(self.0), vdupq_n_s32(127));
            Self(vreinterpretq_f32_s32(vshlq_n_s32::<23>(biased)))
        };
        fn split_exponent(self) -> (Self, Self) = {
            let border = vdupq_n_s32(SQRT_HALF_BITS as i32);
            let shifted = vsubq_s32(vreinterpretq_s32_f32(self.0), border);
            let mantissa = vaddq_s32(vandq_s32(shifted, vdupq_n_s32(0x007f_ffff)), border);
            let exponent = vcvtq_f32_s32(vshrq_n_s32::<23>(shifted));
            (Self(vreinterpretq_f32_s32(mantissa)), Self(exponent))
        };
        fn equals(self, b: Self) -> uint32x4_t = vceqq_f32(self.0, b.0);
        fn less(self, b: Self) -> uint32x4_t = vcltq_f32(self.0, b.0);
        fn select(mask: uint32x4_t, a: Self, b: Self) -> Self = Self(vbslq_f32(mask, a.0, b.0));
        fn to_indices(self) -> U32x4 = U32x4(vcvtq_u32_f32(self.0));
    }
    #[inline(always)]
    fn to_f16(self) -> [u16; MAX_LANES] {
        let mut bits = [0; MAX_LANES];
        let halves: uint16x4_t;
        // SAFETY: every processor with NEON has the instruction, which accesses only registers. `bits` has room for
        // sixteen values, of which four are written.
        unsafe {
            asm!("fcvtn {halves:v}.4h, {x:v}.4s", halves = lateout(vreg) halves, x = in(vreg) self.0,
                options(pure, nomem, nostack, preserves_flags));
            vst1_u16(bits.as_mut_ptr(), halves);
        }
        bits
    }
}

impl Quads for F32x4 {
    type Offsets = U32x4;

    #[inline(always)]
    unsafe fn read_four<T: Value, const LANE: usize>(table: Table<'_, T>, at: &U32x4, plus: usize) -> Self {
        // SAFETY: the caller guarantees four values at the address. Every processor with NEON has the instructions.
        Self(unsafe {
            let offset = match LANE {
                0 => vgetq_lane_u32::<0>(at.0),
                1 => vgetq_lane_u32::<1>(at.0),
                2 => vgetq_lane_u32::<2>(at.0),
                _ => vgetq_lane_u32::<3>(at.0),
            };
            let from = address(table, offset, plus);
            match T::FORMAT {
                Format::F16 => widen(vcreate_u16(from.cast::<u64>().read_unaligned())),
                Format::F32 => from.cast::<float32x4_t>().read_unaligned(),
                Format::Int8 => {
                    let bytes = u64::from(from.cast::<u32>().read_unaligned());
                    vcvtq_f32_s32(vmovl_s16(vget_low_s16(vmovl_s8(vcreate_s8(bytes)))))
                }
            }
        })
    }
    instructions! {
        fn offsets(indices: U32x4) -> U32x4 = indices;
        fn repeat<const LANE: usize>(self) -> Self = Self(match LANE {
            0 => vdupq_laneq_f32::<0>(self.0),
            1 => vdupq_laneq_f32::<1>(self.0),
            2 => vdupq_laneq_f32::<2>(self.0),
            _ => vdupq_laneq_f32::<3>(self.0),
        });
        fn zip(self, b: Self) -> [Self; 2] = [Self(vzip1q_f32(self.0, b.0)), Self(vzip2q_f32(self.0, b.0))];
        fn zip_pairs(self, b: Self) -> [Self; 2] = {
            let (a, b) = (vreinterpretq_f64_f32(self.0), vreinterpretq_f64_f32(b.0));
            [Self(vreinterpretq_f32_f64(vzip1q_f64(a, b))), Self(vreinterpretq_f32_f64(vzip2q_f64(a, b)))]
        };
    }
}

/// Converts four f16 to f32, in assembly: the oldest supported compiler lacks the intrinsic.
#[inline(always)]
fn widen(bits: uint16x4_t) -> float32x4_t {
    let values: float32x4_t;
    // SAFETY: every processor with NEON has the instruction, which accesses only registers.
    unsafe {
        asm!("fcvtl {values:v}.4s, {bits:v}.4h", values = lateout(vreg) values, bits = in(vreg) bits,
            options(pure, nomem, nostack, preserves_flags));
    }
    values
}

#[derive(Clone, Copy)]
pub struct U32x4(uint32x4_t);

impl Indices for U32x4 {
    instructions! {
        fn splat(x: u32) -> Self = Self(vdupq_n_u32(x));
        fn add(self, b: Self) -> Self = Self(vaddq_u32(self.0, b.0));
        fn mul(self, b: Self) -> Self = Self(vmulq_u32(self.0, b.0));
        fn xor(self, b: Self) -> Self = Self(veorq_u32(self.0, b.0));
        fn and(self, b: Self) -> Self = Self(vandq_u32(self.0, b.0));
        fn min(self, b: Self) -> Self = Self(vminq_u32(self.0, b.0));
        fn shift_right_15(self) -> Self = Self(vshrq_n_u32::<15>(self.0));
        // SAFETY: `to` has room for sixteen values, of which four are written.
        fn store(self, to: &mut [u32; MAX_LANES]) = vst1q_u32(to.as_mut_ptr(), self.0);
    }
}
