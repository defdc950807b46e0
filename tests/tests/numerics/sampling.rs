//! Importance sampling against the oracle.

use crate::table::{Row, Worst, cases};
use nerf_core::sampling::{Bins, draw};
use nerf_tests::oracle::sampling::{inverse_cdf, middles};

cases! {
    samples_of_every_kind_of_weights: "error of the distribution function at the drawn samples, over what `draw` promises" => drawn;
    rows_are_ascending_and_inside: "rows that are not" => ordered;
}

/// No weight, one spike, spikes at the ends, what is no number, ramps, noise.
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
    let mut state = 1u32;
    for n in [1, 2, 7, 64, 192, 4096] {
        let noise = (0..n).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((state >> 8) as f32 / (1 << 24) as f32).powi(8) / n as f32
        });
        all.push((format!("noise of {n}"), noise.collect()));
    }
    all
}

fn row(weights: &[f32], count: usize) -> Vec<f32> {
    let bins = Bins::new(2.0, 6.0, weights.len() as u32).expect("bins");
    let mut row = vec![0.0; count];
    row.extend(weights);
    draw(&bins, &mut row, |_| 0.5);
    row
}

fn drawn() -> Vec<Row> {
    let mut worst = Worst::default();
    for (name, weights) in weights() {
        for count in [1, 64, 128] {
            // What an infinity counts is said in the docs of `draw`: 1, as all above 1.
            let exact: Vec<f64> = weights.iter().map(|&w| f64::from(w)).collect();
            let n = weights.len();
            let mut truth = inverse_cdf(2.0, 6.0, &exact, count);
            truth.extend(middles(2.0, 6.0, n));
            truth.sort_by(f64::total_cmp);
            // Heavy bins tell t apart, light ones do not: compared is the share of the weight in front of t.
            let mass = |w: f64| if w.is_nan() { 0.0 } else { w.clamp(0.0, 1.0) } + 1e-5;
            let total: f64 = exact.iter().map(|&w| mass(w)).sum();
            let share = |t: f64| {
                let place = (t - 2.0) / 4.0 * n as f64;
                let bin = (place.max(0.0) as usize).min(n - 1);
                let before: f64 = exact[..bin].iter().map(|&w| mass(w)).sum();
                (before + mass(exact[bin]) * (place - bin as f64)) / total
            };
            for (&found, &t) in row(&weights, count).iter().zip(&truth) {
                // What `draw` promises: 4 ulp of 1, and what rounding t moves the share by the density there. t is
                // near + (bin + u) delta: three roundings, half an ulp of 8, of 64 bins and of 4; an ulp of 4 in all.
                let densest = exact.iter().map(|&w| mass(w)).fold(0.0, f64::max) / total * n as f64;
                let allowed = 4.0 * f64::from(f32::EPSILON) + densest * 2f64.powi(-21) / 4.0;
                let off = (share(f64::from(found)) - share(t)).abs() / allowed;
                worst.see(off, || format!("{name}, {count} drawn"));
            }
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
