//! Settings of a 2D field, with presets.

use crate::config::{ConfigError, OptimiserConfig, rule};
use crate::engine::{Adam, Model};
use nerf_core::encoding::{AngleScale, MAX_LEVELS, SinusoidalEncoding};
use nerf_core::network::{Architecture, MAX_TRUNK, MAX_WIDTH, TrunkLayer};
use serde::{Deserialize, Serialize};

/// Everything that decides what is learned from a photograph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldConfig {
    /// The preset it started from.
    pub preset: FieldPreset,
    /// Levels of the position's encoding: 2 + 4 · levels inputs.
    pub levels: u8,
    /// Hidden layers, all of one width; the output layer comes on top.
    pub layers: usize,
    /// Channels of every hidden layer.
    pub width: usize,
    /// Pixels a step, drawn at random over the whole picture.
    pub pixels: usize,
    /// The optimiser.
    pub optimiser: OptimiserConfig,
    /// Seed of everything random.
    pub seed: u64,
}

/// A named starting point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum FieldPreset {
    /// The classic exercise: L = 10, 3×256, 3,000 steps of 10,000 pixels, Adam from 1e-2. To the letter, with
    /// a constant rate, it is `--warm-up 0 --final-share 1 --average 0`, and 2 dB worse.
    Classic,
    /// What comes out sharpest in eight minutes of two cores: 4×256, and many small steps that end gently.
    Sharp,
}

impl FieldPreset {
    /// Its settings.
    pub fn config(self) -> FieldConfig {
        match self {
            Self::Classic => FieldConfig {
                preset: self,
                levels: 10,
                layers: 3,
                width: 256,
                pixels: 10_000,
                optimiser: OptimiserConfig {
                    steps: 3_000,
                    rate: 1e-2,
                    final_share: 0.05,
                    warm_up: 200,
                    beta2: 0.999,
                    epsilon: 1e-8,
                    average: 0.95,
                },
                seed: 0,
            },
            Self::Sharp => FieldConfig {
                preset: self,
                levels: 10,
                layers: 4,
                width: 256,
                pixels: 1_024,
                optimiser: OptimiserConfig {
                    steps: 40_000,
                    rate: 7e-3,
                    final_share: 0.01,
                    warm_up: 300,
                    beta2: 0.99,
                    epsilon: 1e-15,
                    average: 0.99,
                },
                seed: 0,
            },
        }
    }
}

impl FieldConfig {
    /// Checks every setting on its own.
    ///
    /// # Errors
    /// [`ConfigError`] names the first that is out of range.
    pub fn check(&self) -> Result<(), ConfigError> {
        rule("levels", self.levels <= MAX_LEVELS, format!("at most {MAX_LEVELS}"), self.levels)?;
        rule("layers", (1..=MAX_TRUNK).contains(&self.layers), format!("1 to {MAX_TRUNK}"), self.layers)?;
        rule("width", (1..=MAX_WIDTH).contains(&self.width), format!("1 to {MAX_WIDTH}"), self.width)?;
        rule("pixels", (1..=1_000_000).contains(&self.pixels), "1 to 1000000", self.pixels)?;
        self.optimiser.check()
    }

    /// The network as it is trained, which is as it is exported.
    pub fn model(&self) -> Model {
        let layer = TrunkLayer { width: self.width as u16, skip: false };
        Model::plain(Architecture {
            position: SinusoidalEncoding {
                inputs: 2,
                levels: self.levels,
                scale: AngleScale::Pi,
                identity: true,
            }
            .into(),
            direction: None,
            trunk: std::iter::repeat_n(layer, self.layers.min(MAX_TRUNK)).collect(),
            density: None,
            colour: [].into_iter().collect(),
        })
    }

    /// Adam's constants.
    pub fn adam(&self) -> Adam {
        self.optimiser.adam()
    }
}
