//! One axis: from values to positions, with its ticks.

use crate::show::axis;
use plotters::coord::ranged1d::{KeyPointHint, KeyPointWeight, NoDefaultFormatting, Ranged, ValueFormatter};
use std::ops::Range;

/// Values beyond this are taken as not finite: differences of theirs must not overflow.
const LARGEST: f64 = 1e300;

/// Where a value stands on an axis: itself or its log10; `None` where it has no place.
pub fn place(value: f64, log: bool) -> Option<f64> {
    let placed = if log { (value > 0.0).then(|| value.log10())? } else { value };
    (placed.abs() <= LARGEST).then_some(placed)
}

/// An axis in placed values: linear, or log10.
#[derive(Clone, Debug)]
pub struct Scale {
    low: f64,
    high: f64,
    ticks: Vec<(f64, String)>,
    minor: Vec<f64>,
}

impl Scale {
    /// An axis that holds all `placed` values with some air, and at most about `most` ticks.
    pub fn new(placed: impl Iterator<Item = f64>, log: bool, most: usize) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for value in placed {
            (low, high) = (low.min(value), high.max(value));
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        let largest = low.abs().max(high.abs());
        let margin = if high - low > 1e-9 * largest {
            0.04 * (high - low)
        } else if log || largest == 0.0 {
            0.5
        } else {
            0.1 * largest
        };
        (low, high) = (low - margin, high + margin);
        let (ticks, minor) =
            if log { log_ticks(low, high, most) } else { (linear_ticks(low, high, most), vec![]) };
        Self { low, high, ticks, minor }
    }

    pub fn labels(&self) -> Vec<&str> {
        self.ticks.iter().map(|(_, label)| label.as_str()).collect()
    }
}

fn linear_ticks(low: f64, high: f64, most: usize) -> Vec<(f64, String)> {
    let ticks = axis::nice_ticks(low, high, most);
    let labels = axis::labels(&ticks);
    ticks.into_iter().zip(labels).collect()
}

/// Ticks and unlabelled lines of a logarithmic axis from 10^low to 10^high.
fn log_ticks(low: f64, high: f64, most: usize) -> (Vec<(f64, String)>, Vec<f64>) {
    let within = |p: &f64| *p >= low && *p <= high;
    // Beyond the range of f64 there is no data; the loop below needs an end.
    let (first, last) = (low.floor().max(-330.0) as i32, high.ceil().min(310.0) as i32);
    let times = |factors: &'static [f64]| {
        (first..=last)
            .flat_map(move |decade| factors.iter().map(move |f| f64::from(decade) + f.log10()))
            .filter(within)
            .collect::<Vec<f64>>()
    };
    if high - low < 0.7 {
        // Less than a decade: the round numbers of a linear axis at their logarithmic places.
        let ticks = axis::nice_ticks(10_f64.powf(low), 10_f64.powf(high), most);
        let labels = axis::labels(&ticks);
        let places = ticks.iter().map(|t| t.log10());
        return (places.zip(labels).filter(|(p, _)| within(p)).collect(), vec![]);
    }
    let mut places = times(&[1.0, 2.0, 5.0]);
    if places.len() > most {
        places = times(&[1.0]);
    }
    let stride = places.len().div_ceil(most.max(1)).max(1);
    let ticks: Vec<(f64, String)> = places.into_iter().step_by(stride).map(|p| (p, power_label(p))).collect();
    let minor =
        if last - first <= 8 { times(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]) } else { times(&[1.0]) };
    (ticks, minor)
}

/// "0.002", "50", "1e6" for a place on a logarithmic axis at 1, 2 or 5 times a power of ten.
fn power_label(place: f64) -> String {
    let decade = (place + 1e-9).floor();
    let factor = 10_f64.powf(place - decade).round() as i32;
    if (-4.0..6.0).contains(&decade) {
        let decimals = (-decade).max(0.0) as usize;
        format!("{:.decimals$}", f64::from(factor) * 10_f64.powf(decade))
    } else {
        format!("{factor}e{decade}")
    }
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = ((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0);
        let (start, end) = (f64::from(limit.0), f64::from(limit.1));
        (start + share * (end - start)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        let ticks = self.ticks.iter().map(|&(place, _)| place);
        match hint.weight() {
            KeyPointWeight::Bold => ticks.collect(),
            KeyPointWeight::Any => ticks.chain(self.minor.iter().copied()).collect(),
        }
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Scale {
    fn format_ext(&self, value: &f64) -> String {
        let tick = self.ticks.iter().find(|(place, _)| place == value);
        tick.map_or_else(String::new, |(_, label)| label.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithmic_ticks_are_round() {
        let labels = |low: f64, high: f64| {
            let scale = Scale::new([low.log10(), high.log10()].into_iter(), true, 9);
            scale.labels().join(" ")
        };
        assert_eq!(labels(1.0, 100.0), "1 2 5 10 20 50 100");
        assert_eq!(labels(1e-5, 1e3), "1e-5 0.0001 0.001 0.01 0.1 1 10 100 1000");
        assert_eq!(labels(2.0, 3.0), "2.0 2.2 2.4 2.6 2.8 3.0");
        assert!(Scale::new([-300.0, 300.0].into_iter(), true, 9).ticks.len() <= 9);
    }

    #[test]
    fn every_range_has_extent_and_ticks() {
        for values in
            [vec![], vec![0.0], vec![7.0; 3], vec![-1e-300], vec![-1e300, 1e300], vec![1e9, 1e9 + 1e-6]]
        {
            for log in [false, true] {
                let scale = Scale::new(values.iter().copied(), log, 9);
                assert!(scale.high > scale.low && (scale.high - scale.low).is_finite(), "{values:?}");
                assert!(scale.ticks.len() <= 12, "{values:?} {:?}", scale.ticks);
                for value in &values {
                    assert!((0..=100).contains(&scale.map(value, (0, 100))));
                }
            }
        }
        assert_eq!(place(0.0, true), None);
        assert_eq!(place(f64::NAN, false), None);
        assert_eq!(place(f64::MAX, false), None);
        assert_eq!(place(100.0, true), Some(2.0));
    }
}
