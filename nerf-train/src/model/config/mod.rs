//! Settings of a run, merged from a preset, a TOML file and flags into one [`Config`].

mod check;
mod optimiser;
mod presets;
mod table;
#[cfg(test)]
mod tests;

pub use check::{ConfigError, MAX_OCCUPANCY_RESOLUTION, MAX_TABLE_VALUES};
pub(crate) use check::{at_most, check_table, check_table_values, rule, within};
pub use optimiser::OptimiserConfig;
pub use presets::Preset;
pub use table::TableConfig;

use crate::model::engine::{EngineKind, Model};
use glam::Vec3;
use nerf_core::encoding::{AngleScale, DirectionEncoding, PositionEncoding, SinusoidalEncoding};
use nerf_core::network::{Architecture, DensityActivation, MAX_COLOUR, MAX_TRUNK, Shading, TrunkLayer};
use serde::{Deserialize, Serialize};

/// Resolutions among which [`Config::occupancy_resolution`] chooses: numbers of cells of the occupancy grid along the
/// longest side of the scene box.
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
    /// Occupancy grid, by which training and rendering skip empty space.
    pub occupancy: OccupancyConfig,
    /// Use of a capture's sparse points, exposures, poses and moving objects in training. Only with a learned grid.
    pub capture: CaptureConfig,
    pub optimiser: OptimiserConfig,
    /// Seed of all random numbers.
    pub seed: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Number of trunk layers. With a grid, 0 is allowed: density and colour then read the grid's features.
    pub depth: usize,
    /// Number of channels of every trunk layer.
    pub width: usize,
    /// Number of trunk layers before the skip connection from the encoded position; 0 for no skip connection.
    pub skip_after: usize,
    /// Grid that encodes positions; if absent, the encoding is sinusoidal.
    pub grid: Option<TableConfig>,
    /// Number of levels (frequencies) of the position's sinusoidal encoding; 0 with a grid.
    pub position_levels: u8,
    /// Number of levels (frequencies) of the direction's sinusoidal encoding. With a grid, the direction is encoded by
    /// spherical harmonics instead, and this is their degree. With 0, the colour does not depend on the direction.
    pub direction_levels: u8,
    /// Whether a linear layer lies between trunk and colour branch. Export merges this layer with the next one.
    pub feature: bool,
    /// Number of channels of the colour branch's hidden layer; 0 for no hidden layer.
    pub colour_width: usize,
    /// Activation that turns the density head's raw output into sigma.
    pub density: Density,
    /// Factor on the density head's raw output in training: `sigma = activation(density_scale · raw)`.
    pub density_scale: f32,
    /// Initial bias `b` of the density head, added to `density_scale · raw`. With an exponential density, ln(longest
    /// side of the scene box) is subtracted from `b`. The initial optical depth along this side is then exp(`b`).
    pub density_bias: f32,
}

/// Activation that turns the density head's raw output into sigma.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Density {
    /// max(0, raw).
    Relu,
    /// ln(1 + exp(raw − 1)).
    Softplus,
    /// exp(min(raw, 20)).
    Exponential,
}

/// Settings of the rays and samples of a training step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SamplingConfig {
    /// Number of samples per ray: one in each of this many equal bins between near and far. With a learned grid,
    /// `steps_across` applies instead.
    pub samples: u16,
    /// Number of ray march steps across the longest side of the scene box. In an unbounded scene, the steps are counted
    /// across the ball inside which space is not contracted. Used with a learned grid only.
    pub steps_across: u16,
    /// Position of each sample in its bin: in the middle, anywhere at random, or at random within a given distance
    /// (world units) of the start of the bin.
    pub jitter: Jitter,
    /// Number of rays per step; if `live_samples` is above 0, number of rays of the first step only. `rays` times
    /// `samples` must be at most 2^27.
    pub rays: usize,
    /// Target number of samples per step; the number of rays is adapted to reach this target. With 0, every step has
    /// `rays` rays. Samples in empty cells do not count towards the target. With a learned grid, only trained samples
    /// count: all samples of compositing weight above 0.003, and a random choice of the samples of smaller weight.
    pub live_samples: usize,
    /// Number of random images per step, with equally many rays each. 0: rays are drawn from all pixels of all images.
    pub images: usize,
    /// Whether each ray of an image with alpha gets a random background colour, so that the network learns opacity.
    pub random_background: bool,
    /// Distance along a ray at which its samples begin, world units; derived from the data if absent.
    pub near: Option<f32>,
    /// Distance along a ray at which its samples end, world units; derived from the data if absent.
    pub far: Option<f32>,
    /// Scene box as x0 y0 z0 x1 y1 z1, world units; derived from the data if absent. Not allowed with `contraction`.
    pub scene_box: Option<[f32; 6]>,
    /// Power of an unbounded scene's contraction: 1, 2 or 4; absent for a scene in a box. Contraction maps all of space
    /// into a cube, and leaves a ball around the cameras' subject unchanged. Outside the ball, ray march steps grow
    /// with the distance r from the ball's centre. The steps are proportional to r² with power 1 (uniform in
    /// disparity), to r^1.5 with power 2, and to r^1.25 with power 4. Requires a learned grid.
    pub contraction: Option<u8>,
    /// Weight of the distortion loss, which concentrates the compositing weights along a ray; 0 for none. Unbounded
    /// scenes only. The unit of distance in this loss is the side of the contracted cube.
    pub distortion: f32,
    /// Weight of the smoothness loss, which flattens surfaces of uniform colour; 0 for none. Unbounded scenes only.
    pub smoothness: f32,
}

/// Settings for the use of a capture's sparse points, exposures, poses and moving objects in training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureConfig {
    /// Weight of the depth loss; 0 for none. This loss applies to an eighth of the rays, which are cast at sparse
    /// points.
    pub depth: f32,
    /// Whether the initial occupancy grid marks the cells between each camera and its visible sparse points as empty.
    pub free_space: bool,
    /// Choice of whether each photograph has a learned gain for its exposure: "auto", "own" or "shared".
    pub exposure: Exposure,
    /// Choice of whether training refines the photographs' poses: "auto", "refine" or "given". Unbounded scenes only.
    pub poses: PoseRefinement,
    /// Choice of whether pixels that show moving objects are left out of the loss: "auto" or "off". Unbounded scenes
    /// only.
    pub moving: MovingObjects,
    /// "auto": some photographs are held out during the first steps only, and the weight decay grows with the gap between
    /// their PSNR and that of the other photographs. "off": none are held out, and the weight decay stays as set.
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

/// Choice of whether each photograph has a learned gain per colour channel, to model exposure and white balance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Exposure {
    /// In an unbounded scene, gains are first estimated. Photographs have learned gains if the standard deviation of
    /// the estimated log gains is at least 0.12, or if one estimate differs from the mean by at least a factor of 2. In
    /// a scene box, photographs have learned gains if the PSNR of withheld photographs is more than 3.4 dB below the
    /// PSNR of all other photographs.
    Auto,
    /// Each photograph has its own gain.
    Own,
    /// No photograph has a gain.
    Shared,
}

/// Choice of whether the photographs' poses are refined together with the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PoseRefinement {
    /// Poses stay as given if the median reprojection error of the sparse points is at most 2 pixels. Otherwise, poses
    /// are refined in the first 1,000 steps. If this moves the images by at least 0.008 focal lengths (median over the
    /// photographs), refinement continues; if not, the given poses are restored.
    Auto,
    /// Poses are refined throughout training.
    Refine,
    /// Poses are never refined.
    Given,
}

/// Choice of whether pixels that show moving objects are left out of the loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MovingObjects {
    /// Training searches for moving objects, and leaves the pixels that show one out of the loss.
    Auto,
    /// Training does not search for moving objects: all pixels are in the loss.
    Off,
}

/// Choice of whether some photographs are withheld from the first steps of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Withholding {
    /// Six photographs are withheld if there are at least 24, the run has at least 3,000 steps, poses are not refined,
    /// and the weight decay is not 0.
    Auto,
    /// No photographs are withheld.
    Off,
}

/// What is known of a scene's surroundings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surroundings {
    /// The images show which of their pixels are background, by alpha or by a constant colour.
    Known,
    /// The background is unknown; the scene is within a box.
    Unknown,
    /// The background is unknown; the scene is unbounded.
    Unbounded,
}

/// Position of a training sample in its bin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Jitter {
    /// Each sample lies in the middle of its bin.
    None,
    /// Each sample lies at a uniformly random position in its bin (stratified sampling).
    Bin,
    /// Each sample lies at a random position in the part of its bin that begins at the bin's start and has this length,
    /// world units. If the bin is shorter, the position is anywhere in the bin.
    Width(f32),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OccupancyConfig {
    /// Whether training skips samples in empty cells.
    pub skip: bool,
    /// Number of cells along the longest side of the scene box; 0 for an automatic choice. The automatic number is 128
    /// without a learned grid. With a learned grid, the number is from 32 to 128, and grows with the grid's tables.
    pub resolution: u16,
    /// Whether the occupancy grid begins as a visual hull: the cells that no image shows as background. Effective only
    /// if the images show which pixels are background.
    pub hull: bool,
    /// Number of steps between updates of the occupancy grid from the network's densities.
    pub every: u32,
    /// Largest number of cells that one update evaluates. With a learned grid, at least 1/24 of the cells that the
    /// initial occupancy grid leaves occupied are evaluated, even if this exceeds the limit.
    pub cells: usize,
    /// First step at which an update may turn occupied cells into empty ones.
    pub from: u32,
    /// Optical depth (density times bin width) above which a cell stays occupied. For a scene that is rendered by ray
    /// marching, export uses at least 0.03.
    pub threshold: f32,
    /// Factor by which an update multiplies a cell's stored density. The larger of the product and the new density is
    /// stored.
    pub decay: f32,
    /// Number of training points in empty cells, as a multiple of the number of samples in occupied cells. The loss
    /// pushes the density at these points to 0.
    pub empty_share: f32,
    /// Weight of the loss term that pushes the density at points in empty cells to 0.
    pub empty_weight: f32,
}

impl Config {
    /// Returns the number of steps between updates of the parameters' average. With a grid, the average is updated less
    /// often, since a step changes few of the many parameters.
    pub(crate) fn averaged_every(&self) -> u32 {
        if self.network.grid.is_some() { 16 } else { 1 }
    }

    /// Returns the model that training fits, for a scene box that is a cube of side 1. Export merges some of the
    /// model's layers.
    pub fn model(&self) -> Model {
        self.model_of(Vec3::ONE)
    }

    /// Returns the number of occupancy cells along the longest side of a box of this extent. An `occupancy.resolution`
    /// above 0 is returned unchanged. Otherwise, the result is the largest candidate resolution whose bits take at most
    /// a third of the bytes of the learned grid's tables as f16. If no candidate is small enough, the result is 32.
    /// Without a learned grid, the result is 128.
    pub fn occupancy_resolution(&self, extent: Vec3) -> u16 {
        if self.occupancy.resolution > 0 {
            return self.occupancy.resolution;
        }
        let Some(table) = &self.network.grid else { return OCCUPANCY_RESOLUTIONS[0] };
        // Number of bits in a third of the tables. A value counts as two bytes, whatever its storage at export.
        let most = 16 * table.encoding(extent).values() / 3;
        let sides = |resolution: u16| (extent / extent.max_element() * f32::from(resolution)).round();
        let fits = |&resolution: &u16| sides(resolution).element_product() <= most as f32;
        OCCUPANCY_RESOLUTIONS.into_iter().find(fits).unwrap_or(OCCUPANCY_RESOLUTIONS[4])
    }

    /// Returns the model that training fits, for a scene box of this extent, world units. The extent sets the number of
    /// grid cells per axis, and the initial value of an exponential density.
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

    /// Adapts the settings to data from which no visual hull can be carved. The network must then learn which space is
    /// empty. With a grid: lowers the initial density, and makes grid cells and march steps finer. With the preset
    /// small: lowers initial density and learning rate, so that not all densities become 0.
    pub fn without_hull(mut self) -> Self {
        if self.preset == Preset::Small {
            self.network.density_bias = 0.5;
            self.occupancy.from = 400;
            self.optimiser.rate = 5e-3;
        }
        let preset = self.preset.config();
        if let Some(grid) = &mut self.network.grid {
            // Without a hull, the box is derived from the cameras' distances, and is larger than the object. A grid
            // finer than the preset's makes up for this.
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

    /// Applies [`Config::without_hull`] if the background is unknown, [`Config::unbounded`] if the scene is unbounded.
    pub fn around(self, surroundings: Surroundings) -> Self {
        match surroundings {
            Surroundings::Known => self,
            Surroundings::Unknown => self.without_hull(),
            Surroundings::Unbounded => self.unbounded(),
        }
    }

    /// Adapts the settings to photographs of an unbounded scene: turns on contraction, and sets the grid's size, march
    /// steps, samples per step, initial density and occupancy grid. Without a grid, does [`Config::without_hull`]
    /// instead.
    pub fn unbounded(mut self) -> Self {
        let Some(grid) = &mut self.network.grid else { return self.without_hull() };
        (grid.log2_entries, grid.coarsest, grid.finest) = (16, 16, 1024);
        self.sampling.contraction = Some(1);
        self.sampling.steps_across = 160;
        self.sampling.random_background = true;
        self.sampling.live_samples = 4096;
        // Hashed levels are updated at every step, since otherwise fog remains after a short fit. In a test of 1,500
        // steps with less frequent updates, PSNR was 17.7 dB instead of 19.8 dB.
        self.optimiser.hashed_every = 1;
        // The initial optical depth of a ray march step is below the occupancy threshold. Cells that no view makes
        // denser therefore become empty.
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
