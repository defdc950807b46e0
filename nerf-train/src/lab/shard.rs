//! A part of an experiment: one of several machines.

use std::str::FromStr;

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

    /// Its trials, each with its name.
    pub fn of<T>(self, trials: &[T], name: impl Fn(&T) -> String) -> Vec<(&T, String)> {
        let mine = trials.iter().enumerate().filter(|&(i, _)| self.takes(i));
        mine.map(|(_, trial)| (trial, name(trial))).collect()
    }

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
