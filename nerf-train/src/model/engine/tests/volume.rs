//! Tests of compositing, of its derivatives, and of the division of a batch into chunks.

use super::*;
use crate::model::engine::batch::{Chunk, SAMPLES, cut};
use crate::model::engine::volume_grad::{Samples, Scratch, squared_error};
use nerf_core::simd::BLOCK;

pub(super) const RAY: BatchRay =
    BatchRay { dir: [0.0, 0.0, -1.0], rgb: [0.2, 0.5, 0.9], background: [1.0, 0.5, 0.0], samples: 3 };

pub(super) fn error_of(
    ray: &BatchRay,
    sigma: &[f32],
    deltas: &[f32],
    colour: &[f32],
) -> (f64, Vec<f32>, Vec<f32>) {
    let mut d_sigma = vec![0.0; sigma.len()];
    let mut d_colour = vec![0.0; colour.len()];
    let samples = Samples { deltas, sigma: Some(sigma), colour };
    let rays = std::slice::from_ref(ray);
    let sum = squared_error(rays, &samples, 1.0, &mut Scratch::default(), &mut d_sigma, &mut d_colour);
    (sum, d_sigma, d_colour)
}

#[test]
fn derivatives_of_a_ray_are_finite_differences() {
    let mut colour = vec![0.0; 3 * BLOCK];
    for k in 0..3 {
        for i in 0..3 {
            colour[k * BLOCK + i] = uniform(1, (3 * k + i) as u64) as f32;
        }
    }
    let (sigma, deltas) = ([1.5f32, 0.25, 4.0], [0.5f32, 0.25, 0.125]);
    let (_, d_sigma, d_colour) = error_of(&RAY, &sigma, &deltas, &colour);
    // The step is exact in f32, and the sum is f64: the error of the difference is of order h².
    let h = 1.0 / 1024.0;
    for i in 0..3 {
        let at = |h: f32| {
            let mut sigma = sigma;
            sigma[i] += h;
            error_of(&RAY, &sigma, &deltas, &colour).0
        };
        let difference = (at(h) - at(-h)) / f64::from(2.0 * h);
        assert!((difference - f64::from(d_sigma[i])).abs() < 1e-6, "{i}");
    }
    for i in 0..3 * BLOCK {
        let at = |h: f32| {
            let mut colour = colour.clone();
            colour[i] += h;
            error_of(&RAY, &sigma, &deltas, &colour).0
        };
        let difference = (at(h) - at(-h)) / f64::from(2.0 * h);
        assert!((difference - f64::from(d_colour[i])).abs() < 1e-4, "{i}");
    }
}

#[test]
fn extremes_of_sigma_and_delta_stay_finite() {
    let extremes = [0.0f32, 1e-30, 1e-10, 1.0, 1e6];
    let lengths = [0.0f32, 1e-30, 1e-10, 1.0, 1e10, 1e30];
    let colour = vec![0.5; 3 * BLOCK];
    for a in extremes {
        for b in extremes {
            for delta in lengths {
                let (sum, d_sigma, d_colour) = error_of(&RAY, &[a, b, 1.0], &[delta, 1.0, delta], &colour);
                assert!(sum.is_finite() && sum <= 3.0);
                assert!(d_sigma.iter().chain(&d_colour).all(|g| g.is_finite()), "{a} {b} {delta}");
            }
        }
    }
}

#[test]
fn a_wall_shows_its_colour_and_hides_what_is_behind() {
    let colour = vec![0.25; 3 * BLOCK];
    let (sum, d_sigma, d_colour) = error_of(&RAY, &[0.0, 1e6, 3.0], &[1.0; 3], &colour);
    let expected: f64 = RAY.rgb.iter().map(|&c| (0.25 - f64::from(c)).powi(2)).sum();
    assert!((sum - expected).abs() < 1e-12);
    assert_eq!((d_sigma[1], d_sigma[2], d_colour[0], d_colour[2]), (0.0, 0.0, 0.0, 0.0));
    // A denser sample in front of the wall would change nothing: its colour is equal to the wall's.
    assert_eq!(d_sigma[0], 0.0);
}

#[test]
fn splitting_a_bin_changes_nothing() {
    let colour = vec![0.75; 3 * BLOCK];
    let whole = error_of(&RAY, &[2.0, 5.0, 1.0], &[0.5, 0.25, 0.125], &colour).0;
    let ray = BatchRay { samples: 4, ..RAY };
    let split = error_of(&ray, &[2.0, 5.0, 5.0, 1.0], &[0.5, 0.125, 0.125, 0.125], &colour).0;
    assert!((whole - split).abs() < 1e-12);
}

#[test]
fn chunks_cover_a_batch_once_and_in_order() {
    let mut batch = Batch { empty: vec![[0.0; 3]; 1100], ..Batch::default() };
    for samples in [0, 511, 2, 2000, 0, 0, 512, 1].into_iter().chain([0; 5000]) {
        batch.rays.push(BatchRay { samples, ..RAY });
    }
    let mut chunks = Vec::new();
    cut(&batch, SAMPLES, &mut chunks);
    let (mut next_ray, mut next_sample, mut next_empty) = (0, 0, 0);
    for chunk in &chunks {
        match chunk {
            Chunk::Rays { rays, samples } => {
                assert_eq!((rays.start, samples.start), (next_ray, next_sample));
                let claimed: u32 = batch.rays[rays.clone()].iter().map(|ray| ray.samples).sum();
                assert_eq!(claimed as usize, samples.len());
                assert!(samples.len() <= 512 || rays.len() == 1);
                (next_ray, next_sample) = (rays.end, samples.end);
            }
            Chunk::Empty(points) => {
                assert_eq!(points.start, next_empty);
                assert!(points.len() <= 512);
                next_empty = points.end;
            }
        }
    }
    assert_eq!((next_ray, next_empty), (batch.rays.len(), 1100));
}
