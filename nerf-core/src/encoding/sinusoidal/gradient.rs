//! The derivative of the sinusoidal encoding, computed from the encoded values.

use super::{AngleScale, MAX_LEVELS, SinusoidalEncoding};
use crate::math::polynomial::exp;
use crate::memory::{head, head_mut, tail, tail_mut};
use crate::simd::{Isa, Lanes, Op};
use core::f32::consts::PI;

/// Computes the backward pass through the sinusoidal encoding of a block of samples: the gradient of a function `f`
/// with respect to the positions, from the gradient of `f` with respect to the encoded values.
///
/// `encoded`: `[outputs][stride]`, from [`encode_block`](super::encode_block). `of_encoded`: `[outputs][stride]`,
/// ∂f/∂encoded. `of_x`: `[inputs][stride]`, set to ∂f/∂x. `stride`: number of samples, as for `encode_block`.
///
/// At level `k`, `d sin(2^k s x)/dx = 2^k s cos(2^k s x)` and `d cos(2^k s x)/dx = −2^k s sin(2^k s x)`, where `s` is 1
/// or π ([`AngleScale`]). The sines and cosines are among the encoded values, so that no angle is computed again.
///
/// `blur`: standard deviation, world units, of a Gaussian around each sample. The gradient is averaged over this
/// Gaussian: level `k` is multiplied by `exp(−½ (2^k s blur)²)`. This average is exact only if `f` is linear in the
/// encoded values. If `blur` is 0, nothing is averaged.
///
/// # Source
/// Barron et al. 2021 (mip-NeRF), eq. 13: the encoding's mean over a Gaussian.
///
/// # Panics
/// With debug assertions, if a slice is too short.
pub(crate) fn encode_gradient_block(
    isa: Isa,
    encoding: &SinusoidalEncoding,
    stride: usize,
    encoded: &[f32],
    of_encoded: &[f32],
    blur: f32,
    of_x: &mut [f32],
) {
    let outputs = encoding.outputs() * stride;
    let (encoded, of_encoded) = (head(encoded, outputs), head(of_encoded, outputs));
    let of_x = head_mut(of_x, usize::from(encoding.inputs) * stride);
    let s = if encoding.scale == AngleScale::Pi { PI } else { 1.0 };
    let (mut factors, mut scale) = ([0.0; MAX_LEVELS as usize], 1.0);
    for factor in &mut factors {
        let deviation = scale * s * blur;
        *factor = scale * exp(-0.5 * deviation * deviation);
        scale *= 2.0;
    }
    isa.run_columns(stride, Gradient { encoding, stride, s, factors, encoded, of_encoded, of_x });
}

struct Gradient<'a> {
    encoding: &'a SinusoidalEncoding,
    stride: usize,
    s: f32,
    /// Factor of each level `k` in the derivative: `2^k exp(−½ (2^k s blur)²)`. The common factor `s` is not included.
    factors: [f32; MAX_LEVELS as usize],
    encoded: &'a [f32],
    of_encoded: &'a [f32],
    of_x: &'a mut [f32],
}

impl Op for Gradient<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let (inputs, stride) = (usize::from(self.encoding.inputs), self.stride);
        let first_level = if self.encoding.identity { inputs } else { 0 };
        for input in 0..inputs {
            for column in (0..stride).step_by(V::COUNT) {
                let value = |channel: usize| V::load(tail(self.encoded, channel * stride + column));
                let of = |channel: usize| V::load(tail(self.of_encoded, channel * stride + column));
                let mut of_angle = V::splat(0.0);
                let levels = usize::from(self.encoding.levels);
                for (level, &factor) in self.factors.iter().enumerate().take(levels) {
                    let sin = first_level + (2 * level) * inputs + input;
                    let cos = sin + inputs;
                    let of_level = of(sin).mul(value(cos)).sub(of(cos).mul(value(sin)));
                    of_angle = of_level.mul_add(V::splat(factor), of_angle);
                }
                let of_itself = if self.encoding.identity { of(input) } else { V::splat(0.0) };
                of_angle
                    .mul_add(V::splat(self.s), of_itself)
                    .store(tail_mut(self.of_x, input * stride + column));
            }
        }
    }
}
