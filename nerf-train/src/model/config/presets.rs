//! Presets: complete settings of a run.

use super::{
    CaptureConfig, Config, Density, Jitter, NetworkConfig, OccupancyConfig, OptimiserConfig, SamplingConfig,
    TableConfig,
};
use crate::model::engine::EngineKind;
use crate::model::quantise::TableStorage;
use serde::{Deserialize, Serialize};

/// Name of a preset. [`Preset::config`] returns the preset's values of all settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// A learned grid, and a small colour network evaluated once per ray. Seconds to fit, milliseconds per frame.
    Grid,
    /// A small sinusoidal network, for the smallest files. Training skips samples in empty space from the first step.
    Small,
    /// The classic NeRF: 8 layers of 256 channels, no empty space skipped, 10,000 rays a step, Adam with rate 5e-4.
    Seed,
}

impl Preset {
    pub fn config(self) -> Config {
        match self {
            Self::Grid => grid(),
            Self::Small => small(),
            Self::Seed => seed(),
        }
    }
}

fn grid() -> Config {
    Config {
        preset: Preset::Grid,
        engine: EngineKind::Fused,
        network: NetworkConfig {
            depth: 0,
            width: 32,
            skip_after: 0,
            grid: Some(TableConfig {
                levels: 8,
                features: 2,
                log2_entries: 16,
                coarsest: 24,
                finest: 256,
                storage: TableStorage::F16,
                most_bytes: None,
            }),
            position_levels: 0,
            direction_levels: 4,
            feature: false,
            colour_width: 64,
            density: Density::Exponential,
            density_scale: 1.0,
            density_bias: 3.8,
        },
        sampling: SamplingConfig {
            samples: 128,
            steps_across: 150,
            jitter: Jitter::Bin,
            rays: 400,
            live_samples: 6144,
            images: 0,
            random_background: true,
            near: None,
            far: None,
            scene_box: None,
            contraction: None,
            distortion: 0.01,
            smoothness: 0.2,
        },
        occupancy: OccupancyConfig {
            skip: true,
            resolution: 0,
            hull: true,
            every: 16,
            cells: 8192,
            from: 0,
            threshold: 0.03,
            decay: 0.5,
            empty_share: 0.0,
            empty_weight: 0.0,
        },
        capture: CaptureConfig::default(),
        optimiser: OptimiserConfig {
            steps: 12_000,
            rate: 2.5e-2,
            final_share: 0.3,
            warm_up: 0,
            beta2: 0.99,
            epsilon: 1e-15,
            weight_decay: 0.1,
            average: 0.9999,
            hashed_every: 4,
        },
        seed: 0,
    }
}

fn small() -> Config {
    let grid = grid();
    Config {
        preset: Preset::Small,
        network: NetworkConfig {
            depth: 4,
            width: 128,
            grid: None,
            position_levels: 10,
            density: Density::Relu,
            density_scale: 20.0,
            density_bias: 2.0,
            ..grid.network
        },
        sampling: SamplingConfig { rays: 1024, live_samples: 4096, ..grid.sampling },
        occupancy: OccupancyConfig {
            resolution: 96,
            every: 32,
            cells: 1 << 16,
            from: 100,
            threshold: 0.05,
            decay: 0.8,
            empty_share: 0.06,
            empty_weight: 0.01,
            ..grid.occupancy
        },
        optimiser: OptimiserConfig {
            rate: 1e-2,
            final_share: 0.02,
            warm_up: 300,
            weight_decay: 0.0,
            average: 0.98,
            hashed_every: 1,
            ..grid.optimiser
        },
        ..grid
    }
}

fn seed() -> Config {
    let small = small();
    Config {
        preset: Preset::Seed,
        network: NetworkConfig {
            depth: 8,
            width: 256,
            skip_after: 4,
            feature: true,
            colour_width: 128,
            density_scale: 1.0,
            density_bias: 0.0,
            ..small.network
        },
        sampling: SamplingConfig {
            samples: 64,
            rays: 10_000,
            live_samples: 0,
            random_background: false,
            ..small.sampling
        },
        occupancy: OccupancyConfig {
            skip: false,
            resolution: 128,
            hull: false,
            every: 50,
            from: 200,
            threshold: 0.01,
            empty_share: 0.0,
            empty_weight: 0.0,
            ..small.occupancy
        },
        optimiser: OptimiserConfig {
            steps: 1500,
            rate: 5e-4,
            final_share: 1.0,
            warm_up: 0,
            beta2: 0.999,
            epsilon: 1e-8,
            average: 0.0,
            ..small.optimiser
        },
        ..small
    }
}
