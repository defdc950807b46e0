extern crate std;

use super::median_in_bin;
use crate::Kernel;
use crate::blob::Blob;
use crate::memory::Line;
use crate::plan::{Batch, Outputs, Plan, PlanError, Quality};
use crate::render::Renderer;
use crate::render::tests::{camera, constant, kernels, render};
use crate::sampling::Bins;
use crate::testing::{Worse, architecture, body, bytes, every_kind, halve, parameters, pi};
use core::f32::consts::LN_2;
use std::string::ToString;
use std::vec;
use std::vec::Vec;

const MEDIAN: Outputs = Outputs { median_distance: true, ..Outputs::NONE };

#[test]
fn half_of_a_constant_medium_s_light_is_gone_after_ln_2_over_sigma() {
    let a = architecture(pi(3, 4), Some(pi(3, 2)), &[(16, false)], &[8]);
    let (camera, bins) = (camera(20, 13), Bins::new(2.0, 6.0, 32).unwrap());
    for (sigma, most) in [(0.75f32, true), (8.0, true), (4096.0, true), (0.125, false)] {
        let (weights, _) = halve(&constant(&a, sigma, [0.0; 3]));
        let bytes = bytes(&body(a.clone(), None, &weights));
        let blob = Blob::open(&bytes).unwrap();
        for kernel in kernels() {
            let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
            let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
            let plan = Plan::new(&blob, &Quality::default(), MEDIAN, Batch::FULL).unwrap();
            let (mut reached, mut missed, mut worst) = (0, 0, 0.0f64);
            for (i, pixel) in render(&renderer, &plan, &camera).pixels.iter().enumerate() {
                let ray = camera.ray((i % 20) as f32 + 0.5, (i / 20) as f32 + 0.5);
                let live: Vec<u32> =
                    (0..32).filter(|&bin| plan.occupied(ray.at(bins.at(bin, 0.5)))).collect();
                let delta = 0.125;
                let thickness = f64::from(sigma) * delta * live.len() as f64;
                if live.is_empty() || thickness <= f64::from(LN_2) {
                    assert_eq!(pixel.median_distance, 6.0, "far, where no half is lost");
                    missed += 1;
                    continue;
                }
                // The medium begins at the near edge of the first occupied bin.
                let expected = 2.0 + delta * f64::from(live[0]) + f64::from(LN_2) / f64::from(sigma);
                worst = worst.worse((f64::from(pixel.median_distance) - expected).abs());
                reached += 1;
            }
            std::println!("{sigma} {kernel:?}: {reached} reached, {missed} not, {worst:e}");
            // Error of t: half an ulp (2.4e-7) each for the bin's middle, the bin's edge and their sum. Error of the
            // optical thickness: two ulp of ln 2 (1.2e-7), divided by `sigma`.
            assert!(worst <= 3.0 * 2.4e-7 + 1.2e-7 / f64::from(sigma), "{worst:e}");
            assert!(reached > 50 || !most, "{reached}");
            assert!(missed > 20);
        }
    }
}

#[test]
fn a_cut_of_up_to_one_half_changes_no_median_and_more_is_refused() {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 61));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let plan = |transmittance_cut, outputs| {
        let quality = Quality { transmittance_cut, ..Quality::EXACT };
        Plan::new(&blob, &quality, outputs, Batch::SMALLEST)
    };
    let median = |cut| -> Vec<f32> {
        let picture = render(&renderer, &plan(cut, MEDIAN).unwrap(), &camera(24, 24));
        picture.pixels.iter().map(|pixel| pixel.median_distance).collect()
    };
    let exact = median(0.0);
    assert!(exact.iter().filter(|&&t| t < 6.0).count() > 100, "some have a median");
    assert!(exact.iter().filter(|&&t| t == 6.0).count() > 50, "some have none");
    for cut in [1e-2, 0.3, 0.5] {
        assert_eq!(median(cut), exact, "{cut}");
    }
    let found = 0.5f32.next_up();
    let error = plan(found, MEDIAN).unwrap_err();
    assert_eq!(error, PlanError::MedianBehindCut { found });
    assert!(error.to_string().contains("transmittance_cut: expected at most 0.5"), "{error}");
    assert!(plan(found, Outputs::ALL).is_ok(), "nobody asked for the median");
    assert_eq!(plan(1.0, MEDIAN).unwrap_err(), PlanError::TransmittanceCut { found: 1.0 });
}

#[test]
fn the_median_stays_in_its_bin() {
    // Optical thickness in front of the bin, and `sigma`. The first two bins are opaque; the third thickness was
    // rounded to above ln 2.
    for (thickness, sigma) in [(0.0, f32::INFINITY), (0.5, f32::MAX), (0.7, 1.0), (0.0, 1.0), (0.69, 1e-30)] {
        let t = median_in_bin(thickness, sigma, 3.0, 0.25);
        assert!((2.875..=3.125).contains(&t), "{thickness} {sigma}: {t}");
    }
    assert_eq!(median_in_bin(0.0, f32::INFINITY, 3.0, 0.25), 2.875, "the front of a wall");
    assert_eq!(median_in_bin(0.0, 4.0 * LN_2, 3.0, 0.5), 3.0, "half way through the bin");
}

#[test]
fn half_of_the_light_is_left_ln_2_behind_the_edge_of_a_medium_of_density_1() {
    // A medium of density 1 begins at 2. In front of this bin (2.5 to 3), its optical thickness is 0.5.
    let t = median_in_bin(0.5, 1.0, 2.75, 0.5);
    assert!((t - (2.0 + LN_2)).abs() < 1e-6);
}
