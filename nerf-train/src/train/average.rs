//! The exponential average of the parameters: smoother than any single step's.

use serde::{Deserialize, Serialize};

/// A running average, started at 0 and corrected for that when it is read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Average {
    decay: f64,
    values: Vec<f32>,
}

impl Average {
    /// An average of `parameters` values; a `decay` of 0 keeps none.
    pub fn new(decay: f64, parameters: usize) -> Self {
        Self { decay, values: vec![0.0; if decay > 0.0 { parameters } else { 0 }] }
    }

    /// Whether this is the same average of other steps.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        let finite = self.values.iter().all(|value| value.is_finite());
        finite && (self.decay, self.values.len()) == (other.decay, other.values.len())
    }

    /// Begins anew.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Takes a step's parameters in; they are not asked for where no average is kept.
    pub fn update(&mut self, parameters: impl FnOnce() -> Vec<f32>) {
        if self.values.is_empty() {
            return;
        }
        let decay = self.decay as f32;
        for (average, parameter) in self.values.iter_mut().zip(parameters()) {
            *average = decay * *average + (1.0 - decay) * parameter;
        }
    }

    /// The average after `steps` updates; `None` if there is none, or nothing in it yet.
    pub fn corrected(&self, steps: u32) -> Option<Vec<f32>> {
        let started = 1.0 - self.decay.powf(f64::from(steps));
        let correct = |&average: &f32| (f64::from(average) / started) as f32;
        (self.decay > 0.0 && started > 0.0).then(|| self.values.iter().map(correct).collect())
    }
}
