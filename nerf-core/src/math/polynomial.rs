//! The project's own elementary functions: f32 polynomials, generic over the vector type [`Lanes`], without f64.
//!
//! Coefficients are minimax fits (Remez exchange in 40-digit arithmetic), rounded to f32.

use super::Math;
use crate::simd::Lanes;
use core::f32::consts::{FRAC_2_PI, LN_2, LOG2_E, PI};

/// Backend whose functions are the polynomials of this module.
#[derive(Clone, Copy, Debug)]
pub struct Polynomial;

impl Math for Polynomial {}

/// `c[0] + c[1] x + c[2] x² + …` by Horner's rule.
#[inline(always)]
fn horner<V: Lanes, const N: usize>(x: V, c: [f32; N]) -> V {
    let mut sum = V::splat(c[N - 1]);
    for i in (0..N - 1).rev() {
        sum = sum.mul_add(x, V::splat(c[i]));
    }
    sum
}

/// Computes `(sin, cos)` of `r + n·π/2` from `(sin r, cos r)`, for `n` in `-2..=2`.
#[inline(always)]
fn rotate<V: Lanes>(n: V, sin: V, cos: V) -> (V, V) {
    let quarter = n.abs().equals(V::splat(1.0));
    let half = n.abs().equals(V::splat(2.0));
    let s = V::select(quarter, n.mul(cos), sin);
    let c = V::select(quarter, n.neg().mul(sin), cos);
    (V::select(half, s.neg(), s), V::select(half, c.neg(), c))
}

/// `(sin πu, cos πu)` for every finite `u`.
///
/// The angle is reduced before it is multiplied by π: `u mod 2` and the quadrant are exact in f32, so that the error
/// does not grow with `u`.
///
/// # Accuracy
/// Max abs error 1.2e-7 over all finite f32 (sampled in `math/tests.rs`).
#[inline(always)]
pub fn sin_cos_pi<V: Lanes>(u: V) -> (V, V) {
    let turns = u.mul(V::splat(0.5)).round_even();
    let u = turns.mul_add(V::splat(-2.0), u); // exact; in [-1, 1]
    let n = u.add(u).round_even();
    let r = n.mul_add(V::splat(-0.5), u); // exact; in [-1/4, 1/4]
    let z = r.mul(r);
    let sin = horner(z, [PI, -5.167_713, 2.550_162_6, -0.599_202_1, 0.081_001_855]).mul(r);
    let cos = horner(z, [-4.934_802, 4.058_708, -1.335_058_5, 0.231_429_55]).mul_add(z, V::splat(1.0));
    rotate(n, sin, cos)
}

/// Largest `|x|` that [`sin_cos`] accepts, radians. [`sin_cos`] subtracts `n·π/2` from `x`, with π/2 split into three
/// parts. Up to this limit, the products of the integer `n` with the first part and with the second part are exact.
pub const SIN_COS_DOMAIN: f32 = 1e5;

/// `(sin x, cos x)` for `|x| <= 1e5` radians ([`SIN_COS_DOMAIN`]).
///
/// # Accuracy
/// Max abs error 1.2e-7 on the domain.
/// # Source
/// Cody and Waite 1980. The reduction splits π/2 into three parts, the first two of 8 bits each.
#[inline(always)]
pub fn sin_cos<V: Lanes>(x: V) -> (V, V) {
    let n = x.mul(V::splat(FRAC_2_PI)).round_even();
    let r = n.mul_add(V::splat(-1.570_312_5), x);
    let r = n.mul_add(V::splat(-254.0 / 524_288.0), r);
    let r = n.mul_add(V::splat(6.397_578_4e-7), r);
    let z = r.mul(r);
    let sin = horner(z, [-0.166_666_55, 0.008_332_178, -0.000_195_173]).mul(z).mul_add(r, r);
    let cos = horner(z, [0.041_666_647, -0.001_388_736_8, 2.443_844_2e-5])
        .mul_add(z, V::splat(-0.5))
        .mul_add(z, V::splat(1.0));
    let n = n.sub(n.mul(V::splat(0.25)).round_even().mul(V::splat(4.0)));
    rotate(n, sin, cos)
}

/// Angle between the vector `(x, y)` and the positive x axis, radians, 0 to π; 0 at the origin. Requires `y >= 0`.
///
/// # Accuracy
/// Within 3e-7 (`math/tests.rs`).
/// # Source
/// Cephes (Moshier 1992), `atanf`. The branch for large quotients is left out: of `|x|` and `y`, the smaller is divided
/// by the larger, so that the quotient is at most 1.
#[cfg(feature = "lens")]
pub fn angle(y: f32, x: f32) -> f32 {
    use core::f32::consts::{FRAC_PI_2, FRAC_PI_4};
    let (low, high) = if y < x.abs() { (y, x.abs()) } else { (x.abs(), y) };
    if high == 0.0 {
        return 0.0;
    }
    // If the quotient is above tan(π/8), the series gives the angle minus π/4.
    let turned = low > 0.414_213_57 * high;
    let q = if turned { (low - high) / (low + high) } else { low / high };
    let z = q * q;
    let series = horner(z, [-0.333_329_5, 0.199_777_11, -0.138_776_85, 0.080_537_446]);
    let small = series * z * q + q + if turned { FRAC_PI_4 } else { 0.0 };
    let acute = if y < x.abs() { small } else { FRAC_PI_2 - small };
    if x < 0.0 { PI - acute } else { acute }
}

/// Clamps `x` to -87..88, where `e^x` is a normal f32.
#[inline(always)]
pub(super) fn clamp_exp<V: Lanes>(x: V) -> V {
    V::splat(-87.0).max_of(V::splat(88.0).min_of(x))
}

/// `(2^n, e^r − 1)`, where `x = n ln 2 + r`, `n` is an integer, and `|r| <= ln 2 / 2`.
#[inline(always)]
fn split_exp<V: Lanes>(x: V) -> (V, V) {
    let n = x.mul(V::splat(LOG2_E)).round_even();
    let r = n.mul_add(V::splat(-0.693_359_4), x);
    let r = n.mul_add(V::splat(2.121_944_4e-4), r);
    let q = horner(r, [0.5, 0.166_665_43, 0.041_666_28, 0.008_366_577, 0.001_394_643_9]);
    (n.exp2_integer(), q.mul(r).mul_add(r, r))
}

/// `e^x`, with `x` clamped to `[-87, 88]`, so that the result is finite and > 0.
///
/// # Accuracy
/// Max relative error 2e-7 on `[-87, 88]`.
#[inline(always)]
pub fn exp<V: Lanes>(x: V) -> V {
    let (scale, e) = split_exp(clamp_exp(x));
    e.mul_add(scale, scale)
}

/// `e^x − 1` without cancellation near 0; `x` is clamped as in [`exp`].
///
/// # Accuracy
/// Max relative error 4e-7.
#[inline(always)]
pub fn expm1<V: Lanes>(x: V) -> V {
    let (scale, e) = split_exp(clamp_exp(x));
    e.mul_add(scale, scale.sub(V::splat(1.0)))
}

/// `ln(1 + x)` for `x` in `[0, 1]`.
///
/// # Accuracy
/// Max relative error 5e-7.
#[inline(always)]
fn ln_1p_unit<V: Lanes>(x: V) -> V {
    let one = V::splat(1.0);
    let sum = one.add(x);
    // Effect of the rounding error of `1 + x` on the logarithm, to first order.
    let lost = x.sub(sum.sub(one)).div(sum);
    ln(sum).add(lost)
}

/// `ln x` for a positive normal `x`.
///
/// # Accuracy
/// Max error 2e-7, relative to `max(1, |ln x|)`.
#[inline(always)]
pub fn ln<V: Lanes>(x: V) -> V {
    let (m, e) = x.split_exponent();
    let f = m.sub(V::splat(1.0));
    let p = horner(
        f,
        [
            0.333_333_17,
            -0.250_008_1,
            0.200_022_86,
            -0.166_245_54,
            0.141_811_93,
            -0.131_287_55,
            0.128_816_44,
            -0.078_596_07,
        ],
    );
    let f2 = f.mul(f);
    let ln_m = p.mul(f).mul(f2).sub(f2.mul(V::splat(0.5))).add(f);
    e.mul_add(V::splat(LN_2), ln_m)
}

/// `ln(1 + e^x) = max(x, 0) + ln(1 + e^−|x|)`.
#[inline(always)]
pub fn softplus<V: Lanes>(x: V) -> V {
    V::splat(0.0).max_of(x).add(ln_1p_unit(exp(x.abs().neg())))
}
