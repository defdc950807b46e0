extern crate std;

use super::*;
use crate::math::MathBackend;
use crate::testing::{self, Worse};
use std::format;
use std::vec;
use std::vec::Vec;

const SIZES: [f32; 7] = [0.0, 1e-30, 1e-10, 1.0, 1e10, 1e30, f32::INFINITY];

/// Reproducible pseudo-random values in [0, 1).
fn noise(n: usize, seed: u32) -> Vec<f32> {
    testing::noise(n, seed).into_iter().map(|x| 0.5 + 0.5 * x).collect()
}

fn edges(n: usize, near: f32, far: f32) -> Vec<f32> {
    (0..=n).map(|i| near + (far - near) * i as f32 / n as f32).collect()
}

/// [`super::composite`] with [`MathBackend::Polynomial`].
fn composite(
    sigma: &[f32],
    rgb: &[[f32; 3]],
    t_edges: &[f32],
    background: [f32; 3],
) -> Result<Pixel, VolumeError> {
    super::composite(MathBackend::Polynomial, sigma, rgb, t_edges, background)
}

/// Composites a ray of `n` samples in f64. `t`: edges of the samples' bins, `[n + 1]`. Returns colour over black,
/// opacity, and mean distance: the mean of the bins' middles, weighted by the samples' weights.
fn oracle(sigma: &[f32], rgb: &[[f32; 3]], t: &[f32]) -> ([f64; 3], f64, f64) {
    let (mut tau, mut colour, mut opacity, mut distance) = (0.0f64, [0.0f64; 3], 0.0, 0.0);
    for i in 0..sigma.len() {
        let delta = f64::from(t[i + 1]) - f64::from(t[i]);
        let x = f64::from(sigma[i]) * delta;
        let weight = (-tau).exp() * -(-x).exp_m1();
        tau += x;
        for (sum, &c) in colour.iter_mut().zip(&rgb[i]) {
            *sum += weight * f64::from(c);
        }
        opacity += weight;
        distance += weight * 0.5 * (f64::from(t[i]) + f64::from(t[i + 1]));
    }
    (colour, opacity, distance / opacity)
}

#[test]
fn every_size_of_sigma_and_delta_gives_a_finite_pixel() {
    for sigma in SIZES {
        for delta in SIZES {
            for t in [0.0, 1e-30, 1.0, 1e30] {
                let mut ray = Accumulator::NONE;
                let weight = ray.add(MathBackend::Polynomial, sigma, [1.0, 0.5, 0.0], t, delta);
                let through = ray.transmittance();
                let truth = if sigma == 0.0 || delta == 0.0 {
                    0.0
                } else {
                    -(-(f64::from(sigma) * f64::from(delta))).exp_m1()
                };
                let error = (f64::from(weight) - truth).abs();
                assert!(error <= 2e-7 * truth + 1e-38, "{sigma} {delta}: {weight} {truth}");
                assert!((0.0..=1.0).contains(&weight) && (0.0..=1.0).contains(&through));
                assert!((weight + through - 1.0).abs() <= 1e-6, "{sigma} {delta}");
                let pixel = ray.finish_from(0.0, false, [0.2; 3], 1e30, 0.5);
                let all = [pixel.opacity, pixel.ray_distance, pixel.z_depth];
                assert!(
                    all.iter().chain(&pixel.rgb).all(|x| x.is_finite()),
                    "{sigma} {delta} {t}: {pixel:?}"
                );
            }
        }
    }
}

#[test]
fn every_size_of_density_and_edge_composites_to_a_finite_pixel() {
    for a in SIZES {
        for b in SIZES {
            for t in [
                [0.0, 1e-30, 1e-10],
                [0.0, 1.0, 1e30],
                [1.0, 1.0, 1.0],
                [-3e38, 0.0, 3e38],
                [-3e38, 3e38, 3e38],
            ] {
                let pixel = composite(&[a, b], &[[1.0; 3], [0.0; 3]], &t, [1.0; 3]).unwrap();
                assert!(pixel.rgb.iter().all(|c| (0.0..=1.0 + 1e-6).contains(c)), "{a} {b} {t:?} {pixel:?}");
                assert!((0.0..=1.0).contains(&pixel.opacity) && pixel.ray_distance.is_finite());
                if a == 0.0 && b == 0.0 {
                    assert_eq!(pixel.opacity, 0.0, "no density, no wall: {t:?}");
                }
            }
        }
    }
}

#[test]
fn weights_plus_final_transmittance_is_one() {
    let mut worst = 0.0f64;
    for n in [1, 2, 64, 1000, 4096] {
        for scale in [1e-6, 1e-3, 0.1, 1.0, 30.0] {
            let mut ray = Accumulator::NONE;
            let mut exact = 0.0;
            for x in noise(n, n as u32) {
                exact += f64::from(ray.add(MathBackend::Polynomial, x * scale, [0.0; 3], 1.0, 1.0));
            }
            let sum = f64::from(ray.opacity.value);
            let through = f64::from(ray.transmittance());
            worst = worst.worse((sum + through - 1.0).abs());
            assert!((sum - exact).abs() <= 1.2e-7, "the sum of the weights itself");
        }
    }
    std::println!("Σw + T − 1: {worst:e}");
    assert!(worst <= 1e-6, "{worst:e}");
}

#[test]
fn composite_is_the_f64_oracle() {
    let (mut worst, mut worst_distance) = (0.0f64, 0.0f64);
    for (n, scale) in [(1, 1.0), (7, 2.0), (64, 0.5), (64, 40.0), (192, 5.0), (4096, 1.0)] {
        let sigma: Vec<f32> = noise(n, 5).iter().map(|x| (x - 0.4).max(0.0) * scale).collect();
        let values = noise(3 * n, 6);
        let rgb: Vec<[f32; 3]> = values.chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
        let t = edges(n, 2.0, 6.0);
        let pixel = composite(&sigma, &rgb, &t, [0.0; 3]).unwrap();
        let (colour, opacity, distance) = oracle(&sigma, &rgb, &t);
        for (found, truth) in pixel.rgb.iter().chain([&pixel.opacity]).zip(colour.iter().chain([&opacity])) {
            worst = worst.worse((f64::from(*found) - truth).abs());
        }
        if opacity > 1e-3 {
            worst_distance = worst_distance.worse((f64::from(pixel.ray_distance) - distance).abs());
        }
    }
    std::println!("colour and opacity {worst:e}, distance {worst_distance:e}");
    assert!(worst <= 1e-6 && worst_distance <= 4e-6, "{worst:e} {worst_distance:e}");
}

#[test]
fn thin_samples_keep_their_relative_precision() {
    let mut worst = 0.0f64;
    for exponent in -30..0 {
        for mantissa in [1.0f32, 1.37, 2.9, 9.99] {
            let tau = mantissa * 10f32.powi(exponent);
            let mut sum = Accumulator::NONE;
            let weight = sum.add(MathBackend::Polynomial, tau, [0.0; 3], 1.0, 1.0);
            let truth = -(-f64::from(tau)).exp_m1();
            worst = worst.worse((f64::from(weight) / truth - 1.0).abs());
        }
    }
    std::println!("alpha, relative: {worst:e}");
    assert!(worst <= 1e-6, "{worst:e}");
}

#[test]
fn splitting_a_bin_changes_nothing() {
    let mut worst = 0.0f32;
    for scale in [1e-4, 0.1, 3.0, 50.0] {
        let n = 64;
        let sigma: Vec<f32> = noise(n, 8).iter().map(|x| x * scale).collect();
        let rgb: Vec<[f32; 3]> = noise(3 * n, 9).chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
        let t = edges(n, 2.0, 6.0);
        let whole = composite(&sigma, &rgb, &t, [0.3, 0.6, 1.0]).unwrap();
        for at in 0..n {
            let (mut sigma, mut rgb, mut t) = (sigma.clone(), rgb.clone(), t.clone());
            sigma.insert(at, sigma[at]);
            rgb.insert(at, rgb[at]);
            t.insert(at + 1, t[at] + 0.3 * (t[at + 1] - t[at]));
            let split = composite(&sigma, &rgb, &t, [0.3, 0.6, 1.0]).unwrap();
            for (a, b) in
                split.rgb.iter().chain([&split.opacity]).zip(whole.rgb.iter().chain([&whole.opacity]))
            {
                worst = worst.worse((a - b).abs());
            }
        }
    }
    std::println!("splitting: {worst:e}");
    assert!(worst <= 1e-6, "{worst:e}");
}

#[test]
fn edges_that_do_not_ascend_or_are_no_numbers_are_refused() {
    let go = |t: &[f32]| composite(&[1.0, 1.0], &[[0.0; 3]; 2], t, [0.0; 3]);
    assert_eq!(go(&[2.0, 1.0, 3.0]), Err(VolumeError::Edges { bin: 0 }));
    assert_eq!(go(&[1.0, 2.0, 1.5]), Err(VolumeError::Edges { bin: 1 }));
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert_eq!(go(&[bad, 2.0, 3.0]), Err(VolumeError::Edges { bin: 0 }));
        assert_eq!(go(&[1.0, bad, 3.0]), Err(VolumeError::Edges { bin: 0 }));
        assert_eq!(go(&[1.0, 2.0, bad]), Err(VolumeError::Edges { bin: 1 }));
        assert_eq!(composite(&[], &[], &[bad], [0.0; 3]), Err(VolumeError::Edges { bin: 0 }));
    }
    assert!(go(&[1.0, 1.0, 1.0]).is_ok(), "a bin may be empty");
}

#[test]
fn lengths_that_do_not_fit_are_refused() {
    for (sigma, rgb, t_edges) in [(2, 1, 3), (2, 2, 2), (2, 2, 4), (0, 0, 0)] {
        let found = composite(&vec![1.0; sigma], &vec![[0.0; 3]; rgb], &vec![1.0; t_edges], [0.0; 3]);
        assert_eq!(found, Err(VolumeError::Lengths { sigma, rgb, t_edges }));
    }
    assert!(format!("{}", VolumeError::Edges { bin: 3 }).contains("bin 3"));
    assert!(format!("{}", VolumeError::Lengths { sigma: 1, rgb: 2, t_edges: 3 }).contains("1, 2, 3"));
}

#[test]
fn an_empty_ray_is_background_at_far() {
    let t = edges(8, 2.0, 6.0);
    let pixel = composite(&[0.0; 8], &[[1.0; 3]; 8], &t, [0.25, 0.5, 0.75]).unwrap();
    let empty =
        Pixel { rgb: [0.25, 0.5, 0.75], opacity: 0.0, ray_distance: 6.0, z_depth: 6.0, ..Pixel::BLANK };
    assert_eq!(pixel, empty);
    assert_eq!(composite(&[], &[], &[6.0], [0.25, 0.5, 0.75]).unwrap(), empty);
    let negative = composite(&[-5.0; 8], &[[1.0; 3]; 8], &t, [0.25, 0.5, 0.75]).unwrap();
    assert_eq!(negative, empty, "negative density is clamped to none");
}

#[test]
fn an_opaque_wall_hides_what_is_behind_it() {
    let t = edges(4, 2.0, 6.0);
    let rgb = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0; 3]];
    for wall in [1e10, f32::MAX, f32::INFINITY] {
        let first = composite(&[wall, 5.0, 5.0, 5.0], &rgb, &t, [1.0; 3]).unwrap();
        assert_eq!(
            first,
            Pixel { rgb: [1.0, 0.0, 0.0], opacity: 1.0, ray_distance: 2.5, z_depth: 2.5, ..Pixel::BLANK }
        );
        let last = composite(&[0.0, 0.0, 0.0, wall], &rgb, &t, [0.0; 3]).unwrap();
        assert_eq!(
            last,
            Pixel { rgb: [1.0; 3], opacity: 1.0, ray_distance: 5.5, z_depth: 5.5, ..Pixel::BLANK }
        );
    }
}

#[test]
fn the_background_shows_through_by_what_is_not_opaque() {
    let pixel =
        composite(&[core::f32::consts::LN_2], &[[1.0, 0.0, 0.0]], &[2.0, 3.0], [0.0, 1.0, 0.5]).unwrap();
    for (found, truth) in pixel.rgb.into_iter().zip([0.5, 0.5, 0.25]) {
        assert!((found - truth).abs() < 2e-7, "{pixel:?}");
    }
    let white = composite(&[1e3; 64], &[[1.0; 3]; 64], &edges(64, 2.0, 6.0), [1.0; 3]).unwrap();
    assert!(white.rgb.iter().all(|&c| c <= 1.0 + 1e-6), "{white:?}");
}

#[test]
fn samples_that_are_no_numbers_are_empty() {
    let t = edges(3, 0.0, 3.0);
    let clean = composite(&[0.5, 0.0, 0.7], &[[0.5; 3]; 3], &t, [0.1; 3]).unwrap();
    let found = composite(&[0.5, f32::NAN, 0.7], &[[0.5; 3]; 3], &t, [0.1; 3]).unwrap();
    assert_eq!(found, clean);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let rgb = [[0.5; 3], [0.5, bad, 0.5], [0.5; 3]];
        assert_eq!(composite(&[0.5, 9.0, 0.7], &rgb, &t, [0.1; 3]).unwrap(), clean, "{bad}");
        assert_eq!(composite(&[0.5, 0.0, 0.7], &rgb, &t, [0.1; 3]).unwrap(), clean, "{bad} in no density");
    }
}

#[test]
fn distances_are_far_exactly_up_to_the_epsilon() {
    for (opacity, hit) in [(0.99e-4, false), (1.01e-4, true)] {
        let mut ray = Accumulator::NONE;
        ray.add(MathBackend::Polynomial, opacity, [1.0; 3], 3.0, 1.0);
        let pixel = ray.finish_from(0.0, false, [0.0; 3], 6.0, 0.5);
        let (distance, z) = if hit { (3.0, 1.5) } else { (6.0, 6.0) };
        assert!((pixel.ray_distance - distance).abs() < 1e-5 && (pixel.z_depth - z).abs() < 1e-5);
    }
}

/// Returns the largest `|Σw + T − 1|` and the largest `Σw` of 12 rays with pseudo-random densities, composited with the
/// maths backend `math`. `w`: weights of a ray's samples, `T`: transmittance behind the last sample.
fn conservation(math: MathBackend) -> (f32, f32) {
    let (mut worst, mut most) = (0.0f32, 0.0f32);
    for n in [1, 64, 4096] {
        for scale in [1e-3, 0.1, 1.0, 30.0] {
            let mut ray = Accumulator::NONE;
            for x in noise(n, n as u32) {
                ray.add(math, x * scale, [1.0; 3], 1.0, 1.0);
            }
            worst = worst.worse((ray.opacity.value + ray.transmittance() - 1.0).abs());
            most = most.max(ray.opacity.value);
            let pixel = ray.finish_from(0.0, false, [0.0; 3], 2.0, 1.0);
            assert!(pixel.opacity <= 1.0);
            assert!(pixel.rgb.iter().all(|&c| c <= 1.0 + 1e-6), "{pixel:?}");
        }
    }
    (worst, most)
}

#[test]
fn no_backend_makes_light() {
    let rows = [
        ("polynomial", conservation(MathBackend::Polynomial), 1e-6),
        #[cfg(feature = "libm")]
        ("libm", conservation(MathBackend::Libm), 1e-6),
        #[cfg(feature = "micromath")]
        ("micromath", conservation(MathBackend::Micromath), 1e-6),
    ];
    for (name, (worst, most), limit) in rows {
        std::println!("{name}: Σw + T − 1 {worst:e}, Σw {most}");
        assert!(worst <= limit, "{name}: {worst:e}");
    }
}
