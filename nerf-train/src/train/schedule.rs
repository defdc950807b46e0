//! When to stop, and how fast to learn until then.

use crate::data::system::progress::Total;
use crate::model::config::OptimiserConfig;
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};

/// What ends a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Budget {
    /// Steps; `None` if time alone decides.
    pub steps: Option<u32>,
    /// Wall-clock seconds, everything included.
    pub seconds: Option<f64>,
}

/// Seconds as a duration: nothing below 0 or of NaN, and no more than 30 years.
pub fn duration(seconds: f64) -> Duration {
    const LONGEST: f64 = 1e9;
    Duration::try_from_secs_f64(if seconds > LONGEST { LONGEST } else { seconds }).unwrap_or_default()
}

/// Wall-clock time of a run, over interruptions.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Instant,
    before: Duration,
}

impl Clock {
    /// Goes on from what a checkpoint had used.
    pub fn resume(before: Duration) -> Self {
        Self { start: Instant::now(), before }
    }

    /// Seconds used.
    pub fn seconds(&self) -> f64 {
        self.before.saturating_add(self.start.elapsed()).as_secs_f64()
    }
}

impl Budget {
    /// The same, for the display of progress.
    pub fn total(&self) -> Total {
        match (self.steps, self.seconds) {
            (Some(steps), Some(seconds)) => Total::StepsOrTime(u64::from(steps), duration(seconds)),
            (Some(steps), None) => Total::Steps(u64::from(steps)),
            (None, Some(seconds)) => Total::Time(duration(seconds)),
            (None, None) => Total::Unknown,
        }
    }

    /// Share of the budget that is used, `0..=1`; `reserve` seconds at the end belong to others.
    pub fn share(&self, step: u32, seconds: f64, reserve: f64) -> f64 {
        let of_steps = self.steps.map_or(0.0, |steps| f64::from(step) / f64::from(steps));
        let of_time = self.seconds.map_or(0.0, |limit| seconds / (limit - reserve).max(1e-3));
        of_steps.max(of_time).min(1.0)
    }
}

/// The learning rate when `share` of the budget is used and `step` steps are done: `rate · final_share^share`, after a
/// linear warm-up.
pub fn learning_rate(config: &OptimiserConfig, step: u32, share: f64) -> f64 {
    let warm = if config.warm_up == 0 { 1.0 } else { f64::from(step + 1) / f64::from(config.warm_up) };
    config.rate * config.final_share.powf(share) * warm.min(1.0)
}
