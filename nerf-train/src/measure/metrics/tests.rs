use super::*;
use nerf_core::sampling::{Purpose, uniform};

/// A deterministic noise picture.
fn noise(pixels: usize, seed: u32) -> Vec<[f32; 3]> {
    let value = |pixel, channel| uniform(seed.into(), Purpose::Image, pixel as u64, channel);
    (0..pixels).map(|pixel| [0, 1, 2].map(|channel| value(pixel, channel))).collect()
}

/// SSIM by its definition: every window's weighted mean, variance and covariance, in two passes.
fn ssim_brute_force(a: &[[f32; 3]], b: &[[f32; 3]], width: usize, height: usize) -> f64 {
    let (across, down) = (gaussian(width), gaussian(height));
    let mut sum = 0.0;
    let mut count = 0;
    for c in 0..3 {
        for y0 in 0..=height - down.len() {
            for x0 in 0..=width - across.len() {
                let window: Vec<(f64, f64, f64)> = (0..down.len() * across.len())
                    .map(|i| (i % across.len(), i / across.len()))
                    .map(|(x, y)| {
                        let i = (y0 + y) * width + x0 + x;
                        (across[x] * down[y], f64::from(a[i][c]), f64::from(b[i][c]))
                    })
                    .collect();
                let ma: f64 = window.iter().map(|(w, p, _)| w * p).sum();
                let mb: f64 = window.iter().map(|(w, _, q)| w * q).sum();
                let va: f64 = window.iter().map(|(w, p, _)| w * (p - ma).powi(2)).sum();
                let vb: f64 = window.iter().map(|(w, _, q)| w * (q - mb).powi(2)).sum();
                let cov: f64 = window.iter().map(|(w, p, q)| w * (p - ma) * (q - mb)).sum();
                sum += (2.0 * ma * mb + C1) * (2.0 * cov + C2) / ((ma * ma + mb * mb + C1) * (va + vb + C2));
                count += 1;
            }
        }
    }
    sum / f64::from(count)
}

#[test]
fn mse_and_psnr_of_hand_computed_pictures() {
    // One channel of one of two pixels is off by 0.5: 0.25 / 6.
    let (a, b) = ([[0.0; 3], [0.0; 3]], [[0.0; 3], [0.5, 0.0, 0.0]]);
    assert!((mse(&a, &b) - 0.25 / 6.0).abs() < 1e-15);
    assert!((psnr_db(&a, &b) - 13.802_112_417).abs() < 1e-8);
    // Black against white: MSE 1, 0 dB, and not "-0".
    let db = psnr_db(&[[0.0; 3]], &[[1.0; 3]]);
    assert_eq!(format!("{db}"), "0");
}

#[test]
fn psnr_of_equal_pictures_is_infinite() {
    let a = noise(50, 1);
    assert_eq!(psnr_db(&a, &a), f64::INFINITY);
}

#[test]
fn differences_of_infinite_psnrs_are_no_nan() {
    let inf = f64::INFINITY;
    assert_eq!((gain_db(inf, inf), gain_db(inf, 30.0), gain_db(30.0, inf)), (0.0, inf, -inf));
    assert_eq!(gain_db(30.5, 30.0), 0.5);
    assert!(gain_db(f64::NAN, f64::NAN).is_nan() && gain_db(inf, f64::NAN).is_nan());
}

#[test]
fn no_better_than_the_mean_colour_is_flat() {
    // Half black, half white against grey: MSE 0.25.
    let picture = [[0.0; 3], [1.0; 3]];
    let flat = flat_psnr_db(&picture);
    assert!((flat - psnr_db_of_mse(0.25)).abs() < 1e-12);
    let of_one = |psnr, flat| is_flat([(psnr, flat)]);
    assert!(of_one(flat, flat) && of_one(3.0, flat) && of_one(f64::NAN, flat) && !of_one(7.0, flat));
    // A picture of one colour, or an empty one, cannot show whether a network has learned anything.
    assert_eq!(flat_psnr_db(&[[0.5; 3]; 4]), f64::INFINITY);
    assert!(!of_one(30.0, f64::INFINITY) && !of_one(30.0, flat_psnr_db(&[])) && !is_flat([]));
}

#[test]
fn one_view_above_its_own_mean_colour_proves_learning() {
    let inf = f64::INFINITY;
    // The mean, 25.5 dB, is below the 26 dB of flat colours, but the second view gains 4 dB.
    assert!(!is_flat([(35.0, 40.0), (16.0, 12.0)]));
    assert!(!is_flat([(16.0, 12.0), (35.0, 40.0)]) && !is_flat([(f64::NAN, 5.0), (9.0, 6.0)]));
    assert!(is_flat([(35.0, 40.0), (12.0, 12.0)]) && is_flat([(f64::NAN, 5.0), (5.0, 6.0)]));
    // A view of one colour proves no learning, and does not hide that the other views are flat.
    assert!(is_flat([(30.0, inf), (4.0, 5.0), (inf, inf), (5.0, 6.0)]));
    assert!(!is_flat([(30.0, inf), (inf, inf)]));
    // The mean for comparison leaves out views of one colour, too.
    assert_eq!(mean_flat_psnr_db([inf, 5.0, inf, 6.0]), 5.5);
    assert_eq!((mean_flat_psnr_db([inf]), mean_flat_psnr_db([])), (inf, inf));
}

#[test]
fn nan_and_mismatched_inputs_give_nan() {
    let a = noise(169, 1);
    let mut b = a.clone();
    b[7][1] = f32::NAN;
    assert!(psnr_db(&a, &b).is_nan());
    assert!(psnr_db(&[[f32::NAN; 3]; 4], &[[f32::NAN; 3]; 4]).is_nan());
    assert!(ssim(&a, &b, 13, 13).is_nan());
    assert!(psnr_db(&a, &a[1..]).is_nan());
    assert!(psnr_db(&[], &[]).is_nan());
    assert!(ssim(&a, &a[1..], 13, 13).is_nan());
    assert!(ssim(&a, &a, 13, 12).is_nan());
    assert!(ssim(&[], &[], 0, 5).is_nan());
    assert!(ssim(&a, &a, usize::MAX, 2).is_nan());
}

#[test]
fn ssim_of_constant_pictures_is_one() {
    for level in [0.0, 1e-6, 0.25, 1.0] {
        let flat = vec![[level; 3]; 400];
        let similarity = ssim(&flat, &flat, 20, 20);
        assert!((similarity - 1.0).abs() < 1e-9, "{level}: {similarity}");
    }
    // Black against white: only the luminance term is left, C1 / (1 + C1).
    let (black, white) = (vec![[0.0; 3]; 400], vec![[1.0; 3]; 400]);
    assert!((ssim(&black, &white, 20, 20) - 1e-4 / 1.0001).abs() < 1e-9);
}

#[test]
fn ssim_of_one_pixel_is_the_luminance_term() {
    // (2·0.2·0.6 + 1e-4) / (0.04 + 0.36 + 1e-4), f32 inputs.
    let expected = 0.2401 / 0.4001;
    assert!((ssim(&[[0.2; 3]], &[[0.6; 3]], 1, 1) - expected).abs() < 1e-6);
}

#[test]
fn ssim_equals_its_definition() {
    for (width, height) in [(31, 17), (11, 11), (12, 30), (5, 40), (10, 10), (1, 20), (2, 2)] {
        let a = noise(width * height, 7);
        let b: Vec<[f32; 3]> = a
            .iter()
            .zip(noise(width * height, 8))
            .map(|(p, n)| [0, 1, 2].map(|c| 0.8 * p[c] + 0.2 * n[c]))
            .collect();
        let (fast, slow) = (ssim(&a, &b, width, height), ssim_brute_force(&a, &b, width, height));
        assert!((fast - slow).abs() < 1e-10, "{width}×{height}: {fast} against {slow}");
        assert!(fast < 1.0);
        assert!((ssim(&a, &a, width, height) - 1.0).abs() < 1e-9);
    }
}

#[test]
fn ssim_is_symmetric_and_falls_with_noise() {
    let a = noise(40 * 40, 3);
    let with_noise = |amount: f32| -> Vec<[f32; 3]> {
        let other = noise(40 * 40, 4);
        a.iter().zip(&other).map(|(p, n)| [0, 1, 2].map(|c| p[c] + amount * (n[c] - 0.5))).collect()
    };
    let (little, much) = (with_noise(0.1), with_noise(0.5));
    assert!((ssim(&a, &much, 40, 40) - ssim(&much, &a, 40, 40)).abs() < 1e-12);
    assert!(ssim(&a, &little, 40, 40) > ssim(&a, &much, 40, 40));
}

#[test]
fn pixels_that_do_not_count_change_nothing() {
    let (width, height) = (24, 17);
    let noise = |seed: usize| -> Vec<[f32; 3]> {
        (0..width * height)
            .map(|i| [0, 1, 2].map(|c| ((i * 37 + c * 11 + seed) % 101) as f32 / 100.0))
            .collect()
    };
    let (a, b) = (noise(0), noise(5));
    let all = vec![true; width * height];
    assert_eq!(ssim_of(&a, &b, width, height, Some(&all)), ssim(&a, &b, width, height));
    // The right third is not marked: even NaN there changes nothing.
    let mask: Vec<bool> = (0..width * height).map(|i| i % width < 16).collect();
    let mut other = a.clone();
    other.iter_mut().zip(&mask).filter(|(_, counts)| !**counts).for_each(|(pixel, _)| *pixel = [f32::NAN; 3]);
    let masked = ssim_of(&a, &b, width, height, Some(&mask));
    assert!(masked < 1.0 && masked == ssim_of(&other, &b, width, height, Some(&mask)), "{masked}");
    assert_eq!(ssim_of(&b, &b, width, height, Some(&mask)), 1.0);
    assert!(ssim_of(&a, &b, width, height, Some(&vec![false; width * height])).is_nan());
    assert!(ssim_of(&a, &b, width, height, Some(&mask[1..])).is_nan());
}
