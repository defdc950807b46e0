//! Dense layers in bf16 with f32 sums: two multiply-adds per lane and instruction if the CPU has `vdpbf16ps`.
//!
//! Inputs and weights are stored in pairs. A 32-bit word holds the values for input `2q` (low half) and input `2q + 1`
//! (high half). If the number of inputs is odd, the last input is paired with 0. Words are stored as bits in `f32`
//! slices, so that the same workspace serves every format of weights.

use super::Init;
use crate::simd::Isa;
use half::bf16;

/// One of a layer's two groups of inputs (main or appended), and the weights that multiply this group.
#[derive(Clone, Copy, Debug)]
pub struct PairedInput<'a> {
    /// Weights as pairs of bf16: 32-bit words, `[outputs][row]`. Only the first `pairs` words of each row are used.
    pub weights: &'a [f32],
    /// Distance from one row of `weights` to the next, in 32-bit words.
    pub row: usize,
    /// Number of pairs of inputs.
    pub pairs: usize,
    /// Inputs of a block of samples, as pairs of bf16, `[pairs][stride]`.
    pub inputs: &'a [f32],
}

/// Format of a layer's outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PairedOutput {
    /// f32 values, `[outputs][stride]`.
    Floats,
    /// 32-bit words, `[pairs(outputs)][stride]`. Each word holds two successive outputs, rounded to bf16: the input
    /// format of the next layer.
    Pairs,
}

/// Number of pairs that hold `count` values: half of `count`, rounded up.
pub const fn pairs(count: usize) -> usize {
    count.div_ceil(2)
}

/// Packs two values into the 32 bits of one f32, each value rounded to the nearest bf16, ties to even.
#[inline]
pub fn pair(low: f32, high: f32) -> f32 {
    let [low, high] = [low, high].map(|x| u32::from(bf16::from_f32(x).to_bits()));
    f32::from_bits(high << 16 | low)
}

/// Unpacks the two bf16 values in the 32 bits of `word`. Returns the low half, then the high half.
#[inline]
pub fn unpair(word: f32) -> [f32; 2] {
    [f32::from_bits(word.to_bits() << 16), f32::from_bits(word.to_bits() & 0xffff_0000)]
}

/// Converts f32 values, `[rows][stride]`, to pairs of bf16 in place. Row `q` of pairs holds rows `2q` and `2q + 1`. An
/// odd last row is paired with 0.
pub fn pair_rows(values: &mut [f32], rows: usize, stride: usize) {
    for q in 0..pairs(rows) {
        let (low, high) = (2 * q * stride, (2 * q + 1) * stride);
        for column in 0..stride {
            let odd = if 2 * q + 1 < rows { values[high + column] } else { 0.0 };
            // Row `q` of pairs overwrites only values that have been read.
            values[q * stride + column] = pair(values[low + column], odd);
        }
    }
}

/// Computes a layer: `to = act(init + Σ weights inputs)`, summed over the `parts` in order. `act` is ReLU if `relu`,
/// else the identity.
///
/// `parts`: the layer's main and appended inputs, with their weights. `stride`: number of samples, a multiple of 16.
/// With [`Init::Accumulate`], sums start from the f32 values in `to`, `[outputs][stride]`, even if `output` is
/// [`PairedOutput::Pairs`]. Every output is summed pair after pair of inputs, in an order that does not depend on
/// `outputs` or `stride`.
///
/// # Panics
/// If `stride` is no multiple of 16 or a slice is too short.
#[allow(clippy::too_many_arguments, reason = "one layer, described in full")]
pub fn dense_bf16(
    isa: Isa,
    parts: [PairedInput<'_>; 2],
    outputs: usize,
    stride: usize,
    init: Init<'_>,
    to: &mut [f32],
    relu: bool,
    output: PairedOutput,
) {
    if outputs == 0 || stride == 0 {
        return;
    }
    assert!(stride.is_multiple_of(16), "dense_bf16: stride is a multiple of 16");
    for part in parts.iter().filter(|part| part.pairs > 0) {
        let reach = (outputs - 1).checked_mul(part.row).and_then(|start| start.checked_add(part.pairs));
        assert!(reach.is_some_and(|end| part.weights.len() >= end), "dense_bf16: weights are too short");
        let reach = part.pairs.checked_mul(stride);
        assert!(reach.is_some_and(|end| part.inputs.len() >= end), "dense_bf16: inputs are too short");
    }
    let floats = output == PairedOutput::Floats || matches!(init, Init::Accumulate);
    let reach = if floats { outputs } else { pairs(outputs) }.checked_mul(stride);
    assert!(reach.is_some_and(|end| to.len() >= end), "dense_bf16: outputs are too short");
    if let Init::Bias(bias) = init {
        assert!(bias.len() >= outputs, "dense_bf16: bias is too short");
    }
    let layer = Layer { parts, outputs, stride, init, to, relu, output };
    match isa {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `multiplies_bf16` checked that the CPU and the OS support the instructions.
        Isa::Avx512 if isa.multiplies_bf16() => unsafe { layer.avx512() },
        _ => layer.plain(),
    }
}

/// Arguments of [`dense_bf16`], which has checked that every slice is long enough.
struct Layer<'a> {
    parts: [PairedInput<'a>; 2],
    outputs: usize,
    stride: usize,
    init: Init<'a>,
    to: &'a mut [f32],
    relu: bool,
    output: PairedOutput,
}

impl Layer<'_> {
    /// Reference implementation of [`dense_bf16`]: computes one output of one sample at a time.
    fn plain(self) {
        for row in (0..self.outputs).step_by(2) {
            for column in 0..self.stride {
                let low = self.element(row, column);
                let high = if row + 1 < self.outputs { self.element(row + 1, column) } else { 0.0 };
                match self.output {
                    PairedOutput::Pairs => self.to[row / 2 * self.stride + column] = pair(low, high),
                    PairedOutput::Floats => {
                        self.to[row * self.stride + column] = low;
                        if row + 1 < self.outputs {
                            self.to[(row + 1) * self.stride + column] = high;
                        }
                    }
                }
            }
        }
    }

    fn element(&self, row: usize, column: usize) -> f32 {
        let mut sum = match self.init {
            Init::Zero => 0.0,
            Init::Bias(bias) => bias[row],
            Init::Accumulate => self.to[row * self.stride + column],
        };
        for part in &self.parts {
            for q in 0..part.pairs {
                let [w0, w1] = unpair(part.weights[row * part.row + q]);
                let [x0, x1] = unpair(part.inputs[q * self.stride + column]);
                sum += w1 * x1;
                sum += w0 * x0;
            }
        }
        if self.relu && 0.0 > sum { 0.0 } else { sum }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::{Init, Layer, PairedOutput, pairs};
    use core::arch::x86_64::*;

    impl Layer<'_> {
        /// Computes the layer with AVX-512 instructions.
        ///
        /// # Safety
        /// The CPU must have AVX-512 F and AVX-512 BF16, and the OS must save the AVX-512 registers.
        #[target_feature(enable = "avx512f,avx512bf16")]
        pub(super) unsafe fn avx512(mut self) {
            let mut row = 0;
            while row < self.outputs {
                match pairs(self.outputs - row) {
                    1 => self.panel::<1>(row),
                    2 => self.panel::<2>(row),
                    _ => self.panel::<3>(row),
                }
                row += 6;
            }
        }

        /// Computes `2 * PAIRS` rows of outputs from `row` on, tile by tile.
        #[inline]
        #[target_feature(enable = "avx512f,avx512bf16")]
        fn panel<const PAIRS: usize>(&mut self, row: usize) {
            let mut column = 0;
            while column < self.stride {
                if self.stride - column >= 64 {
                    self.tile::<PAIRS, 4>(row, column);
                    column += 64;
                } else {
                    self.tile::<PAIRS, 1>(row, column);
                    column += 16;
                }
            }
        }

        /// Computes one tile: `2 * PAIRS` rows × `COLS` vectors of outputs. The sums stay in registers over all inputs.
        #[inline]
        #[target_feature(enable = "avx512f,avx512bf16")]
        fn tile<const PAIRS: usize, const COLS: usize>(&mut self, row: usize, column: usize) {
            let stride = self.stride;
            // An odd last row is paired with itself; the sums of its second copy are not used.
            let even: [usize; PAIRS] = core::array::from_fn(|i| row + 2 * i);
            let odd = even.map(|even| (even + 1).min(self.outputs - 1));
            let start = |row: usize| match self.init {
                Init::Zero => [_mm512_setzero_ps(); COLS],
                Init::Bias(bias) => [_mm512_set1_ps(bias[row]); COLS],
                Init::Accumulate => core::array::from_fn(|j| {
                    let from = &self.to[row * stride + column + 16 * j..][..16];
                    // SAFETY: `from` has sixteen values.
                    unsafe { _mm512_loadu_ps(from.as_ptr()) }
                }),
            };
            let (mut low, mut high) = (even.map(start), odd.map(start));
            for part in &self.parts {
                let weights = |row: usize| part.weights.as_ptr().wrapping_add(row * part.row);
                let weights = (even.map(weights), odd.map(weights));
                let inputs = part.inputs.as_ptr().wrapping_add(column);
                for q in 0..part.pairs {
                    let mut x = [_mm512_setzero_ps(); COLS];
                    for (j, x) in x.iter_mut().enumerate() {
                        // SAFETY: `dense_bf16` checked that row `q` holds `stride` samples, and this
                        // tile's columns end at or before `stride`.
                        *x = unsafe { _mm512_loadu_ps(inputs.wrapping_add(q * stride + 16 * j)) };
                    }
                    for (sums, weights) in [(&mut low, weights.0), (&mut high, weights.1)] {
                        for (i, sums) in sums.iter_mut().enumerate() {
                            // SAFETY: `dense_bf16` checked that weights reach to the last row's last pair.
                            let weight = _mm512_set1_ps(unsafe { *weights[i].wrapping_add(q) });
                            for (sum, &x) in sums.iter_mut().zip(&x) {
                                *sum = _mm512_dpbf16_ps(*sum, words(x), words(weight));
                            }
                        }
                    }
                }
            }
            for (i, (low, high)) in low.iter().zip(&high).enumerate() {
                for (j, (&low, &high)) in low.iter().zip(high).enumerate() {
                    let (low, high, paired) = (self.act(low), self.act(high), odd[i] > even[i]);
                    let at = |row: usize| row * stride + column + 16 * j;
                    match self.output {
                        PairedOutput::Pairs => {
                            let high = if paired { high } else { _mm512_setzero_ps() };
                            put(&mut self.to[at(even[i] / 2)..], pair(low, high));
                        }
                        PairedOutput::Floats => {
                            put(&mut self.to[at(even[i])..], low);
                            if paired {
                                put(&mut self.to[at(odd[i])..], high);
                            }
                        }
                    }
                }
            }
        }

        /// Applies the ReLU if the layer has one. A NaN stays a NaN.
        #[inline]
        #[target_feature(enable = "avx512f")]
        fn act(&self, sum: __m512) -> __m512 {
            if self.relu { _mm512_max_ps(_mm512_setzero_ps(), sum) } else { sum }
        }
    }

    #[inline]
    #[target_feature(enable = "avx512f")]
    fn words(x: __m512) -> __m512bh {
        // SAFETY: both types have 512 bits, and any bits are valid.
        unsafe { core::mem::transmute(x) }
    }

    /// Packs sixteen pairs of f32 into 32-bit words, each value rounded to bf16; `low` in the low halves.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bf16")]
    fn pair(low: __m512, high: __m512) -> __m512 {
        let half = |x| {
            // SAFETY: both types have 256 bits, and any bits are valid.
            let bits: __m256i = unsafe { core::mem::transmute(_mm512_cvtneps_pbh(x)) };
            _mm512_cvtepu16_epi32(bits)
        };
        _mm512_castsi512_ps(_mm512_or_si512(_mm512_slli_epi32::<16>(half(high)), half(low)))
    }

    #[inline]
    #[target_feature(enable = "avx512f")]
    fn put(to: &mut [f32], x: __m512) {
        let to = &mut to[..16];
        // SAFETY: `to` has sixteen values.
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), x) }
    }
}
