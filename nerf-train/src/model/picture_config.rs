//! Settings of a 2D field, with presets.

use crate::model::config::{
    ConfigError, OptimiserConfig, TableConfig, at_most, check_table, check_table_values, rule, within,
};
use crate::model::engine::Model;
use crate::model::quantise::TableStorage;
use nerf_core::encoding::{
    AngleScale, MAX_GRID_RESOLUTION, MAX_LEVELS, PositionEncoding, SinusoidalEncoding,
};
use nerf_core::network::{Architecture, MAX_TRUNK, MAX_WIDTH, Shading, TrunkLayer};
use serde::{Deserialize, Serialize};

/// Settings of the fit of a 2D field to one photograph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldConfig {
    pub preset: FieldPreset,
    /// Grid that encodes the position; if absent, the encoding is sinusoidal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid: Option<TableConfig>,
    /// Number of levels of the position's sinusoidal encoding, which has 2 + 4 · levels outputs; 0 with a grid.
    pub levels: u8,
    /// Number of hidden layers, all of one width; the output layer is not counted.
    pub layers: usize,
    pub width: usize,
    /// Number of random pixels per step; with a grid, one in each of `pixels` equal parts of the photograph.
    pub pixels: usize,
    pub optimiser: OptimiserConfig,
    pub seed: u64,
}

/// Name of a preset of a 2D field's settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum FieldPreset {
    /// A learned grid as fine as the image, and small layers: fits in seconds; a file of about 1 MiB for a large image.
    Grid,
    /// Settings of a common course exercise: 10 frequencies, 3 layers of 256 channels, 3,000 steps of 10,000 pixels.
    /// Deviation: the learning rate rises to 1e-2, then falls. With a constant rate and no average of parameters, as in
    /// the exercise (`--set optimiser.warm_up=0`, `final_share=1` and `average=0`), PSNR is 2 dB lower.
    Classic,
    /// Highest PSNR in eight minutes on two cores: 4 layers of 256 channels, and many steps of few pixels.
    Sharp,
}

impl FieldPreset {
    pub fn config(self) -> FieldConfig {
        let grid = TableConfig {
            levels: 8,
            features: 4,
            log2_entries: 15,
            coarsest: 16,
            finest: 1024,
            storage: TableStorage::F16,
            most_bytes: None,
        };
        let (grid, levels, layers, width, pixels) = match self {
            Self::Grid => (Some(grid), 0, 2, 32, 8_192),
            Self::Classic => (None, 10, 3, 256, 10_000),
            Self::Sharp => (None, 10, 4, 256, 1_024),
        };
        let (preset, optimiser) = (self, self.optimiser());
        FieldConfig { preset, grid, levels, layers, width, pixels, optimiser, seed: 0 }
    }

    fn optimiser(self) -> OptimiserConfig {
        let of_grid = OptimiserConfig {
            steps: 8_000,
            rate: 1.5e-2,
            final_share: 0.1,
            warm_up: 0,
            beta2: 0.99,
            epsilon: 1e-15,
            weight_decay: 0.0,
            average: 0.0,
            hashed_every: 1,
        };
        match self {
            Self::Grid => of_grid,
            Self::Classic => OptimiserConfig {
                steps: 3_000,
                rate: 1e-2,
                final_share: 0.05,
                warm_up: 200,
                beta2: 0.999,
                epsilon: 1e-8,
                average: 0.95,
                ..of_grid
            },
            Self::Sharp => OptimiserConfig {
                steps: 40_000,
                rate: 7e-3,
                final_share: 0.01,
                warm_up: 300,
                average: 0.99,
                ..of_grid
            },
        }
    }
}

impl FieldConfig {
    /// Sets the finest level of the grid, if there is one, to one cell per pixel of an image of `size`, pixels.
    pub fn for_picture(mut self, size: [u32; 2]) -> Self {
        if let Some(grid) = &mut self.grid {
            grid.finest = longest(size).min(MAX_GRID_RESOLUTION.into()) as u16;
            grid.coarsest = grid.coarsest.min(grid.finest);
        }
        self
    }

    /// Checks every setting, and whether the grid's finest level and tables suit an image of `size`, pixels.
    pub fn check_for(&self, size: [u32; 2]) -> Result<(), ConfigError> {
        self.check()?;
        let Some(grid) = &self.grid else { return Ok(()) };
        let (finest, most) = (u32::from(grid.finest), longest(size));
        // Cells finer than a pixel are not constrained by the photograph: they would be noise between the pixels.
        let pixels = format!("at most the picture's {most} pixels along its longest side");
        rule("grid.finest", finest <= most, pixels, finest)?;
        check_table_values(&grid.picture_encoding(size), "the picture").map_err(ConfigError::of_picture)
    }

    pub fn check(&self) -> Result<(), ConfigError> {
        at_most("levels", MAX_LEVELS, self.levels)?;
        if let Some(grid) = &self.grid {
            check_table(grid).map_err(ConfigError::of_picture)?;
            rule("levels", self.levels == 0, "0 beside a grid, which takes their place", self.levels)?;
        }
        within("layers", 1..=MAX_TRUNK, self.layers)?;
        within("width", 1..=MAX_WIDTH, self.width)?;
        within("pixels", 1..=1_000_000, self.pixels)?;
        self.optimiser.check()
    }

    /// Returns the network for an image of this width and height, pixels, the same for training and the exported file.
    pub fn model(&self, size: [u32; 2]) -> Model {
        let layer = TrunkLayer { width: self.width as u16, skip: false };
        let (levels, scale) = (self.levels, AngleScale::Pi);
        Model::plain(Architecture {
            position: match &self.grid {
                Some(grid) => PositionEncoding::Grid(grid.picture_encoding(size)),
                None => SinusoidalEncoding { inputs: 2, levels, scale, identity: true }.into(),
            },
            direction: None,
            trunk: std::iter::repeat_n(layer, self.layers.min(MAX_TRUNK)).collect(),
            density: None,
            colour: [].into_iter().collect(),
            shading: Shading::PerSample,
        })
    }
}

fn longest(size: [u32; 2]) -> u32 {
    size[0].max(size[1])
}
