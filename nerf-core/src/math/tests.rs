//! Sampled accuracy of every backend against f64.

extern crate std;

#[cfg(feature = "libm")]
use super::libm::Libm;
#[cfg(feature = "micromath")]
use super::micromath::Micromath;
use super::polynomial::Polynomial;
use super::recurrence::Recurrence;
use super::{Math, MathBackend};
use crate::simd::Lanes;
use crate::simd::{Isa, Op};
use crate::testing::Worse;
use half::f16;

/// Every `step`-th f32 between `low` and `high`.
fn floats(low: f32, high: f32, step: usize) -> impl Iterator<Item = f32> {
    let sided = move |limit: f32, sign: u32| {
        (0..=limit.abs().to_bits()).step_by(step).map(move |bits| f32::from_bits(bits | sign))
    };
    sided(high.max(0.0), 0).chain(sided(low.min(0.0), 1 << 31)).filter(move |x| (low..=high).contains(x))
}

fn worst_abs(points: impl Iterator<Item = f32>, f: impl Fn(f32) -> f32, truth: impl Fn(f64) -> f64) -> f64 {
    points.map(|x| (f64::from(f(x)) - truth(f64::from(x))).abs()).fold(0.0, Worse::worse)
}

fn worst_rel(points: impl Iterator<Item = f32>, f: impl Fn(f32) -> f32, truth: impl Fn(f64) -> f64) -> f64 {
    let relative = |x: f32| {
        let t = truth(f64::from(x));
        if t == 0.0 { f64::from(f(x)).abs() } else { ((f64::from(f(x)) - t) / t).abs() }
    };
    points.map(relative).fold(0.0, Worse::worse)
}

/// sin and cos of πu in f64. `u` is first reduced modulo 2, exactly.
fn truth_pi(u: f64) -> (f64, f64) {
    let r = u % 2.0;
    ((core::f64::consts::PI * r).sin(), (core::f64::consts::PI * r).cos())
}

fn encoding_error<M: Math>() -> (f64, f64) {
    let points = || floats(f32::MIN, f32::MAX, 9973);
    let pi = worst_abs(points(), |u| M::sin_cos_pi(u).0, |u| truth_pi(u).0).max(worst_abs(
        points(),
        |u| M::sin_cos_pi(u).1,
        |u| truth_pi(u).1,
    ));
    let points = || floats(-1e5, 1e5, 997);
    let one = worst_abs(points(), |x| M::sin_cos(x).0, f64::sin).max(worst_abs(
        points(),
        |x| M::sin_cos(x).1,
        f64::cos,
    ));
    (pi, one)
}

#[test]
fn polynomial_sin_cos_stays_within_1_2e_7_for_every_magnitude() {
    let (pi, one) = encoding_error::<Polynomial>();
    std::println!("polynomial: {pi:e} {one:e}");
    assert!(pi <= 1.2e-7 && one <= 1.2e-7, "{pi:e} {one:e}");
}

#[cfg(feature = "libm")]
#[test]
fn libm_stays_within_its_row() {
    let (pi, one) = encoding_error::<Libm>();
    std::println!("libm: {pi:e} {one:e}");
    assert!(pi <= 4e-7 && one <= 1.2e-7, "{pi:e} {one:e}");
}

#[cfg(feature = "micromath")]
#[test]
fn micromath_stays_within_its_row() {
    let (pi, one) = encoding_error::<Micromath>();
    std::println!("micromath: {pi:e} {one:e}");
    assert!(pi <= 2e-3, "{pi:e} {one:e}");
}

#[test]
fn exponentials_stay_within_their_relative_bounds() {
    let exp = worst_rel(floats(-87.0, 88.0, 131), Polynomial::exp::<f32>, f64::exp);
    let expm1 = worst_rel(floats(-87.0, 88.0, 131), Polynomial::expm1::<f32>, f64::exp_m1);
    let softplus = worst_rel(floats(-80.0, 1e4, 131), Polynomial::softplus::<f32>, |x| {
        x.max(0.0) + (-x.abs()).exp().ln_1p()
    });
    let sigmoid =
        worst_rel(floats(-80.0, 1e4, 131), Polynomial::sigmoid::<f32>, |x| 1.0 / (1.0 + (-x).exp()));
    std::println!("exp {exp:e}, expm1 {expm1:e}, softplus {softplus:e}, sigmoid {sigmoid:e}");
    assert!(exp <= 2e-7 && expm1 <= 4e-7 && softplus <= 5e-7 && sigmoid <= 4e-7);
}

#[test]
fn logarithms_and_powers_stay_within_their_bounds() {
    let points = || floats(f32::MIN_POSITIVE, f32::MAX, 9973);
    let ln = points()
        .map(|x| {
            let truth = f64::from(x).ln();
            (f64::from(super::polynomial::ln(x)) - truth).abs() / truth.abs().max(1.0)
        })
        .fold(0.0, Worse::worse);
    let power = |p: f32| worst_rel(floats(0.05, 1.0, 131), |x| Polynomial::pow(x, p), |x| x.powf(p.into()));
    let (up, down) = (power(2.4), power(1.0 / 2.4));
    std::println!("ln {ln:e}, x^2.4 {up:e}, x^(1/2.4) {down:e}");
    assert!(ln <= 2e-7 && up <= 2e-6 && down <= 5e-7);
}

#[test]
fn extremes_are_finite() {
    for x in [1e4, -1e4, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN] {
        assert!(Polynomial::exp(x) > 0.0 && Polynomial::exp(x).is_finite());
        assert!((0.0..=1.0).contains(&Polynomial::sigmoid(x)));
        assert!((-1.0..f32::INFINITY).contains(&Polynomial::expm1(x)));
    }
    assert_eq!(Polynomial::softplus(1e4), 1e4);
    assert_eq!(Polynomial::expm1(-0.0f32).to_bits() << 1, 0);
    assert!(Polynomial::exp(f32::NAN).is_nan() && Polynomial::expm1(f32::NAN).is_nan());
}

/// Tests every f16, its midpoint to the next f16, and the two f32 next to the midpoint, with each instruction set.
#[test]
fn halves_are_rounded_alike_with_every_kernel() {
    struct Halves<'a>(&'a [f32]);
    impl Op for Halves<'_> {
        type Output = std::vec::Vec<u16>;
        #[inline(always)]
        fn run<V: Lanes>(self) -> Self::Output {
            self.0.chunks(V::COUNT).flat_map(|x| V::load(x).to_f16()[..V::COUNT].to_vec()).collect()
        }
    }
    let mut values = std::vec::Vec::new();
    for bits in 0..0x7c00 {
        let (this, next) = (f16::from_bits(bits).to_f32(), f16::from_bits(bits + 1).to_f32());
        let middle = if next.is_finite() { 0.5 * (this + next) } else { 65_520.0 };
        for x in [this, middle.next_down(), middle, middle.next_up()] {
            values.extend([x, -x]);
        }
    }
    values.extend([f32::MAX, f32::INFINITY, 1e-40, -1e-40, 70_000.0, -70_000.0, 0.0, -0.0]);
    values.resize(values.len().next_multiple_of(16), 1.0);
    let expected: std::vec::Vec<u16> = values.iter().map(|&x| f16::from_f32(x).to_bits()).collect();
    for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
        assert_eq!(isa.run(Halves(&values)), expected, "{}", isa.name());
    }
}

#[test]
fn doubling_errs_by_its_row() {
    let mut worst = 0.0f64;
    for i in 0..10_000 {
        let x = i as f32 / 5000.0 - 1.0;
        let (mut s, mut c) = Recurrence::sin_cos_pi(x);
        for k in 1..10 {
            (s, c) = super::recurrence::double(s, c);
            let (ts, tc) = truth_pi(f64::from(x) * f64::from(1 << k));
            worst = worst.worse((f64::from(s) - ts).abs()).worse((f64::from(c) - tc).abs());
        }
    }
    std::println!("recurrence at level 9: {worst:e}");
    assert!(worst <= 1e-4, "{worst:e}");
}

#[test]
fn rounding_and_exponents_are_exact() {
    for x in [0.5, 1.5, 2.5, -0.5, -1.5, 8_388_607.5, 4_194_304.5, 1e30, -0.49, 0.0] {
        assert_eq!(f32::round_even(x), x.round_ties_even(), "{x}");
    }
    for x in [1.0, 1.5, 0.75, 3e-20, 7e30] {
        let (m, e) = f32::split_exponent(x);
        assert!((0.707..1.4143).contains(&m), "{x}: {m}");
        assert_eq!(m * 2f32.powi(e as i32), x);
    }
}

#[test]
fn tags_name_one_backend_each_and_the_same_in_every_build() {
    for tag in 0..=u8::MAX {
        if let Some(backend) = MathBackend::from_tag(tag) {
            assert!(backend.tag() == tag && tag < MathBackend::TAGS);
        }
    }
    assert_eq!(MathBackend::from_tag(0), Some(MathBackend::Polynomial));
    assert_eq!(MathBackend::from_tag(3), Some(MathBackend::Recurrence));
}

#[cfg(feature = "lens")]
#[test]
fn angles_are_those_of_f64() {
    let mut worst = 0.0f64;
    for i in 0..20_001 {
        let exact = f64::from(i) / 20_000.0 * core::f64::consts::PI;
        for scale in [1e-6, 1.0, 3e7] {
            let (y, x) = ((scale * exact.sin()).abs() as f32, (scale * exact.cos()) as f32);
            let expected = f64::from(y).atan2(f64::from(x));
            worst = worst.max((f64::from(super::polynomial::angle(y, x)) - expected).abs());
        }
    }
    assert!(worst <= 3e-7, "{worst:e}");
    use core::f32::consts::{FRAC_PI_2, PI};
    let edges = [(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, FRAC_PI_2), (0.0, -1.0, PI)];
    for (y, x, expected) in edges {
        assert_eq!(super::polynomial::angle(y, x), expected, "({y}, {x})");
    }
}
