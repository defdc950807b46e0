extern crate std;

use super::*;
use crate::testing::noise;
use std::vec;
use std::vec::Vec;

const NEAR: f32 = 2.0;
const FAR: f32 = 6.0;

fn bins(count: usize) -> Bins {
    Bins::new(NEAR, FAR, count as u32).unwrap()
}

/// The row that [`sample_pdf`] makes from `weights`, one per bin: `drawn` samples and the middles of all bins,
/// ascending. Before the call, the values of the drawn samples are NaN.
fn row(weights: &[f32], drawn: usize) -> Vec<f32> {
    let mut row = vec![f32::NAN; drawn];
    row.extend(weights);
    sample_pdf(&bins(weights.len()), &mut row, |_| 0.5);
    row
}

/// The drawn samples of a row: all its values without the middles of its `count` bins.
fn drawn_of(row: &[f32], count: usize) -> Vec<f32> {
    let bins = bins(count);
    let mut middles: Vec<f32> = (0..count as u32).map(|i| bins.at(i, 0.5)).collect();
    let mut drawn = row.to_vec();
    drawn.retain(|t| match middles.iter().position(|middle| middle == t) {
        Some(at) => {
            middles.remove(at);
            false
        }
        None => true,
    });
    assert!(middles.is_empty(), "{} middles are missing", middles.len());
    drawn
}

/// Named cases of weights that a coarse network may give.
fn cases() -> Vec<(&'static str, Vec<f32>)> {
    let random =
        |n: usize, seed| -> Vec<f32> { noise(n, seed).iter().map(|w| (0.5 + 0.5 * w).powi(8)).collect() };
    let spike = |n: usize, at: usize, height: f32| {
        let mut weights = vec![0.0; n];
        weights[at] = height;
        weights
    };
    let mut sparse = random(64, 3);
    sparse.iter_mut().enumerate().for_each(|(i, w)| *w *= f32::from(u8::from(i % 7 == 2)));
    vec![
        ("nothing", vec![0.0; 64]),
        ("even", vec![1.0 / 64.0; 64]),
        ("one bin", vec![0.5]),
        ("random", random(64, 1)),
        ("many", random(4096, 2).iter().map(|w| w / 512.0).collect()),
        ("sparse", sparse),
        ("a wall in front", spike(64, 0, 1.0)),
        ("a wall", spike(64, 40, 1.0)),
        ("a wall behind", spike(64, 63, 1.0)),
        ("a wall among many", spike(4096, 2047, 1.0)),
        ("a whiff", spike(64, 17, 1e-30)),
    ]
}

#[test]
fn a_row_is_ascending_and_holds_every_middle_and_as_many_more() {
    for (name, weights) in cases() {
        for drawn in [0, 1, 2, 7, 128, 4096] {
            let row = row(&weights, drawn);
            assert!(row.windows(2).all(|pair| pair[0] <= pair[1]), "{name}, {drawn}");
            assert!(row.iter().all(|t| (NEAR..=FAR).contains(t)), "{name}, {drawn}");
            // A drawn sample may equal a middle. `drawn_of` then keeps one of the two.
            assert_eq!(drawn_of(&row, weights.len()).len(), drawn, "{name}");
        }
    }
}

#[test]
fn the_distribution_function_at_the_samples_is_the_middle_of_the_strata() {
    for (name, weights) in cases() {
        let n = weights.len();
        let mass: Vec<f64> = weights.iter().map(|&w| f64::from(w) + f64::from(WEIGHT_FLOOR)).collect();
        let total: f64 = mass.iter().sum();
        let cdf = |t: f64| {
            let x = (t - f64::from(NEAR)) / f64::from(FAR - NEAR) * n as f64;
            let bin = (x as usize).min(n - 1);
            (mass[..bin].iter().sum::<f64>() + mass[bin] * (x - bin as f64)) / total
        };
        for drawn in [1, 3, 128, 500] {
            for (k, &t) in drawn_of(&row(&weights, drawn), n).iter().enumerate() {
                let u = (k as f64 + 0.5) / drawn as f64;
                // Rounding of `t`, world units: half an ulp of the product with the bin width, of the sum with near,
                // and of bin plus fraction.
                let ulp = f64::from(f32::EPSILON);
                let rounding = 2.0 * f64::from(FAR) * ulp + n as f64 * ulp * f64::from(FAR - NEAR) / n as f64;
                let (low, high) = (cdf(f64::from(t) - rounding), cdf(f64::from(t) + rounding));
                let slack = 4.0 * ulp;
                assert!(low - slack <= u && u <= high + slack, "{name}, {k} of {drawn}: {u}, {low}..{high}");
            }
        }
    }
}

#[test]
fn without_weights_the_samples_are_even() {
    for drawn in [1, 64, 100] {
        for (k, t) in drawn_of(&row(&[0.0; 63], drawn), 63).iter().enumerate() {
            let expected = NEAR + (FAR - NEAR) * (k as f32 + 0.5) / drawn as f32;
            assert!((t - expected).abs() <= 8.0 * f32::EPSILON * FAR, "{k} of {drawn}: {t}, {expected}");
        }
    }
}

#[test]
fn what_is_no_weight_counts_as_none_and_no_more_than_all() {
    let clean = [0.0, 0.25, 0.0, 1.0, 0.0, 0.125];
    let dirty = [f32::NAN, 0.25, -3.0, f32::INFINITY, f32::NEG_INFINITY, 0.125];
    for drawn in [0, 5, 128] {
        assert_eq!(row(&clean, drawn), row(&dirty, drawn));
    }
    assert_eq!(row(&[f32::NAN; 8], 9), row(&[0.0; 8], 9));
    assert_eq!(row(&[f32::INFINITY; 8], 9), row(&[1.0; 8], 9));
}

#[test]
fn a_wall_gets_nearly_every_sample() {
    // The other 63 bins have weight 0 and get only the floor: together less than a tenth of one of the 128 samples.
    let (name, weights) = &cases()[7];
    assert_eq!((*name, weights[40]), ("a wall", 1.0));
    let bins = bins(64);
    let inside = bins.at(40, 0.0)..=bins.at(41, 0.0);
    assert_eq!(drawn_of(&row(weights, 128), 64).iter().filter(|t| inside.contains(*t)).count(), 128);
}

#[test]
fn a_row_too_short_for_its_weights_stays() {
    let mut short = [0.5, 0.25];
    sample_pdf(&bins(3), &mut short, |_| 0.5);
    assert_eq!(short, [0.5, 0.25]);
}

#[test]
fn stretches_tile_the_range() {
    for (name, weights) in cases() {
        let row = row(&weights, 100);
        let widths: Vec<f32> = (0..row.len()).map(|k| sample_interval(NEAR, FAR, &row, k).1).collect();
        assert!(widths.iter().all(|&width| width >= 0.0), "{name}");
        let sum: f64 = widths.iter().map(|&width| f64::from(width)).sum();
        // Neighbouring intervals share their edges exactly, so that only the subtractions round.
        let bound = row.len() as f64 * f64::from(f32::EPSILON) / 2.0
            * widths.iter().fold(0.0f64, |a, &w| a.max(w.into()));
        assert!((sum - 4.0).abs() <= bound, "{name}: {sum}");
    }
    // Without drawn samples the intervals are the bins.
    let row = row(&[0.0; 32], 0);
    assert!((0..32).all(|k| (sample_interval(NEAR, FAR, &row, k).1 - 0.125).abs() <= f32::EPSILON * FAR));
}
