//! What a checkpoint cannot say of itself.

use super::error::ImportError;
use super::order::{Identity, Order};
use nerf_core::blob::{MAX_OCCUPANCY_RESOLUTION, MAX_SAMPLES, SceneFacts, SceneSampling};
use nerf_core::camera::SceneBox;
use nerf_core::encoding::AngleScale;
use serde::{Deserialize, Serialize};

/// The factor `s` in `sin(2^k s x)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
pub enum AngleFactor {
    /// 1: the original code, nerf-pytorch.
    #[value(name = "1")]
    #[serde(rename = "1")]
    One,
    /// π: the paper's formula.
    #[value(name = "pi")]
    #[serde(rename = "pi")]
    Pi,
}

impl AngleFactor {
    /// As an encoding has it.
    pub fn scale(self) -> AngleScale {
        match self {
            Self::One => AngleScale::One,
            Self::Pi => AngleScale::Pi,
        }
    }
}

/// From the density head's output to sigma.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum RawDensity {
    /// max(0, raw): the original code, nerf-pytorch.
    Relu,
    /// ln(1 + exp(raw)).
    Softplus,
    /// ln(1 + exp(raw − 1)): mip-NeRF.
    ShiftedSoftplus,
}

/// What a checkpoint cannot say of itself.
///
/// The default is what nerf-pytorch does for the synthetic scenes, on black.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The factor of the encodings.
    pub angle: AngleFactor,
    /// The order within the encodings.
    pub order: Order,
    /// Where the inputs stand in the encodings; in front if `None` and the widths say that they are there.
    pub identity: Option<Identity>,
    /// Levels of the position's encoding, to be checked against its width.
    pub position_levels: Option<u8>,
    /// Levels of the direction's encoding, to be checked against its width.
    pub direction_levels: Option<u8>,
    /// From the density head's output to sigma.
    pub density: RawDensity,
    /// What is behind the scene, display-encoded.
    pub background: [f32; 3],
    /// Where rays begin, world units along the ray.
    pub near: f32,
    /// Where rays end, world units along the ray.
    pub far: f32,
    /// The scene box as x0 y0 z0 x1 y1 z1, world units; outside of it density is 0.
    pub scene_box: [f32; 6],
    /// Samples a ray; with a coarse network those drawn from it.
    pub samples: u16,
    /// Samples a ray of the coarse network, if there is one.
    pub coarse_samples: Option<u16>,
    /// Cells of an occupancy grid along the longest side of the box, where one is built.
    pub occupancy_resolution: u16,
    /// A cell of such an occupancy grid is kept where density times bin width exceeds this.
    pub occupancy_threshold: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            angle: AngleFactor::One,
            order: Order::Level,
            identity: None,
            position_levels: None,
            direction_levels: None,
            density: RawDensity::Relu,
            background: [0.0; 3],
            near: 2.0,
            far: 6.0,
            scene_box: [-1.5, -1.5, -1.5, 1.5, 1.5, 1.5],
            samples: Self::EVEN_SAMPLES,
            coarse_samples: None,
            occupancy_resolution: 128,
            occupancy_threshold: 0.01,
        }
    }
}

impl Settings {
    /// Samples a ray of the coarse network, as nerf-pytorch has it.
    pub const COARSE_SAMPLES: u16 = 64;
    /// Samples a ray that are drawn from it.
    pub const DRAWN_SAMPLES: u16 = 128;
    /// Samples a ray without a coarse network: as many as the fine one is asked at with it.
    pub const EVEN_SAMPLES: u16 = Self::COARSE_SAMPLES + Self::DRAWN_SAMPLES;

    /// Checks every setting; the blob's own rules are checked again when it is written.
    ///
    /// # Errors
    /// [`ImportError::Setting`] names the flag.
    pub fn check(&self) -> Result<(), ImportError> {
        let fail =
            |field, expected: String, found: String| Err(ImportError::Setting { field, expected, found });
        let (near, far) = (self.near, self.far);
        if !(near >= 0.0 && near < far && far.is_finite()) {
            let found = format!("near {near}, far {far}");
            return fail("near, far", "0 <= near < far, both finite".into(), found);
        }
        if SceneBox::new(self.min().into(), self.max().into()).is_err() {
            let expected = "finite corners, the smaller first, on every axis".into();
            return fail("box", expected, format!("{:?}", self.scene_box));
        }
        if !(1..=MAX_SAMPLES).contains(&self.samples) {
            return fail("samples", format!("1 to {MAX_SAMPLES}"), self.samples.to_string());
        }
        if let Some(samples) = self.coarse_samples.filter(|samples| !(1..=MAX_SAMPLES).contains(samples)) {
            return fail("coarse_samples", format!("1 to {MAX_SAMPLES}"), samples.to_string());
        }
        if !self.background.iter().all(|channel| (0.0..=1.0).contains(channel)) {
            return fail("background", "channels in [0, 1]".into(), format!("{:?}", self.background));
        }
        if !(1..=MAX_OCCUPANCY_RESOLUTION).contains(&self.occupancy_resolution) {
            let found = self.occupancy_resolution.to_string();
            return fail("occupancy_resolution", format!("1 to {MAX_OCCUPANCY_RESOLUTION}"), found);
        }
        let threshold = self.occupancy_threshold;
        if !(threshold.is_finite() && threshold >= 0.0) {
            return fail(
                "occupancy_threshold",
                "a finite number of at least 0".into(),
                threshold.to_string(),
            );
        }
        Ok(())
    }

    /// Smallest corner of the scene box.
    pub fn min(&self) -> [f32; 3] {
        let [x, y, z, ..] = self.scene_box;
        [x, y, z]
    }

    /// Largest corner of the scene box.
    pub fn max(&self) -> [f32; 3] {
        let [.., x, y, z] = self.scene_box;
        [x, y, z]
    }

    /// sigma that keeps a cell of a built occupancy grid, 1/world unit.
    pub fn sigma_threshold(&self) -> f32 {
        let samples = f32::from(self.samples) + f32::from(self.coarse_samples.unwrap_or(0));
        self.occupancy_threshold * samples / (self.far - self.near)
    }

    /// What the blob says of the scene.
    pub fn facts(&self, occupancy_required: bool) -> SceneFacts {
        let Self { near, far, samples, background, .. } = *self;
        let sampling = SceneSampling::Bins(samples);
        SceneFacts {
            min: self.min(),
            max: self.max(),
            near,
            far,
            sampling,
            background,
            occupancy_required,
            viewpoint: None,
        }
    }
}
