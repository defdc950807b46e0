//! Maths backend that calls the `libm` crate, separately for each SIMD lane.

use super::{Math, polynomial::clamp_exp, sin_cos_of_reduced};
use crate::simd::Lanes;

pub struct Libm;

impl Math for Libm {
    #[inline(always)]
    fn sin_cos_pi<V: Lanes>(u: V) -> (V, V) {
        sin_cos_of_reduced::<Self, V>(u)
    }
    #[inline(always)]
    fn sin_cos<V: Lanes>(x: V) -> (V, V) {
        (x.map(libm::sinf), x.map(libm::cosf))
    }
    #[inline(always)]
    fn exp<V: Lanes>(x: V) -> V {
        clamp_exp(x).map(libm::expf)
    }
    #[inline(always)]
    fn expm1<V: Lanes>(x: V) -> V {
        clamp_exp(x).map(libm::expm1f)
    }
    #[inline(always)]
    fn softplus<V: Lanes>(x: V) -> V {
        V::splat(0.0).max_of(x).add(Self::exp(x.abs().neg()).map(libm::log1pf))
    }
    #[cfg(any(feature = "tone-map", feature = "train"))]
    #[inline(always)]
    fn pow<V: Lanes>(x: V, p: f32) -> V {
        x.map(|x| libm::powf(x, p))
    }
}
