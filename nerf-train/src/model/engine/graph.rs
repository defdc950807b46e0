//! Graph of the network's layers; forward and backward pass of one layer over one chunk, by the matrix product kernel.
//!
//! Activations are in buffers called slots, `[blocks][channels][BLOCK]`: encoded positions in slot 0, encoded
//! directions in slot 1, outputs of layer `l` in slot `FIRST + l`.

use super::{Dense, Model, ModelError, Part};
use nerf_core::encoding::{SinusoidalEncoding, encode_block};
use nerf_core::math::MathBackend;
use nerf_core::matrix::{Gemm, Init, gemm};
use nerf_core::simd::{BLOCK, Isa};
use std::ops::Range;

pub(super) const POSITION: usize = 0;
pub(super) const DIRECTION: usize = 1;
pub(super) const FIRST: usize = 2;

/// Padding unit, in values, of block lanes and matrix rows: a whole number of vectors in every instruction set.
pub(super) const VECTOR: usize = 16;

pub(super) fn padded(length: usize) -> usize {
    length.next_multiple_of(VECTOR)
}

pub(super) struct Node {
    pub(super) dense: Dense,
    pub(super) main: usize,
    pub(super) extra: usize,
    pub(super) relu: bool,
}

pub(super) struct Graph {
    pub(super) model: Model,
    pub(super) nodes: Vec<Node>,
    pub(super) trunk: Range<usize>,
    pub(super) density: Option<usize>,
    pub(super) colour: Range<usize>,
}

impl Graph {
    pub(super) fn new(model: &Model) -> Result<Self, ModelError> {
        model.check()?;
        let a = &model.architecture;
        if a.position.sinusoidal().is_none() || a.direction.is_some_and(|d| d.sinusoidal().is_none()) {
            return Err(ModelError::NotSinusoidal);
        }
        let layers = model.layers();
        let trunk = 0..model.architecture.trunk.len();
        let density = layers.iter().position(|layer| layer.part == Part::Density);
        let colour = trunk.end + usize::from(density.is_some())..layers.len();
        let trunk_out = FIRST + trunk.end - 1;
        let nodes = layers.iter().enumerate().map(|(l, &dense)| {
            let main = match l {
                0 => POSITION,
                _ if Some(l) == density || l == colour.start => trunk_out,
                _ => FIRST + l - 1,
            };
            let extra = if trunk.contains(&l) { POSITION } else { DIRECTION };
            let relu = matches!(dense.part, Part::Trunk(_) | Part::Colour(_));
            Node { dense, main, extra, relu }
        });
        let nodes = nodes.collect();
        Ok(Self { model: model.clone(), nodes, trunk, density, colour })
    }
}

/// Returns for each block of [`BLOCK`] samples its index and its number of lanes to compute, a multiple of [`VECTOR`].
pub(super) fn blocks(samples: usize) -> impl Iterator<Item = (usize, usize)> {
    let lanes = move |block: usize| padded((samples - block * BLOCK).min(BLOCK));
    (0..samples.div_ceil(BLOCK)).map(move |block| (block, lanes(block)))
}

/// Returns one block, `[channels][BLOCK]`, of an activation buffer with `channels` channels.
pub(super) fn block_of(slot: &[f32], channels: usize, block: usize) -> &[f32] {
    &slot[block * channels * BLOCK..][..channels * BLOCK]
}

pub(super) fn block_of_mut(slot: &mut [f32], channels: usize, block: usize) -> &mut [f32] {
    &mut slot[block * channels * BLOCK..][..channels * BLOCK]
}

impl Node {
    /// Computes the layer's outputs `out`, `[blocks][outputs][BLOCK]`. `parameters`: parameters of all layers; `slots`:
    /// activation buffers, including those of the layer's inputs.
    pub(super) fn forward(
        &self,
        isa: Isa,
        parameters: &[f32],
        slots: &[Vec<f32>],
        out: &mut [f32],
        samples: usize,
    ) {
        let d = &self.dense;
        let (weights, bias) = (&parameters[d.weights..d.bias], &parameters[d.bias..][..d.outputs]);
        let product =
            |n, k| Gemm { m: d.outputs, n, k, a_row: d.inputs(), a_col: 1, b_row: BLOCK, c_row: BLOCK };
        for (block, lanes) in blocks(samples) {
            let y = block_of_mut(out, d.outputs, block);
            let x = block_of(&slots[self.main], d.main, block);
            let whole = d.extra == 0;
            gemm(isa, product(lanes, d.main), weights, x, y, Init::Bias(bias), self.relu && whole);
            if !whole {
                let x = block_of(&slots[self.extra], d.extra, block);
                let weights = &weights[d.main..];
                gemm(isa, product(lanes, d.extra), weights, x, y, Init::Accumulate, self.relu);
            }
        }
    }

    /// Computes the gradient with respect to the main inputs, `W_mainᵀ dy`, `[blocks][main][BLOCK]`. If `accumulate`,
    /// adds the gradient to `dx`; otherwise, overwrites `dx`. `dy`: gradient with respect to the layer's outputs.
    pub(super) fn backward(
        &self,
        isa: Isa,
        parameters: &[f32],
        dy: &[f32],
        dx: &mut [f32],
        accumulate: bool,
        samples: usize,
    ) {
        let d = &self.dense;
        let weights = &parameters[d.weights..d.bias];
        for (block, lanes) in blocks(samples) {
            let product = Gemm {
                m: d.main,
                n: lanes,
                k: d.outputs,
                a_row: 1,
                a_col: d.inputs(),
                b_row: BLOCK,
                c_row: BLOCK,
            };
            let init = if accumulate { Init::Accumulate } else { Init::Zero };
            let (dy, dx) = (block_of(dy, d.outputs, block), block_of_mut(dx, d.main, block));
            gemm(isa, product, weights, dy, dx, init, false);
        }
    }
}

/// Does a ReLU's backward pass: sets `dy` to 0 where the output `y` is 0. Shape of both: `[blocks][channels][BLOCK]`.
pub(super) fn mask_relu(dy: &mut [f32], y: &[f32], channels: usize, samples: usize) {
    let length = samples.div_ceil(BLOCK) * channels * BLOCK;
    for (dy, &y) in dy[..length].iter_mut().zip(&y[..length]) {
        *dy = if y > 0.0 { *dy } else { 0.0 };
    }
}

/// Encodes the first `encoding.inputs` coordinates of up to [`BLOCK`] points into `out`, `[outputs][BLOCK]`. Lanes
/// without a point encode the origin.
pub(super) fn encode_points<'a>(
    isa: Isa,
    encoding: &SinusoidalEncoding,
    points: impl Iterator<Item = &'a [f32; 3]>,
    out: &mut [f32],
) {
    let mut x = [0.0; 3 * BLOCK];
    let inputs = usize::from(encoding.inputs);
    for (lane, point) in points.take(BLOCK).enumerate() {
        for (axis, &coordinate) in point.iter().take(inputs).enumerate() {
            x[axis * BLOCK + lane] = coordinate;
        }
    }
    encode_block(isa, MathBackend::Polynomial, encoding, BLOCK, &x[..inputs * BLOCK], out);
}
