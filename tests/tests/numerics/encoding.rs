//! Errors of the positional encoding at every level, with every kernel and maths backend.

mod domain;
mod grid;
mod laws;

pub use {domain::CASES as DOMAIN, grid::CASES as GRID, laws::CASES as LAWS};

use crate::table::{BACKENDS, Row, Worst, cases, isas};
use nerf_core::encoding::{AngleScale, SinusoidalEncoding, encode_block};
use nerf_testing::noise::share;
use nerf_testing::oracle;

/// Bound: three roundings of the largest angle among [`least`], 2^15 π 2^-126; cosines are 1.
const TINY: f64 = 2.2e-40;

cases! {
    sixteen_levels_up_to_1e4_with_pi: "absolute error of sin and cos" =>
        || levels(AngleScale::Pi, 16, &hard(1e4), [1.2e-7, 4e-7, 2e-3, 5e-3]);
    ten_levels_up_to_1e4_with_pi: "absolute error of sin and cos" =>
        || levels(AngleScale::Pi, 10, &hard(1e4), [1.2e-7, 4e-7, 2e-3, 1e-4]);
    ten_levels_up_to_190_without_pi: "absolute error of sin and cos" =>
        || levels(AngleScale::One, 10, &hard(190.0), [1.2e-7, 1.2e-7, 1e-2, 1e-4]);
    sixteen_levels_of_multiples_of_powers_of_two: "absolute error of sin and cos, of which those of quarter turns are 0 and ±1" =>
        || levels(AngleScale::Pi, 16, &multiples(), [1.2e-7, 4e-7, 2e-3, 5e-3]);
    sixteen_levels_of_zeros_and_subnormals: "absolute error of sin and cos" =>
        || levels(AngleScale::Pi, 16, &least(), [TINY, TINY, 1e-32, TINY]);
    sixteen_levels_of_zeros_and_subnormals_without_pi: "absolute error of sin and cos" =>
        || levels(AngleScale::One, 16, &least(), [TINY, TINY, 3e-33, TINY]);
}

/// Returns difficult coordinates up to `limit`: ±0, subnormals, multiples of 2^-k and their neighbours, powers of ten,
/// and noise.
fn hard(limit: f32) -> Vec<f32> {
    let mut all = vec![0.0, 1e-45, 1e-40, f32::MIN_POSITIVE, 1.0, 0.5f32.next_up(), 1.0 / 3.0, limit];
    for k in 0..=18 {
        for n in [1.0, 3.0, 5.0, 1023.0] {
            let x = n * 0.5f32.powi(k);
            all.extend([x, x.next_up(), x.next_down()]);
        }
    }
    for e in -12..=4 {
        all.extend([1.0, 1.234_567, 3.3, 9.876_543].map(|m| m * 10f32.powi(e)));
    }
    let mut state = 1;
    for _ in 0..200_000 {
        let unit = share(&mut state);
        all.extend([unit, unit * limit]);
    }
    let negative: Vec<f32> = all.iter().map(|x| -x).collect();
    all.extend(negative);
    all.retain(|x| x.abs() <= limit);
    all.truncate(all.len() / 64 * 64);
    all
}

/// Returns values `n 2^-k`; their angles are multiples of a quarter turn from some level on.
fn multiples() -> Vec<f32> {
    let all = (0..=18).flat_map(|k| (0..64).map(move |n| n as f32 * 0.5f32.powi(k)));
    all.flat_map(|x| [x, -x]).collect()
}

/// Returns ±0 and subnormals so small that their product with 2^15 π is below the rounding of 1.
fn least() -> Vec<f32> {
    let all = (0..32).map(|i| f32::from_bits(if i == 0 { 0 } else { (1 << (i % 24)) | (i * 7 % 16) }));
    all.flat_map(|x| [x, -x]).collect()
}

fn levels(scale: AngleScale, levels: u8, points: &[f32], bounds: [f64; 4]) -> Vec<Row> {
    let encoding = SinusoidalEncoding { inputs: 1, levels, scale, identity: true };
    let mut worst = vec![Worst::default(); BACKENDS.len()];
    let mut out = vec![0.0; encoding.outputs() * 64];
    for x in points.chunks_exact(64) {
        let truth: Vec<Vec<f64>> = x
            .iter()
            .map(|&x| oracle::encoding::encode(&[f64::from(x)], levels, scale == AngleScale::Pi, true))
            .collect();
        for (&(_, math), worst) in BACKENDS.iter().zip(&mut worst) {
            for isa in isas() {
                encode_block(isa, math, &encoding, 64, x, &mut out);
                let (error, row, column) = oracle::encoding::furthest(&out, &truth);
                let level = row.saturating_sub(1) / 2;
                worst.see(error, || format!("x = {:e}, level {level}, {}", x[column], isa.name()));
            }
        }
    }
    let rows = worst.into_iter().zip(BACKENDS).zip(bounds);
    rows.map(|((worst, (name, _)), bound)| worst.row(name, "exact", bound)).collect()
}
