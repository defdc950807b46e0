//! Backend [`Recurrence`]: the polynomials, except that the sinusoidal encoding computes each level from the previous
//! level by angle doubling.

use super::Math;
use crate::simd::Lanes;

pub struct Recurrence;

impl Math for Recurrence {
    const DOUBLING: bool = true;
}

/// Computes `(sin 2a, cos 2a)` from `(sin a, cos a)`. Then scales sine and cosine by a common factor, which corrects
/// `sin² + cos²` to 1, to first order in the deviation.
///
/// With the formula `cos 2a = (cos a − sin a)(cos a + sin a)` the error doubles when the angle doubles. With
/// `2 cos² a − 1` the error would grow faster.
#[inline(always)]
pub(crate) fn double<V: Lanes>(sin: V, cos: V) -> (V, V) {
    let s = sin.add(sin).mul(cos);
    let c = cos.sub(sin).mul(cos.add(sin));
    let norm = s.mul_add(s, c.mul(c));
    let fix = norm.mul_add(V::splat(-0.5), V::splat(1.5));
    (s.mul(fix), c.mul(fix))
}
