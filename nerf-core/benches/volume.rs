//! Benchmark of volume rendering: densities and colours along rays are composited to pixels.

mod support;

use nerf_core::volume::composite;
use nerf_core::{Kernel, MathBackend};
use std::hint::black_box;
use support::{Table, noise};

const RAYS: usize = 256;
/// Floating-point operations per composited sample: two exponentials of 17 each, six compensated sums of 4 each, and 10
/// others.
const FLOP_PER_SAMPLE: usize = 68;

fn main() {
    let mut table = Table::new();
    for samples in [16, 64, 192, 1024] {
        let edges: Vec<f32> = (0..=samples).map(|i| 2.0 + 4.0 * i as f32 / samples as f32).collect();
        let sigma: Vec<f32> = noise(RAYS * samples, 1).iter().map(|x| x.abs()).collect();
        let rgb: Vec<[f32; 3]> = noise(3 * RAYS * samples, 2).chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
        let flop = (FLOP_PER_SAMPLE * RAYS * samples) as f64;
        // Compared with the peak of the fastest kernel, although `composite` computes one ray at a time, in one SIMD
        // lane.
        let name = format!("composite, {RAYS} rays of {samples} samples");
        table.line(&name, Kernel::detect(), 1, flop, || {
            for (sigma, rgb) in sigma.chunks(samples).zip(rgb.chunks(samples)) {
                black_box(composite(MathBackend::Polynomial, sigma, rgb, &edges, [0.0; 3]).expect("a ray"));
            }
        });
    }
}
