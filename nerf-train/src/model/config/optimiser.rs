//! Settings of every training: Adam, its schedule, and the average that is exported.

use super::check::{ConfigError, positive, rule, within};
use crate::model::engine::Adam;
use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimiserConfig {
    /// Number of steps; if only a limit in seconds is given, time alone decides.
    pub steps: u32,
    /// Learning rate at the start.
    pub rate: f64,
    /// Learning rate at the end, as a fraction of `rate`; 1 keeps it constant.
    pub final_share: f64,
    /// Steps over which the learning rate rises from 0.
    pub warm_up: u32,
    /// Adam's decay of the second moment.
    pub beta2: f64,
    /// Adam's epsilon.
    pub epsilon: f64,
    /// Decoupled weight decay: each step multiplies a weight by 1 − learning rate · decay. With a grid, only weights
    /// of the colour branch decay.
    pub weight_decay: f64,
    /// Decay per step of the exponential average of the parameters that is exported. Its horizon is at most a ninth
    /// of the steps so far. 0 exports the last parameters.
    pub average: f64,
    /// Steps between two updates of a hashed level of the grid, each by the sum of the gradients meanwhile; 1 updates
    /// every level at every step.
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
