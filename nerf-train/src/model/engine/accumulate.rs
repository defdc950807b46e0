//! Gradients of layer weights: sums over the blocks of a chunk, then over chunks, then over accumulators.

use super::graph::{Node, VECTOR, block_of, blocks, padded};
use nerf_core::matrix::{Gemm, Init, gemm};
use nerf_core::simd::{BLOCK, Isa};
use rayon::prelude::*;

/// Largest number of outputs at which dot products compute a layer's gradient faster than a matrix product does.
const FEW_OUTPUTS: usize = 4;
const ROWS: usize = 32;

/// Gradient of the loss with respect to one layer's parameters, summed over the chunks of one accumulator.
#[derive(Default)]
pub(super) struct LayerSum {
    /// Whether a gradient was added since [`LayerSum::clear`]. If false, the values are stale.
    touched: bool,
    /// Gradient with respect to the weights of the main inputs, `[outputs][padded main]`.
    main: Vec<f32>,
    /// Gradient with respect to weights of extra inputs (encoded position or direction): `[outputs][padded extra]`.
    extra: Vec<f32>,
    bias: Vec<f32>,
}

impl LayerSum {
    /// Marks the sum as empty, without setting its values to 0.
    pub(super) fn clear(&mut self) {
        self.touched = false;
    }

    /// Adds the gradient of a chunk: the product of `dy` and the layer's transposed inputs, `[main, extra, 1]`. `dy`:
    /// gradient with respect to the layer's outputs, `[blocks][outputs][BLOCK]`. `slots`: activation buffers, including
    /// those of the layer's inputs. `transposed`: scratch buffer.
    pub(super) fn add(
        &mut self,
        isa: Isa,
        node: &Node,
        dy: &[f32],
        slots: &[Vec<f32>],
        samples: usize,
        transposed: &mut Vec<f32>,
    ) {
        let d = &node.dense;
        if !self.touched {
            self.main.resize(d.outputs * padded(d.main), 0.0);
            self.extra.resize(d.outputs * padded(d.extra), 0.0);
            self.bias.clear();
            self.bias.resize(d.outputs, 0.0);
        }
        for (block, lanes) in blocks(samples) {
            let dy = block_of(dy, d.outputs, block);
            for (bias, dy) in self.bias.iter_mut().zip(dy.chunks_exact(BLOCK)) {
                *bias += sum(&dy[..lanes], |i| dy[i]);
            }
            let parts = [(&mut self.main, node.main, d.main), (&mut self.extra, node.extra, d.extra)];
            for (gradient, slot, channels) in parts {
                if channels == 0 {
                    continue;
                }
                let x = block_of(&slots[slot], channels, block);
                let columns = padded(channels);
                if d.outputs <= FEW_OUTPUTS {
                    add_dots(gradient, columns, dy, x, lanes, self.touched);
                    continue;
                }
                transpose(x, channels, lanes, transposed);
                let product = Gemm {
                    m: d.outputs,
                    n: columns,
                    k: lanes,
                    a_row: BLOCK,
                    a_col: 1,
                    b_row: columns,
                    c_row: columns,
                };
                let init = if self.touched { Init::Accumulate } else { Init::Zero };
                gemm(isa, product, dy, transposed, gradient, init, false);
            }
            self.touched = true;
        }
    }
}

/// Writes one layer's gradient (weights, then bias) to `gradient`: the total of all `sums`, added in order.
pub(super) fn reduce<'a>(
    node: &Node,
    sums: impl Iterator<Item = &'a LayerSum> + Clone + Sync,
    gradient: &mut [f32],
) {
    let d = &node.dense;
    let (weights, bias) = gradient.split_at_mut(d.inputs() * d.outputs);
    let sums = || sums.clone().filter(|sum| sum.touched);
    weights.par_chunks_mut(d.inputs() * ROWS).enumerate().for_each(|(chunk, rows)| {
        for (row, gradient) in rows.chunks_exact_mut(d.inputs()).enumerate() {
            let row = chunk * ROWS + row;
            let (main, extra) = gradient.split_at_mut(d.main);
            add_all(main, sums().map(|sum| &sum.main[row * padded(d.main)..]));
            add_all(extra, sums().map(|sum| &sum.extra[row * padded(d.extra)..]));
        }
    });
    add_all(bias, sums().map(|sum| &sum.bias[..]));
}

fn add_all<'a>(out: &mut [f32], rows: impl Iterator<Item = &'a [f32]>) {
    out.fill(0.0);
    for row in rows {
        for (out, &value) in out.iter_mut().zip(row) {
            *out += value;
        }
    }
}

/// Computes `gradient[o][i] = Σ_s dy[o][s] x[i][s]` over the first `lanes` samples `s` of a block. If `add`, adds the
/// sum to the old `gradient`. `columns`: length of a row of `gradient`.
fn add_dots(gradient: &mut [f32], columns: usize, dy: &[f32], x: &[f32], lanes: usize, add: bool) {
    for (row, dy) in gradient.chunks_exact_mut(columns).zip(dy.chunks_exact(BLOCK)) {
        for (g, x) in row.iter_mut().zip(x.chunks_exact(BLOCK)) {
            let dot = sum(&x[..lanes], |i| x[i] * dy[i]);
            *g = if add { *g + dot } else { dot };
        }
    }
}

/// Returns the sum of `term(i)` over all lanes `i`, in an order of additions that the compiler can vectorise.
fn sum(lanes: &[f32], term: impl Fn(usize) -> f32) -> f32 {
    let mut partial = [0.0; VECTOR];
    for first in (0..lanes.len()).step_by(VECTOR) {
        for (lane, partial) in partial.iter_mut().enumerate() {
            *partial += term(first + lane);
        }
    }
    for half in [8, 4, 2, 1] {
        for lane in 0..half {
            partial[lane] += partial[lane + half];
        }
    }
    partial[0]
}

/// Transposes `x`, `[channels][BLOCK]`, into `out`, `[lanes][padded channels]`, with zeros in the padding.
fn transpose(x: &[f32], channels: usize, lanes: usize, out: &mut Vec<f32>) {
    let columns = padded(channels);
    out.resize(lanes * columns, 0.0);
    let zeros = [0.0; BLOCK];
    for first in (0..columns).step_by(4) {
        let row = |i: usize| if first + i < channels { &x[(first + i) * BLOCK..][..BLOCK] } else { &zeros };
        let rows = [row(0), row(1), row(2), row(3)];
        for first_lane in (0..lanes).step_by(4) {
            // Four rows at a time: the loop is bound by memory loads, which are faster from few streams.
            let [a, b, c, d] = rows.map(|row| four(row, first_lane));
            for lane in 0..4 {
                let out = &mut out[(first_lane + lane) * columns + first..][..4];
                out.copy_from_slice(&[a[lane], b[lane], c[lane], d[lane]]);
            }
        }
    }
}

fn four(values: &[f32], first: usize) -> [f32; 4] {
    let v = &values[first..][..4];
    [v[0], v[1], v[2], v[3]]
}
