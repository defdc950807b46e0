//! Maths backend that calls the `micromath` crate, separately for each SIMD lane.

use super::{Math, polynomial::clamp_exp, sin_cos_of_reduced};
use crate::simd::Lanes;
use micromath::F32Ext;

/// The functions of [`super::MathBackend::Micromath`]. `expm1` and `pow` are the project's own polynomials. The crate
/// `micromath` has no `expm1`. Its power function is too inexact: sRGB colours, 0 to 1, would be decoded with errors of
/// up to 0.14.
pub struct Micromath;

impl Math for Micromath {
    #[inline(always)]
    fn sin_cos_pi<V: Lanes>(u: V) -> (V, V) {
        sin_cos_of_reduced::<Self, V>(u)
    }
    #[inline(always)]
    fn sin_cos<V: Lanes>(x: V) -> (V, V) {
        (x.map(F32Ext::sin), x.map(F32Ext::cos))
    }
    #[inline(always)]
    fn exp<V: Lanes>(x: V) -> V {
        let e = clamp_exp(x).map(F32Ext::exp);
        // A NaN stays a NaN, since the renderer counts invalid samples. For NaN, the crate's `exp` returns a number.
        V::select(x.equals(x), e, x)
    }
    /// Computes `e^−x` as `1 + expm1(−x)`: with `micromath`'s inexact `exp`, a ray's weights would add up to over 1.
    #[inline(always)]
    fn decay<V: Lanes>(x: V) -> V {
        V::splat(1.0).add(Self::expm1(x.neg()))
    }
    #[inline(always)]
    fn softplus<V: Lanes>(x: V) -> V {
        V::splat(0.0).max_of(x).add(Self::exp(x.abs().neg()).map(|e| F32Ext::ln(1.0 + e)))
    }
}
