extern crate std;

use crate::Kernel;
use crate::blob::{Blob, StoredOccupancy};
use crate::camera::Camera;
use crate::math::MathBackend;
use crate::memory::Line;
use crate::network::{Architecture, GradientScratch, Network, Scratch, Weights};
use crate::plan::{Batch, Outputs, Plan, PlanError, Quality};
use crate::render::Renderer;
use crate::render::tests::{camera, constant, kernels, render};
use crate::sampling::Bins;
use crate::simd::BLOCK;
use crate::testing::{architecture, body, bytes, every_kind, halve, parameters, pi, tolerance};
use crate::volume::{Accumulator, NormalSum, Pixel};
use glam::Vec3;
use std::vec;
use std::vec::Vec;

const NORMALS: Outputs = Outputs { normals: true, opacity: true, ..Outputs::NONE };

/// Network with the raw density start + Σ_i head · relu(slope_i · x + bias), without an encoding.
fn one_layer(slopes: &[Vec3], bias: f32, head: f32, start: f32) -> (Architecture, Vec<f32>) {
    let a = architecture(pi(3, 0), None, &[(slopes.len() as u16, false)], &[]);
    let mut all = vec![0.0; a.parameters()];
    let layers = a.layers();
    for (i, slope) in slopes.iter().enumerate() {
        all[layers[0].weights + 3 * i..][..3].copy_from_slice(&slope.to_array());
        all[layers[0].bias + i] = bias;
        all[layers[1].weights + i] = head;
    }
    all[layers[1].bias] = start;
    (a, all)
}

/// `n` evenly spread directions: points of a Fibonacci lattice on the sphere.
fn directions(n: usize) -> Vec<Vec3> {
    let turn = core::f32::consts::PI * (5f32.sqrt() - 1.0);
    let direction = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f32 / n as f32;
        let (r, angle) = ((1.0 - z * z).sqrt(), turn * i as f32);
        Vec3::new(r * angle.cos(), r * angle.sin(), z)
    };
    (0..n).map(direction).collect()
}

#[test]
fn a_plane_s_normal_is_the_plane_s() {
    // Density 64 (slope · x) where slope · x is above 0; elsewhere 0.
    let slope = Vec3::new(0.75, -1.5, 1.0);
    let (a, all) = one_layer(&[slope], 2.0, 64.0, -128.0);
    let (weights, _) = halve(&all);
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let expected = -slope.normalize();
    for kernel in kernels() {
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        let plan = Plan::new(&blob, &Quality::default(), NORMALS, Batch::FULL).unwrap();
        let picture = render(&renderer, &plan, &camera(24, 17));
        // At a lower opacity, the colour cut may have skipped all samples of the ray.
        let solid = picture.pixels.iter().filter(|pixel| pixel.opacity > Quality::COLOUR_CUT);
        let empty = picture.pixels.iter().filter(|pixel| pixel.opacity <= 1e-4);
        let (solid, empty): (Vec<&Pixel>, Vec<&Pixel>) = (solid.collect(), empty.collect());
        assert!(solid.len() > 50 && empty.len() > 50, "{} {}", solid.len(), empty.len());
        for pixel in solid {
            // Tolerance: a few roundings of 6e-8 in each component of the unit vector.
            assert!((Vec3::from(pixel.normal) - expected).abs().max_element() <= 3e-7, "{:?}", pixel.normal);
        }
        assert!(empty.iter().all(|pixel| pixel.normal == [0.0; 3]));
    }
}

#[test]
fn a_ball_s_normals_point_outward() {
    // Σ relu(d · x) over n directions d is about n |x| / 4. The density is thus about 100 (0.6 − |x|): a ball of many
    // facets.
    let n = 200;
    let (a, all) = one_layer(&directions(n), 0.0, -400.0 / n as f32, 60.0);
    let (weights, _) = halve(&all);
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let (camera, outputs) = (camera(32, 32), Outputs { ray_distance: true, ..NORMALS });
    for kernel in kernels() {
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        let quality = Quality { samples: 512, ..Quality::default() };
        let plan = Plan::new(&blob, &quality, outputs, Batch::FULL).unwrap();
        let (mut seen, mut worst) = (0, 1.0f32);
        for (i, pixel) in render(&renderer, &plan, &camera).pixels.iter().enumerate() {
            let ray = camera.ray((i % 32) as f32 + 0.5, (i / 32) as f32 + 0.5);
            let normal = Vec3::from(pixel.normal);
            if pixel.opacity <= 0.9 {
                continue;
            }
            assert!((normal.length() - 1.0).abs() < 2e-7 && normal.dot(ray.dir) < 0.0);
            worst = worst.min(normal.dot(ray.at(pixel.ray_distance).normalize()));
            seen += 1;
        }
        std::println!("{kernel:?}: {seen} pixels, at most {:.2} degrees off", worst.acos().to_degrees());
        // Neighbouring directions are about √(4π / n) apart, 14 degrees. A normal is the mean of the directions in a
        // hemisphere.
        assert!(seen > 50 && worst > 5f32.to_radians().cos(), "{seen} {worst}");
    }
}

/// Returns a reference, computed one sample at a time: the normals of all pixels, and the number of density gradients.
fn sample_by_sample(
    renderer: &Renderer<'_>,
    quality: &Quality,
    camera: &Camera,
    (width, height): (u32, u32),
) -> (Vec<[f32; 3]>, u64) {
    let network = renderer.network();
    let bins = Bins::new(2.0, 6.0, 32).unwrap();
    let batch = Batch { rays: 1, samples: BLOCK };
    let plan = Plan::new(renderer.blob(), quality, Outputs::NONE, batch).unwrap();
    let mut memory = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    // Standard deviation of a point that is uniform in a bin of width 1/8: 1/8 divided by √12.
    let blur = 0.125 * 0.288_675_13;
    let (mut normals, mut evaluations) = (vec![], 0);
    for i in 0..width * height {
        let ray = camera.ray((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
        let (mut gathered, mut sum) = (Accumulator::NONE, NormalSum::NONE);
        for t in (0..32).map(|i| bins.at(i, 0.5)).filter(|&t| plan.occupied(ray.at(t))) {
            let (mut sigma, mut rgb) = ([f32::NAN], [[f32::NAN; 3]]);
            let (p, dir) = (ray.at(t), ray.dir.into());
            renderer.query(&plan, &[p.into()], &[dir], &mut memory, &mut sigma, &mut rgb).unwrap();
            gathered.add_density(MathBackend::Polynomial, sigma[0], t, bins.delta());
            if let Some(weight) = gathered.take_uncoloured(quality.colour_cut) {
                evaluations += 1;
                sum.add(weight, gradient(network, p, blur));
            }
            if gathered.transmittance() < quality.transmittance_cut {
                break;
            }
        }
        normals.push(sum.finish(gathered.finish_from(0.0, false, [0.0; 3], 6.0, 1.0).opacity));
    }
    (normals, evaluations)
}

/// Gradient of the raw density at `p`, computed in a block whose columns all hold `p`. `blur`: standard deviation,
/// world units, of the Gaussian over which the gradient is averaged.
fn gradient(network: &Network<'_>, p: Vec3, blur: f32) -> Vec3 {
    let stride = if network.whole_blocks() { 16 } else { 1 };
    let mut encoded = vec![0.0; network.encoded_rows() * stride];
    let mut front = vec![0.0; network.activation_rows() * stride];
    let mut back = front.clone();
    let mut scratch = Scratch { stride, encoded: &mut encoded, front: &mut front, back: &mut back };
    let mut signs = vec![0; network.sign_words(stride)];
    let mut of_encoded = vec![0.0; network.gradient_rows() * stride];
    let mut memory = GradientScratch { signs: &mut signs, encoded: &mut of_encoded };
    let positions: Vec<f32> = p.to_array().into_iter().flat_map(|x| vec![x; stride]).collect();
    let mut found = vec![0.0; 3 * stride];
    network.gradient(MathBackend::Polynomial, &mut scratch, &mut memory, &positions, blur, &mut found);
    Vec3::new(found[0], found[stride], found[2 * stride])
}

#[test]
fn every_batch_gives_the_normals_and_the_work_of_one_sample_at_a_time() {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 31));
    let bits = [0b1110_1011];
    let bytes = bytes(&body(a.clone(), Some(StoredOccupancy { resolution: [2; 3], bits: &bits }), &weights));
    let blob = Blob::open(&bytes).unwrap();
    let camera = camera(9, 7);
    for kernel in kernels() {
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        for (transmittance_cut, colour_cut) in [(0.0, 0.0), (1e-2, 1e-3), (0.0, 0.02), (0.3, 0.2)] {
            let quality = Quality { transmittance_cut, colour_cut, ..Quality::default() };
            let (normals, evaluations) = sample_by_sample(&renderer, &quality, &camera, (9, 7));
            assert!(normals.iter().any(|n| *n != [0.0; 3]) && evaluations > 5, "{evaluations}");
            let in_place = !renderer.network().whole_blocks();
            let sizes: &[usize] = if in_place { &[1, 5, 63, 64] } else { &[64] };
            for (rays, &samples) in
                [1, 7, 64, 256].into_iter().flat_map(|rays| sizes.iter().map(move |s| (rays, s)))
            {
                let batch = Batch { rays, samples };
                for outputs in [NORMALS, Outputs { normals: true, ..Outputs::ALL }] {
                    let plan = Plan::new(&blob, &quality, outputs, batch).unwrap();
                    let found = render(&renderer, &plan, &camera);
                    let what = std::format!("{kernel:?} {quality:?} {batch:?} {outputs:?}");
                    let of_pixels: Vec<_> = found.pixels.iter().map(|pixel| pixel.normal).collect();
                    assert_eq!(of_pixels, normals, "{what}");
                    let c = found.counters;
                    assert_eq!(c.normal_evaluations, evaluations, "{what}");
                    // If colour is requested, it is evaluated at the samples of the normals.
                    let colours = if outputs.rgb { evaluations } else { 0 };
                    assert_eq!(c.colour_evaluations, colours, "{what}");
                    let shares = renderer.shares(&c);
                    assert_eq!(shares.normals, evaluations * a.gradient_macs() as u64, "{what}");
                    assert_eq!(shares.direction > 0, outputs.rgb, "{what}");
                }
            }
        }
    }
}

#[test]
fn kernels_agree_about_normals() {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 33));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let go = |kernel| {
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        let plan = Plan::new(&blob, &Quality::default(), NORMALS, Batch::FULL).unwrap();
        render(&renderer, &plan, &camera(16, 16)).pixels
    };
    let oracle = go(Kernel::IN_PLACE);
    for kernel in kernels() {
        // Rounding may switch a unit whose input is near 0. With weights of 8 significant bits, this happens at many
        // samples. Therefore only the median error of all pixels is bounded.
        let mut off: Vec<f32> = go(kernel)
            .iter()
            .zip(&oracle)
            .filter(|(a, b)| a.opacity > 0.1 && b.opacity > 0.1)
            .map(|(a, b)| (Vec3::from(a.normal) - Vec3::from(b.normal)).length())
            .collect();
        off.sort_unstable_by(f32::total_cmp);
        let median = off[off.len() / 2];
        std::println!("{kernel:?}: {median:e} of {}", off.len());
        assert!(
            off.len() > 50 && f64::from(median) <= 5.0 * tolerance(kernel, 2e-6),
            "{kernel:?}: {median:e}"
        );
    }
}

#[test]
fn a_blur_takes_ripples_away_and_none_gives_the_gradient_itself() {
    // A plane with a ripple that is too fine for the samples: 64 x + 0.5 sin(2^9 π z).
    let a = architecture(pi(3, 10), None, &[(1, false)], &[]);
    let mut all = vec![0.0; a.parameters()];
    let layers = a.layers();
    (all[0], all[3 + 6 * 9 + 2], all[layers[0].bias]) = (64.0, 0.5, 0.0);
    all[layers[1].weights] = 1.0;
    let (weights, _) = halve(&all);
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let tilt = |blur| {
        let plan = Plan::new(&blob, &Quality::default(), NORMALS, Batch::SMALLEST).unwrap();
        let picture = render(&renderer, &plan.with_normal_blur(blur).unwrap(), &camera(16, 16));
        let solid = picture.pixels.iter().filter(|pixel| pixel.opacity > 0.5);
        solid.fold(0.0f32, |most, pixel| most.max((Vec3::from(pixel.normal) - Vec3::NEG_X).length()))
    };
    assert!(tilt(0.0) > 0.5, "the ripple's slope is 804 beside the plane's 64");
    assert!(tilt(Plan::NORMAL_BLUR) < 1e-6, "a bin holds 32 of its waves");
    let plan = Plan::new(&blob, &Quality::default(), NORMALS, Batch::SMALLEST).unwrap();
    for bad in [-1.0, f32::INFINITY, f32::NAN] {
        assert!(matches!(plan.with_normal_blur(bad), Err(PlanError::NormalBlur { .. })), "{bad}");
    }
}

#[test]
fn a_medium_without_a_slope_has_no_normal() {
    let a = every_kind();
    let (weights, _) = halve(&constant(&a, 2.0, [0.0; 3]));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let plan = Plan::new(&blob, &Quality::EXACT, NORMALS, Batch::SMALLEST).unwrap();
    let picture = render(&renderer, &plan, &camera(8, 8));
    assert!(picture.pixels.iter().any(|pixel| pixel.opacity > 0.5));
    assert!(picture.pixels.iter().all(|pixel| pixel.normal == [0.0; 3]));
    assert!(picture.counters.normal_evaluations > 0 && picture.counters.invalid_samples == 0);
}

#[test]
fn gradients_beyond_the_numbers_are_counted_and_have_no_direction() {
    let a = architecture(pi(3, 0), None, &[(1, false)], &[]);
    let layers = a.layers();
    let mut all = vec![0.0; a.parameters()];
    all[layers[0].weights] = 1e30;
    all[layers[0].bias] = 1e30;
    all[layers[1].weights] = 1e30;
    let bytes = bytes(&body(a.clone(), None, &vec![0; 2 * a.parameters()]));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::with_parameters(blob.clone(), Kernel::IN_PLACE, &all, None).unwrap();
    let plan = Plan::new(&blob, &Quality::EXACT, NORMALS, Batch { rays: 3, samples: BLOCK }).unwrap();
    let picture = render(&renderer, &plan, &camera(8, 8));
    assert!(picture.counters.normal_evaluations > 0);
    assert_eq!(picture.counters.invalid_samples, picture.counters.normal_evaluations);
    assert!(picture.pixels.iter().all(|pixel| pixel.normal == [0.0; 3]));
    // The same parameters make a valid network of prepared f32 weights.
    assert!(Network::new(&a, Weights::Prepared(&all), crate::Isa::Portable).is_some());
}

#[test]
fn opposing_normals_cancel_and_steep_ones_do_not_overflow() {
    let up = Vec3::new(0.3, -0.4, 1.2);
    let mut sum = NormalSum::NONE;
    sum.add(0.5, up);
    let one = Vec3::from(sum.finish(0.5));
    assert!((one + up.normalize()).length() < 2e-7, "{one}");
    sum.add(0.5, -up);
    assert_eq!(sum.finish(1.0), [0.0; 3], "two halves that cancel");
    for size in [f32::MAX, 1e-37, f32::MIN_POSITIVE / 1024.0] {
        let mut sum = NormalSum::NONE;
        sum.add(1e-2, Vec3::new(0.0, -size, 0.0));
        assert_eq!(sum.finish(1e-2), [0.0, 1.0, 0.0], "{size:e}");
        assert_eq!(sum.finish(1e-4), [0.0; 3], "no surface");
    }
    for nothing in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY, Vec3::new(0.0, f32::NEG_INFINITY, 1.0)] {
        let mut sum = NormalSum::NONE;
        sum.add(1.0, nothing);
        assert_eq!(sum.finish(1.0), [0.0; 3], "{nothing}");
    }
}
