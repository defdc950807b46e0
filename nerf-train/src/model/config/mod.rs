//! What a run is made of: presets, TOML files and flags end in one [`Config`].

mod optimiser;
#[cfg(test)]
mod tests;

pub use optimiser::OptimiserConfig;

use crate::model::engine::{Adam, Model};
use crate::model::quantise::{ROUNDED_FROM, TableStorage};
use glam::Vec3;
use nerf_core::blob::MAX_SAMPLES;
use nerf_core::camera::Contraction;
use nerf_core::encoding::{
    AngleScale, DirectionEncoding, GridEncoding, MAX_GRID_LEVELS, MAX_GRID_RESOLUTION, MAX_HARMONICS_DEGREE,
    MAX_LEVELS, MAX_LOG2_ENTRIES, PositionEncoding, SinusoidalEncoding,
};
use nerf_core::network::{Architecture, DensityActivation, MAX_COLOUR, MAX_TRUNK, MAX_WIDTH, TrunkLayer};
use serde::{Deserialize, Serialize};

/// Samples a step may draw: some gigabytes of positions, where none is skipped; a first step may skip none.
const MAX_STEP_SAMPLES: usize = 1 << 27;
/// What the occupancy grid's resolution is chosen from, cells along the longest side of the scene box.
const OCCUPANCY_RESOLUTIONS: [u16; 5] = [128, 96, 64, 48, 32];
/// Values of the tables of a grid that is trained, half of what the format holds: a checkpoint, which has each value
/// with two moments, then stays within what is read of one.
const MAX_TABLE_VALUES: usize = 1 << 26;

/// Every setting of a run. Fields that a TOML file leaves out keep the preset's value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The preset it started from.
    pub preset: Preset,
    /// The network.
    pub network: NetworkConfig,
    /// Rays and samples.
    pub sampling: SamplingConfig,
    /// The occupancy grid that skips empty space in training; its end state is the blob's occupancy grid.
    pub occupancy: OccupancyConfig,
    /// The optimiser.
    pub optimiser: OptimiserConfig,
    /// Seed of everything random.
    pub seed: u64,
}

/// A named starting point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// A learned grid and two small layers: seconds to fit, milliseconds to draw.
    Grid,
    /// A small sinusoidal network, empty space skipped from the first step: the smallest files.
    Small,
    /// The classic recipe to the letter: 8×256, dense, 10,000 rays a step, Adam 5e-4.
    Seed,
}

/// The network's shape.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Trunk layers.
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

/// The multiresolution grid that encodes positions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableConfig {
    /// Levels.
    pub levels: usize,
    /// Features of an entry: 1, 2 or 4.
    pub features: u8,
    /// Binary logarithm of the most entries a level has.
    pub log2_entries: u8,
    /// Cells of the first level along the longest side of the scene box.
    pub coarsest: u16,
    /// Cells of the last level.
    pub finest: u16,
    /// What its values are stored in when the run is exported; they are trained in f32.
    pub storage: TableStorage,
}

impl TableConfig {
    /// The grid over a box of this extent: resolutions grow geometrically, and cells are cubes as far as whole
    /// numbers of them allow.
    pub fn encoding(&self, extent: Vec3) -> GridEncoding {
        self.over(3, extent)
    }

    /// The grid over a picture of this size, pixels; its cells are squares as far as whole numbers of them allow.
    pub fn picture_encoding(&self, [width, height]: [u32; 2]) -> GridEncoding {
        self.over(2, Vec3::new(width as f32, height as f32, 0.0))
    }

    fn over(&self, inputs: u8, extent: Vec3) -> GridEncoding {
        let (first, last) = (f64::from(self.coarsest), f64::from(self.finest));
        let longest = extent.max_element();
        let level = |level: usize| {
            let share = if self.levels > 1 { level as f64 / (self.levels - 1) as f64 } else { 0.0 };
            let cells = (first * (last / first).powf(share)).round();
            let mut sides = [0; 3];
            for (axis, side) in sides.iter_mut().enumerate().take(usize::from(inputs)) {
                *side = ((f64::from(extent[axis] / longest) * cells).round() as u16).max(1);
            }
            sides
        };
        let resolutions = (0..self.levels.min(MAX_GRID_LEVELS)).map(level).collect();
        GridEncoding { inputs, features: self.features, log2_entries: self.log2_entries, resolutions }
    }

    /// Whether its tables are trained as they are exported, rounded, when `share` of the run is over.
    pub(crate) fn is_rounded(&self, share: f64) -> bool {
        self.storage == TableStorage::Int8 && share >= ROUNDED_FROM
    }

    /// Checks every setting on its own.
    pub(crate) fn check(&self) -> Result<(), ConfigError> {
        let Self { levels, features, log2_entries, coarsest, finest, storage: _ } = *self;
        let field = "network.grid.levels";
        rule(field, (1..=MAX_GRID_LEVELS).contains(&levels), format!("1 to {MAX_GRID_LEVELS}"), levels)?;
        rule("network.grid.features", matches!(features, 1 | 2 | 4), "1, 2 or 4", features)?;
        let most = format!("1 to {MAX_LOG2_ENTRIES}");
        rule(
            "network.grid.log2_entries",
            (1..=MAX_LOG2_ENTRIES).contains(&log2_entries),
            most,
            log2_entries,
        )?;
        rule("network.grid.coarsest", coarsest >= 1, "at least 1", coarsest)?;
        let most = format!("the coarsest level's {coarsest} to {MAX_GRID_RESOLUTION}");
        rule("network.grid.finest", (coarsest..=MAX_GRID_RESOLUTION).contains(&finest), most, finest)
    }
}

/// Checks the size of the tables of a grid over `what`.
pub(crate) fn check_table_values(grid: &GridEncoding, what: &str) -> Result<(), ConfigError> {
    let values = grid.values();
    let most =
        format!("tables of at most {MAX_TABLE_VALUES} values over {what}: fewer entries, levels or features");
    rule("network.grid.log2_entries", values <= MAX_TABLE_VALUES, most, format!("{values} values"))
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
    /// Live samples a step: rays are drawn until there are as many; 0 to draw exactly `rays`.
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

/// The occupancy grid.
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

impl Preset {
    /// Its settings.
    pub fn config(self) -> Config {
        match self {
            Self::Grid => Config {
                preset: self,
                network: NetworkConfig {
                    depth: 1,
                    width: 32,
                    skip_after: 0,
                    grid: Some(TableConfig {
                        levels: 8,
                        features: 2,
                        log2_entries: 16,
                        coarsest: 24,
                        finest: 256,
                        storage: TableStorage::F16,
                    }),
                    position_levels: 0,
                    direction_levels: 4,
                    feature: false,
                    colour_width: 32,
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
                },
                occupancy: OccupancyConfig {
                    skip: true,
                    resolution: 0,
                    hull: true,
                    every: 16,
                    cells: 8192,
                    from: 0,
                    threshold: 0.01,
                    decay: 0.5,
                    empty_share: 0.0,
                    empty_weight: 0.0,
                },
                optimiser: OptimiserConfig {
                    steps: 12_000,
                    rate: 2e-2,
                    final_share: 0.3,
                    warm_up: 0,
                    beta2: 0.99,
                    epsilon: 1e-15,
                    average: 0.998,
                },
                seed: 0,
            },
            Self::Small => Config {
                preset: self,
                network: NetworkConfig {
                    depth: 4,
                    width: 128,
                    skip_after: 0,
                    grid: None,
                    position_levels: 10,
                    direction_levels: 4,
                    feature: false,
                    colour_width: 64,
                    density: Density::Relu,
                    density_scale: 20.0,
                    density_bias: 2.0,
                },
                sampling: SamplingConfig {
                    samples: 128,
                    steps_across: 150,
                    jitter: Jitter::Bin,
                    rays: 1024,
                    live_samples: 4096,
                    images: 0,
                    random_background: true,
                    near: None,
                    far: None,
                    scene_box: None,
                    contraction: None,
                    distortion: 0.01,
                },
                occupancy: OccupancyConfig {
                    skip: true,
                    resolution: 96,
                    hull: true,
                    every: 32,
                    cells: 1 << 16,
                    from: 100,
                    threshold: 0.05,
                    decay: 0.8,
                    empty_share: 0.06,
                    empty_weight: 0.01,
                },
                optimiser: OptimiserConfig {
                    steps: 12_000,
                    rate: 1e-2,
                    final_share: 0.02,
                    warm_up: 300,
                    beta2: 0.99,
                    epsilon: 1e-15,
                    average: 0.98,
                },
                seed: 0,
            },
            Self::Seed => Config {
                preset: self,
                network: NetworkConfig {
                    depth: 8,
                    width: 256,
                    skip_after: 4,
                    grid: None,
                    position_levels: 10,
                    direction_levels: 4,
                    feature: true,
                    colour_width: 128,
                    density: Density::Relu,
                    density_scale: 1.0,
                    density_bias: 0.0,
                },
                sampling: SamplingConfig {
                    samples: 64,
                    steps_across: 150,
                    jitter: Jitter::Bin,
                    rays: 10_000,
                    live_samples: 0,
                    images: 0,
                    random_background: false,
                    near: None,
                    far: None,
                    scene_box: None,
                    contraction: None,
                    distortion: 0.01,
                },
                occupancy: OccupancyConfig {
                    skip: false,
                    resolution: 128,
                    hull: false,
                    every: 50,
                    cells: 1 << 16,
                    from: 200,
                    threshold: 0.01,
                    decay: 0.8,
                    empty_share: 0.0,
                    empty_weight: 0.0,
                },
                optimiser: OptimiserConfig {
                    steps: 1500,
                    rate: 5e-4,
                    final_share: 1.0,
                    warm_up: 0,
                    beta2: 0.999,
                    epsilon: 1e-8,
                    average: 0.0,
                },
                seed: 0,
            },
        }
    }
}

/// A setting outside its range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field}: expected {expected}, found {found}")]
pub struct ConfigError {
    /// The setting, as in the TOML file.
    pub field: &'static str,
    /// What is allowed.
    pub expected: String,
    /// What was given.
    pub found: String,
}

impl Config {
    /// Checks every setting on its own.
    ///
    /// # Errors
    /// [`ConfigError`] names the first that is out of range.
    pub fn check(&self) -> Result<(), ConfigError> {
        let (n, s, g, o) = (&self.network, &self.sampling, &self.occupancy, &self.optimiser);
        rule("network.depth", (1..=MAX_TRUNK).contains(&n.depth), format!("1 to {MAX_TRUNK}"), n.depth)?;
        rule("network.width", (1..=MAX_WIDTH).contains(&n.width), format!("1 to {MAX_WIDTH}"), n.width)?;
        rule("network.skip_after", n.skip_after < n.depth, "less than the depth", n.skip_after)?;
        rule(
            "network.position_levels",
            n.position_levels <= MAX_LEVELS,
            format!("at most {MAX_LEVELS}"),
            n.position_levels,
        )?;
        rule(
            "network.direction_levels",
            n.direction_levels <= MAX_LEVELS,
            format!("at most {MAX_LEVELS}"),
            n.direction_levels,
        )?;
        rule(
            "network.colour_width",
            n.colour_width <= MAX_WIDTH,
            format!("at most {MAX_WIDTH}"),
            n.colour_width,
        )?;
        rule(
            "network.density_scale",
            positive(n.density_scale.into()),
            "a finite number above 0",
            n.density_scale,
        )?;
        rule("network.density_bias", n.density_bias.is_finite(), "a finite number", n.density_bias)?;
        if let Some(grid) = &n.grid {
            grid.check()?;
            // A box that is no cube has no more.
            check_table_values(&grid.encoding(Vec3::ONE), "a cube")?;
            let levels = n.position_levels;
            rule("network.position_levels", levels == 0, "0 beside a grid, which takes their place", levels)?;
            rule("network.skip_after", n.skip_after == 0, "0 beside a grid", n.skip_after)?;
            rule("network.feature", !n.feature, "false beside a grid", n.feature)?;
            let degree = n.direction_levels;
            let most = format!("at most degree {MAX_HARMONICS_DEGREE} beside a grid");
            rule("network.direction_levels", degree <= MAX_HARMONICS_DEGREE, most, degree)?;
            let density = n.density == Density::Exponential;
            rule("network.density", density, "exponential beside a grid", format!("{:?}", n.density))?;
            rule("network.density_scale", n.density_scale == 1.0, "1 beside a grid", n.density_scale)?;
            // Its samples are trained where light reaches them, which culled space is not.
            rule("occupancy.empty_share", g.empty_share == 0.0, "0 beside a grid", g.empty_share)?;
        }
        let sound = s.distortion.is_finite() && s.distortion >= 0.0;
        rule("sampling.distortion", sound, "finite, at least 0", s.distortion)?;
        if let Some(power) = s.contraction {
            let field = "sampling.contraction";
            rule(field, Contraction::POWERS.contains(&power), "1, 2 or 4", power)?;
            rule(field, n.grid.is_some(), "none without a learned grid", power)?;
            rule(field, s.scene_box.is_none(), "none beside a scene box", power)?;
            rule(field, g.skip, "none where occupancy.skip is false", power)?;
            // The scene's own steps are as many as a file can name.
            let steps = (1.0 + f32::from(power)) * f32::from(s.steps_across);
            let most = format!(
                "2 to {} beside a contraction of power {power}",
                MAX_SAMPLES / (1 + u16::from(power))
            );
            rule(
                "sampling.steps_across",
                s.steps_across > 1 && steps <= f32::from(MAX_SAMPLES),
                most,
                s.steps_across,
            )?;
        }
        rule("sampling.steps_across", s.steps_across > 0, "at least 1", s.steps_across)?;
        rule("sampling.samples", (1..=4096).contains(&s.samples), "1 to 4096", s.samples)?;
        rule("sampling.rays", (1..=1_000_000).contains(&s.rays), "1 to 1000000", s.rays)?;
        let samples = s.rays * usize::from(s.samples);
        rule(
            "sampling.rays",
            samples <= MAX_STEP_SAMPLES,
            format!("at most {MAX_STEP_SAMPLES} samples a step"),
            format!("{} rays of {} samples", s.rays, s.samples),
        )?;
        rule("sampling.live_samples", s.live_samples <= 10_000_000, "at most 10000000", s.live_samples)?;
        rule("occupancy.resolution", (0..=512).contains(&g.resolution), "0 to 512", g.resolution)?;
        rule("occupancy.every", g.every > 0, "at least 1", g.every)?;
        rule(
            "occupancy.threshold",
            g.threshold.is_finite() && g.threshold >= 0.0,
            "a finite number of at least 0",
            g.threshold,
        )?;
        rule(
            "occupancy.empty_weight",
            g.empty_weight.is_finite() && g.empty_weight >= 0.0,
            "a finite number of at least 0",
            g.empty_weight,
        )?;
        rule("occupancy.decay", (0.0..=1.0).contains(&g.decay), "0 to 1", g.decay)?;
        rule("occupancy.empty_share", (0.0..=1.0).contains(&g.empty_share), "0 to 1", g.empty_share)?;
        o.check()?;
        if let Jitter::Width(width) = s.jitter
            && !(width.is_finite() && width >= 0.0)
        {
            let (expected, found) = ("a finite width of at least 0".into(), width.to_string());
            return Err(ConfigError { field: "sampling.jitter", expected, found });
        }
        Ok(())
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
        self.optimiser.rate = 1.5e-2;
        // A step absorbs less than what keeps a cell: what no view needs goes away.
        self.network.density_bias = 1.9;
        self.occupancy.resolution = 128;
        self.occupancy.threshold = 0.1;
        self.occupancy.hull = false;
        self
    }

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

    /// Adam's constants.
    pub fn adam(&self) -> Adam {
        self.optimiser.adam()
    }
}

/// A number above 0.
fn positive(x: f64) -> bool {
    x.is_finite() && x > 0.0
}

/// One line of a check.
pub(crate) fn rule(
    field: &'static str,
    holds: bool,
    expected: impl Into<String>,
    found: impl ToString,
) -> Result<(), ConfigError> {
    let error = || ConfigError { field, expected: expected.into(), found: found.to_string() };
    if holds { Ok(()) } else { Err(error()) }
}
