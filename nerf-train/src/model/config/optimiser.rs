//! Settings of the optimiser: Adam, the schedule of its learning rate, and the average of the parameters.

use super::check::{ConfigError, positive, rule, within};
use crate::model::engine::Adam;
use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimiserConfig {
    /// Number of training steps; ignored if only a time limit is given.
    pub steps: u32,
    /// Learning rate at the start of the run; during the warm-up, the learning rate is smaller.
    pub rate: f64,
    /// Learning rate at the end of the run, as a fraction of `rate`; 1 for no decay.
    pub final_share: f64,
    /// Number of steps at the start of the run over which the learning rate rises linearly from 0; 0 for no warm-up.
    pub warm_up: u32,
    /// Adam's beta2: decay of the second moment per step.
    pub beta2: f64,
    /// Adam's epsilon, which is added to the square root of the second moment.
    pub epsilon: f64,
    /// Decoupled weight decay: each step multiplies a weight by 1 − learning rate · decay. With a grid, only weights
    /// of the colour branch decay.
    pub weight_decay: f64,
    /// Decay per step of the exponential moving average of the parameters. Early in a run the decay is smaller: the
    /// average's time constant is at most a ninth of the steps so far. Export takes the average or, if `average` is 0,
    /// the parameters of the last step.
    pub average: f64,
    /// Number of steps between two updates of a hashed level of the grid. An update uses the sum of the gradients since
    /// the last update. 1: every level is updated at every step.
    pub hashed_every: u32,
}

impl OptimiserConfig {
    pub fn check(&self) -> Result<(), ConfigError> {
        rule("optimiser.steps", self.steps > 0, "at least 1", self.steps)?;
        rule("optimiser.rate", positive(self.rate) && self.rate <= 10.0, "above 0, at most 10", self.rate)?;
        let share = self.final_share;
        rule("optimiser.final_share", positive(share) && share <= 1.0, "above 0, at most 1", share)?;
        rule("optimiser.beta2", (0.0..1.0).contains(&self.beta2), "0 to 1, without 1", self.beta2)?;
        // Adam divides by epsilon in f32 if a gradient was always 0.
        let sound = (self.epsilon as f32).is_finite() && self.epsilon as f32 > 0.0;
        rule("optimiser.epsilon", sound, "above 0, in the range of f32", self.epsilon)?;
        let shrinks = (0.0..=1.0).contains(&(self.rate * self.weight_decay));
        rule("optimiser.weight_decay", shrinks, "at least 0, times the rate at most 1", self.weight_decay)?;
        rule("optimiser.average", (0.0..1.0).contains(&self.average), "0 to 1, without 1", self.average)?;
        within("optimiser.hashed_every", 1..=16, self.hashed_every)
    }

    pub fn adam(&self) -> Adam {
        Adam {
            betas: [0.9, self.beta2],
            epsilon: self.epsilon,
            weight_decay: self.weight_decay,
            hashed_every: self.hashed_every,
        }
    }
}
