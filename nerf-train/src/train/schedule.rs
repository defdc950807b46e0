//! Budget of a run in steps and seconds, and its learning rate.

use crate::model::config::OptimiserConfig;
use crate::system::progress::Total;
use anyhow::bail;
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};

/// Default least number of steps. If a limit in seconds allows fewer, the run fails: the field is hardly trained.
pub const MIN_STEPS: u32 = 20;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Budget {
    /// Number of steps; `None` if only `seconds` limits the run.
    pub steps: Option<u32>,
    /// Limit in wall-clock seconds, including reading, validation and export.
    pub seconds: Option<f64>,
}

/// Progress of a command when its limit in seconds is reached.
#[derive(Clone, Copy, Debug)]
pub struct Done {
    /// Number of steps in the checkpoint from which this command resumed.
    pub before: u32,
    pub steps: u32,
    /// Seconds of this command before its first step.
    pub prepared: f64,
    pub seconds: f64,
    /// Seconds reserved for the work after the last step.
    pub reserve: f64,
}

/// Returns `seconds` as a duration: 0 if negative or NaN, and at most 30 years.
pub fn duration(seconds: f64) -> Duration {
    const LONGEST: f64 = 1e9;
    Duration::try_from_secs_f64(if seconds > LONGEST { LONGEST } else { seconds }).unwrap_or_default()
}

/// Wall-clock time of a command and, if the command resumes a run, of the run's earlier commands.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Instant,
    before: Duration,
}

impl Clock {
    pub fn start() -> Self {
        Self { start: Instant::now(), before: Duration::ZERO }
    }

    /// Returns this clock with `before` as the time of earlier commands.
    #[must_use]
    pub fn after(self, before: Duration) -> Self {
        Self { before, ..self }
    }

    /// Returns this clock without the time `spent`: a part of this command's time that is not charged to the run.
    #[must_use]
    pub fn without(self, spent: Duration) -> Self {
        Self { start: self.start + spent, ..self }
    }

    /// Returns the seconds that the run has taken so far, including the seconds of earlier commands.
    pub fn seconds(&self) -> f64 {
        self.before.saturating_add(self.start.elapsed()).as_secs_f64()
    }

    pub fn own_seconds(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }
}

impl Budget {
    pub fn total(&self) -> Total {
        match (self.steps, self.seconds) {
            (Some(steps), Some(seconds)) => Total::StepsOrTime(u64::from(steps), duration(seconds)),
            (Some(steps), None) => Total::Steps(u64::from(steps)),
            (None, Some(seconds)) => Total::Time(duration(seconds)),
            (None, None) => Total::Unknown,
        }
    }

    /// Adds `seconds`, the time of earlier commands of the run, to this command's limit in seconds. The used fraction
    /// of the budget then counts the time of all commands.
    #[must_use]
    pub fn after(self, seconds: f64) -> Self {
        Self { seconds: self.seconds.map(|limit| limit + seconds), ..self }
    }

    /// Returns an error if the limit in seconds allowed fewer than `min_steps` steps, or allowed this command no step.
    pub fn check_steps(&self, done: Done, min_steps: u32) -> anyhow::Result<()> {
        let Some(limit) = self.seconds.filter(|_| self.steps.is_none_or(|steps| done.steps < steps)) else {
            return Ok(());
        };
        let found = done.steps.saturating_sub(done.before);
        let expected = min_steps.saturating_sub(done.before).max(min_steps.min(1));
        if found >= expected {
            return Ok(());
        }
        // If no step was measured, training is assumed to need as long as the preparation.
        let step = (found > 0).then(|| (done.seconds - done.prepared) / f64::from(found));
        let training = step.map_or(done.prepared, |step| 1.5 * step * f64::from(expected)).max(1.0);
        // The reserve is assumed to be the same fraction of a larger limit.
        let kept = (done.reserve / limit).clamp(0.0, 0.5);
        let enough = ((done.prepared + training) / (1.0 - kept)).max(limit).ceil() + 1.0;
        let Done { prepared, reserve, .. } = done;
        bail!(
            "--max-seconds {limit}: expected time for at least {expected} steps, found time for {found}: reading and \
             preparing took {prepared:.1} s, and {reserve:.1} s are kept for the end; ask for --max-seconds {enough} or \
             more, or for --steps alone; no blob is written"
        )
    }

    /// Returns the used fraction of the budget, 0 to 1: of steps or of time, whichever is larger. The fraction of time
    /// is `seconds` divided by the limit minus `reserve`, the seconds for the work after the last step.
    pub fn share(&self, step: u32, seconds: f64, reserve: f64) -> f64 {
        let of_steps = self.steps.map_or(0.0, |steps| f64::from(step) / f64::from(steps));
        let of_time = self.seconds.map_or(0.0, |limit| seconds / (limit - reserve).max(1e-3));
        of_steps.max(of_time).min(1.0)
    }
}

/// Returns the learning rate after `step` steps: `rate · final_share^share`, after a linear warm-up. `share`: used
/// fraction of the budget.
pub fn learning_rate(config: &OptimiserConfig, step: u32, share: f64) -> f64 {
    let warm = if config.warm_up == 0 { 1.0 } else { f64::from(step + 1) / f64::from(config.warm_up) };
    config.rate * config.final_share.powf(share) * warm.min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_in_seconds_is_the_commands_own_and_shares_go_on() {
        let budget = Budget { steps: None, seconds: Some(4.0) };
        // A run with 4 seconds used and a new limit of 4 is as far as a run with 4 of 8 seconds used.
        let taken_up = budget.after(4.0);
        assert_eq!(taken_up.share(0, 4.0, 0.0), Budget { seconds: Some(8.0), ..budget }.share(0, 4.0, 0.0));
        assert_eq!((taken_up.share(0, 7.0, 1.0), taken_up.share(0, 8.0, 0.0)), (1.0, 1.0));
        let steps = Budget { steps: Some(10), seconds: None };
        assert_eq!(steps.after(1e9), steps);
    }

    #[test]
    fn a_limit_that_leaves_too_few_steps_is_refused_with_one_that_does() {
        let budget = Budget { steps: None, seconds: Some(10.0) };
        let done = Done { before: 0, steps: 0, prepared: 6.0, seconds: 8.5, reserve: 2.0 };
        let refused = |done| budget.check_steps(done, MIN_STEPS).expect_err("too few").to_string();
        let text = refused(done);
        for part in
            ["--max-seconds 10:", "at least 20 steps", "for 0", "took 6.0 s", "2.0 s are kept", "--steps"]
        {
            assert!(text.contains(part), "{part}: {text}");
        }
        // Suggested limit: 6 s of reading, 6 s of training, and a fifth of the limit reserved for the end.
        assert!(text.contains("--max-seconds 16 or"), "{text}");
        // Suggested limit: 20 steps of a second each, times 1.5, with 6 s of reading and a fifth reserved.
        let slow = refused(Done { steps: 2, seconds: 8.0, ..done });
        assert!(slow.contains("--max-seconds 46 or"), "{slow}");
        for fine in [
            Done { steps: MIN_STEPS, ..done },
            // A resumed run that has enough steps, and did three more.
            Done { before: 30, steps: 33, ..done },
        ] {
            budget.check_steps(fine, MIN_STEPS).expect("enough");
        }
        assert!(refused(Done { before: 30, steps: 30, ..done }).contains("at least 1 steps"));
        // A run at its limit in steps is accepted however small the limit, and so is a run without a limit in seconds.
        let all = Budget { steps: Some(3), ..budget };
        all.check_steps(Done { steps: 3, ..done }, MIN_STEPS).expect("what was asked for");
        Budget { seconds: None, ..budget }.check_steps(done, MIN_STEPS).expect("no limit");
    }
}
