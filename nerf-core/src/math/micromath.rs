//! The `micromath` crate, lane by lane.

use super::{Math, sin_cos_of_reduced};
use crate::simd::Lanes;
use micromath::F32Ext;

/// See [`super::MathBackend::Micromath`]. It has no expm1, and its power is off by 0.14 on the sRGB curve.
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
        let e = V::splat(-87.0).max_of(V::splat(88.0).min_of(x)).map(F32Ext::exp);
        // The crate turns a NaN into a number, which would then not be counted as an invalid sample.
        V::select(x.equals(x), e, x)
    }
    /// `exp` by `expm1`: with the crate's own rough one the weights of a ray would add up to more than 1.
    #[inline(always)]
    fn decay<V: Lanes>(x: V) -> V {
        V::splat(1.0).add(Self::expm1(x.neg()))
    }
    #[inline(always)]
    fn softplus<V: Lanes>(x: V) -> V {
        V::splat(0.0).max_of(x).add(Self::exp(x.abs().neg()).map(|e| F32Ext::ln(1.0 + e)))
    }
}
