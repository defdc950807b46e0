//! Errors of importance sampling against the oracle.

mod laws;

pub use laws::CASES as LAWS;

use crate::table::{Row, Worst, cases};
use nerf_core::sampling::{Bins, sample_pdf};
use nerf_testing::error::worst_of;
use nerf_testing::noise::share;
use nerf_testing::oracle::sampling::{inverse_cdf_at, middles};

cases! {
    samples_of_every_kind_of_weights: "error of the distribution function at the drawn samples, over what `draw` promises" => drawn;
    rows_are_ascending_and_inside: "rows that are not" => ordered;
}

/// Returns named arrays of weights: all 0, one spike, NaNs and other invalid weights, a ramp, and noise.
fn weights() -> Vec<(String, Vec<f32>)> {
    let mut all = vec![("all zero".to_string(), vec![0.0; 64]), ("all NaN".to_string(), vec![f32::NAN; 64])];
    for bin in [0, 31, 63] {
        let mut spike = vec![0.0; 64];
        spike[bin] = 1.0;
        all.push((format!("a spike in bin {bin}"), spike));
    }
    let odd = [f32::INFINITY, -1.0, f32::NEG_INFINITY, 1e-30, 1e30, f32::NAN, -0.0, 0.5];
    all.push(("what is no weight".to_string(), (0..64).map(|i| odd[i % 8]).collect()));
    all.push(("a ramp".to_string(), (0..4096).map(|i| i as f32 / 4096.0 / 64.0).collect()));
    let mut state = 1;
    for n in [1, 2, 7, 64, 192, 4096] {
        let noise = (0..n).map(|_| share(&mut state).powi(8) / n as f32);
        all.push((format!("noise of {n}"), noise.collect()));
    }
    all
}

fn row(weights: &[f32], count: usize) -> Vec<f32> {
    let bins = Bins::new(2.0, 6.0, weights.len() as u32).expect("bins");
    row_of(&bins, weights, count, |_| 0.5)
}

/// Returns the samples that are drawn from `bins` with these weights, and the middles of the bins, in ascending order.
fn row_of(bins: &Bins, weights: &[f32], drawn: usize, within: impl Fn(u32) -> f32) -> Vec<f32> {
    let mut row = vec![f32::NAN; drawn];
    row.extend(weights);
    sample_pdf(bins, &mut row, within);
    row
}

/// Returns the error of the distribution function at the samples of a ray, divided by the error that `draw` promises.
fn off(near: f32, far: f32, weights: &[f32], drawn: usize, within: impl Fn(u32) -> f32) -> f64 {
    let (n, [low, high]) = (weights.len(), [near, far].map(f64::from));
    let bins = Bins::new(near, far, n as u32).expect("bins");
    // What an infinity counts is said in the docs of `draw`: 1, as all above 1.
    let exact: Vec<f64> = weights.iter().map(|&w| f64::from(w)).collect();
    let mut truth = inverse_cdf_at(low, high, &exact, drawn, |k| f64::from(within(k as u32)));
    truth.extend(middles(low, high, n));
    truth.sort_by(f64::total_cmp);
    // Heavy bins tell t apart, light ones do not: compared is the share of the weight in front of t.
    let mass = |w: f64| if w.is_nan() { 0.0 } else { w.clamp(0.0, 1.0) } + 1e-5;
    let mut before = vec![0.0];
    exact.iter().for_each(|&w| before.push(before[before.len() - 1] + mass(w)));
    let total = before[n];
    let share = |t: f64| {
        let place = (t - low) / (high - low) * n as f64;
        let bin = (place.max(0.0) as usize).min(n - 1);
        (before[bin] + mass(exact[bin]) * (place - bin as f64)) / total
    };
    // What `draw` promises: 4 ulp of 1, and what rounding t moves the share by the density there. t is near +
    // (bin + u) delta, and delta (far - near)/n: half an ulp of far, and of the range for each of four roundings.
    let densest = exact.iter().map(|&w| mass(w)).fold(0.0, f64::max) / total * n as f64;
    // Among the subnormal numbers an ulp is no smaller part of them: that of delta counts in every bin.
    let least = (n + 4) as f64 * 2f64.powi(-150);
    let rounding = (2f64.powi(-24) * (high + 4.0 * (high - low)) + least) / (high - low);
    let allowed = 4.0 * f64::from(f32::EPSILON) + densest * rounding;
    let row = row_of(&bins, weights, drawn, within);
    let errors =
        row.iter().zip(&truth).map(|(&found, &t)| (share(f64::from(found)) - share(t)).abs() / allowed);
    worst_of(errors)
}

fn drawn() -> Vec<Row> {
    let mut worst = Worst::default();
    for (name, weights) in weights() {
        for count in [1, 64, 128] {
            worst.see(off(2.0, 6.0, &weights, count, |_| 0.5), || format!("{name}, {count} drawn"));
        }
    }
    vec![worst.row("any", "any", 1.0)]
}

fn ordered() -> Vec<Row> {
    let mut worst = Worst::default();
    for (name, weights) in weights() {
        for count in [0, 1, 5, 128] {
            let row = row(&weights, count);
            let good =
                row.windows(2).all(|pair| pair[0] <= pair[1]) && row.iter().all(|t| (2.0..=6.0).contains(t));
            worst.see(f64::from(u8::from(!good)), || format!("{name}, {count} drawn"));
        }
    }
    vec![worst.row("any", "any", 0.0)]
}
