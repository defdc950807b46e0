//! Backend of the polynomials, with angle doubling from level to level of the encoding.

use super::Math;
use crate::simd::Lanes;

pub struct Recurrence;

impl Math for Recurrence {
    const DOUBLING: bool = true;
}

/// `(sin 2a, cos 2a)` from `(sin a, cos a)`, normalised to the unit circle to first order.
///
/// `cos 2a = (cos a − sin a)(cos a + sin a)` lets the error grow no faster than necessary.
#[inline(always)]
pub(crate) fn double<V: Lanes>(sin: V, cos: V) -> (V, V) {
    let s = sin.add(sin).mul(cos);
    let c = cos.sub(sin).mul(cos.add(sin));
    let norm = s.mul_add(s, c.mul(c));
    let fix = norm.mul_add(V::splat(-0.5), V::splat(1.5));
    (s.mul(fix), c.mul(fix))
}
