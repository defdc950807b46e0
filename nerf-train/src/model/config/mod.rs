//! What a run is made of: presets, TOML files and flags end in one [`Config`].

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

use crate::model::engine::{Adam, EngineKind, Model};
use glam::Vec3;
use nerf_core::encoding::{AngleScale, DirectionEncoding, PositionEncoding, SinusoidalEncoding};
use nerf_core::network::{Architecture, DensityActivation, MAX_COLOUR, MAX_TRUNK, Shading, TrunkLayer};
use serde::{Deserialize, Serialize};

/// What the occupancy grid's resolution is chosen from, cells along the longest side of the scene box.
const OCCUPANCY_RESOLUTIONS: [u16; 5] = [128, 96, 64, 48, 32];
/// Every setting of a run. Fields that a TOML file leaves out keep the preset's value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The preset it started from.
    pub preset: Preset,
    /// What computes the gradients.
    pub engine: EngineKind,
    pub network: NetworkConfig,
    pub sampling: SamplingConfig,
    /// The occupancy grid that skips empty space in training; its end state is the blob's occupancy grid.
    pub occupancy: OccupancyConfig,
    /// What photographs of an unbounded scene are believed of; beside a grid.
    pub capture: CaptureConfig,
    pub optimiser: OptimiserConfig,
    /// Seed of everything random.
    pub seed: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Trunk layers; 0 beside a grid only, whose values density and colour are then read from.
    pub depth: usize,
    /// Channels of every trunk layer.
    pub width: usize,
    /// Trunk layers in front of the one that takes the encoded position again; 0 for none.
    pub skip_after: usize,
    /// The grid that encodes positions; the sinusoidal encoding if absent.
    pub grid: Option<TableConfig>,
    /// Levels of the position's sinusoidal encoding.
    pub position_levels: u8,
    /// Levels of the direction's sinusoidal encoding, or beside a grid the degree of its spherical harmonics; 0 for a
    /// colour that does not depend on it.
    pub direction_levels: u8,
    /// Whether a linear layer stands between trunk and colour branch (folded away at export).
    pub feature: bool,
    /// Channels of the colour branch's hidden layer; 0 for none.
    pub colour_width: usize,
    /// From raw density to sigma.
    pub density: Density,
    /// `sigma = activation(scale · raw)` in training.
    pub density_scale: f32,
    /// Start value added to the density, after scaling; of an exponential density, the logarithm of the optical depth
    /// of the scene box's longest side at the start.
    pub density_bias: f32,
}

/// From raw density to sigma.
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

/// Where rays and samples are drawn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SamplingConfig {
    /// Samples per ray, equal bins between near and far; beside a grid they follow from `steps_across`.
    pub samples: u16,
    /// Steps that a ray takes across the longest side of the scene box, beside a grid; in an unbounded scene across the
    /// ball that is not contracted.
    pub steps_across: u16,
    /// Share of a bin, around its start, that a sample is drawn from; or a width in world units.
    pub jitter: Jitter,
    /// Rays a step; times `samples` at most 2^27. With `live_samples` the rays of the first step, all of which are
    /// drawn before any is left out: the same limit holds.
    pub rays: usize,
    /// Live samples a step, beside a grid those of them that weigh enough to be kept: as many rays are drawn as have them;
    /// 0 to draw exactly `rays`.
    pub live_samples: usize,
    /// Draw rays image by image: this many images a step; 0 to draw over all pixels of all images.
    pub images: usize,
    /// Composite pictures with alpha over a random colour per ray, so that opacity is learned.
    pub random_background: bool,
    /// Rays begin here, world units; as the data says if absent.
    pub near: Option<f32>,
    /// Rays end here, world units; as the data says if absent.
    pub far: Option<f32>,
    /// The scene box as x0 y0 z0 x1 y1 z1; found from the data if absent. None beside a contraction.
    pub scene_box: Option<[f32; 6]>,
    /// An unbounded scene, contracted around what the cameras look at: the power that its steps grow with, 1, 2 or 4.
    /// Beside a grid only.
    pub contraction: Option<u8>,
    /// Weight of the distortion loss in an unbounded scene, lengths in sides of its cube: the weights of a ray draw
    /// together. 0 for none.
    pub distortion: f32,
}

/// What is made of what a capture says of its scene, beside its colours.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureConfig {
    /// Weight of the distances of sparse points along an eighth of the rays; 0 for none.
    pub depth: f32,
    /// Whether space that lines of sight to sparse points cross is free.
    pub free_space: bool,
    /// Whether each photograph has a gain.
    pub exposure: Exposure,
    /// Whether poses are refined.
    pub poses: PoseRefinement,
    /// Whether what moved is left out of the loss.
    pub moving: MovingObjects,
    /// Whether photographs are withheld at the beginning, to choose the weight decay by them.
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

/// Whether photographs have gains: exposure and white balance of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Exposure {
    /// Where they differ by enough; in a box, where withheld photographs contradict the others.
    Auto,
    /// Each.
    Own,
    /// None.
    Shared,
}

/// Whether the photographs' poses are refined with the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PoseRefinement {
    /// Where they are off by enough.
    Auto,
    /// In any case.
    Refine,
    /// They stay as they are given.
    Given,
}

/// Whether what moved between photographs is left out of the loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MovingObjects {
    /// Where it is found.
    Auto,
    /// It is not searched for.
    Off,
}

/// Whether photographs are withheld at the beginning of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Withholding {
    /// An eighth of them, where there are sixteen or more.
    Auto,
    /// None.
    Off,
}

/// What the data says of what lies around a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surroundings {
    /// Which parts of the pictures are background.
    Known,
    /// Nothing, but it ends at a box.
    Unknown,
    /// Nothing, and it goes on for ever.
    Unbounded,
}

/// How samples are perturbed in training; never in rendering.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Jitter {
    /// In the middle of the bin.
    None,
    /// Anywhere in the bin.
    Bin,
    /// At the start of the bin plus up to this much, world units; anywhere in a bin that is no wider.
    Width(f32),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OccupancyConfig {
    /// Whether empty space is skipped in training.
    pub skip: bool,
    /// Cells along the longest side of the scene box; 0 for as many as suit the field's own size.
    pub resolution: u16,
    /// Whether a visual hull is carved where the pictures say what is empty.
    pub hull: bool,
    /// Steps between refreshes from the network.
    pub every: u32,
    /// Most cells that a refresh asks.
    pub cells: usize,
    /// First step at which cells may be dropped.
    pub from: u32,
    /// A cell is kept while its density times the bin width exceeds this; in the file of a marched scene, at least 0.03.
    pub threshold: f32,
    /// What a cell's remembered density is multiplied with at each refresh.
    pub decay: f32,
    /// Points of culled space a step, as a share of the live samples, pushed to zero density.
    pub empty_share: f32,
    /// Weight of their term in the loss.
    pub empty_weight: f32,
}

impl Config {
    /// Steps from one that is averaged to the next: a grid has many parameters, of which a step moves few.
    pub(crate) fn averaged_every(&self) -> u32 {
        if self.network.grid.is_some() { 16 } else { 1 }
    }

    /// The network as it is trained, over a cube of side 1.
    pub fn model(&self) -> Model {
        self.model_of(Vec3::ONE)
    }

    /// Cells of the occupancy grid along the longest side of a box of this extent: what was asked for, or else the
    /// most whose bits take no more than a third of the grid's tables.
    pub fn occupancy_resolution(&self, extent: Vec3) -> u16 {
        if self.occupancy.resolution > 0 {
            return self.occupancy.resolution;
        }
        let Some(table) = &self.network.grid else { return OCCUPANCY_RESOLUTIONS[0] };
        // A bit a cell, and two bytes a value, whatever they are exported as.
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
        // The capacities are those that `check` holds depth and width to.
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

    pub fn adam(&self) -> Adam {
        self.optimiser.adam()
    }

    /// What changes where no hull can be carved and the network itself must find the empty space:
    /// a gentler start, or its densities die in the fog.
    pub fn without_hull(mut self) -> Self {
        if self.preset == Preset::Small {
            self.network.density_bias = 0.5;
            self.occupancy.from = 400;
            self.optimiser.rate = 5e-3;
        }
        let preset = self.preset.config();
        if let Some(grid) = &mut self.network.grid {
            // What is found without a hull is a part of the box that the cameras' distances give: finer, where nobody
            // has chosen.
            if preset.network.grid.as_ref() == Some(&*grid) {
                (grid.coarsest, grid.finest) = (32, 416);
            }
            if self.sampling.steps_across == preset.sampling.steps_across {
                self.sampling.steps_across = 220;
            }
            // Opaque from the start, each view would be painted onto the shell of the box.
            self.network.density_bias = 0.0;
        }
        self.occupancy.hull = false;
        self
    }

    /// These settings, for what lies around a scene.
    pub fn around(self, surroundings: Surroundings) -> Self {
        match surroundings {
            Surroundings::Known => self,
            Surroundings::Unknown => self.without_hull(),
            Surroundings::Unbounded => self.unbounded(),
        }
    }

    /// What changes where photographs show whatever is behind the scene, too; of a preset without a grid as
    /// [`Config::without_hull`].
    pub fn unbounded(mut self) -> Self {
        let Some(grid) = &mut self.network.grid else { return self.without_hull() };
        (grid.log2_entries, grid.coarsest, grid.finest) = (16, 16, 1024);
        self.sampling.contraction = Some(1);
        self.sampling.steps_across = 160;
        self.sampling.random_background = true;
        self.sampling.live_samples = 4096;
        // In turns, a short fit does not get out of its fog: 17.7 dB for 19.8 in a law's 1,500 steps.
        self.optimiser.hashed_every = 1;
        // A step absorbs less than what keeps a cell: what no view needs goes away.
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
