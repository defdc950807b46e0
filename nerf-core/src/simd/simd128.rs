//! WebAssembly SIMD implementation of the vector traits [`Lanes`] and [`Indices`]: four lanes, without fused
//! multiply-adds. Results equal those of `Portable` bit for bit.
//!
//! There is no run-time detection: an engine without these instructions refuses to load the module. Relaxed SIMD could
//! fuse multiply-adds, but its results depend on the engine.

use super::lanes::{Indices, SQRT_HALF_BITS};
use super::leaf::{Quads, address, instructions, lanes_in_memory};
use super::table::{Format, Table, Value};
use super::{Lanes, MAX_LANES, Op};
use core::arch::wasm32::*;

#[derive(Clone, Copy)]
pub struct F32x4(v128);

pub fn run<O: Op>(op: O) -> O::Output {
    op.run::<F32x4>()
}

impl super::sealed::Sealed for F32x4 {}

impl Lanes for F32x4 {
    const TILE_ROWS: usize = 2;
    const TILE_COLS: usize = 4;
    type Mask = v128;
    type Indices = U32x4;

    lanes_in_memory!(4, v128_load, v128_store);
    instructions! {
        fn splat(x: f32) -> Self = Self(f32x4_splat(x));
        fn add(self, b: Self) -> Self = Self(f32x4_add(self.0, b.0));
        fn sub(self, b: Self) -> Self = Self(f32x4_sub(self.0, b.0));
        fn mul(self, b: Self) -> Self = Self(f32x4_mul(self.0, b.0));
        fn div(self, b: Self) -> Self = Self(f32x4_div(self.0, b.0));
        fn mul_add(self, b: Self, c: Self) -> Self = Self(f32x4_add(f32x4_mul(self.0, b.0), c.0));
        // `pmax(b, a)` is `b < a ? a : b`, one instruction on x86; the plain `max` would spread NaNs.
        fn max_of(self, b: Self) -> Self = Self(f32x4_pmax(b.0, self.0));
        fn min_of(self, b: Self) -> Self = Self(f32x4_pmin(b.0, self.0));
        fn sqrt(self) -> Self = Self(f32x4_sqrt(self.0));
        fn abs(self) -> Self = Self(f32x4_abs(self.0));
        // Adding 0 turns −0 into 0, as in `Portable`.
        fn round_even(self) -> Self = Self(f32x4_add(f32x4_nearest(self.0), f32x4_splat(0.0)));
        fn floor(self) -> Self = Self(f32x4_floor(self.0));
        fn exp2_integer(self) -> Self =
            Self(i32x4_shl(i32x4_add(i32x4_trunc_sat_f32x4(self.0), i32x4_splat(127)), 23));
        fn split_exponent(self) -> (Self, Self) = {
            let border = i32x4_splat(SQRT_HALF_BITS as i32);
            let shifted = i32x4_sub(self.0, border);
            let mantissa = i32x4_add(v128_and(shifted, i32x4_splat(0x007f_ffff)), border);
            (Self(mantissa), Self(f32x4_convert_i32x4(i32x4_shr(shifted, 23))))
        };
        fn equals(self, b: Self) -> v128 = f32x4_eq(self.0, b.0);
        fn less(self, b: Self) -> v128 = f32x4_lt(self.0, b.0);
        fn select(mask: v128, a: Self, b: Self) -> Self = Self(v128_bitselect(a.0, b.0, mask));
        // After adding 2^23, the lowest bits are the integer. WebAssembly's own conversion saturates, which takes five
        // instructions on x86.
        fn to_indices(self) -> U32x4 = {
            let whole = f32x4_splat(8_388_608.0);
            U32x4(i32x4_sub(f32x4_add(self.0, whole), whole))
        };
    }
    #[inline(always)]
    fn bits(bytes: &[u8], at: U32x4) -> u32 {
        let Some(last) = bytes.len().checked_sub(1) else { return 0 };
        let byte = u32x4_shr(at.0, 3);
        let inside = u32x4_le(byte, u32x4_splat(last as u32));
        let byte = u32x4_min(byte, u32x4_splat(last as u32));
        let start = bytes.as_ptr();
        // SAFETY: every index in `byte` is at most that of the last byte.
        let found = unsafe {
            let found =
                v128_load8_lane::<0>(u32x4_splat(0), start.add(u32x4_extract_lane::<0>(byte) as usize));
            let found = v128_load8_lane::<4>(found, start.add(u32x4_extract_lane::<1>(byte) as usize));
            let found = v128_load8_lane::<8>(found, start.add(u32x4_extract_lane::<2>(byte) as usize));
            v128_load8_lane::<12>(found, start.add(u32x4_extract_lane::<3>(byte) as usize))
        };
        // Byte i of the constant is 1 << i. Only the lowest byte of each lane of `found` can be non-zero.
        let bit = u8x16_swizzle(
            i64x2_splat(0x8040_2010_0804_0201u64.cast_signed()),
            v128_and(at.0, u32x4_splat(7)),
        );
        let empty = i32x4_eq(v128_and(found, bit), u32x4_splat(0));
        u32::from(i32x4_bitmask(v128_andnot(inside, empty)))
    }
}

impl Quads for F32x4 {
    // With sums in registers, V8 hoists the loads of the next lanes and spills most of their values to the stack.
    const SUMS_IN_MEMORY: bool = true;
    type Offsets = U32x4;

    #[inline(always)]
    unsafe fn read_four<T: Value, const LANE: usize>(table: Table<'_, T>, at: &U32x4, plus: usize) -> Self {
        let from = address(table, u32x4_extract_lane::<LANE>(at.0), plus);
        // SAFETY: the caller guarantees four values at the address. Reads may be unaligned.
        Self(unsafe {
            match T::FORMAT {
                Format::F16 => widen_finite(i32x4_load_extend_i16x4(from.cast())),
                Format::F32 => v128_load(from.cast()),
                Format::Int8 => {
                    let bytes = i16x8_extend_low_i8x16(v128_load32_zero(from.cast()));
                    f32x4_convert_i32x4(i32x4_extend_low_i16x8(bytes))
                }
            }
        })
    }
    instructions! {
        fn offsets(indices: U32x4) -> U32x4 = indices;
        fn repeat<const LANE: usize>(self) -> Self =
            Self(i32x4_shuffle::<LANE, LANE, LANE, LANE>(self.0, self.0));
        fn zip(self, b: Self) -> [Self; 2] = [
            Self(i32x4_shuffle::<0, 4, 1, 5>(self.0, b.0)),
            Self(i32x4_shuffle::<2, 6, 3, 7>(self.0, b.0)),
        ];
        fn zip_pairs(self, b: Self) -> [Self; 2] =
            [Self(i64x2_shuffle::<0, 2>(self.0, b.0)), Self(i64x2_shuffle::<1, 3>(self.0, b.0))];
    }
}

/// Converts four finite f16, each sign-extended to 32 bits, to f32.
///
/// The magnitude `v` is the difference of two f32, whose bits are made from the f16's bits by shifts and integer
/// additions. For a normal f16 the two are `2 v` and `v`: they differ by 1 in the exponent. For a subnormal f16, which
/// has no leading 1, they are `2^-14 + v` and `2^-14`. The difference is exact. No intermediate f32 is subnormal: many
/// Intel cores stall on multiplications of subnormal numbers.
#[inline(always)]
fn widen_finite(bits: v128) -> v128 {
    const SMALLEST_NORMAL: i32 = (127 - 14) << 23;
    let magnitude = u32x4_shr(i32x4_shl(bits, 17), 4);
    let more = i32x4_add(magnitude, i32x4_splat(SMALLEST_NORMAL));
    let less = i32x4_max(
        i32x4_add(magnitude, i32x4_splat(SMALLEST_NORMAL - (1 << 23))),
        i32x4_splat(SMALLEST_NORMAL),
    );
    v128_or(f32x4_sub(more, less), v128_and(bits, u32x4_splat(0x8000_0000)))
}

#[derive(Clone, Copy)]
pub struct U32x4(v128);

impl Indices for U32x4 {
    instructions! {
        fn splat(x: u32) -> Self = Self(u32x4_splat(x));
        fn add(self, b: Self) -> Self = Self(i32x4_add(self.0, b.0));
        fn mul(self, b: Self) -> Self = Self(i32x4_mul(self.0, b.0));
        fn xor(self, b: Self) -> Self = Self(v128_xor(self.0, b.0));
        fn and(self, b: Self) -> Self = Self(v128_and(self.0, b.0));
        fn min(self, b: Self) -> Self = Self(u32x4_min(self.0, b.0));
        fn shift_right_15(self) -> Self = Self(u32x4_shr(self.0, 15));
        // SAFETY: `to` has room for sixteen values, of which four are written. Unaligned stores are allowed.
        fn store(self, to: &mut [u32; MAX_LANES]) = v128_store(to.as_mut_ptr().cast(), self.0);
    }
}
