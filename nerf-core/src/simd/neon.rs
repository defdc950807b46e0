//! NEON leaf: four lanes, fused. Every 64-bit ARM processor has NEON, so that nothing is detected at run time.

use super::Op;
use super::gather::{Quads, address, weighted_rows_by_quads};
use crate::simd::lanes::{Indices, SQRT_HALF_BITS};
use crate::simd::table::{Format, Table, Value};
use crate::simd::{Lanes, MAX_LANES};
use core::arch::aarch64::*;
use core::arch::asm;

/// Four f32 in a vector register.
#[derive(Clone, Copy)]
pub struct F32x4(float32x4_t);

/// Calls an intrinsic, which is safe on every target for which this file is compiled.
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
    instructions! {
        add(a, b) = vaddq_f32(a, b);
        sub(a, b) = vsubq_f32(a, b);
        mul(a, b) = vmulq_f32(a, b);
        div(a, b) = vdivq_f32(a, b);
        mul_add(a, b, c) = vfmaq_f32(c, a, b);
        // NEON's own maximum and minimum are NaN if either is.
        max_of(a, b) = vbslq_f32(vcltq_f32(b, a), a, b);
        min_of(a, b) = vbslq_f32(vcltq_f32(a, b), a, b);
        sqrt(a) = vsqrtq_f32(a);
        abs(a) = vabsq_f32(a);
        round_even(a) = vrndnq_f32(a);
        floor(a) = vrndmq_f32(a);
        exp2_integer(a) = {
            let biased = vaddq_s32(vcvtq_s32_f32(a), vdupq_n_s32(127));
            vreinterpretq_f32_s32(vshlq_n_s32::<23>(biased))
        };
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
    weighted_rows_by_quads!();
}

impl Quads for F32x4 {
    type Offsets = U32x4;

    #[inline(always)]
    fn offsets(indices: U32x4) -> U32x4 {
        indices
    }
    #[inline(always)]
    unsafe fn read_four<T: Value, const LANE: usize>(table: Table<'_, T>, at: &U32x4, plus: usize) -> Self {
        let offset = neon!(match LANE {
            0 => vgetq_lane_u32::<0>(at.0),
            1 => vgetq_lane_u32::<1>(at.0),
            2 => vgetq_lane_u32::<2>(at.0),
            _ => vgetq_lane_u32::<3>(at.0),
        });
        let from = address(table, offset, plus);
        // SAFETY: the caller vouches for four values at the address.
        Self(unsafe {
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
    #[inline(always)]
    fn repeat<const LANE: usize>(self) -> Self {
        Self(neon!(match LANE {
            0 => vdupq_laneq_f32::<0>(self.0),
            1 => vdupq_laneq_f32::<1>(self.0),
            2 => vdupq_laneq_f32::<2>(self.0),
            _ => vdupq_laneq_f32::<3>(self.0),
        }))
    }
    #[inline(always)]
    fn transpose([s0, s1, s2, s3]: [Self; 4]) -> [Self; 4] {
        neon!({
            let (a, b) = (vzip1q_f32(s0.0, s1.0), vzip2q_f32(s0.0, s1.0));
            let (c, d) = (vzip1q_f32(s2.0, s3.0), vzip2q_f32(s2.0, s3.0));
            let (a, b) = (vreinterpretq_f64_f32(a), vreinterpretq_f64_f32(b));
            let (c, d) = (vreinterpretq_f64_f32(c), vreinterpretq_f64_f32(d));
            [vzip1q_f64(a, c), vzip2q_f64(a, c), vzip1q_f64(b, d), vzip2q_f64(b, d)]
                .map(|of_lanes| Self(vreinterpretq_f32_f64(of_lanes)))
        })
    }
}
/// Converts four f16 to f32, in assembly: the oldest supported compiler lacks the intrinsic.
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
    instructions! {
        add(a, b) = vaddq_u32(a, b);
        mul(a, b) = vmulq_u32(a, b);
        xor(a, b) = veorq_u32(a, b);
        and(a, b) = vandq_u32(a, b);
        min(a, b) = vminq_u32(a, b);
        shift_right_15(a) = vshrq_n_u32::<15>(a);
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; MAX_LANES]) {
        // SAFETY: sixteen values are in bounds, of which four are written.
        unsafe { vst1q_u32(to.as_mut_ptr(), self.0) }
    }
}
