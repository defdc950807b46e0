//! Dense layers that read f16 weights directly from the scene file's bytes: for hosts without memory for f32 weights.

use super::{Gemm, Init};
use crate::memory::{at, tail, tail_mut};
use crate::simd::{Isa, Lanes, Op};

/// Computes `C[i][j] = act(init + Σ_p A[i][p] B[p][j])`, where A is little-endian f16 at any alignment. `act` is ReLU
/// if `relu`, else the identity. B and C may have any number `n` of columns: if `n` is no multiple of [`Isa::columns`],
/// all columns are computed one by one with portable instructions. `c_row` must be >= `n`.
///
/// # Panics
/// With debug assertions, if a slice is too short for sizes and strides. Other builds read missing values as 0.
pub fn gemm_f16(isa: Isa, g: Gemm, a: &[u8], b: &[f32], c: &mut [f32], init: Init<'_, u8>, relu: bool) {
    isa.run_columns(g.n, Product { g, a, b, c, init, relu });
}

/// Reads the `i`-th little-endian f16 of `bytes` and converts it to f32. If `bytes` are too short: panics with debug
/// assertions, else returns 0.
#[inline(always)]
pub fn f16_at(bytes: &[u8], i: usize) -> f32 {
    let pair = tail(bytes, 2 * i).first_chunk();
    debug_assert!(pair.is_some(), "expected more than {i} f16, found {} bytes", bytes.len());
    widen(pair.copied().unwrap_or_default())
}

/// Converts a little-endian f16 to f32.
///
/// Gives the same value as the software conversion of the crate `half`, but tests for normal numbers first: nearly all
/// weights are normal, and every multiplication converts a weight.
#[inline(always)]
fn widen(bytes: [u8; 2]) -> f32 {
    /// Difference of the exponent biases of f32 and f16, shifted to the position of an f32's exponent.
    const BIAS: u32 = (127 - 15) << 23;
    let bits = u32::from(u16::from_le_bytes(bytes));
    let (sign, magnitude) = ((bits & 0x8000) << 16, bits & 0x7fff);
    let widened = (magnitude << 13) + BIAS;
    f32::from_bits(
        sign | match magnitude {
            0x0400..0x7c00 => widened,
            // A subnormal f16 has no leading 1: its value is `magnitude` times 2^-24.
            0..0x0400 => (magnitude as f32 * (1.0 / 16_777_216.0)).to_bits(),
            // Infinity or NaN: adding the bias twice gives the largest exponent of f32.
            _ => widened + BIAS,
        },
    )
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
            let weights = tail(self.a, 2 * row * g.a_row).as_chunks().0;
            for col in (0..g.n).step_by(V::COUNT) {
                let to = tail_mut(to, col);
                let mut sum = match self.init {
                    Init::Bias(bias) => V::splat(f16_at(bias, row)),
                    Init::Zero => V::splat(0.0),
                    Init::Accumulate => V::load(to),
                };
                for p in 0..g.k {
                    let weight = V::splat(widen(at(weights, p * g.a_col)));
                    sum = weight.mul_add(V::load(tail(self.b, p * g.b_row + col)), sum);
                }
                let sum = if self.relu { V::splat(0.0).max_of(sum) } else { sum };
                sum.store(to);
            }
        }
    }
}
