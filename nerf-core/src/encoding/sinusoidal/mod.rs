//! Sinusoidal positional encoding.

use crate::math::recurrence::double;
use crate::math::{Math, MathBackend, with_encoding_math};
use crate::memory::{head, head_mut, tail, tail_mut};
use crate::simd::{Isa, Lanes, Op};
use core::marker::PhantomData;
use serde::{Deserialize, Serialize};

#[cfg(feature = "normals")]
mod gradient;

#[cfg(test)]
mod tests;

#[cfg(feature = "normals")]
pub(crate) use gradient::encode_gradient_block;

/// Maximum number of levels of a sinusoidal encoding.
pub const MAX_LEVELS: u8 = 16;

/// Angle scale of a sinusoidal encoding: the factor `s` in `sin(2^k s x)`, where `k` is the level and `x` an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum AngleScale {
    /// `s = 1`, as in the code of the NeRF paper's authors and in nerf-pytorch.
    One,
    /// `s = π`, as in the NeRF paper's formula and in this project's own networks.
    Pi,
}

/// The sinusoidal encoding of a position or a direction.
///
/// Order of the outputs: `[inputs,] then per level k: sin(2^k s x) for all inputs, cos(2^k s x) for all inputs`
///
/// # Source
/// Mildenhall et al. 2020, eq. 4, in the order of the authors' code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SinusoidalEncoding {
    /// Number of inputs: 3 for a position or a direction, 2 for a point of an image.
    pub inputs: u8,
    /// Number of levels, at most [`MAX_LEVELS`]; level `k` has the frequency `2^k`.
    pub levels: u8,
    /// The factor `s` in `sin(2^k s x)`.
    pub scale: AngleScale,
    /// Whether the outputs begin with the inputs themselves, in front of the sines and cosines.
    pub identity: bool,
}

impl SinusoidalEncoding {
    /// Number of encoded values of a position or direction.
    ///
    /// ```
    /// use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
    /// let position = SinusoidalEncoding { inputs: 3, levels: 10, scale: AngleScale::Pi, identity: true };
    /// assert_eq!(position.outputs(), 63);
    /// ```
    pub const fn outputs(&self) -> usize {
        self.inputs as usize * (self.identity as usize + 2 * self.levels as usize)
    }
}

/// Computes the sinusoidal encoding of a block of samples.
///
/// `x`: `[inputs][stride]`; `out`: `[outputs][stride]`. `stride`: number of samples. If `stride` is not a multiple of
/// [`Isa::columns`], samples are encoded one by one.
///
/// # Accuracy
/// With [`MathBackend::Polynomial`], absolute error of at most 1.2e-7 at every level. If `s = π`, `2^k x` is exact and
/// is reduced modulo 2 before it is multiplied by π. If `s = 1`, the bound holds only for `|2^k x| <= 1e5`.
///
/// # Panics
/// With debug assertions, if a slice is too short.
pub fn encode_block(
    isa: Isa,
    math: MathBackend,
    encoding: &SinusoidalEncoding,
    stride: usize,
    x: &[f32],
    out: &mut [f32],
) {
    let x = head(x, usize::from(encoding.inputs) * stride);
    let out = head_mut(out, encoding.outputs() * stride);
    with_encoding_math!(math, M => isa.run_columns(stride, Encode::<M> { encoding, stride, x, out, math: PhantomData }));
}

struct Encode<'a, M> {
    encoding: &'a SinusoidalEncoding,
    stride: usize,
    x: &'a [f32],
    out: &'a mut [f32],
    math: PhantomData<M>,
}

impl<M: Math> Op for Encode<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let (inputs, stride) = (usize::from(self.encoding.inputs), self.stride);
        let first_level = if self.encoding.identity { inputs } else { 0 };
        let pi = self.encoding.scale == AngleScale::Pi;
        for input in 0..inputs {
            for column in (0..stride).step_by(V::COUNT) {
                let x = V::load(tail(self.x, input * stride + column));
                let mut put = |channel: usize, v: V| v.store(tail_mut(self.out, channel * stride + column));
                if self.encoding.identity {
                    put(input, x);
                }
                let (mut sin, mut cos) = (x, x);
                let mut scale = 1.0;
                for level in 0..usize::from(self.encoding.levels) {
                    if level > 0 && M::DOUBLING {
                        (sin, cos) = double(sin, cos);
                    } else {
                        let u = x.mul(V::splat(scale)); // a power of two: exact
                        (sin, cos) = if pi { M::sin_cos_pi(u) } else { M::sin_cos(u) };
                    }
                    put(first_level + (2 * level) * inputs + input, sin);
                    put(first_level + (2 * level + 1) * inputs + input, cos);
                    scale *= 2.0;
                }
            }
        }
    }
}
