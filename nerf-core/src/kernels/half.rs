//! Dense layers whose f16 weights are read where they lie: the scalar tier and microcontrollers.

use super::{Gemm, Op, Tier};
use crate::math::lanes::Lanes;
use half::f16;

/// As [`super::gemm`] on the scalar tier, with A as little-endian f16 at any alignment, and any
/// number of columns.
///
/// # Panics
/// If a slice is shorter than sizes and strides say.
pub fn gemm_f16(g: Gemm, a: &[u8], b: &[f32], c: &mut [f32], init: HalfInit<'_>, relu: bool) {
    Tier::Scalar.run_columns(g.n, Product { g, a, b, c, init, relu });
}

/// As [`super::Init`], with the bias as little-endian f16.
#[derive(Clone, Copy, Debug)]
pub enum HalfInit<'a> {
    /// `bias[i]` in the whole row `i`; `[2 m]` bytes.
    Bias(&'a [u8]),
    /// 0.
    Zero,
    /// What C holds.
    Accumulate,
}

/// The `i`-th little-endian f16 of `bytes`.
#[inline(always)]
pub fn f16_at(bytes: &[u8], i: usize) -> f32 {
    f16::from_bits(u16::from_le_bytes([bytes[2 * i], bytes[2 * i + 1]])).to_f32()
}

struct Product<'a> {
    g: Gemm,
    a: &'a [u8],
    b: &'a [f32],
    c: &'a mut [f32],
    init: HalfInit<'a>,
    relu: bool,
}

impl Op for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let g = &self.g;
        for row in 0..g.m {
            for col in (0..g.n).step_by(V::COUNT) {
                let to = &mut self.c[row * g.c_row + col..];
                let mut sum = match self.init {
                    HalfInit::Bias(bias) => V::splat(f16_at(bias, row)),
                    HalfInit::Zero => V::splat(0.0),
                    HalfInit::Accumulate => V::load(to),
                };
                for p in 0..g.k {
                    let weight = V::splat(f16_at(self.a, row * g.a_row + p * g.a_col));
                    sum = weight.mul_add(V::load(&self.b[p * g.b_row + col..]), sum);
                }
                let sum = if self.relu { V::splat(0.0).max_of(sum) } else { sum };
                sum.store(to);
            }
        }
    }
}
