//! Products with the transpose of a weight matrix that is stored in pairs of bf16: the backward pass through a layer.

use super::bf16::{pairs, unpair};
use crate::simd::{Isa, Lanes, Op};

/// Computes `to = start + Wᵀ from` in f32. W is the matrix `weights` of a layer, stored as pairs of bf16.
///
/// `weights`: 32-bit words, `[outputs][row]`; only the first `pairs(inputs)` words of each row are used. `from`: f32,
/// `[outputs][stride]`. `to`: f32, `[inputs][stride]`. `start` is the content of `to` if `accumulate`, else 0.
/// `stride`: number of samples, a multiple of 16. Each element of `to` is summed over the outputs in ascending order.
///
/// # Panics
/// If `stride` is no multiple of 16 or a slice is too short.
#[allow(clippy::too_many_arguments, reason = "one product, described in full")]
pub fn transposed_bf16(
    isa: Isa,
    weights: &[f32],
    row: usize,
    [outputs, inputs]: [usize; 2],
    stride: usize,
    from: &[f32],
    to: &mut [f32],
    accumulate: bool,
) {
    assert!(stride.is_multiple_of(16), "transposed_bf16: stride is a multiple of 16");
    isa.run(Transposed { weights, row, outputs, inputs, stride, from, to, accumulate });
}

struct Transposed<'a> {
    weights: &'a [f32],
    row: usize,
    outputs: usize,
    inputs: usize,
    stride: usize,
    from: &'a [f32],
    to: &'a mut [f32],
    accumulate: bool,
}

impl Op for Transposed<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(mut self) {
        for pair in 0..pairs(self.inputs) {
            let mut column = 0;
            while column < self.stride {
                if self.stride - column >= 4 * V::COUNT {
                    self.tile::<V, 4>(pair, column);
                    column += 4 * V::COUNT;
                } else {
                    self.tile::<V, 1>(pair, column);
                    column += V::COUNT;
                }
            }
        }
    }
}

impl Transposed<'_> {
    /// Computes one tile: two rows × `COLS` vectors of `to`. The sums stay in registers over all outputs of the layer.
    #[inline(always)]
    fn tile<V: Lanes, const COLS: usize>(&mut self, pair: usize, column: usize) {
        let stride = self.stride;
        // An odd last row has no partner: the upper halves of its words are 0.
        let rows = [2 * pair, 2 * pair + 1].map(|row| (row < self.inputs).then_some(row * stride + column));
        let mut sums = [[V::splat(0.0); COLS]; 2];
        for (sums, row) in sums.iter_mut().zip(rows) {
            let Some(row) = row.filter(|_| self.accumulate) else { continue };
            for (j, sum) in sums.iter_mut().enumerate() {
                *sum = V::load(&self.to[row + j * V::COUNT..]);
            }
        }
        for output in 0..self.outputs {
            let weights = unpair(self.weights[output * self.row + pair]).map(V::splat);
            for j in 0..COLS {
                let from = V::load(&self.from[output * stride + column + j * V::COUNT..]);
                for (sums, weight) in sums.iter_mut().zip(weights) {
                    sums[j] = weight.mul_add(from, sums[j]);
                }
            }
        }
        for (sums, row) in sums.iter().zip(rows) {
            let Some(row) = row else { continue };
            for (j, sum) in sums.iter().enumerate() {
                sum.store(&mut self.to[row + j * V::COUNT..]);
            }
        }
    }
}
