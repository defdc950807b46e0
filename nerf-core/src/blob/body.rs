//! The content of a blob, as plain data.

use crate::encoding::{GridEncoding, SinusoidalEncoding};
use crate::network::{Architecture, DensityActivation, MAX_TRUNK, Shading, TrunkLayer};
use crate::space::{Contraction, SceneBox};
use glam::Vec3;
use serde::{Deserialize, Serialize, Serializer};

/// Maximum number of samples per ray.
pub const MAX_SAMPLES: u16 = 4096;
/// Maximum side of the image that a 2D field was fitted to, pixels.
pub const MAX_PICTURE_SIDE: u32 = 65_535;
/// Maximum number of cells of the occupancy grid along one axis.
pub const MAX_OCCUPANCY_RESOLUTION: u16 = 512;
/// Maximum length of each text of the provenance, bytes.
pub const MAX_TEXT: usize = 1024;
/// Maximum number of points of a Pareto front.
pub const MAX_FRONT: usize = 16;

/// The body of a blob, in file order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Body<'a> {
    /// The network's shape.
    pub architecture: Architecture,
    /// Whether the blob is a scene or a 2D field, with its bounds or size.
    pub content: Content,
    /// The occupancy grid, if the scene has one.
    #[serde(borrow)]
    pub occupancy: Option<StoredOccupancy<'a>>,
    /// The Pareto front of accuracy against work, most expensive point first; empty if none was measured.
    pub front: ParetoFront,
    /// A second, cheaper network: the samples of the scene's network are drawn from its weights along a ray.
    #[serde(borrow)]
    pub proposal: Option<Proposal<'a>>,
    /// Data, program, settings and PSNR that the blob results from.
    pub provenance: Provenance<'a>,
    /// The parameters as little-endian f16, in the order of [`Architecture::layers`].
    #[serde(serialize_with = "as_bytes")]
    pub weights: &'a [u8],
    /// The table entries of the grid encoding; present if and only if a grid encodes the position.
    #[serde(borrow)]
    pub tables: Option<StoredTables<'a>>,
}

impl<'a> Body<'a> {
    /// The grid and the coded bytes; `None` unless tables are coded.
    pub(super) fn coded(&self) -> Option<(&GridEncoding, &'a [u8])> {
        match (self.architecture.position.grid(), self.tables) {
            (Some(grid), Some(StoredTables::Coded { bytes, .. })) => Some((grid, bytes)),
            _ => None,
        }
    }
}

/// The entries of a grid as stored in the file: level by level, entry by entry, feature by feature.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StoredTables<'a> {
    /// Little-endian f16, finite.
    F16(#[serde(serialize_with = "as_bytes")] &'a [u8]),
    /// Signed bytes; a value is its byte times the scale of its level.
    Int8 {
        /// One little-endian f32 per level, above 0; 128 times the scale is finite.
        #[serde(serialize_with = "as_bytes")]
        scales: &'a [u8],
        /// One signed byte per value.
        #[serde(serialize_with = "as_bytes")]
        bytes: &'a [u8],
    },
    /// The values of [`StoredTables::Int8`], entropy-coded; a renderer decodes them into its own memory.
    Coded {
        /// Scales as in [`StoredTables::Int8`].
        #[serde(serialize_with = "as_bytes")]
        scales: &'a [u8],
        /// The coded bytes.
        #[serde(serialize_with = "as_bytes")]
        bytes: &'a [u8],
    },
}

impl<'a> StoredTables<'a> {
    /// The bytes of the entries, as stored in the file.
    pub const fn bytes(&self) -> &'a [u8] {
        match self {
            Self::F16(bytes) | Self::Int8 { bytes, .. } | Self::Coded { bytes, .. } => bytes,
        }
    }

    /// The scales of the levels; `None` for f16.
    pub const fn scales(&self) -> Option<&'a [u8]> {
        match self {
            Self::F16(_) => None,
            Self::Int8 { scales, .. } | Self::Coded { scales, .. } => Some(scales),
        }
    }

    /// Name of the format: `f16`, `int8` or `coded`.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::F16(_) => "f16",
            Self::Int8 { .. } => "int8",
            Self::Coded { .. } => "coded",
        }
    }
}

/// The content of a blob: a 2D field or a scene.
///
/// A 2D field's network has 2 inputs and no density head, a scene's 3 inputs and a density head.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Content {
    /// Colour over a plane: a 2D field.
    Picture(PictureFacts),
    /// Density and colour in space.
    Scene(SceneFacts),
}

/// Size of the image that a 2D field was fitted to. The field can be rendered at any size.
///
/// The network's inputs are x to the right and y down, each 0 to 1 over the image at any aspect ratio.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PictureFacts {
    /// Pixels per row, 1 to [`MAX_PICTURE_SIDE`].
    pub width: u32,
    /// Number of rows, 1 to [`MAX_PICTURE_SIDE`].
    pub height: u32,
}

/// Bounds and conventions of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneFacts {
    /// Smallest corner of the scene box, world units.
    pub min: [f32; 3],
    /// Largest corner of the scene box, world units.
    pub max: [f32; 3],
    /// Near plane of the cameras that the scene was trained on, world units along the ray.
    pub near: f32,
    /// Far plane of the cameras that the scene was trained on, world units along the ray.
    pub far: f32,
    /// Placement of the samples along a ray.
    pub sampling: SceneSampling,
    /// Background colour, visible where opacity is below 1; display-encoded.
    pub background: [f32; 3],
    /// Whether the occupancy grid is part of the model: the network was never trained in empty cells, and rendering
    /// without the grid is refused.
    pub occupancy_required: bool,
    /// Default viewpoint; `None` if the photographs' cameras are not known.
    pub viewpoint: Option<Viewpoint>,
}

/// A viewpoint among the scene's photographs: a view from there shows parts that were photographed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Viewpoint {
    /// The camera's position, world units.
    pub eye: [f32; 3],
    /// Point the camera looks at, the photographs' subject, world units; not along `up` from the eye.
    pub target: [f32; 3],
    /// Upward direction of the photographs; unit length within 1e-3.
    pub up: [f32; 3],
    /// Arc around the target that the photographs cover, radians around `up`, centred on the eye: 0 to 2π.
    pub arc: f32,
}

/// Placement of a ray's samples, at which a scene's field is evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum SceneSampling {
    /// The middles of this number of equal bins of `near..far`, at which the network was trained. With a proposal
    /// network, the number of samples drawn from the proposal. 1 to [`MAX_SAMPLES`].
    Bins(u16),
    /// Steps of this length, world units, from the point where the ray enters the scene box to the point where it
    /// leaves. Finite, above 0, and at most [`MAX_SAMPLES`] steps along the box's diagonal.
    March(f32),
    /// Steps through unbounded space, which is contracted into the scene box, a cube ([`Contraction`]). Steps are equal
    /// in the inner ball and grow outside of the ball, from `near` to `far` beyond the ball's middle.
    Contracted {
        /// Length of a step in the inner ball, in radii of the ball: above 0, at most 1, and at most [`MAX_SAMPLES`]
        /// steps on a ray that comes from far away.
        step: f32,
        /// Power with which steps outside of the ball grow: 1, 2 or 4.
        power: u8,
    },
}

impl SceneFacts {
    /// Number of samples per ray: bins of `near..far`, or steps on the longest ray through the box.
    pub fn samples(&self) -> u16 {
        match self.sampling {
            SceneSampling::Bins(samples) => samples,
            SceneSampling::March(step) => steps(self.diagonal(), step).min(MAX_SAMPLES.into()) as u16,
            SceneSampling::Contracted { step, .. } => {
                steps(self.reach(), step).min(MAX_SAMPLES.into()) as u16
            }
        }
    }

    /// Distance between samples, world units; in a contracted scene, inside the inner ball.
    pub fn step(&self) -> f32 {
        match self.sampling {
            SceneSampling::Contracted { step, .. } => {
                step * self.contraction().map_or(1.0, |contraction| contraction.radius())
            }
            SceneSampling::Bins(samples) => (self.far - self.near) / f32::from(samples),
            SceneSampling::March(step) => step,
        }
    }

    /// The contraction; `None` in a bounded scene.
    pub fn contraction(&self) -> Option<Contraction> {
        let SceneSampling::Contracted { power, .. } = self.sampling else { return None };
        Contraction::new(&self.bounds(), power)
    }

    /// The scene box.
    pub(crate) fn bounds(&self) -> SceneBox {
        SceneBox { min: Vec3::from(self.min), max: Vec3::from(self.max) }
    }

    /// Length of a ray of a contracted scene from the rim of the inner ball to `far`, in the unit of `s` in
    /// [`Contraction::distance`].
    pub(crate) fn reach(&self) -> f32 {
        self.contraction().map_or(0.0, |contraction| 1.0 + contraction.step_at(self.far))
    }

    /// Length of the scene box's diagonal, world units.
    pub(crate) fn diagonal(&self) -> f32 {
        (Vec3::from(self.max) - Vec3::from(self.min)).length()
    }
}

/// Number of steps that cover `length`, rounded up; at least 1.
pub(crate) fn steps(length: f32, step: f32) -> u32 {
    let steps = length / step;
    // `as` saturates, and converts NaN to 0.
    let whole = steps as u32;
    if (whole as f32) < steps { whole.saturating_add(1) } else { whole.max(1) }
}

/// The occupancy grid: one bit per cell of the scene box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredOccupancy<'a> {
    /// Number of cells along x, y, z.
    pub resolution: [u16; 3],
    /// Bit `(x * ny + y) * nz + z`, least significant bit of a byte first; padding bits are 0.
    #[serde(serialize_with = "as_bytes")]
    pub bits: &'a [u8],
}

impl StoredOccupancy<'_> {
    /// Size of an occupancy grid of this resolution, bytes; `usize::MAX` on overflow.
    pub fn bytes(resolution: [u16; 3]) -> usize {
        let cells: u64 = resolution.iter().map(|&side| u64::from(side)).product();
        usize::try_from(cells.div_ceil(8)).unwrap_or(usize::MAX)
    }
}

/// The Pareto front of a scene, most expensive point first.
pub type ParetoFront = heapless::Vec<FrontPoint, MAX_FRONT>;

/// The settings of a [`Quality`](crate::plan::Quality) with their loss and cost. No point of a Pareto front has both a
/// lower cost and a higher PSNR than another.
///
/// Cost is in multiply-adds, not in time, which depends on the host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrontPoint {
    /// Samples per ray, 1 to [`MAX_SAMPLES`].
    pub samples: u16,
    /// Transmittance below which a ray ends, `[0, 1)`.
    pub transmittance_cut: f32,
    /// Weight above which a sample's colour is evaluated, `[0, 1)`.
    pub colour_cut: f32,
    /// Whether empty cells are skipped; true only in a scene with an occupancy grid.
    pub occupancy: bool,
    /// Elementary functions (exp, sin, …) of these settings, as [`MathBackend::tag`](crate::math::MathBackend::tag).
    pub math: u8,
    /// Whether samples are drawn from the proposal network; true only in a scene that has one.
    pub proposal: bool,
    /// PSNR of the scene's exact rendering minus that of this point, against ground truth, dB. Negative if the
    /// approximation happens to be better.
    pub loss_db: f32,
    /// Multiply-adds of this point relative to the exact rendering's, above 0.
    pub cost: f32,
}

/// A network with densities only: encoding, trunk and density head, over the scene box.
///
/// # Source
/// Mildenhall et al. 2020, section 5.2: the coarse network, of which rendering uses only the weights
/// along the ray. Its colours are not in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Proposal<'a> {
    /// Encoding of the position, which may differ from that of the scene's network.
    pub position: SinusoidalEncoding,
    /// The trunk, in order; the input of the first layer is `PE(x)`, without a skip.
    pub trunk: heapless::Vec<TrunkLayer, MAX_TRUNK>,
    /// Activation of the density head.
    pub density: DensityActivation,
    /// Samples per ray at which the proposal is evaluated, one in each of equal bins of `near..far`.
    pub samples: u16,
    /// The parameters as little-endian f16, in the order of [`Architecture::layers`]: trunk, density head.
    #[serde(serialize_with = "as_bytes")]
    pub weights: &'a [u8],
}

impl Proposal<'_> {
    /// The shape as a scene's architecture. Its rgb head has no parameters in [`Proposal::weights`], which end after
    /// [`Architecture::density_parameters`].
    pub fn architecture(&self) -> Architecture {
        Architecture {
            position: self.position.into(),
            direction: None,
            trunk: self.trunk.clone(),
            density: Some(self.density),
            colour: heapless::Vec::new(),
            shading: Shading::PerSample,
        }
    }
}

/// Origin of a blob: data, program, settings and measured PSNR.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance<'a> {
    /// Name of the data that the network was fitted to.
    pub data: &'a str,
    /// Program and settings that made the blob.
    pub made_by: &'a str,
    /// Number of optimiser steps.
    pub steps: u32,
    /// Seed of the training run.
    pub seed: u64,
    /// Mean PSNR of this blob over the validation views, dB; `None` without validation views.
    pub psnr_db: Option<f32>,
    /// Conventions by which the PSNR was measured: views, background, samples.
    pub psnr_convention: &'a str,
    /// PSNR lost on the validation views by rounding weights and tables to their stored format, dB (negative: a
    /// gain); `None` if not measured.
    pub quantisation_loss_db: Option<f32>,
    /// Number of trained parameters, before layers are folded for the export.
    pub trained_parameters: u32,
}

impl Provenance<'_> {
    /// Empty provenance.
    pub const NONE: Self = Self {
        data: "",
        made_by: "",
        steps: 0,
        seed: 0,
        psnr_db: None,
        psnr_convention: "",
        quantisation_loss_db: None,
        trained_parameters: 0,
    };
}

/// Serialises all bytes in one call instead of one call per byte; the bytes written are the same.
fn as_bytes<S: Serializer>(bytes: &&[u8], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(bytes)
}
