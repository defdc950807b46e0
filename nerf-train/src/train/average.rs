//! The exponential average of the parameters over the steps: less noisy than the parameters after any single step.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Largest horizon of the average, as a fraction of the updates so far. The parameters of the first steps, which
/// describe no scene yet, are thereby soon forgotten.
const REACH: f64 = 1.0 / 9.0;
/// Number of parameters that one task averages.
const PART: usize = 1 << 14;

/// Exponential moving average of the network's parameters over a run's last steps.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Average {
    decay: f64,
    /// Steps between two updates.
    every: u32,
    updates: u32,
    values: Vec<f32>,
}

impl Average {
    /// Creates an average of `parameters` parameters, updated every `every` steps. `decay`: factor per step; 0 keeps no
    /// average.
    pub fn new(decay: f64, every: u32, parameters: usize) -> Self {
        let values = vec![0.0; if decay > 0.0 { parameters } else { 0 }];
        Self { decay: decay.powi(every as i32), every, updates: 0, values }
    }

    /// Whether this average, from a checkpoint after `steps` steps, fits a run that begins with the average `other`.
    pub(super) fn is_like(&self, other: &Self, steps: u32) -> bool {
        let finite = self.values.iter().all(|value| value.is_finite());
        let shape = |average: &Self| (average.decay, average.every, average.values.len());
        // No division by 0: both intervals are equal here, and no run has an interval of 0 steps.
        let counted = || self.values.is_empty() || self.updates == steps / self.every;
        finite && shape(self) == shape(other) && counted()
    }

    pub fn clear(&mut self) {
        self.updates = 0;
    }

    /// Adds the parameters after `steps` steps if an update is due in that step; `parameters` is called only then.
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

    /// The average; `None` if none is kept, or before the first update.
    pub fn values(&self) -> Option<&[f32]> {
        (self.updates > 0).then_some(&self.values)
    }
}
