//! Settings that an import needs and a checkpoint does not store.

use super::order::{Identity, Order};
use crate::data::pictures::colour;
use crate::model::config::{ConfigError, rule, within};
use crate::system::input::parse_numbers;
use glam::Vec3;
use nerf_core::blob::{MAX_OCCUPANCY_RESOLUTION, MAX_SAMPLES, SceneFacts, SceneSampling};
use nerf_core::encoding::AngleScale;
use nerf_core::space::SceneBox;

/// The factor `s` in `sin(2^k s x)`, the encoding of an input `x` at level `k`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum AngleFactor {
    /// s = 1, as in the original NeRF code and nerf-pytorch.
    #[value(name = "1")]
    One,
    /// s = π, as in the formula of the NeRF paper.
    Pi,
}

impl AngleFactor {
    pub fn scale(self) -> AngleScale {
        match self {
            Self::One => AngleScale::One,
            Self::Pi => AngleScale::Pi,
        }
    }
}

/// Activation that turns the density head's output into sigma.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum RawDensity {
    /// max(0, raw), as in the original NeRF code and nerf-pytorch.
    Relu,
    /// ln(1 + exp(raw)).
    Softplus,
    /// ln(1 + exp(raw − 1)), as in mip-NeRF.
    ShiftedSoftplus,
}

/// Settings that an import needs and a checkpoint does not store.
///
/// The defaults are those of nerf-pytorch for the synthetic scenes, with a black background.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(next_help_heading = "Settings that the checkpoint does not store [defaults: as nerf-pytorch]")]
pub struct Settings {
    /// Factor s of the encoding sin(2^k s x).
    #[arg(long, value_enum, value_name = "S", default_value = "1")]
    pub angle_scale: AngleFactor,
    /// Order of sines and cosines. level (nerf-pytorch): per level, sin x, sin y, sin z, cos x, cos y, cos z; pairs:
    /// per level, sin x, cos x, sin y, cos y, sin z, cos z; input (tiny-cuda-nn): per input, sin and cos of each level;
    /// halves (mip-NeRF): sines by level, then cosines; halves-by-input (nerfstudio): sines by input, then cosines.
    #[arg(long, value_enum, default_value = "level")]
    pub order: Order,
    /// Position of the raw inputs in the encoding [default: first, or none if the tensors' shapes show no raw inputs].
    #[arg(long, value_enum)]
    pub identity: Option<Identity>,
    /// Levels of the position encoding; must agree with the tensors' shapes [default: from the shapes].
    #[arg(long, value_name = "L")]
    pub position_levels: Option<u8>,
    /// Levels of the direction encoding; must agree with the tensors' shapes [default: from the shapes].
    #[arg(long, value_name = "L")]
    pub direction_levels: Option<u8>,
    /// Activation that turns the density head's output into sigma.
    #[arg(long, value_enum, default_value = "relu")]
    pub density: RawDensity,
    /// Background: a name (black, white, red), #RRGGBB or R,G,B (0 to 255).
    #[arg(long, value_name = "COLOUR", value_parser = colour::parse, default_value = "black")]
    pub background: [f32; 3],
    /// Near plane, world units along the ray.
    #[arg(long, value_name = "T", default_value_t = 2.0)]
    pub near: f32,
    /// Far plane, world units along the ray.
    #[arg(long, value_name = "T", default_value_t = 6.0)]
    pub far: f32,
    /// Scene box: least x, y, z, then greatest x, y, z, world units. Outside of the box density is 0.
    #[arg(
        long = "box",
        value_name = "X0,Y0,Z0,X1,Y1,Z1",
        value_parser = parse_numbers::<6, f32>,
        default_value = "-1.5,-1.5,-1.5,1.5,1.5,1.5",
        allow_hyphen_values = true
    )]
    pub scene_box: [f32; 6],
    /// Samples per ray [default: 192; with --coarse: 128 importance samples].
    #[arg(long, value_name = "N")]
    pub samples: Option<u16>,
    /// Samples per ray of the coarse network.
    #[arg(long, value_name = "N", requires = "coarse", default_value_t = 64)]
    pub coarse_samples: u16,
    /// Cells of the occupancy grid along the longest side of the box, if the import builds the grid.
    #[arg(long, value_name = "N", default_value_t = 128)]
    pub occupancy_resolution: u16,
    /// Density × (far − near) / samples above which a cell is occupied, if the import builds the occupancy grid.
    #[arg(long, value_name = "X", default_value_t = 0.01)]
    pub occupancy_threshold: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            angle_scale: AngleFactor::One,
            order: Order::Level,
            identity: None,
            position_levels: None,
            direction_levels: None,
            density: RawDensity::Relu,
            background: [0.0; 3],
            near: 2.0,
            far: 6.0,
            scene_box: [-1.5, -1.5, -1.5, 1.5, 1.5, 1.5],
            samples: None,
            coarse_samples: 64,
            occupancy_resolution: 128,
            occupancy_threshold: 0.01,
        }
    }
}

impl Settings {
    /// Checks the settings against their limits. Numbers of levels are checked later, against the tensors' shapes.
    pub fn check(&self) -> Result<(), ConfigError> {
        let Self { near, far, background, occupancy_threshold: threshold, .. } = *self;
        let sound = near >= 0.0 && near < far && far.is_finite();
        rule("near, far", sound, "0 <= near < far, both finite", format!("near {near}, far {far}"))?;
        let SceneBox { min, max } = self.bounds();
        let sound = SceneBox::new(min, max).is_ok();
        let expected = "finite corners, the smaller first, on every axis";
        rule("box", sound, expected, format!("{:?}", self.scene_box))?;
        within("samples", 1..=MAX_SAMPLES, self.samples.unwrap_or(1))?;
        within("coarse_samples", 1..=MAX_SAMPLES, self.coarse_samples)?;
        let sound = background.iter().all(|channel| (0.0..=1.0).contains(channel));
        rule("background", sound, "channels in [0, 1]", format!("{background:?}"))?;
        within("occupancy_resolution", 1..=MAX_OCCUPANCY_RESOLUTION, self.occupancy_resolution)?;
        let sound = threshold.is_finite() && threshold >= 0.0;
        rule("occupancy_threshold", sound, "a finite number of at least 0", threshold)
    }

    pub fn bounds(&self) -> SceneBox {
        let [x0, y0, z0, x1, y1, z1] = self.scene_box;
        SceneBox { min: Vec3::new(x0, y0, z0), max: Vec3::new(x1, y1, z1) }
    }

    /// Returns the number of samples per ray of the fine network. With a coarse network, these are importance samples.
    pub fn samples(&self, has_coarse: bool) -> u16 {
        self.samples.unwrap_or(if has_coarse { 128 } else { 192 })
    }

    pub fn facts(&self, has_coarse: bool, occupancy_required: bool) -> SceneFacts {
        let Self { near, far, background, .. } = *self;
        let sampling = SceneSampling::Bins(self.samples(has_coarse));
        let (min, max) = (self.bounds().min.into(), self.bounds().max.into());
        SceneFacts { min, max, near, far, sampling, background, occupancy_required, viewpoint: None }
    }
}
