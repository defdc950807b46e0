//! Settings of a run: presets, TOML files and flags end in one [`Config`].

mod check;
mod optimiser;
mod presets;
mod table;
#[cfg(test)]
mod tests;

pub use check::ConfigError;
pub(crate) use check::{at_most, check_table, check_table_values, rule, within};
pub use optimiser::OptimiserConfig;
pub use presets::Preset;
pub use table::TableConfig;

use crate::model::engine::{EngineKind, Model};
use glam::Vec3;
use nerf_core::encoding::{AngleScale, DirectionEncoding, PositionEncoding, SinusoidalEncoding};
use nerf_core::network::{Architecture, DensityActivation, MAX_COLOUR, MAX_TRUNK, Shading, TrunkLayer};
use serde::{Deserialize, Serialize};

/// Candidate resolutions of the occupancy grid, cells along the longest side of the scene box.
const OCCUPANCY_RESOLUTIONS: [u16; 5] = [128, 96, 64, 48, 32];

/// Every setting of a run. Fields that a TOML file leaves out keep the preset's value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Preset that the settings started from.
    pub preset: Preset,
    /// Engine that computes the gradients.
    pub engine: EngineKind,
    pub network: NetworkConfig,
    pub sampling: SamplingConfig,
    /// Occupancy grid, which skips empty space in training and then in the blob.
    pub occupancy: OccupancyConfig,
    /// Use of a capture's sparse points, exposures, poses and moving objects; with a grid only.
    pub capture: CaptureConfig,
    pub optimiser: OptimiserConfig,
    /// Seed of all random numbers.
    pub seed: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Number of trunk layers; 0 only with a grid: density and colour then read the grid's features.
    pub depth: usize,
    /// Channels of every trunk layer.
    pub width: usize,
    /// Trunk layers before the skip connection from the encoded position; 0 for none.
    pub skip_after: usize,
    /// The grid that encodes positions; the sinusoidal encoding if absent.
    pub grid: Option<TableConfig>,
    /// Levels of the position's sinusoidal encoding.
    pub position_levels: u8,
    /// Levels of the direction's sinusoidal encoding; with a grid, the degree of its spherical harmonics. 0 for a
    /// colour that does not depend on the direction.
    pub direction_levels: u8,
    /// Whether a linear layer stands between trunk and colour branch (folded away at export).
    pub feature: bool,
    /// Channels of the colour branch's hidden layer; 0 for none.
    pub colour_width: usize,
    /// Activation from raw density to sigma.
    pub density: Density,
    /// `sigma = activation(scale · raw)` in training.
    pub density_scale: f32,
    /// Added to the initial density, after scaling. For an exponential density: the logarithm of the optical depth
    /// along the scene box's longest side at the start.
    pub density_bias: f32,
}

/// Activation from raw density to sigma.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Density {
    /// max(0, raw).
    Relu,
    /// ln(1 + exp(raw − 1)).
    Softplus,
    /// exp(raw), up to the core's limit.
    Exponential,
}

/// How rays and samples are drawn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SamplingConfig {
    /// Samples per ray, in equal bins between near and far; with a grid, follows from `steps_across`.
    pub samples: u16,
    /// With a grid: steps of a ray across the longest side of the scene box; in an unbounded scene, across the ball
    /// that is not contracted.
    pub steps_across: u16,
    /// Random offset of a sample in its bin: none, the whole bin, or a width in world units.
    pub jitter: Jitter,
    /// Rays per step; with `live_samples`, rays of the first step. `rays` times `samples` is at most 2^27.
    pub rays: usize,
    /// Samples per step in occupied cells or, with a grid, of large enough weight: decides the number of rays. 0 draws
    /// exactly `rays`.
    pub live_samples: usize,
    /// Images per step if rays are drawn image by image; 0 draws over all pixels of all images.
    pub images: usize,
    /// Composite pictures with alpha over a random colour per ray, so that opacity is learned.
    pub random_background: bool,
    /// Distance at which rays begin, world units; from the data if absent.
    pub near: Option<f32>,
    /// Distance at which rays end, world units; from the data if absent.
    pub far: Option<f32>,
    /// Scene box as x0 y0 z0 x1 y1 z1; found from the data if absent. Must be absent with a contraction.
    pub scene_box: Option<[f32; 6]>,
    /// Power with which steps grow in an unbounded scene, contracted around what the cameras look at: 1, 2 or 4. Absent
    /// for a scene in a box. With a grid only.
    pub contraction: Option<u8>,
    /// Weight of the distortion loss, which concentrates the weights along a ray; in an unbounded scene only, lengths
    /// in sides of its cube. 0 for none.
    pub distortion: f32,
}

/// Use of a capture's sparse points, exposures, poses and moving objects.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureConfig {
    /// Weight of the depth loss: distances of sparse points along an eighth of the rays; 0 for none.
    pub depth: f32,
    /// Whether space that lines of sight to sparse points cross is taken as free.
    pub free_space: bool,
    /// Whether each photograph has an exposure gain.
    pub exposure: Exposure,
    /// Whether poses are refined.
    pub poses: PoseRefinement,
    /// Whether moving objects are left out of the loss.
    pub moving: MovingObjects,
    /// Whether photographs are withheld at the beginning, to choose the weight decay by their error.
    pub withhold: Withholding,
}

impl Default for CaptureConfig {
    fn default() -> Self {
        Self {
            depth: 1.0,
            free_space: true,
            exposure: Exposure::Auto,
            poses: PoseRefinement::Auto,
            moving: MovingObjects::Auto,
            withhold: Withholding::Auto,
        }
    }
}

/// Whether each photograph has a gain, which models its exposure and white balance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Exposure {
    /// Gains if exposures differ enough; in a box, if withheld photographs contradict the others.
    Auto,
    /// Each photograph has its own gain.
    Own,
    /// No photograph has a gain.
    Shared,
}

/// Whether the photographs' poses are refined with the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PoseRefinement {
    /// Refined if the given poses are too inaccurate.
    Auto,
    /// Always.
    Refine,
    /// Never: the given poses stay.
    Given,
}

/// Whether moving objects are left out of the loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MovingObjects {
    /// If moving objects are found.
    Auto,
    /// No search for moving objects.
    Off,
}

/// Whether photographs are withheld at the beginning of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Withholding {
    /// An eighth of the photographs, if there are sixteen or more.
    Auto,
    /// No photographs.
    Off,
}

/// What the data tell about a scene's background.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surroundings {
    /// The pictures tell which of their parts are background.
    Known,
    /// The background is unknown; the scene ends at a box.
    Unknown,
    /// The background is unknown; the scene has no end.
    Unbounded,
}

/// How samples are perturbed in training; never in rendering.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Jitter {
    /// Sample in the middle of the bin.
    None,
    /// Sample anywhere in the bin.
    Bin,
    /// Sample up to this far after the start of the bin, world units; anywhere in a bin that is no wider.
    Width(f32),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OccupancyConfig {
    /// Whether empty space is skipped in training.
    pub skip: bool,
    /// Cells along the longest side of the scene box; 0 to choose them by the size of the grid's tables.
    pub resolution: u16,
    /// Whether a visual hull is carved if the pictures tell what is empty.
    pub hull: bool,
    /// Steps between updates of the occupancy grid from the network.
    pub every: u32,
    /// Most cells that one update evaluates.
    pub cells: usize,
    /// First step at which cells may be dropped.
    pub from: u32,
    /// Optical depth (density times bin width) above which a cell is kept; in the file of a marched scene at least
    /// 0.03.
    pub threshold: f32,
    /// Factor on a cell's stored density at each update.
    pub decay: f32,
    /// Points in culled space per step, whose density is pushed to 0, per sample in occupied cells.
    pub empty_share: f32,
    /// Weight in the loss of the density at the points in culled space.
    pub empty_weight: f32,
}

impl Config {
    /// Steps between updates of the parameters' average: a grid has many parameters, of which a step moves few.
    pub(crate) fn averaged_every(&self) -> u32 {
        if self.network.grid.is_some() { 16 } else { 1 }
    }

    /// The network as it is trained, over a cube of side 1.
    pub fn model(&self) -> Model {
        self.model_of(Vec3::ONE)
    }

    /// Cells of the occupancy grid along the longest side of a box of this extent: the configured number or, if that is
    /// 0, the largest candidate whose bits take at most a third of the space of the grid's tables.
    pub fn occupancy_resolution(&self, extent: Vec3) -> u16 {
        if self.occupancy.resolution > 0 {
            return self.occupancy.resolution;
        }
        let Some(table) = &self.network.grid else { return OCCUPANCY_RESOLUTIONS[0] };
        // One bit per cell and two bytes per value, whatever the storage at export.
        let most = 16 * table.encoding(extent).values() / 3;
        let sides = |resolution: u16| (extent / extent.max_element() * f32::from(resolution)).round();
        let fits = |&resolution: &u16| sides(resolution).element_product() <= most as f32;
        OCCUPANCY_RESOLUTIONS.into_iter().find(fits).unwrap_or(OCCUPANCY_RESOLUTIONS[4])
    }

    /// The network as it is trained, over a scene box of this extent.
    pub fn model_of(&self, extent: Vec3) -> Model {
        let n = &self.network;
        let sinusoidal =
            |levels| SinusoidalEncoding { inputs: 3, levels, scale: AngleScale::Pi, identity: true };
        let position = match &n.grid {
            Some(grid) => PositionEncoding::Grid(grid.encoding(extent)),
            None => sinusoidal(n.position_levels).into(),
        };
        let direction = match &n.grid {
            Some(_) => DirectionEncoding::SphericalHarmonics { degree: n.direction_levels },
            None => sinusoidal(n.direction_levels).into(),
        };
        // `check` limits depth and width to these capacities.
        let trunk = (0..n.depth.min(MAX_TRUNK))
            .map(|i| TrunkLayer { width: n.width as u16, skip: i > 0 && i == n.skip_after })
            .collect();
        let colour: heapless::Vec<u16, MAX_COLOUR> =
            (n.colour_width > 0).then_some(n.colour_width as u16).into_iter().collect();
        let architecture = Architecture {
            position,
            direction: (n.direction_levels > 0).then_some(direction),
            trunk,
            density: Some(match n.density {
                Density::Relu => DensityActivation::Relu,
                Density::Softplus => DensityActivation::ShiftedSoftplus,
                Density::Exponential => DensityActivation::Exponential,
            }),
            colour,
            shading: if n.grid.is_some() { Shading::PerRay } else { Shading::PerSample },
        };
        // An exponential density starts at the same optical depth whatever the unit of length is.
        let per_unit = match n.density {
            Density::Exponential => extent.max_element().ln(),
            Density::Relu | Density::Softplus => 0.0,
        };
        Model {
            architecture,
            feature: n.feature,
            density_scale: n.density_scale,
            density_bias: n.density_bias - per_unit,
        }
    }

    /// Settings for data from which no hull can be carved. The network itself must then find the empty space: without a
    /// gentler start, all its densities become 0.
    pub fn without_hull(mut self) -> Self {
        if self.preset == Preset::Small {
            self.network.density_bias = 0.5;
            self.occupancy.from = 400;
            self.optimiser.rate = 5e-3;
        }
        let preset = self.preset.config();
        if let Some(grid) = &mut self.network.grid {
            // Without a hull the box follows from the cameras' distances, and the object is only a part of the box: the
            // preset's grid is made finer.
            if preset.network.grid.as_ref() == Some(&*grid) {
                (grid.coarsest, grid.finest) = (32, 416);
            }
            if self.sampling.steps_across == preset.sampling.steps_across {
                self.sampling.steps_across = 220;
            }
            // If the scene were opaque from the start, each view would be painted onto the shell of the box.
            self.network.density_bias = 0.0;
        }
        self.occupancy.hull = false;
        self
    }

    /// Adapts the settings to a scene's surroundings.
    pub fn around(self, surroundings: Surroundings) -> Self {
        match surroundings {
            Surroundings::Known => self,
            Surroundings::Unknown => self.without_hull(),
            Surroundings::Unbounded => self.unbounded(),
        }
    }

    /// Settings for photographs that also show what is behind the scene; without a grid, those of
    /// [`Config::without_hull`].
    pub fn unbounded(mut self) -> Self {
        let Some(grid) = &mut self.network.grid else { return self.without_hull() };
        (grid.log2_entries, grid.coarsest, grid.finest) = (16, 16, 1024);
        self.sampling.contraction = Some(1);
        self.sampling.steps_across = 160;
        self.sampling.random_background = true;
        self.sampling.live_samples = 4096;
        // With hashed levels updated only every few steps, a short fit keeps its fog: 17.7 dB in place of 19.8 in a
        // test's 1,500 steps.
        self.optimiser.hashed_every = 1;
        // The initial optical depth of a step is below the occupancy threshold: cells that no view needs are dropped.
        self.network.density_bias = 1.9;
        self.occupancy.resolution = 128;
        self.occupancy.threshold = 0.1;
        self.occupancy.hull = false;
        self
    }

    pub fn check(&self) -> Result<(), ConfigError> {
        check::check(self)
    }
}
