//! Sixteen lanes in plain, unfused f32: what the portable instructions are where a block is at hand.
//!
//! Bit for bit what one lane at a time gives; the compiler vectorises it with whatever the target
//! has.

use crate::simd::{Indices, Lanes};

/// Sixteen f32 in an array.
#[derive(Clone, Copy)]
pub struct Portable([f32; 16]);

impl Portable {
    #[inline(always)]
    fn each(self, b: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(core::array::from_fn(|i| f(self.0[i], b.0[i])))
    }
}

impl super::lanes::sealed::Sealed for Portable {}
const _: () = super::lanes::divides::<Portable>();

impl Lanes for Portable {
    const COUNT: usize = 16;
    const TILE_ROWS: usize = 2;
    const TILE_COLS: usize = 1;
    type Mask = [bool; 16];
    type Indices = PortableIndices;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; 16])
    }
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        let from = &from[..16];
        Self(core::array::from_fn(|i| from[i]))
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        to[..16].copy_from_slice(&self.0);
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        self.each(b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        self.each(b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        self.each(b, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        self.each(b, |a, b| a / b)
    }
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        self.mul(b).add(c)
    }
    #[inline(always)]
    fn max_of(self, b: Self) -> Self {
        self.each(b, f32::max_of)
    }
    #[inline(always)]
    fn min_of(self, b: Self) -> Self {
        self.each(b, f32::min_of)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.map(Lanes::sqrt))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.map(Lanes::abs))
    }
    #[inline(always)]
    fn round_even(self) -> Self {
        Self(self.0.map(Lanes::round_even))
    }
    #[inline(always)]
    fn exp2_integer(self) -> Self {
        Self(self.0.map(Lanes::exp2_integer))
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        let parts = self.0.map(Lanes::split_exponent);
        (Self(parts.map(|p| p.0)), Self(parts.map(|p| p.1)))
    }
    #[inline(always)]
    fn equals(self, b: Self) -> [bool; 16] {
        core::array::from_fn(|i| self.0[i] == b.0[i])
    }
    #[inline(always)]
    fn less(self, b: Self) -> [bool; 16] {
        core::array::from_fn(|i| self.0[i] < b.0[i])
    }
    #[inline(always)]
    fn select(mask: [bool; 16], a: Self, b: Self) -> Self {
        Self(core::array::from_fn(|i| if mask[i] { a.0[i] } else { b.0[i] }))
    }
    #[inline(always)]
    fn to_indices(self) -> PortableIndices {
        PortableIndices(self.0.map(|x| x as u32))
    }
}

/// Sixteen u32 in an array.
#[derive(Clone, Copy)]
pub struct PortableIndices([u32; 16]);

impl PortableIndices {
    #[inline(always)]
    fn each(self, b: Self, f: impl Fn(u32, u32) -> u32) -> Self {
        Self(core::array::from_fn(|i| f(self.0[i], b.0[i])))
    }
}

impl Indices for PortableIndices {
    #[inline(always)]
    fn splat(x: u32) -> Self {
        Self([x; 16])
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        self.each(b, u32::wrapping_add)
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        self.each(b, u32::wrapping_mul)
    }
    #[inline(always)]
    fn xor(self, b: Self) -> Self {
        self.each(b, |a, b| a ^ b)
    }
    #[inline(always)]
    fn and(self, b: Self) -> Self {
        self.each(b, |a, b| a & b)
    }
    #[inline(always)]
    fn min(self, b: Self) -> Self {
        self.each(b, Ord::min)
    }
    #[inline(always)]
    fn shift_right_15(self) -> Self {
        Self(self.0.map(|x| x >> 15))
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; 16]) {
        *to = self.0;
    }
}
