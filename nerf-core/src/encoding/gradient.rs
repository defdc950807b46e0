//! The encoding's derivative, from what the encoding gave.

use super::{AngleScale, Encoding};
use crate::kernels::{Op, Tier};
use crate::math::lanes::Lanes;
use core::f32::consts::PI;

/// Takes a gradient back through the encoding of a block of samples.
///
/// `encoded`: `[outputs][stride]`, from [`encode_block`](super::encode_block). `of_encoded`:
/// `[outputs][stride]`, ∂f/∂encoded. `of_x`: `[inputs][stride]`, becomes ∂f/∂x. `stride` as there.
///
/// `d sin(2^k s x)/dx = 2^k s cos(2^k s x)` and `d cos(2^k s x)/dx = −2^k s sin(2^k s x)`: both are
/// encoded values themselves, so that no angle is computed again.
///
/// # Panics
/// If a slice is shorter than that.
pub(crate) fn encode_gradient_block(
    tier: Tier,
    encoding: &Encoding,
    stride: usize,
    encoded: &[f32],
    of_encoded: &[f32],
    of_x: &mut [f32],
) {
    let outputs = encoding.outputs() * stride;
    assert!(encoded.len() >= outputs && of_encoded.len() >= outputs, "encoding: encoded is too short");
    assert!(of_x.len() >= usize::from(encoding.inputs) * stride, "encoding: of_x is too short");
    tier.run_columns(stride, Gradient { encoding, stride, encoded, of_encoded, of_x });
}

struct Gradient<'a> {
    encoding: &'a Encoding,
    stride: usize,
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
        let s = V::splat(if self.encoding.scale == AngleScale::Pi { PI } else { 1.0 });
        for input in 0..inputs {
            for column in (0..stride).step_by(V::COUNT) {
                let value = |channel: usize| V::load(&self.encoded[channel * stride + column..]);
                let of = |channel: usize| V::load(&self.of_encoded[channel * stride + column..]);
                let (mut of_angle, mut scale) = (V::splat(0.0), 1.0);
                for level in 0..usize::from(self.encoding.levels) {
                    let sin = first_level + (2 * level) * inputs + input;
                    let cos = sin + inputs;
                    let of_level = of(sin).mul(value(cos)).sub(of(cos).mul(value(sin)));
                    of_angle = of_level.mul_add(V::splat(scale), of_angle);
                    scale *= 2.0;
                }
                let of_itself = if self.encoding.identity { of(input) } else { V::splat(0.0) };
                of_angle.mul_add(s, of_itself).store(&mut self.of_x[input * stride + column..]);
            }
        }
    }
}
