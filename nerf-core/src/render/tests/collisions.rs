//! Tests of collisions drawn along rays: their mean colour is the composited colour.

use super::segments::{of_rays, pixels, scenes, segments};
use super::*;
use crate::render::RaySegment;
use crate::sampling::random::{Purpose, uniform};

/// Number of collisions drawn on each ray.
const DRAWS: usize = 1024;
const RAYS: usize = 300;

fn sampled(file: &[u8], kernel: Kernel, rays: &[RaySegment], random: &[f32]) -> Vec<Pixel> {
    let forward = camera(1, 1).pose().forward();
    pixels(file, kernel, (0.0, f32::INFINITY), rays.len(), |worker, put| {
        worker.sample_rays(rays, random, Some(forward), &mut |i, pixel| put(i, pixel)).unwrap();
    })
}

fn some_rays() -> Vec<RaySegment> {
    segments(0.3, 4.5).into_iter().skip(60).take(RAYS).collect()
}

/// For each channel of each ray, the mean of the collisions is within a few standard errors of the composited value.
#[test]
fn the_mean_of_collisions_is_the_composited_colour() {
    for (scene, file) in scenes().iter().enumerate() {
        let kernel = Kernel::detect();
        let rays = some_rays();
        let exact = of_rays(file, kernel, &rays);
        let (mut sums, mut squares) = (vec![[0.0f64; 4]; RAYS], vec![[0.0f64; 4]; RAYS]);
        for draw in 0..DRAWS {
            let random: Vec<f32> =
                (0..RAYS).map(|i| uniform(9, Purpose::Pixel, draw as u64, i as u64)).collect();
            for (i, pixel) in sampled(file, kernel, &rays, &random).iter().enumerate() {
                assert!(pixel.opacity == 0.0 || pixel.opacity == 1.0);
                let [r, g, b] = pixel.rgb;
                for (c, x) in [r, g, b, pixel.opacity].into_iter().enumerate() {
                    sums[i][c] += f64::from(x);
                    squares[i][c] += f64::from(x) * f64::from(x);
                }
            }
        }
        let (mut scores, mut count, n) = (0.0, 0.0, DRAWS as f64);
        for (i, exact) in exact.iter().enumerate() {
            let [r, g, b] = exact.rgb;
            for (c, exact) in [r, g, b, exact.opacity].into_iter().enumerate() {
                let mean = sums[i][c] / n;
                let error = ((squares[i][c] / n - mean * mean).max(0.0) / (n - 1.0)).sqrt();
                let off = (mean - f64::from(exact)).abs();
                assert!(
                    off <= 4.5 * error + 1e-4,
                    "scene {scene}, ray {i}, {c}: off by {off}, error {error}"
                );
                if error > 1e-5 {
                    scores += (off / error).powi(2);
                    count += 1.0;
                }
            }
        }
        let score = scores / count;
        assert!(count > 400.0, "scene {scene}: only {count} colours vary");
        assert!((0.8..1.2).contains(&score), "scene {scene}: mean squared score {score} of {count}");
    }
}

/// A ray collides if its random number is below its opacity. With a larger number, the ray collides farther away. Other
/// rays of the call have no effect.
#[test]
fn a_ray_collides_where_its_opacity_reaches_the_number() {
    for file in &scenes() {
        for kernel in kernels() {
            let rays = some_rays();
            let opacity: Vec<f32> = of_rays(file, kernel, &rays).iter().map(|pixel| pixel.opacity).collect();
            let scaled = |by: f32| -> Vec<f32> { opacity.iter().map(|o| (o * by).min(0.999)).collect() };
            let above: Vec<f32> = opacity.iter().map(|o| (o + 1e-4).min(0.9999)).collect();
            let near = sampled(file, kernel, &rays, &scaled(0.3));
            let far = sampled(file, kernel, &rays, &scaled(0.9));
            let missed = sampled(file, kernel, &rays, &above);
            for i in (0..RAYS).filter(|&i| opacity[i] > 1e-3 && opacity[i] < 0.999) {
                assert_eq!((near[i].opacity, far[i].opacity, missed[i].opacity), (1.0, 1.0, 0.0));
                assert!(near[i].ray_distance <= far[i].ray_distance && far[i].ray_distance < 4.5 + 1e-3);
                assert!(missed[i].ray_distance == f32::INFINITY && missed[i].z_depth == f32::INFINITY);
                // Up to the collision, the ray's opacity is its random number.
                let cut = RaySegment { t_max: far[i].ray_distance, ..rays[i] };
                let seen = of_rays(file, kernel, &[cut])[0].opacity;
                assert!((seen - 0.9 * opacity[i]).abs() < 2e-3, "{kernel}: {seen}, {}", 0.9 * opacity[i]);
            }
            for i in [0, 7, 200] {
                let alone = sampled(file, kernel, &rays[i..=i], &scaled(0.9)[i..=i]);
                assert_eq!(alone[0], far[i], "{kernel}");
            }
        }
    }
}

#[test]
fn what_is_no_random_number_is_refused_with_its_index() {
    let file = &scenes()[0];
    let rays = some_rays();
    let refused = |random: &[f32]| {
        let found = core::cell::Cell::new(None);
        pixels(file, Kernel::detect(), (0.0, f32::INFINITY), RAYS, |worker, _| {
            found
                .set(worker.sample_rays(&rays, random, None, &mut |_, _| panic!("nothing is written")).err());
        });
        found.get()
    };
    let half = [0.5; RAYS];
    for wrong in [1.0f32.next_up(), -0.1, f32::NAN, f32::INFINITY] {
        let mut random = half;
        random[17] = wrong;
        assert_eq!(refused(&random), Some(RenderError::Random { index: 17 }));
    }
    // The number 1 is replaced by the largest f32 below 1.
    let (mut rounded, mut below) = (half, half);
    (rounded[17], below[17]) = (1.0, 1.0f32.next_down());
    assert_eq!(
        sampled(file, Kernel::detect(), &rays, &rounded),
        sampled(file, Kernel::detect(), &rays, &below)
    );
    assert_eq!(refused(&half[1..]), Some(RenderError::Random { index: RAYS - 1 }));
    assert_eq!(refused(&[0.5; RAYS + 1]), Some(RenderError::Random { index: RAYS }));
}
