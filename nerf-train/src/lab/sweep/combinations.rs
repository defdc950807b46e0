//! Points of a sweep: combinations of values, with one list of values for each varied setting.

use anyhow::bail;
use clap::ValueEnum;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt;

const SINUSOIDAL: &str = "a sinusoidal encoding";
const LEARNED: &str = "a learned grid";

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Knob {
    Levels,
    Layers,
    Width,
    /// log2 of the largest number of entries of a grid level.
    Table,
    GridLevels,
    Features,
    /// Resolution of the finest level of a learned grid, cells.
    Finest,
    Rate,
    Samples,
    /// Training steps between updates of a hashed level of a learned grid.
    Turns,
    Seconds,
}

impl Knob {
    /// Returns the flag, the axis label in plots, and the only encoding that has the setting (`None`: all have it).
    fn row(self) -> (&'static str, &'static str, Option<&'static str>) {
        match self {
            Self::Levels => ("levels", "levels L of the encoding", Some(SINUSOIDAL)),
            Self::Layers => ("layers", "hidden layers", None),
            Self::Width => ("width", "channels of a layer", None),
            Self::Table => ("table", "binary logarithm of a level's most entries", Some(LEARNED)),
            Self::GridLevels => ("grid-levels", "levels of the grid", Some(LEARNED)),
            Self::Features => ("features", "features of an entry", Some(LEARNED)),
            Self::Finest => ("finest", "cells of the finest level", Some(LEARNED)),
            Self::Rate => ("rate", "learning rate", None),
            Self::Samples => ("samples", "samples a ray", Some(SINUSOIDAL)),
            Self::Turns => ("turns", "steps between updates of a hashed level", Some(LEARNED)),
            Self::Seconds => ("max-seconds", "seconds of a run", None),
        }
    }

    /// Returns the flag, without dashes, that takes the list of the knob's values.
    pub fn flag(self) -> &'static str {
        self.row().0
    }

    pub fn name(self) -> &'static str {
        if self == Self::Levels { "L" } else { self.flag() }
    }

    pub fn axis(self) -> &'static str {
        self.row().1
    }
}

/// Settings of one run of a sweep: for each [`Knob`] a value, or `None` to keep the value of the base settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Point([Option<f64>; Knob::Seconds as usize + 1]);

impl Point {
    pub fn of(values: &[(Knob, f64)]) -> Self {
        values.iter().fold(Self::default(), |point, &(knob, value)| point.with(knob, value))
    }

    #[must_use]
    pub fn with(mut self, knob: Knob, value: f64) -> Self {
        self.0[knob as usize] = Some(value);
        self
    }

    pub fn get(&self, knob: Knob) -> Option<f64> {
        self.0[knob as usize]
    }

    pub fn values(&self) -> impl Iterator<Item = (Knob, f64)> {
        Knob::value_variants().iter().copied().zip(self.0).filter_map(|(knob, value)| Some((knob, value?)))
    }

    /// Returns a unique name of the point, usable as a file name: `L10_layers4_width256_rate0.01`.
    pub fn name(&self) -> String {
        self.joined("", "_")
    }

    fn joined(&self, space: &str, between: &str) -> String {
        let part = |(knob, value): (Knob, f64)| format!("{}{space}{value}", knob.name());
        self.values().map(part).collect::<Vec<_>>().join(between)
    }
}

impl fmt::Display for Point {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.joined(" ", ", "))
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
            let Some(&knob) = Knob::value_variants().iter().find(|knob| knob.flag() == flag) else {
                return Err(serde::de::Error::custom(format!("`{flag}` is no setting of a sweep")));
            };
            point = point.with(knob, value);
        }
        Ok(point)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// All combinations of the lists' values.
    Full,
    /// One list is varied at a time; the other settings stay at the base.
    OneAtATime,
}

/// Lists of values to vary around a base: an empty list keeps the base's value, a list of one value replaces it.
#[derive(Clone, Debug, PartialEq)]
pub struct Combinations {
    /// Values of the settings that a point does not take from a list.
    pub base: Point,
    pub lists: Vec<(Knob, Vec<f64>)>,
    pub mode: Mode,
}

impl Combinations {
    pub fn points(&self) -> anyhow::Result<Vec<Point>> {
        if self.listed().next().is_none() {
            bail!(
                "nothing to sweep: expected a list for at least one of --rate, --layers, --width, --levels, or of a learned \
                 grid --table, --grid-levels, --features, --finest"
            );
        }
        let found = if self.base.get(Knob::Table).is_some() { LEARNED } else { SINUSOIDAL };
        for (knob, _) in self.listed() {
            if let Some(wanted) = knob.row().2.filter(|wanted| *wanted != found) {
                bail!("--{}: expected settings with {wanted}, these have {found}", knob.flag());
            }
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

    fn listed(&self) -> impl Iterator<Item = (Knob, &[f64])> {
        let lists = self.lists.iter().map(|(knob, list)| (*knob, list.as_slice()));
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
