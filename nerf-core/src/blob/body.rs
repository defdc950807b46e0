//! Data types of a blob's body: everything in a `*.nerf` file after the header.

use crate::encoding::{GridEncoding, SinusoidalEncoding};
use crate::math::length;
use crate::network::{Architecture, DensityActivation, MAX_TRUNK, Shading, TrunkLayer};
use crate::space::{Contraction, SceneBox};
use glam::Vec3;
use serde::{Deserialize, Serialize, Serializer};

/// Maximum number of samples per ray.
pub const MAX_SAMPLES: u16 = 4096;
/// Maximum width and maximum height of the image that a 2D field was fitted to, pixels.
pub const MAX_PICTURE_SIDE: u32 = 65_535;
/// Maximum number of cells of the occupancy grid along one axis.
pub const MAX_OCCUPANCY_RESOLUTION: u16 = 512;
/// Maximum length of each text of [`Provenance`], bytes.
pub const MAX_TEXT: usize = 1024;
/// Maximum number of points of a [`ParetoFront`].
pub const MAX_FRONT: usize = 16;

/// Body of a blob (`*.nerf` file): everything after the header. Fields are in the order of the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Body<'a> {
    /// The network's shape: encodings, layers, activations.
    pub architecture: Architecture,
    /// A scene with its bounds, or a 2D field with its image size.
    pub content: Content,
    /// The occupancy grid, if the scene has one.
    #[serde(borrow)]
    pub occupancy: Option<StoredOccupancy<'a>>,
    /// Pareto front of render settings: PSNR against multiply-adds, most expensive first. Empty if not measured.
    pub front: ParetoFront,
    /// The proposal network, if the scene has one: a second, cheaper network. The compositing weights of this network's
    /// samples determine where on a ray the scene's network is sampled.
    #[serde(borrow)]
    pub proposal: Option<Proposal<'a>>,
    /// Origin of the blob: data, program, settings and measured PSNR.
    pub provenance: Provenance<'a>,
    /// Weights and biases of the network as little-endian f16, in the order of [`Architecture::layers`].
    #[serde(serialize_with = "as_bytes")]
    pub weights: &'a [u8],
    /// The table entries of the grid encoding; present if and only if a grid encodes the position.
    #[serde(borrow)]
    pub tables: Option<StoredTables<'a>>,
}

impl<'a> Body<'a> {
    /// Returns the grid encoding and the bytes of its entropy-coded tables; `None` if no tables are entropy-coded.
    pub(super) fn coded(&self) -> Option<(&GridEncoding, &'a [u8])> {
        match (self.architecture.position.grid(), self.tables) {
            (Some(grid), Some(StoredTables::Coded { bytes, .. })) => Some((grid, bytes)),
            _ => None,
        }
    }
}

/// The table values of a grid encoding, as stored in the file: ordered by level, then by entry, then by feature.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StoredTables<'a> {
    /// Finite values, each as little-endian f16.
    F16(#[serde(serialize_with = "as_bytes")] &'a [u8]),
    /// Each table value is a signed 8-bit integer times the scale of its level.
    Int8 {
        /// Scale of each level, little-endian f32: above 0, and small enough that 128 times the scale is finite.
        #[serde(serialize_with = "as_bytes")]
        scales: &'a [u8],
        /// One byte per table value: a signed 8-bit integer.
        #[serde(serialize_with = "as_bytes")]
        bytes: &'a [u8],
    },
    /// Each table value is a signed 8-bit integer times the scale of its level. The integers are entropy-coded: a
    /// renderer decodes them into its own memory.
    Coded {
        /// Scale of each level, as in [`StoredTables::Int8`].
        #[serde(serialize_with = "as_bytes")]
        scales: &'a [u8],
        /// The entropy-coded bytes of all levels.
        #[serde(serialize_with = "as_bytes")]
        bytes: &'a [u8],
    },
}

impl<'a> StoredTables<'a> {
    /// Returns the bytes of the table values as the file stores them (f16, int8 or entropy-coded), without the scales.
    pub const fn bytes(&self) -> &'a [u8] {
        match self {
            Self::F16(bytes) | Self::Int8 { bytes, .. } | Self::Coded { bytes, .. } => bytes,
        }
    }

    /// Returns the scale of each level, little-endian f32: the factor of the stored integers. `None` for f16 tables.
    pub const fn scales(&self) -> Option<&'a [u8]> {
        match self {
            Self::F16(_) => None,
            Self::Int8 { scales, .. } | Self::Coded { scales, .. } => Some(scales),
        }
    }

    /// Returns the name of the tables' format: `f16`, `int8` or `coded`.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::F16(_) => "f16",
            Self::Int8 { .. } => "int8",
            Self::Coded { .. } => "coded",
        }
    }
}

/// The content of a blob: a 2D field (a network fitted to an image) or a scene.
///
/// A 2D field's network has 2 inputs and no density head. A scene's network has 3 inputs and a density head.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Content {
    /// A 2D field: colour as a function of a point of an image.
    Picture(PictureFacts),
    /// A scene: density and colour as functions of a point in space.
    Scene(SceneFacts),
}

/// Size of the image that a 2D field was fitted to. The field can be rendered at any size.
///
/// The network's inputs are x (to the right) and y (down). For any aspect ratio, each is 0 to 1 across the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PictureFacts {
    /// Width of the image, pixels: 1 to [`MAX_PICTURE_SIDE`].
    pub width: u32,
    /// Height of the image, pixels: 1 to [`MAX_PICTURE_SIDE`].
    pub height: u32,
}

/// Bounds of a scene, placement of samples on a ray, background colour and default viewpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneFacts {
    /// Corner of the scene box with the smallest coordinates, world units.
    pub min: [f32; 3],
    /// Corner of the scene box with the largest coordinates, world units.
    pub max: [f32; 3],
    /// Smallest distance from a training camera at which the camera's rays are sampled, world units.
    pub near: f32,
    /// Largest distance from a training camera at which the camera's rays are sampled, world units. In an unbounded
    /// scene, `far` is measured from another point: see [`SceneSampling::Contracted`].
    pub far: f32,
    /// Placement of samples on a ray: in equal bins, at equal steps, or at growing steps through unbounded space.
    pub sampling: SceneSampling,
    /// Background colour (red, green, blue), sRGB-encoded, 0 to 1; visible where opacity is below 1.
    pub background: [f32; 3],
    /// Whether rendering without the occupancy grid is an error. True if the network was not trained in empty cells.
    pub occupancy_required: bool,
    /// Default viewpoint of renders; `None` if the cameras of the training photographs are not known.
    pub viewpoint: Option<Viewpoint>,
}

/// A viewpoint at the position of a training camera, so that a render shows parts of the scene that were photographed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Viewpoint {
    /// The camera's position, world units.
    pub eye: [f32; 3],
    /// Point that the camera looks at, world units; `target - eye` is not parallel to `up`.
    pub target: [f32; 3],
    /// Upward direction in world space, estimated from the training cameras; unit length within 1e-3.
    pub up: [f32; 3],
    /// Angle over which a camera may orbit and still see photographed parts of the scene, 0 to 2π radians. The orbit's
    /// axis is the line through `target` along `up`. Half of the angle lies on each side of `eye`.
    pub arc: f32,
}

/// Placement of samples on a ray: in equal bins, at equal steps, or at growing steps through unbounded space.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum SceneSampling {
    /// Equal bins from `near` to `far`, each with a sample at its middle. The value is the number of bins, 1 to
    /// [`MAX_SAMPLES`]. If the scene has a proposal network, the value is instead the number of samples that this
    /// network places.
    Bins(u16),
    /// Equal steps inside the scene box, from the ray's entry to the ray's exit. The value is the length of a step,
    /// world units: finite and above 0. The box's diagonal must be at most [`MAX_SAMPLES`] steps long.
    March(f32),
    /// Steps through unbounded space, which [`Contraction`] maps into the scene box. Steps are equal in the inner ball,
    /// where space is not contracted, and grow outside. Samples begin at distance `near` from the ray's origin, and end
    /// at distance `far` past the point of the ray that is nearest to the ball's middle.
    Contracted {
        /// Length of a step in the inner ball as a fraction of the ball's radius: above 0 and at most 1. Since steps
        /// grow outside the ball, an infinite line through the ball's middle has a finite number of steps:
        /// `2 (1 + power) / step`. This number must be at most [`MAX_SAMPLES`].
        step: f32,
        /// The power `p` in [`Contraction::distance`], which sets how steps outside the inner ball grow: 1, 2 or 4.
        power: u8,
    },
}

impl SceneFacts {
    /// Number of samples per ray. [`SceneSampling::Bins`]: the stored number. [`SceneSampling::March`]: the number of
    /// steps along the box's diagonal. [`SceneSampling::Contracted`]: the number of steps on a ray through the middle
    /// of the inner ball, from the ray's entry into the ball to distance `far` past the middle.
    pub fn samples(&self) -> u16 {
        match self.sampling {
            SceneSampling::Bins(samples) => samples,
            SceneSampling::March(step) => steps(self.diagonal(), step).min(MAX_SAMPLES.into()) as u16,
            SceneSampling::Contracted { step, .. } => {
                steps(self.reach(), step).min(MAX_SAMPLES.into()) as u16
            }
        }
    }

    /// Distance between successive samples on a ray, world units. In an unbounded scene, the distance is valid inside
    /// the inner ball, and distances outside are larger. If a proposal network places the samples, the distance is a
    /// mean: far − near, divided by the number of samples.
    pub fn step(&self) -> f32 {
        match self.sampling {
            SceneSampling::Contracted { step, .. } => {
                step * self.contraction().map_or(1.0, |contraction| contraction.radius())
            }
            SceneSampling::Bins(samples) => (self.far - self.near) / f32::from(samples),
            SceneSampling::March(step) => step,
        }
    }

    /// The contraction of space into the scene box; `None` in a bounded scene.
    pub fn contraction(&self) -> Option<Contraction> {
        let SceneSampling::Contracted { power, .. } = self.sampling else { return None };
        Contraction::new(&self.bounds(), power)
    }

    pub(crate) fn bounds(&self) -> SceneBox {
        SceneBox { min: Vec3::from(self.min), max: Vec3::from(self.max) }
    }

    /// Length of a ray through the middle of the contraction's inner ball, from the ray's entry into the ball to
    /// distance `far` past the middle. The length is a difference in `s` of [`Contraction::distance`]: inside the ball,
    /// a radius has the length 1. In a bounded scene the result is 0.
    pub(crate) fn reach(&self) -> f32 {
        self.contraction().map_or(0.0, |contraction| 1.0 + contraction.step_at(self.far))
    }

    /// Length of the scene box's diagonal, world units.
    pub(crate) fn diagonal(&self) -> f32 {
        length(Vec3::from(self.max) - Vec3::from(self.min))
    }
}

/// Number of steps of length `step` that cover `length`, rounded up; at least 1.
pub(crate) fn steps(length: f32, step: f32) -> u32 {
    let steps = length / step;
    // `as` saturates, and converts NaN to 0.
    let whole = steps as u32;
    if (whole as f32) < steps { whole.saturating_add(1) } else { whole.max(1) }
}

/// The occupancy grid: one bit per cell of the scene box, 1 if the cell is occupied.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredOccupancy<'a> {
    /// Number of cells along x, y, z.
    pub resolution: [u16; 3],
    /// One bit for each of nx × ny × nz cells. Cell (x, y, z) has the index `i = (x * ny + y) * nz + z`. The cell's bit
    /// is bit `i % 8` of byte `i / 8`, where bit 0 is the least significant. Padding bits are 0.
    #[serde(serialize_with = "as_bytes")]
    pub bits: &'a [u8],
}

impl StoredOccupancy<'_> {
    /// Number of bytes of an occupancy grid with `resolution` cells along x, y, z; `usize::MAX` on overflow.
    pub fn bytes(resolution: [u16; 3]) -> usize {
        let cells: u64 = resolution.iter().map(|&side| u64::from(side)).product();
        usize::try_from(cells.div_ceil(8)).unwrap_or(usize::MAX)
    }
}

/// The Pareto front of a scene's render settings: PSNR against multiply-adds, most expensive point first.
pub type ParetoFront = heapless::Vec<FrontPoint, MAX_FRONT>;

/// A point of a scene's Pareto front: the settings of a [`Quality`](crate::plan::Quality), and their PSNR loss and cost
/// relative to the exact rendering. Of two points of a front, the cheaper never has the higher PSNR. The cost is
/// counted in multiply-adds, not in time, since a time depends on the host.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrontPoint {
    /// Samples per ray, 1 to [`MAX_SAMPLES`].
    pub samples: u16,
    /// Transmittance below which early ray termination ends a ray, `[0, 1)`.
    pub transmittance_cut: f32,
    /// Threshold of compositing weight above which a colour is evaluated, `[0, 1)`. The weight is summed over
    /// consecutive samples: see [`Quality::colour_cut`](crate::plan::Quality::colour_cut).
    pub colour_cut: f32,
    /// Whether empty cells of the occupancy grid are skipped; true only in a scene with an occupancy grid.
    pub occupancy: bool,
    /// Tag of the backend that computes exp, sin and cos: [`MathBackend::tag`](crate::math::MathBackend::tag).
    pub math: u8,
    /// Whether the proposal network places the samples; true only in a scene with a proposal network.
    pub proposal: bool,
    /// PSNR of the exact rendering ([`Quality::exact`](crate::plan::Quality::exact)) minus PSNR with these settings,
    /// dB. Each PSNR is a mean over the same photographs. Negative if these settings give the higher PSNR.
    pub loss_db: f32,
    /// Multiply-adds with these settings divided by those of the exact rendering, both over the same views; above 0.
    pub cost: f32,
}

/// A proposal network: a coarse network with encoding, trunk and density head, but no colour layers. The inputs are
/// positions in the scene box.
///
/// # Source
/// Mildenhall et al. 2020, section 5.2: the coarse network. Deviation: a blob does not store the colour layers of the
/// coarse network, since rendering needs only the compositing weights of the coarse network's samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Proposal<'a> {
    /// Encoding of the position in the proposal network. The scene's network may encode positions differently.
    pub position: SinusoidalEncoding,
    /// Hidden layers of the trunk, in order. The first layer takes the encoded position alone. A later layer takes the
    /// previous layer's output, and also the encoded position if the layer has a skip connection.
    pub trunk: heapless::Vec<TrunkLayer, MAX_TRUNK>,
    /// Activation that maps the density head's output to a density.
    pub density: DensityActivation,
    /// Number of samples per ray at which the proposal network is evaluated. The range `near..far` is divided into this
    /// many equal bins, with one sample in each.
    pub samples: u16,
    /// Weights and biases as little-endian f16, in the order of [`Architecture::layers`]: trunk, density head.
    #[serde(serialize_with = "as_bytes")]
    pub weights: &'a [u8],
}

impl Proposal<'_> {
    /// Shape of the proposal network as an [`Architecture`]. An [`Architecture`] always has a colour head, but
    /// [`Proposal::weights`] holds only parameters of trunk and density head ([`Architecture::density_parameters`]).
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
    /// Number of optimiser steps of the training run.
    pub steps: u32,
    /// Seed of the training run.
    pub seed: u64,
    /// Mean PSNR of this blob over the validation views, dB; `None` without validation views.
    pub psnr_db: Option<f32>,
    /// Text that says how the PSNR was measured: views, background, samples.
    pub psnr_convention: &'a str,
    /// PSNR over the validation views before weights and tables are rounded to their stored format, minus PSNR after
    /// rounding, dB. Negative if rounding increases the PSNR; `None` if not measured.
    pub quantisation_loss_db: Option<f32>,
    /// Number of trained parameters, counted before the export merges successive linear layers.
    pub trained_parameters: u32,
}

impl Provenance<'_> {
    /// Provenance without information: empty texts, zeros, no PSNR.
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

/// Serialises a byte slice in one call. Serde would otherwise make one call per byte, with the same output.
fn as_bytes<S: Serializer>(bytes: &&[u8], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(bytes)
}
