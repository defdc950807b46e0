//! Evaluation of one elementary function over a slice, for tests and benchmarks of the maths backends.

use super::{Math, MathBackend, with_math};
use crate::simd::{Isa, Lanes, Op};
use core::marker::PhantomData;

/// One of the elementary functions of [`Math`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Elementary {
    /// `sin πx` for finite `x`, as in the sinusoidal encoding of scale π.
    SinPi,
    /// `cos πx` for finite `x`.
    CosPi,
    /// `sin x` for `|x| <= 1e5`, as in the sinusoidal encoding of scale 1.
    Sin,
    /// `cos x` for `|x| <= 1e5`.
    Cos,
    /// `e^x`, with `x` clamped to `[-87, 88]`.
    Exp,
    /// `e^x − 1`, with `x` clamped to `[-87, 88]`.
    Expm1,
    /// `e^−x`, the transmittance at optical thickness `x`.
    Decay,
    /// `ln(1 + e^x)`.
    Softplus,
    /// `1 / (1 + e^−x)`.
    Sigmoid,
}

impl Elementary {
    /// Applies the function to each `x[i]` and writes the result to `out[i]`, with backend `math` and instruction set
    /// `isa`. Values after the last whole group of 16 are computed one by one. Values of `out` beyond the length of `x`
    /// are left unchanged.
    pub fn apply(self, isa: Isa, math: MathBackend, x: &[f32], out: &mut [f32]) {
        let whole = x.len().min(out.len()) / 16 * 16;
        let ((x, rest), (out, rest_out)) = (x.split_at(whole), out.split_at_mut(whole));
        with_math!(math, M => {
            isa.run(Apply::<M> { function: self, x, out, math: PhantomData });
            Apply::<M> { function: self, x: rest, out: rest_out, math: PhantomData }.run::<f32>();
        });
    }
}

struct Apply<'a, M> {
    function: Elementary,
    x: &'a [f32],
    out: &'a mut [f32],
    math: PhantomData<M>,
}

impl<M: Math> Op for Apply<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        for (x, out) in self.x.chunks_exact(V::COUNT).zip(self.out.chunks_exact_mut(V::COUNT)) {
            let x = V::load(x);
            let y = match self.function {
                Elementary::SinPi => M::sin_cos_pi(x).0,
                Elementary::CosPi => M::sin_cos_pi(x).1,
                Elementary::Sin => M::sin_cos(x).0,
                Elementary::Cos => M::sin_cos(x).1,
                Elementary::Exp => M::exp(x),
                Elementary::Expm1 => M::expm1(x),
                Elementary::Decay => M::decay(x),
                Elementary::Softplus => M::softplus(x),
                Elementary::Sigmoid => M::sigmoid(x),
            };
            y.store(out);
        }
    }
}
