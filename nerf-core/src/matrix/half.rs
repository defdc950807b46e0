//! Dense layers that read f16 weights directly from the scene file's bytes: for hosts without memory for f32 weights.

use super::{Gemm, Init};
use crate::memory::{at, head, tail, tail_mut};
use crate::simd::{Isa, Lanes, Op};

/// Computes `C[i][j] = act(init + Σ_p A[i][p] B[p][j])`, where A and biases are finite little-endian f16 at any
/// alignment. `act` is ReLU if `relu`, else the identity. B and C may have any number `n` of columns: if `n` is no
/// multiple of [`Isa::columns`], all columns are computed one by one with portable instructions. `c_row` must be
/// >= `n`.
///
/// # Panics
/// With debug assertions, if a slice is too short for `g`. Without debug assertions, missing values are read as 0.
pub fn gemm_f16(isa: Isa, g: Gemm, a: &[u8], b: &[f32], c: &mut [f32], init: Init<'_, u8>, relu: bool) {
    isa.run_columns(g.n, Product { g, a, b, c, init, relu });
}

/// Reads the `i`-th little-endian f16 of `bytes` and converts it to f32. If `bytes` are too short: panics with debug
/// assertions, else returns 0.
pub fn f16_at(bytes: &[u8], i: usize) -> f32 {
    let pair = tail(bytes, 2 * i).first_chunk();
    debug_assert!(pair.is_some(), "expected more than {i} f16, found {} bytes", bytes.len());
    ::half::f16::from_le_bytes(pair.copied().unwrap_or_default()).to_f32()
}

/// Converts a finite little-endian f16 to f32. Takes few instructions, since a matrix product converts one weight per
/// multiplication. In a floating-point mode that reads subnormal f32 as 0, a subnormal f16 becomes 0, too.
#[inline(always)]
fn widen(bytes: [u8; 2]) -> f32 {
    /// Scale factor `2^(127 − 15)`: f32 has the exponent bias 127, f16 has 15.
    const SCALE: f32 = f32::from_bits((127 + 127 - 15) << 23);
    // The shift by 13 aligns the mantissas. The mask clears the three upper exponent bits, which sign extension fills.
    let bits = i32::from(i16::from_le_bytes(bytes)) << 13;
    f32::from_bits(bits as u32 & 0x8fff_ffff) * SCALE
}

struct Product<'a> {
    g: Gemm,
    a: &'a [u8],
    b: &'a [f32],
    c: &'a mut [f32],
    init: Init<'a, u8>,
    relu: bool,
}

impl Op for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let g = &self.g;
        for (row, to) in self.c.chunks_mut(g.c_row.max(1)).take(g.m).enumerate() {
            let weights: &[[u8; 2]] = tail(self.a, 2 * row * g.a_row).as_chunks().0;
            for col in (0..g.n).step_by(V::COUNT) {
                let to = tail_mut(to, col);
                let mut sum = match self.init {
                    Init::Bias(bias) => V::splat(widen(at(bias.as_chunks().0, row))),
                    Init::Zero => V::splat(0.0),
                    Init::Accumulate => V::load(to),
                };
                let inputs = tail(self.b, col);
                let mut add = |weight, x| sum = V::splat(widen(weight)).mul_add(x, sum);
                if V::COUNT == 1 && g.a_col == 1 && g.b_row == 1 {
                    // Without strides: half the instructions on a microcontroller.
                    let (weights, inputs) = (head(weights, g.k), head(inputs, g.k));
                    weights.iter().zip(inputs).for_each(|(&weight, &x)| add(weight, V::splat(x)));
                } else {
                    for p in 0..g.k {
                        add(at(weights, p * g.a_col), V::load(tail(inputs, p * g.b_row)));
                    }
                }
                let sum = if self.relu { V::splat(0.0).max_of(sum) } else { sum };
                sum.store(to);
            }
        }
    }
}
