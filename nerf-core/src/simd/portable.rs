//! Portable leaf: sixteen lanes of plain, unfused f32.
//!
//! Bit for bit the same as one lane at a time; the compiler vectorises it with the target's instructions.

use crate::simd::{Indices, Lanes};

/// Defines methods of two vectors lane by lane.
macro_rules! by_lane {
    ($of:ident: $($name:ident)+) => {$(
        #[inline(always)]
        fn $name(self, b: Self) -> Self {
            Self(core::array::from_fn(|i| $of::$name(self.0[i], b.0[i])))
        }
    )+};
}

/// Sixteen f32 in an array.
#[derive(Clone, Copy)]
pub struct Portable([f32; 16]);

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
    by_lane!(Lanes: add sub mul div max_of min_of);
    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        self.mul(b).add(c)
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

impl Indices for PortableIndices {
    #[inline(always)]
    fn splat(x: u32) -> Self {
        Self([x; 16])
    }
    by_lane!(Indices: add mul xor and min);
    #[inline(always)]
    fn shift_right_15(self) -> Self {
        Self(self.0.map(|x| x >> 15))
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; 16]) {
        *to = self.0;
    }
}
