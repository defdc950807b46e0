//! What an audit found, for scripts.

use super::{Audit, Verdict, Worth};
use crate::data::pictures::colour;
use crate::system::cpu;
use serde::Serialize;

/// What an audit found, for scripts.
#[derive(Debug, Serialize)]
pub struct Summary {
    pub effects: Vec<EffectSummary>,
    pub threshold_db: f64,
    pub views: usize,
    pub split: &'static str,
    pub background: String,
    pub threads: usize,
    pub cpu: String,
}

/// What an effect is worth, or why it was not asked.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum EffectSummary {
    Asked {
        effect: &'static str,
        with_db: f64,
        without_db: f64,
        gain_db: f64,
        relative_time: f64,
        relative_macs: f64,
        kept: bool,
    },
    NotAsked {
        effect: &'static str,
        gain_db: Option<f64>,
        gain_db_note: &'static str,
    },
}

impl EffectSummary {
    fn of(effect: &'static str, worth: &Result<Worth, &'static str>) -> Self {
        match worth {
            Ok(worth) => Self::Asked {
                effect,
                with_db: worth.with_db,
                without_db: worth.without_db,
                gain_db: worth.gain_db(),
                relative_time: worth.relative_time,
                relative_macs: worth.relative_macs,
                kept: worth.verdict == Verdict::Keeps,
            },
            Err(gain_db_note) => Self::NotAsked { effect, gain_db: None, gain_db_note },
        }
    }
}

impl Summary {
    /// Of an audit on so many views of the split of this name, over `background`.
    pub fn of(
        audit: &Audit,
        threshold_db: f64,
        (split, views): (&'static str, usize),
        background: [f32; 3],
    ) -> Self {
        Self {
            effects: audit.iter().map(|(effect, worth)| EffectSummary::of(effect.name, worth)).collect(),
            threshold_db,
            views,
            split,
            background: colour::name(background),
            threads: rayon::current_num_threads(),
            cpu: cpu::name(),
        }
    }
}
