//! Lists of values, and the points they span.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt;

/// A setting that sweeps vary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Knob {
    /// Levels of the sinusoidal encoding.
    Levels,
    /// Hidden layers beside it.
    Layers,
    /// Channels of each.
    Width,
    /// Of a learned grid: binary logarithm of the most entries a level has.
    Table,
    /// Its levels.
    GridLevels,
    /// Features of an entry.
    Features,
    /// Cells of its finest level.
    Finest,
    /// Learning rate at the start.
    Rate,
}

impl Knob {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Levels,
        Self::Layers,
        Self::Width,
        Self::Table,
        Self::GridLevels,
        Self::Features,
        Self::Finest,
        Self::Rate,
    ];

    /// The flag that lists its values, without dashes.
    pub fn flag(self) -> &'static str {
        match self {
            Self::Levels => "levels",
            Self::Layers => "layers",
            Self::Width => "width",
            Self::Table => "table",
            Self::GridLevels => "grid-levels",
            Self::Features => "features",
            Self::Finest => "finest",
            Self::Rate => "rate",
        }
    }

    /// Its name in tables and names of files.
    pub fn name(self) -> &'static str {
        if self == Self::Levels { "L" } else { self.flag() }
    }

    /// Its name on the axis of a plot.
    pub fn axis(self) -> &'static str {
        match self {
            Self::Levels => "levels L of the encoding",
            Self::Layers => "hidden layers",
            Self::Width => "channels of a layer",
            Self::Table => "binary logarithm of a level's most entries",
            Self::GridLevels => "levels of the grid",
            Self::Features => "features of an entry",
            Self::Finest => "cells of the finest level",
            Self::Rate => "learning rate",
        }
    }

    /// Which encoding it is a setting of; `None` of a rate, which is any field's.
    fn encoding(self) -> Option<&'static str> {
        match self {
            Self::Levels | Self::Layers | Self::Width => Some("a sinusoidal encoding"),
            Self::Table | Self::GridLevels | Self::Features | Self::Finest => Some("a learned grid"),
            Self::Rate => None,
        }
    }
}

/// The settings that a sweep varies, at one point: a value for each [`Knob`] that its field has.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Point([Option<f64>; Knob::ALL.len()]);

impl Point {
    /// A point with these values.
    pub fn of(values: &[(Knob, f64)]) -> Self {
        values.iter().fold(Self::default(), |point, &(knob, value)| point.with(knob, value))
    }

    /// The same point with another value of one knob.
    #[must_use]
    pub fn with(mut self, knob: Knob, value: f64) -> Self {
        self.0[knob as usize] = Some(value);
        self
    }

    /// The value of a knob, if the field has it.
    pub fn get(&self, knob: Knob) -> Option<f64> {
        self.0[knob as usize]
    }

    /// The knobs it has, with their values.
    pub fn values(&self) -> impl Iterator<Item = (Knob, f64)> {
        Knob::ALL.into_iter().zip(self.0).filter_map(|(knob, value)| Some((knob, value?)))
    }

    /// A name that no other point has, fit for a file: `L10_layers4_width256_rate0.01`.
    pub fn name(&self) -> String {
        let parts: Vec<String> =
            self.values().map(|(knob, value)| format!("{}{value}", knob.name())).collect();
        parts.join("_")
    }
}

impl fmt::Display for Point {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts: Vec<String> =
            self.values().map(|(knob, value)| format!("{} {value}", knob.name())).collect();
        f.write_str(&parts.join(", "))
    }
}

impl Serialize for Point {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_map(self.values().map(|(knob, value)| (knob.flag(), value)))
    }
}

impl<'de> Deserialize<'de> for Point {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let mut point = Self::default();
        for (flag, value) in BTreeMap::<String, f64>::deserialize(from)? {
            let Some(knob) = Knob::ALL.into_iter().find(|knob| knob.flag() == flag) else {
                return Err(serde::de::Error::custom(format!("`{flag}` is no setting of a sweep")));
            };
            point = point.with(knob, value);
        }
        Ok(point)
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
    /// Values of each [`Knob`], in the order of [`Knob::ALL`].
    pub lists: [Vec<f64>; Knob::ALL.len()],
    /// How they are combined.
    pub mode: Mode,
}

/// Lists without points to compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CombinationsError {
    /// No list at all.
    #[error(
        "nothing to sweep: expected a list for at least one of --levels, --layers, --width, --rate, or of a learned grid \
         --table, --grid-levels, --features, --finest, --rate"
    )]
    Empty,
    /// A list of what this field has not.
    #[error("--{flag}: expected settings with {wanted}, these have {found}")]
    Other {
        /// The list's.
        flag: &'static str,
        /// Whose setting it is.
        wanted: &'static str,
        /// What there is.
        found: &'static str,
    },
}

impl Combinations {
    /// The points in order, each once.
    ///
    /// # Errors
    /// [`CombinationsError::Empty`] without any list, [`CombinationsError::Other`] on a list of another encoding's.
    pub fn points(&self) -> Result<Vec<Point>, CombinationsError> {
        if self.lists.iter().all(Vec::is_empty) {
            return Err(CombinationsError::Empty);
        }
        if let Some((knob, _)) = self.listed().find(|&(knob, _)| self.base.get(knob).is_none()) {
            let found = self.base.values().find_map(|(knob, _)| knob.encoding()).unwrap_or_default();
            let wanted = knob.encoding().unwrap_or_default();
            return Err(CombinationsError::Other { flag: knob.flag(), wanted, found });
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

    /// The knobs with a list.
    fn listed(&self) -> impl Iterator<Item = (Knob, &[f64])> {
        let lists = Knob::ALL.into_iter().zip(self.lists.iter().map(Vec::as_slice));
        lists.filter(|(_, list)| !list.is_empty())
    }

    fn full(&self) -> Vec<Point> {
        let mut points = vec![self.base];
        for (knob, list) in self.listed() {
            let each = |point: Point| list.iter().map(move |&value| point.with(knob, value));
            points = points.into_iter().flat_map(each).collect();
        }
        points
    }

    fn one_at_a_time(&self) -> Vec<Point> {
        let fixed = |point: Point, (knob, list): (Knob, &[f64])| match list {
            &[value] => point.with(knob, value),
            _ => point,
        };
        let base = self.listed().fold(self.base, fixed);
        let varied =
            self.listed().flat_map(|(knob, list)| list.iter().map(move |&value| base.with(knob, value)));
        std::iter::once(base).chain(varied).collect()
    }
}
