//! Portable implementation of the vector traits [`Lanes`] and [`Indices`]: sixteen lanes, without fused multiply-adds.
//!
//! Results equal those of the one-lane vector `f32` bit for bit. The compiler vectorises the loops over lanes.

use super::{Indices, Lanes};

/// Returns `[f(0), …, f(15)]`. Replaces [`core::array::from_fn`], which is not always inlined: only inlined code is
/// compiled for the instruction set of [`run_portable`](super::Isa::run_portable).
#[inline(always)]
fn from_fn<T: Copy + Default>(f: impl Fn(usize) -> T) -> [T; 16] {
    let mut values = [T::default(); 16];
    for (i, value) in values.iter_mut().enumerate() {
        *value = f(i);
    }
    values
}

#[derive(Clone, Copy)]
pub struct Portable([f32; 16]);

impl super::sealed::Sealed for Portable {}

impl Lanes for Portable {
    const COUNT: usize = 16;
    const TILE_ROWS: usize = 2;
    const TILE_COLS: usize = 1;
    type Mask = [bool; 16];
    type Indices = PortableIndices;

    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        let from = &from[..16];
        Self(from_fn(|i| from[i]))
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        let parts = from_fn(|i| self.0[i].split_exponent());
        (Self(from_fn(|i| parts[i].0)), Self(from_fn(|i| parts[i].1)))
    }
    methods! {
        fn splat(x: f32) -> Self = Self([x; 16]);
        fn store(self, to: &mut [f32]) = to[..16].copy_from_slice(&self.0);
        fn add(self, b: Self) -> Self = Self(from_fn(|i| self.0[i] + b.0[i]));
        fn sub(self, b: Self) -> Self = Self(from_fn(|i| self.0[i] - b.0[i]));
        fn mul(self, b: Self) -> Self = Self(from_fn(|i| self.0[i] * b.0[i]));
        fn div(self, b: Self) -> Self = Self(from_fn(|i| self.0[i] / b.0[i]));
        fn mul_add(self, b: Self, c: Self) -> Self = self.mul(b).add(c);
        fn max_of(self, b: Self) -> Self = Self(from_fn(|i| self.0[i].max_of(b.0[i])));
        fn min_of(self, b: Self) -> Self = Self(from_fn(|i| self.0[i].min_of(b.0[i])));
        fn sqrt(self) -> Self = Self(from_fn(|i| self.0[i].sqrt()));
        fn abs(self) -> Self = Self(from_fn(|i| self.0[i].abs()));
        fn round_even(self) -> Self = Self(from_fn(|i| self.0[i].round_even()));
        fn exp2_integer(self) -> Self = Self(from_fn(|i| self.0[i].exp2_integer()));
        fn equals(self, b: Self) -> [bool; 16] = from_fn(|i| self.0[i] == b.0[i]);
        fn less(self, b: Self) -> [bool; 16] = from_fn(|i| self.0[i] < b.0[i]);
        fn select(mask: [bool; 16], a: Self, b: Self) -> Self =
            Self(from_fn(|i| if mask[i] { a.0[i] } else { b.0[i] }));
        fn to_indices(self) -> PortableIndices = PortableIndices(from_fn(|i| self.0[i] as u32));
    }
}

#[derive(Clone, Copy)]
pub struct PortableIndices([u32; 16]);

impl Indices for PortableIndices {
    methods! {
        fn splat(x: u32) -> Self = Self([x; 16]);
        fn add(self, b: Self) -> Self = Self(from_fn(|i| self.0[i].wrapping_add(b.0[i])));
        fn mul(self, b: Self) -> Self = Self(from_fn(|i| self.0[i].wrapping_mul(b.0[i])));
        fn xor(self, b: Self) -> Self = Self(from_fn(|i| self.0[i] ^ b.0[i]));
        fn and(self, b: Self) -> Self = Self(from_fn(|i| self.0[i] & b.0[i]));
        fn min(self, b: Self) -> Self = Self(from_fn(|i| Ord::min(self.0[i], b.0[i])));
        fn shift_right_15(self) -> Self = Self(from_fn(|i| self.0[i] >> 15));
        fn store(self, to: &mut [u32; 16]) = *to = self.0;
    }
}
