//! The gradient of the raw density with respect to the position: a forward and a backward pass through the trunk.
//!
//! ```text
//! ∂raw/∂h = w of the density head ─► ReLU: 0 where the unit was off ─► Wᵀ … ─► ∂raw/∂PE(x) ─► ∂raw/∂x
//!                                                                    └── through each skip layer ───┘
//! ```
//!
//! Sigma is the density: the activation's value at the raw density. The derivative of every activation is at least 0.
//! Where the derivative is above 0, the gradient of sigma has the direction of the raw density's gradient. Where the
//! derivative is 0, the gradient of sigma is 0, and the raw density's gradient may have any value.

use super::architecture::{Layer, Role};
use super::view::{Network, Scratch};
use super::weights::Weights;
use crate::encoding::{PositionEncoding, encode_gradient_block};
use crate::math::MathBackend;
use crate::matrix::{Gemm, Init, f16_at, gemm, gemm_f16, pairs, transposed_bf16, unpair};
use crate::memory::{head, head_mut, tail, tail_mut};
use core::ops::Range;

#[cfg(test)]
mod tests;

/// Number of bits of the ReLU mask in one word of [`GradientScratch::signs`].
const SIGNS: usize = 16;

/// Memory that the backward pass of one block of samples needs in addition to [`Scratch`].
#[derive(Debug)]
pub struct GradientScratch<'w> {
    /// ReLU mask of the trunk: for each output of each trunk layer, one bit per sample, set if the output is above 0.
    /// Length: [`Network::sign_words`].
    pub signs: &'w mut [u16],
    /// Gradient of the raw density with respect to the encoded position, `[gradient_rows][stride]`.
    pub encoded: &'w mut [f32],
}

impl Network<'_> {
    /// Length of [`GradientScratch::signs`], the ReLU mask, for blocks of up to `samples` samples, in 16-bit words.
    pub fn sign_words(&self, samples: usize) -> usize {
        self.trunk_layers().map(|layer| sign_words(layer, samples)).sum()
    }

    /// Number of rows of [`GradientScratch::encoded`]: one for each value of the encoded position.
    pub fn gradient_rows(&self) -> usize {
        self.architecture.position.outputs()
    }

    /// Computes the gradient ∂raw_sigma/∂x at each sample of a block; 0 in a 2D field, which has no density.
    ///
    /// `positions`: `[3][stride]`, inside the scene box. `gradient`: `[3][stride]`, 1/world unit². In a 2D field,
    /// `positions` and `gradient` have 2 rows. The contents of `scratch` and `memory` are overwritten.
    ///
    /// `blur`: standard deviation, world units, of a Gaussian around each sample; 0 for no blur. The gradient is
    /// averaged over this Gaussian: the encoding is averaged, and the layers after the encoding are treated as linear.
    /// The blur damps the finer levels of the encoding.
    ///
    /// A grid's interpolation is differentiated inside the sample's cell. A face between two cells belongs to the cell
    /// with the larger index.
    ///
    /// The derivative of the ReLU at 0 is 0. A forward pass in the kernel's own arithmetic determines which outputs of
    /// the ReLU are above 0. The backward pass computes in f32, from weights in their stored precision.
    ///
    /// # Panics
    /// If a slice is shorter than its rows times [`Scratch::stride`]; see [`Network::trunk`].
    pub fn gradient(
        &self,
        math: MathBackend,
        scratch: &mut Scratch<'_>,
        memory: &mut GradientScratch<'_>,
        positions: &[f32],
        blur: f32,
        gradient: &mut [f32],
    ) {
        let stride = scratch.stride;
        let encoding = &self.architecture.position;
        let inputs = usize::from(encoding.inputs());
        let Some(head) = self.layers.iter().find(|layer| layer.role == Role::Density) else {
            head_mut(gradient, inputs * stride).fill(0.0);
            return;
        };
        if self.trunk_layers().next().is_none() {
            for (row, of_h) in memory.encoded.chunks_exact_mut(stride.max(1)).take(head.main).enumerate() {
                of_h.fill(self.weight(head, row));
            }
            return self.gradient_of_position(scratch, memory, positions, blur, gradient);
        }
        let mut end = 0;
        let paired = matches!(self.weights(), Weights::Paired(_));
        self.trunk_with(math, scratch, positions, |layer, outputs| {
            let signs = head_mut(tail_mut(memory.signs, end), sign_words(layer, stride));
            record(signs, outputs, layer.outputs, stride, paired);
            end += signs.len();
        });
        if paired && encoding.sinusoidal().is_some() {
            // The trunk converted the encoded values to pairs of bf16; the derivative needs them in f32.
            self.encode_position(math, stride, positions, scratch.encoded);
        }
        for (row, of_h) in scratch.front.chunks_exact_mut(stride.max(1)).take(head.main).enumerate() {
            of_h.fill(self.weight(head, row));
        }
        head_mut(memory.encoded, encoding.outputs() * stride).fill(0.0);
        for layer in self.trunk_layers().rev() {
            end -= sign_words(layer, stride);
            mask(head_mut(scratch.front, layer.outputs * stride), tail(memory.signs, end));
            let from = &*scratch.front;
            if layer.role == Role::Trunk(0) {
                self.back(layer, 0..layer.main, stride, from, memory.encoded, true);
                break;
            }
            if layer.extra > 0 {
                self.back(layer, layer.main..layer.inputs(), stride, from, memory.encoded, true);
            }
            self.back(layer, 0..layer.main, stride, from, scratch.back, false);
            core::mem::swap(&mut scratch.front, &mut scratch.back);
        }
        self.gradient_of_position(scratch, memory, positions, blur, gradient);
    }

    /// Computes ∂raw/∂x, into `gradient`, from ∂raw/∂PE(x) in `memory.encoded`. With a sinusoidal encoding,
    /// `scratch.encoded` must hold the encoded positions PE(x) as f32.
    fn gradient_of_position(
        &self,
        scratch: &Scratch<'_>,
        memory: &GradientScratch<'_>,
        positions: &[f32],
        blur: f32,
        gradient: &mut [f32],
    ) {
        let stride = scratch.stride;
        match &self.architecture.position {
            PositionEncoding::Sinusoidal(encoding) => {
                let (encoded, of_encoded) = (&*scratch.encoded, &*memory.encoded);
                encode_gradient_block(self.isa, encoding, stride, encoded, of_encoded, blur, gradient);
            }
            PositionEncoding::Grid(grid) => {
                grid.gradient(&self.tables, self.isa, stride, positions, memory.encoded, blur, gradient);
            }
        }
    }

    fn trunk_layers(&self) -> impl DoubleEndedIterator<Item = &Layer> {
        self.layers.iter().filter(|layer| matches!(layer.role, Role::Trunk(_)))
    }

    /// Returns weight `i` of the density head `layer`, which has one output and no appended inputs.
    fn weight(&self, layer: &Layer, i: usize) -> f32 {
        match self.weights() {
            Weights::Prepared(parameters) | Weights::Transposed(parameters) => parameters[layer.weights + i],
            Weights::InPlace(bytes) => f16_at(bytes, layer.weights + i),
            Weights::Paired(words) => unpair(words[layer.weights + i / 2])[i % 2],
        }
    }

    /// Computes the backward pass through a layer, for either its main inputs or its appended inputs:
    /// `to = start + Wᵀ from`. W holds the columns `inputs` of the layer's weights, which multiply the chosen inputs.
    ///
    /// `from`: gradient with respect to the layer's outputs before the ReLU, `[outputs][stride]`. `to`: gradient with
    /// respect to the chosen inputs, `[inputs][stride]`. `start` is the content of `to` if `accumulate`, else 0.
    fn back(
        &self,
        layer: &Layer,
        inputs: Range<usize>,
        stride: usize,
        from: &[f32],
        to: &mut [f32],
        accumulate: bool,
    ) {
        let (m, k, a_col) = (inputs.len(), layer.outputs, layer.inputs());
        let g = Gemm { m, n: stride, k, a_row: 1, a_col, b_row: stride, c_row: stride };
        let at = layer.weights + inputs.start;
        match self.weights() {
            Weights::Prepared(parameters) | Weights::Transposed(parameters) => {
                let init = Init::zero_unless(accumulate);
                gemm(self.isa, g, &parameters[at..], from, to, init, false);
            }
            Weights::InPlace(bytes) => {
                let init = Init::zero_unless(accumulate);
                gemm_f16(self.isa, g, tail(bytes, 2 * at), from, to, init, false);
            }
            Weights::Paired(words) => {
                let row = pairs(layer.main) + pairs(layer.extra);
                let first = if inputs.start == 0 { 0 } else { pairs(layer.main) };
                let weights = &words[layer.weights + first..];
                transposed_bf16(self.isa, weights, row, [k, m], stride, from, to, accumulate);
            }
        }
    }
}

/// Number of words of [`SIGNS`] bits in the ReLU mask of a layer: one bit per output and sample, for `samples` samples.
fn sign_words(layer: &Layer, samples: usize) -> usize {
    (layer.outputs * samples).div_ceil(SIGNS)
}

/// Writes the ReLU mask of a layer to `signs`: for each output, one bit per sample, set if the output is above 0.
///
/// `outputs`: the layer's `rows` outputs after the ReLU. If not `paired`: f32, `[rows][stride]`. If `paired`: pairs of
/// bf16, `[⌈rows / 2⌉][stride]`, each in the bits of one f32. Row `q` then holds outputs `2q` and `2q + 1` of each
/// sample, and `stride` is a multiple of [`SIGNS`].
fn record(signs: &mut [u16], outputs: &[f32], rows: usize, stride: usize, paired: bool) {
    if !paired {
        for (sign, outputs) in signs.iter_mut().zip(head(outputs, rows * stride).chunks(SIGNS)) {
            *sign = word(outputs, |x| x);
        }
        return;
    }
    for (row, signs) in signs.chunks_exact_mut(stride / SIGNS).enumerate() {
        let outputs = &outputs[row / 2 * stride..][..stride];
        for (sign, outputs) in signs.iter_mut().zip(outputs.chunks(SIGNS)) {
            *sign = word(outputs, |pair| unpair(pair)[row % 2]);
        }
    }
}

/// Packs the signs of up to [`SIGNS`] outputs in a word: bit `i` is set if `value(outputs[i])` is above 0. `value`
/// extracts the number to test from a stored f32, which may hold a pair of bf16.
#[inline]
fn word(outputs: &[f32], value: impl Fn(f32) -> f32) -> u16 {
    outputs.iter().enumerate().fold(0, |word, (i, &x)| word | u16::from(value(x) > 0.0) << i)
}

/// Backward pass through a ReLU: sets each gradient in `values` to 0 if its bit in the ReLU mask `signs` is 0.
fn mask(values: &mut [f32], signs: &[u16]) {
    for (values, &signs) in values.chunks_mut(SIGNS).zip(signs) {
        for (i, value) in values.iter_mut().enumerate() {
            *value = if signs >> i & 1 == 1 { *value } else { 0.0 };
        }
    }
}
