//! The exponential average of the parameters over the steps: less noisy than the parameters after any single step.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Largest time constant of the average, as a fraction of the number of updates so far. The average thus soon forgets
/// the first steps.
const REACH: f64 = 1.0 / 9.0;
/// Number of parameters that one parallel task averages.
const PART: usize = 1 << 14;

/// Exponential moving average of the network's parameters over a run's last steps.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Average {
    decay: f64,
    /// Number of training steps between two updates of the average.
    every: u32,
    updates: u32,
    values: Vec<f32>,
}

impl Average {
    /// Creates an average of `parameters` values, updated after every `every` training steps. `decay`: factor of the
    /// old average per training step; 0 keeps no average.
    pub fn new(decay: f64, every: u32, parameters: usize) -> Self {
        let values = vec![0.0; if decay > 0.0 { parameters } else { 0 }];
        Self { decay: decay.powi(every as i32), every, updates: 0, values }
    }

    /// Whether this average, read from a checkpoint, can belong to the run: finite, with the decay, interval and number
    /// of values of the run's own average `other`, and with the number of updates due after `steps` steps.
    pub(super) fn is_like(&self, other: &Self, steps: u32) -> bool {
        let finite = self.values.iter().all(|value| value.is_finite());
        let shape = |average: &Self| (average.decay, average.every, average.values.len());
        // `every` is not 0 here: it equals that of `other`, and no run has an interval of 0 steps.
        let counted = || self.values.is_empty() || self.updates == steps / self.every;
        finite && shape(self) == shape(other) && counted()
    }

    pub fn clear(&mut self) {
        self.updates = 0;
    }

    /// Updates the average with the present `parameters` if `every` divides `steps`, the number of steps done.
    pub fn update<'p>(&mut self, steps: u32, parameters: impl FnOnce() -> Cow<'p, [f32]>) {
        if self.values.is_empty() || !steps.is_multiple_of(self.every) {
            return;
        }
        let before = f64::from(self.updates);
        let decay = self.decay.min(before / (before + 1.0 / REACH)) as f32;
        self.updates += 1;
        let parameters = parameters();
        let parts = self.values.par_chunks_mut(PART).zip(parameters.par_chunks(PART));
        parts.for_each(|(values, parameters)| {
            for (average, parameter) in values.iter_mut().zip(parameters) {
                *average = decay * *average + (1.0 - decay) * parameter;
            }
        });
    }

    /// Returns the averaged parameters; `None` before the first update, or if no average is kept.
    pub fn values(&self) -> Option<&[f32]> {
        (self.updates > 0).then_some(&self.values)
    }
}
