//! Elementary functions. The crate `micromath` is called only in this module. The crate `libm` is called only in this
//! module and, except on x86-64 and on ARM with an FPU, in [`Lanes::sqrt`] of the type `f32`. In the table, "own" is the
//! project's f32 polynomials, and "exact reduction" is the reduction of the angle in [`Math::sin_cos_pi`], for encodings
//! of scale π only.
//!
//! | backend | sin/cos of the encoding | exp, softplus | expm1 | powers (tone stage) |
//! | --- | --- | --- | --- | --- |
//! | [`MathBackend::Polynomial`] | own | own | own | own |
//! | [`MathBackend::Libm`] | `libm` after exact reduction | `libm` | `libm` | `libm` |
//! | [`MathBackend::Micromath`] | `micromath` after exact reduction | `micromath`, but own for transmittance | own: the crate has none | own |
//! | [`MathBackend::Recurrence`] | own at level 0, then angle doubling | own | own | own |

#[cfg(feature = "train")]
mod elementary;
#[cfg(feature = "libm")]
pub(crate) mod libm;
#[cfg(feature = "micromath")]
pub(crate) mod micromath;
pub mod polynomial;
pub(crate) mod recurrence;
mod sum;

#[cfg(test)]
mod tests;

#[cfg(feature = "train")]
pub use elementary::Elementary;
pub(crate) use sum::Sum;

use crate::simd::Lanes;
use glam::Vec3;

/// Returns `v.length()`, bit for bit. On ARM with an FPU, [`Lanes::sqrt`] is an instruction, where glam computes square
/// roots in software. Used in what every firmware links.
pub(crate) fn length(v: Vec3) -> f32 {
    Lanes::sqrt(v.length_squared())
}

/// Backend that computes the elementary functions (sin, cos, exp, …).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum MathBackend {
    /// The project's own polynomials: always built in, vectorised with every instruction set.
    #[default]
    Polynomial,
    /// The `libm` crate, one value at a time.
    #[cfg(feature = "libm")]
    Libm,
    /// The `micromath` crate, one value at a time: little code, low accuracy.
    #[cfg(feature = "micromath")]
    Micromath,
    /// The project's own polynomials, with angle doubling in the sinusoidal encoding: the sine and cosine of each level
    /// after the first are computed from the previous level, so that errors grow with the level.
    Recurrence,
}

impl MathBackend {
    /// Number of backends, including backends that this build lacks. The backends' tags in files are 0 to `TAGS − 1`.
    pub const TAGS: u8 = 4;

    /// Number that identifies the backend in files, the same in every build.
    pub const fn tag(self) -> u8 {
        match self {
            Self::Polynomial => 0,
            #[cfg(feature = "libm")]
            Self::Libm => 1,
            #[cfg(feature = "micromath")]
            Self::Micromath => 2,
            Self::Recurrence => 3,
        }
    }

    /// Returns the backend with the tag `tag`; `None` if this build lacks the backend, or if no backend has the tag.
    pub const fn from_tag(tag: u8) -> Option<Self> {
        match tag {
            0 => Some(Self::Polynomial),
            #[cfg(feature = "libm")]
            1 => Some(Self::Libm),
            #[cfg(feature = "micromath")]
            2 => Some(Self::Micromath),
            3 => Some(Self::Recurrence),
            _ => None,
        }
    }
}

/// The elementary functions of one backend; the default implementations are the project's own polynomials.
pub trait Math {
    /// Whether the sinusoidal encoding computes each level from the previous level by angle doubling.
    const DOUBLING: bool = false;
    /// `(sin πu, cos πu)` for finite `u`. First reduces `u` modulo 2 exactly, so that no backend gets a large angle.
    #[inline(always)]
    fn sin_cos_pi<V: Lanes>(u: V) -> (V, V) {
        polynomial::sin_cos_pi(u)
    }
    /// `(sin x, cos x)` for `|x| <= 1e5` radians (`polynomial::SIN_COS_DOMAIN`).
    #[inline(always)]
    fn sin_cos<V: Lanes>(x: V) -> (V, V) {
        polynomial::sin_cos(x)
    }
    /// `e^x`, finite and positive for every `x` except NaN.
    #[inline(always)]
    fn exp<V: Lanes>(x: V) -> V {
        polynomial::exp(x)
    }
    /// `e^x − 1`.
    #[inline(always)]
    fn expm1<V: Lanes>(x: V) -> V {
        polynomial::expm1(x)
    }
    /// `e^−x`. Must be as precise as [`Math::expm1`]: transmittance, `e^−x`, and opacity, `1 − e^−x`, must add up to 1.
    #[inline(always)]
    fn decay<V: Lanes>(x: V) -> V {
        Self::exp(x.neg())
    }
    /// `ln(1 + e^x)`.
    #[inline(always)]
    fn softplus<V: Lanes>(x: V) -> V {
        polynomial::softplus(x)
    }
    /// `x^p` for a positive normal `x` and a positive normal result.
    #[cfg(any(feature = "tone-map", feature = "train"))]
    #[inline(always)]
    fn pow<V: Lanes>(x: V, p: f32) -> V {
        polynomial::exp(polynomial::ln(x).mul(V::splat(p)))
    }
    /// `1 / (1 + e^−x)`.
    #[inline(always)]
    fn sigmoid<V: Lanes>(x: V) -> V {
        let one = V::splat(1.0);
        one.div(one.add(Self::exp(x.neg())))
    }
}

/// Computes `(sin πu, cos πu)` by the sine and cosine of backend `M`, after an exact reduction of `u` modulo 2.
#[cfg(any(feature = "libm", feature = "micromath"))]
#[inline(always)]
fn sin_cos_of_reduced<M: Math, V: Lanes>(u: V) -> (V, V) {
    let turns = u.mul(V::splat(0.5)).round_even();
    let u = turns.mul_add(V::splat(-2.0), u);
    M::sin_cos(u.mul(V::splat(core::f32::consts::PI)))
}

/// Evaluates `$body` with the type `$M` set to the [`Math`] implementation of `$backend`. For `Recurrence`, `$M` is
/// `Polynomial`: the two differ only in sinusoidal encodings, which need `with_encoding_math`.
macro_rules! with_math {
    ($backend:expr, $M:ident => $body:expr) => {
        match $backend {
            $crate::math::MathBackend::Polynomial | $crate::math::MathBackend::Recurrence => {
                type $M = $crate::math::polynomial::Polynomial;
                $body
            }
            #[cfg(feature = "libm")]
            $crate::math::MathBackend::Libm => {
                type $M = $crate::math::libm::Libm;
                $body
            }
            #[cfg(feature = "micromath")]
            $crate::math::MathBackend::Micromath => {
                type $M = $crate::math::micromath::Micromath;
                $body
            }
        }
    };
}
pub(crate) use with_math;

/// Evaluates `$body` with the type `$M` set to the [`Math`] implementation of `$backend`, for sinusoidal encodings. For
/// the backend `Recurrence`, `with_math` sets `$M` to `Polynomial`, this macro to `Recurrence`.
macro_rules! with_encoding_math {
    ($backend:expr, $M:ident => $body:expr) => {
        match $backend {
            $crate::math::MathBackend::Recurrence => {
                type $M = $crate::math::recurrence::Recurrence;
                $body
            }
            backend => $crate::math::with_math!(backend, $M => $body),
        }
    };
}
pub(crate) use with_encoding_math;

/// `ln(1 + x)`, by the libm crate.
pub(crate) fn log1p(x: f32) -> f32 {
    ::libm::log1pf(x)
}
