extern crate std;

use super::*;
use crate::testing::{Worse, noise};
use std::vec;
use std::vec::Vec;

fn isas() -> impl Iterator<Item = Isa> {
    Isa::ALL.into_iter().filter(|isa| isa.available())
}

/// `n` unit directions, `[3][n]`: the axes, the diagonals, then random directions.
fn dirs(n: usize) -> Vec<f32> {
    let mut rows = noise(3 * n, 9);
    for i in 0..n {
        let mut d = [rows[i], rows[n + i], rows[2 * n + i]];
        if i < 26 {
            let code = if i < 13 { i } else { i + 1 };
            d = [code % 3, code / 3 % 3, code / 9].map(|c| c as f32 - 1.0);
        }
        let length = d.iter().map(|x| x * x).sum::<f32>().sqrt();
        (0..3).for_each(|axis| rows[axis * n + i] = d[axis] / length);
    }
    rows
}

/// `Y_l^m` by associated Legendre functions and angles, in f64: an independent computation.
fn truth(l: i32, m: i32, [x, y, z]: [f64; 3]) -> f64 {
    let (order, radius) = (m.abs(), (x * x + y * y).sqrt());
    // Recurrence over l. It starts at P_m^m, with the Condon–Shortley phase.
    let mut p = vec![0.0; l as usize + 1];
    for l in order..=l {
        p[l as usize] = if l == order {
            (0..order).map(|k| -f64::from(2 * k + 1) * radius).product()
        } else {
            let below = if l == order + 1 { 0.0 } else { p[l as usize - 2] };
            (f64::from(2 * l - 1) * z * p[l as usize - 1] - f64::from(l + order - 1) * below)
                / f64::from(l - order)
        };
    }
    let ratio: f64 = (l - order + 1..=l + order).map(f64::from).product();
    let k = (f64::from(2 * l + 1) / (4.0 * core::f64::consts::PI * ratio)).sqrt();
    let phi = y.atan2(x) * f64::from(order);
    let p = p[l as usize] * k;
    match m {
        0 => p,
        1.. => 2f64.sqrt() * p * phi.cos(),
        _ => 2f64.sqrt() * p * phi.sin(),
    }
}

#[test]
fn every_band_is_its_legendre_function_with_every_kernel() {
    let n = 192;
    let x = dirs(n);
    for isa in isas() {
        for degree in 1..=MAX_HARMONICS_DEGREE {
            let count = usize::from(degree).pow(2);
            let mut out = vec![f32::NAN; count * n];
            encode_harmonics_block(isa, degree, n, &x, &mut out);
            let mut worst = 0.0f64;
            for i in 0..n {
                let d = [0, 1, 2].map(|axis| f64::from(x[axis * n + i]));
                for l in 0..i32::from(degree) {
                    for m in -l..=l {
                        let found = out[(l * l + l + m) as usize * n + i];
                        worst = worst.worse((f64::from(found) - truth(l, m, d)).abs());
                    }
                }
            }
            assert!(worst <= 5e-7, "{isa:?}, degree {degree}: {worst:e}");
        }
    }
}

#[test]
fn harmonics_are_orthonormal_over_the_sphere() {
    // Midpoint rule in z and angle, accurate enough for products of harmonics (degree 6).
    let (rows, columns) = (128, 32);
    let n = rows * columns;
    let mut x = vec![0.0; 3 * n];
    for i in 0..n {
        let z = ((i / columns) as f64 + 0.5) / rows as f64 * 2.0 - 1.0;
        let phi = ((i % columns) as f64 + 0.5) / columns as f64 * core::f64::consts::TAU;
        let r = (1.0 - z * z).sqrt();
        (x[i], x[n + i], x[2 * n + i]) = ((r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32);
    }
    let mut out = vec![0.0; 16 * n];
    encode_harmonics_block(Isa::Portable, 4, n, &x, &mut out);
    for (a, b) in (0..16).flat_map(|a| (0..=a).map(move |b| (a, b))) {
        let product = |i: usize| f64::from(out[a * n + i]) * f64::from(out[b * n + i]);
        let mean = (0..n).map(product).sum::<f64>() / n as f64 * 4.0 * core::f64::consts::PI;
        assert!((mean - f64::from(u8::from(a == b))).abs() < 1e-3, "{a}, {b}: {mean}");
    }
}

#[test]
fn a_direction_does_not_depend_on_those_beside_it() {
    let x = dirs(64);
    for isa in isas() {
        let mut all = vec![0.0; 16 * 64];
        encode_harmonics_block(isa, 4, 64, &x, &mut all);
        let columns = if isa == Isa::Portable { 3 } else { 16 };
        let cut = |rows: &[f32]| -> Vec<u32> {
            rows.chunks(64).flat_map(|row| row[..columns].iter().map(|x| x.to_bits())).collect()
        };
        let some: Vec<f32> = x.chunks(64).flat_map(|row| row[..columns].to_vec()).collect();
        let mut out = vec![0.0; 16 * columns];
        encode_harmonics_block(isa, 4, columns, &some, &mut out);
        assert!(out.iter().map(|x| x.to_bits()).eq(cut(&all)), "{isa:?}");
    }
}
