extern crate std;

use super::*;
use crate::testing::{Worse, noise};
use std::vec::Vec;

mod colmap;

fn lenses() -> impl Iterator<Item = Lens> {
    let k1 = [-0.1, -0.02, 0.0, 0.05, 0.3];
    let p = [-0.005, 0.0, 0.005];
    k1.into_iter().flat_map(move |k1| {
        p.into_iter().flat_map(move |p1| {
            p.into_iter().map(move |p2| Lens { k1, k2: 0.1 * k1 * k1, p1, p2, ..Lens::NONE })
        })
    })
}

fn distort_f64(lens: &Lens, x: f64, y: f64) -> (f64, f64) {
    let [k1, k2, p1, p2] = [lens.k1, lens.k2, lens.p1, lens.p2].map(f64::from);
    let r2 = x * x + y * y;
    let radial = 1.0 + r2 * (k1 + r2 * k2);
    (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )
}

#[test]
fn distort_undoes_undistort() {
    let (mut worst, mut points) = (0.0f64, 0);
    for lens in lenses() {
        for i in -20..=20i8 {
            for j in -20..=20i8 {
                let (xd, yd) = (f32::from(i) * 0.035, f32::from(j) * 0.035);
                let (x, y) = lens.undistort(xd, yd).unwrap_or_else(|| panic!("{lens:?} ({xd}, {yd})"));
                let (a, b) = distort_f64(&lens, x.into(), y.into());
                worst = worst.worse((a - f64::from(xd)).abs()).worse((b - f64::from(yd)).abs());
                points += 1;
            }
        }
    }
    std::println!("lens round trip: {worst:e} over {points} points");
    assert!(worst <= 1.5e-6, "{worst:e}");
}

#[test]
fn undistort_undoes_distort_to_the_last_digits_even_far_from_the_axis() {
    let lens = Lens { k1: 1e-4, k2: 1e-9, p1: 1e-5, p2: -1e-5, ..Lens::NONE };
    for r in [0.5f32, 2.0, 7.0, 12.0, 33.0] {
        for step in 0..64 {
            let (s, c) = (step as f32 * 0.1).sin_cos();
            let (xd, yd) = lens.distort(r * c, r * s);
            let (x, y) = lens.undistort(xd, yd).unwrap_or_else(|| panic!("({xd}, {yd})"));
            assert!((x - r * c).abs().max((y - r * s).abs()) <= 4e-6 * r.max(1.0), "r {r}: ({x}, {y})");
        }
    }
}

#[test]
fn no_lens_moves_nothing_bit_for_bit() {
    for (x, y) in [(0.0, -0.0), (0.1, -3.7), (1e30, 1e-40)] {
        assert_eq!(Lens::NONE.undistort(x, y), Some((x, y)));
        assert_eq!(Lens::default().undistort(x, y), Some((x, y)));
    }
    assert_eq!(Lens::NONE.distort(0.3, -0.7), (0.3, -0.7));
}

#[test]
fn the_jacobian_is_the_slope() {
    let lens = Lens { k1: 0.1, k2: -0.02, p1: 0.01, p2: -0.03, ..Lens::NONE };
    let (x, y, h) = (0.4f32, -0.7f32, 1e-6f64);
    let ([a, b], [c, d]) = lens.jacobian(x, y);
    let (x, y) = (f64::from(x), f64::from(y));
    let slope = |p: (f64, f64), q: (f64, f64)| ((p.0 - q.0) / (2.0 * h), (p.1 - q.1) / (2.0 * h));
    let by_x = slope(distort_f64(&lens, x + h, y), distort_f64(&lens, x - h, y));
    let by_y = slope(distort_f64(&lens, x, y + h), distort_f64(&lens, x, y - h));
    for (found, truth) in [(a, by_x.0), (b, by_y.0), (c, by_x.1), (d, by_y.1)] {
        assert!((f64::from(found) - truth).abs() < 1e-6, "{found} {truth}");
    }
}

#[test]
fn a_point_that_no_direction_is_seen_at_has_none() {
    // With k1 = −1, a point at r is seen at r (1 − r²), which is at most 0.385.
    let lens = Lens { k1: -1.0, ..Lens::NONE };
    assert_eq!(lens.undistort(0.5, 0.0), None);
    assert!(lens.undistort(0.3, 0.0).is_some());
    assert_eq!(lens.undistort(f32::NAN, 0.0), None);
    assert_eq!(lens.undistort(f32::INFINITY, 0.0), None);
}

#[test]
fn a_tilt_may_lift_what_would_fold_without_it() {
    // Slope along x: 1 + 6 p2 s − 2.1 s² + 1.11 s⁴. The minimum is 0.065 with p2 = 0.01, and 0.007 with p2 = 0.
    let lens = |p2| Lens { k1: -0.7, k2: 0.222, p1: 0.0, p2, ..Lens::NONE };
    for (p2, found) in [(0.01, true), (0.0, false)] {
        let (xd, yd) = lens(p2).distort(1.0, 0.0);
        assert_eq!(lens(p2).invert(xd, yd, true).is_some(), found, "p2 {p2}");
    }
}

#[test]
fn the_domain_reaches_to_the_fold_and_without_one_to_ten_radii() {
    for k1 in [-0.01f32, -0.1, -0.7] {
        let lens = Lens { k1, ..Lens::NONE };
        let fold = 2.0 / 3.0 / (-3.0 * k1).sqrt();
        for step in 0..=99 {
            let seen = fold * step as f32 / 100.0;
            for (xd, yd) in [(seen, 0.0), (-0.6 * seen, 0.8 * seen)] {
                let (x, y) = lens.undistort(xd, yd).unwrap_or_else(|| panic!("k1 {k1}: {step} % of the way"));
                let (a, b) = lens.distort(x, y);
                assert!((a - xd).abs().max((b - yd).abs()) <= 2e-6 * fold.max(1.0));
            }
        }
        assert_eq!(lens.undistort(1.001 * fold, 0.0), None, "k1 {k1}: beyond the fold");
    }
    for (k1, k2) in [(1.0, 0.0), (0.0, 1.0), (0.3, 0.01)] {
        let lens = Lens { k1, k2, ..Lens::NONE };
        for r in [0.1, 1.0, 3.0, 10.0, 30.0] {
            let (seen, _) = lens.distort(r, 0.0);
            if seen <= 10.0 * r {
                let (x, _) =
                    lens.undistort(seen, 0.0).unwrap_or_else(|| panic!("k1 {k1} k2 {k2}: radius {r}"));
                assert!((x - r).abs() <= 3e-6 * r.max(1.0), "k1 {k1} k2 {k2}: {x} for {r}");
            }
        }
    }
}

/// Returns random lenses with coefficients of all signs and magnitudes. Each lens comes with the radius at which
/// [`Lens::bend`] reaches `bend`, and with random points within this radius.
fn lenses_of_bend(bend: f32) -> impl Iterator<Item = (Lens, f32, Vec<(f32, f32)>)> {
    let (signs, sizes) = (noise(16_000, 5), noise(16_000, 6));
    (0..4_000).map(move |i| {
        let part = |k: usize| signs[4 * i + k] * 10f32.powf(3.0 * sizes[4 * i + k]) * ((i >> k) & 1) as f32;
        let lens = Lens { k1: part(0), k2: part(1), p1: part(2), p2: 0.1 + part(3), ..Lens::NONE };
        // Bisects the radius, since the bend grows with the radius.
        let (mut low, mut radius) = (0.0f32, 1e3f32);
        for _ in 0..60 {
            let middle = 0.5 * (low + radius);
            if lens.bend(middle) <= bend { low = middle } else { radius = middle }
        }
        let places = noise(32, i as u32);
        let points = places.chunks(2).map(|place| {
            let ((s, c), r) = ((3.15 * place[0]).sin_cos(), low * place[1].abs().sqrt());
            (r * c, r * s)
        });
        (lens, low, points.collect())
    })
}

#[test]
fn the_bend_bounds_the_slopes() {
    let mut most = 0.0f32;
    for (lens, radius, points) in lenses_of_bend(0.9) {
        for (x, y) in points {
            let ([a, b], [c, d]) = lens.jacobian(x, y);
            // Operator norm of the Jacobian minus the identity: the larger absolute eigenvalue of a symmetric matrix.
            let norm = 0.5 * ((a + d - 2.0).abs() + ((a - d) * (a - d) + 4.0 * b * c).sqrt());
            assert!(norm <= 0.9 + 1e-6, "{lens:?} within {radius}: {norm}");
            most = most.max(norm);
        }
    }
    assert!(most > 0.85, "a bound nothing comes near: {most}");
}

#[test]
fn a_gentle_lens_has_an_answer_to_every_question() {
    for (lens, reach, points) in lenses_of_bend(0.125) {
        let within = 7.0 / 9.0 * (1.0 - 1e-6);
        let radius = reach * within;
        assert!(lens.is_gentle(radius) && !lens.is_gentle(radius * 1.01), "{lens:?} within {radius}");
        for (x, y) in points {
            assert!(lens.invert(x * within, y * within, true).is_some(), "{lens:?} at ({x}, {y})");
        }
    }
    let nan = Lens { k2: f32::NAN, ..Lens::NONE };
    assert!(!nan.is_gentle(1.0) && !Lens { p1: 1e-9, ..Lens::NONE }.is_gentle(f32::NAN));
}
