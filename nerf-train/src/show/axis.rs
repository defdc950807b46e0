//! Ticks at round numbers for axes and legends, and their labels.

/// Returns at most `most` (≥ 1) ticks in [`low`, `high`]: multiples of 1, 2 or 5 times a power of ten.
/// A range of one number has one tick, a reversed or not finite range none, any other at least two if `most` ≥ 4.
pub fn nice_ticks(low: f64, high: f64, most: usize) -> Vec<f64> {
    let span = high - low;
    if !span.is_finite() || span <= 0.0 {
        return if low.is_finite() && low == high { vec![low] } else { Vec::new() };
    }
    let most = most.max(1);
    let magnitude = 10_f64.powf((span / most as f64).log10().floor());
    for factor in [1.0, 2.0, 5.0, 10.0, 20.0] {
        let step = factor * magnitude;
        // The tolerance of 1e-9 steps keeps a tick that lies exactly at an end of the range.
        let first = (low / step - 1e-9).ceil();
        let last = (high / step + 1e-9).floor();
        if !(first.is_finite() && last.is_finite() && step > 0.0) {
            return Vec::new();
        }
        let count = last - first + 1.0;
        // Beyond 2^53 steps from zero, neighbouring ticks would coincide.
        if count <= most as f64 && first.abs().max(last.abs()) < 9e15 {
            return (0..count.max(0.0) as usize).map(|i| (first + i as f64) * step).collect();
        }
    }
    Vec::new()
}

/// Returns the labels of the ticks: just enough decimals to tell them apart; long numbers in scientific notation.
pub fn labels(ticks: &[f64]) -> Vec<String> {
    let largest = ticks.iter().fold(0.0_f64, |m, t| m.max(t.abs()));
    let steps = ticks.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    let step = steps.filter(|&s| s > 0.0).fold(f64::INFINITY, f64::min);
    let step = if step.is_finite() { step } else { largest };
    if largest == 0.0 {
        return vec!["0".to_owned(); ticks.len()];
    }
    // Decimals down to the first digit of the distance between ticks; a lone tick gets three significant digits.
    let lone = if ticks.len() < 2 { 2 } else { 0 };
    let decimals = (-(step.log10() + 1e-9).floor()) as i64 + lone;
    if largest >= 1e6 || decimals > 5 {
        let digits = (largest.log10().floor() as i64 + decimals).clamp(0, 15) as usize;
        return ticks.iter().map(|t| tidy_exponent(&format!("{t:.digits$e}"))).collect();
    }
    let decimals = decimals.clamp(0, 12) as usize;
    let write = |&tick: &f64| {
        let text = format!("{tick:.decimals$}");
        // Zero has no minus sign: "0.0", not "-0.0".
        if text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.') {
            text.trim_start_matches('-').to_owned()
        } else {
            text
        }
    };
    ticks.iter().map(write).collect()
}

/// Removes superfluous zeros of scientific notation: "1.50e6" becomes "1.5e6", "0e0" becomes "0".
fn tidy_exponent(text: &str) -> String {
    let Some((mantissa, exponent)) = text.split_once('e') else { return text.to_owned() };
    let mantissa = match mantissa.contains('.') {
        true => mantissa.trim_end_matches('0').trim_end_matches('.'),
        false => mantissa,
    };
    if mantissa == "0" || mantissa == "-0" { "0".to_owned() } else { format!("{mantissa}e{exponent}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(nice_ticks(0.0, 10.0, 6), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(labels(&nice_ticks(2.01, 2.99, 6)), ["2.2", "2.4", "2.6", "2.8"]);
        assert_eq!(labels(&nice_ticks(-1.0, 1.0, 5)), ["-1.0", "-0.5", "0.0", "0.5", "1.0"]);
        assert_eq!(labels(&nice_ticks(0.0, 2e7, 5)), ["0", "5e6", "1e7", "1.5e7", "2e7"]);
        assert_eq!(labels(&nice_ticks(0.0, 20_000.0, 5)), ["0", "5000", "10000", "15000", "20000"]);
        for (low, high) in [(1e-7, 3e-7), (-5.0, 1e5), (0.3, 0.300_01), (1e6, 1e6 + 1.0)] {
            for most in 4..10 {
                let ticks = nice_ticks(low, high, most);
                assert!((2..=most).contains(&ticks.len()), "{low} {high} {most}: {ticks:?}");
                let texts = labels(&ticks);
                assert!(texts.windows(2).all(|pair| pair[0] != pair[1]), "{texts:?}");
            }
        }
    }

    #[test]
    fn odd_ranges_give_few_or_no_ticks() {
        assert!(nice_ticks(f64::NAN, 1.0, 5).is_empty());
        assert!(nice_ticks(0.0, f64::INFINITY, 5).is_empty());
        assert!(nice_ticks(f64::MIN, f64::MAX, 5).is_empty());
        assert!(nice_ticks(2.0, 1.0, 5).is_empty());
        assert_eq!(nice_ticks(3.0, 3.0, 5), [3.0]);
        for value in [1e300, 1e-300, 5e-324, 1.0] {
            labels(&nice_ticks(0.0, value, 5));
            labels(&nice_ticks(value, value * (1.0 + 3e-16), 5));
            labels(&[value]);
        }
        assert!(labels(&[]).is_empty());
    }
}
