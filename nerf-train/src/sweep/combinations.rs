//! Lists of values, and the points they span.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// The settings that a sweep varies, at one point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Levels of the position's encoding.
    pub levels: u8,
    /// Hidden layers of the trunk.
    pub layers: usize,
    /// Channels of every hidden layer.
    pub width: usize,
    /// Learning rate at the start.
    pub rate: f64,
}

/// The settings' names, in the order of [`Point::values`].
pub const KNOBS: [&str; 4] = ["L", "layers", "width", "rate"];

impl Point {
    /// Its settings as numbers, in the order of their names in tables.
    pub fn values(&self) -> [f64; 4] {
        [f64::from(self.levels), self.layers as f64, self.width as f64, self.rate]
    }

    /// A name that no other point has, fit for a file: `L10_layers4_width256_rate0.01`.
    pub fn name(&self) -> String {
        let values = self.values();
        let parts: Vec<String> =
            KNOBS.iter().zip(values).map(|(knob, value)| format!("{knob}{value}")).collect();
        parts.join("_")
    }
}

impl fmt::Display for Point {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "L {}, {} layers, width {}, rate {}", self.levels, self.layers, self.width, self.rate)
    }
}

/// How values are combined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Every value of a list with every value of the others.
    Full,
    /// Every list on its own; the other settings stay at the base.
    OneAtATime,
}

/// Lists of values around a base: an empty list keeps the base's value, a list of one value replaces it.
#[derive(Clone, Debug, PartialEq)]
pub struct Combinations {
    /// What holds where a list is empty.
    pub base: Point,
    /// Values of [`Point::levels`].
    pub levels: Vec<u8>,
    /// Values of [`Point::layers`].
    pub layers: Vec<usize>,
    /// Values of [`Point::width`].
    pub widths: Vec<usize>,
    /// Values of [`Point::rate`].
    pub rates: Vec<f64>,
    /// How they are combined.
    pub mode: Mode,
}

/// Lists without points to compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CombinationsError {
    /// No list at all.
    #[error("nothing to sweep: expected a list for at least one of --levels, --layers, --width, --rate")]
    Empty,
}

impl Combinations {
    /// The points in order, each once.
    ///
    /// # Errors
    /// [`CombinationsError::Empty`] without any list.
    pub fn points(&self) -> Result<Vec<Point>, CombinationsError> {
        if self.levels.is_empty() && self.layers.is_empty() && self.widths.is_empty() && self.rates.is_empty()
        {
            return Err(CombinationsError::Empty);
        }
        let all = match self.mode {
            Mode::Full => self.full(),
            Mode::OneAtATime => self.one_at_a_time(),
        };
        let mut points: Vec<Point> = Vec::new();
        for point in all {
            if !points.contains(&point) {
                points.push(point);
            }
        }
        Ok(points)
    }

    fn full(&self) -> Vec<Point> {
        let b = self.base;
        let mut points = Vec::new();
        for levels in or_base(&self.levels, b.levels) {
            for layers in or_base(&self.layers, b.layers) {
                for width in or_base(&self.widths, b.width) {
                    for rate in or_base(&self.rates, b.rate) {
                        points.push(Point { levels, layers, width, rate });
                    }
                }
            }
        }
        points
    }

    fn one_at_a_time(&self) -> Vec<Point> {
        fn fixed<T: Copy>(list: &[T], base: T) -> T {
            if let [value] = list { *value } else { base }
        }
        let base = Point {
            levels: fixed(&self.levels, self.base.levels),
            layers: fixed(&self.layers, self.base.layers),
            width: fixed(&self.widths, self.base.width),
            rate: fixed(&self.rates, self.base.rate),
        };
        let levels = self.levels.iter().map(|&levels| Point { levels, ..base });
        let layers = self.layers.iter().map(|&layers| Point { layers, ..base });
        let widths = self.widths.iter().map(|&width| Point { width, ..base });
        let rates = self.rates.iter().map(|&rate| Point { rate, ..base });
        std::iter::once(base).chain(levels).chain(layers).chain(widths).chain(rates).collect()
    }
}

fn or_base<T: Copy>(list: &[T], base: T) -> Vec<T> {
    if list.is_empty() { vec![base] } else { list.to_vec() }
}

/// The part of a sweep that one process runs: `i/n` takes every n-th point, beginning with the i-th.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// `1..=count`.
    pub index: usize,
    /// At least 1.
    pub count: usize,
}

impl Shard {
    /// All of it.
    pub const WHOLE: Self = Self { index: 1, count: 1 };

    /// Whether the point at `position` is this part's.
    pub fn takes(&self, position: usize) -> bool {
        position % self.count == self.index - 1
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let shard = text.split_once('/').and_then(|(index, count)| {
            Some(Self { index: index.trim().parse().ok()?, count: count.trim().parse().ok()? })
        });
        match shard {
            Some(shard) if (1..=shard.count).contains(&shard.index) => Ok(shard),
            _ => Err("expected I/N with I from 1 to N, for example 3/25".into()),
        }
    }
}
