//! The content of a blob, as plain data.

use super::front::ParetoFront;
use super::proposal::{Proposal, as_bytes};
use crate::network::Architecture;
use crate::space::{Contraction, SceneBox};
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Most samples per ray a blob may ask for.
pub const MAX_SAMPLES: u16 = 4096;
/// Longest side of a picture, pixels.
pub const MAX_PICTURE_SIDE: u32 = 65_535;
/// Most cells of the occupancy grid along one axis.
pub const MAX_OCCUPANCY_RESOLUTION: u16 = 512;
/// Longest text of the provenance, bytes.
pub const MAX_TEXT: usize = 1024;

/// The body of a blob, in file order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Body<'a> {
    /// The network's shape.
    pub architecture: Architecture,
    /// The content: a scene or a picture.
    pub content: Content,
    /// The cells of the scene box that may hold something.
    #[serde(borrow)]
    pub occupancy: Option<StoredOccupancy<'a>>,
    /// The Pareto front of accuracy against work, as a study measured it: dearest point first; empty without one.
    pub front: ParetoFront,
    /// A second, cheaper network that says where on a ray the scene's own is asked.
    #[serde(borrow)]
    pub proposal: Option<Proposal<'a>>,
    /// The blob's provenance.
    pub provenance: Provenance<'a>,
    /// The parameters as little-endian f16, in the order of [`Architecture::layers`].
    #[serde(serialize_with = "as_bytes")]
    pub weights: &'a [u8],
    /// The entries of the position's grid; present exactly if it is one.
    #[serde(borrow)]
    pub tables: Option<StoredTables<'a>>,
}

/// The entries of a grid as a file has them: level by level, entry by entry, feature by feature.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StoredTables<'a> {
    /// Little-endian f16, finite.
    F16(#[serde(serialize_with = "as_bytes")] &'a [u8]),
    /// Signed bytes; those of a level times its scale are its values.
    Int8 {
        /// A little-endian f32 a level; above 0, and 128 times it finite.
        #[serde(serialize_with = "as_bytes")]
        scales: &'a [u8],
        /// The bytes.
        #[serde(serialize_with = "as_bytes")]
        bytes: &'a [u8],
    },
    /// The values of [`StoredTables::Int8`], entropy-coded: a renderer has them decoded in memory of its own.
    Coded {
        /// The length of a step in each level, f32.
        #[serde(serialize_with = "as_bytes")]
        scales: &'a [u8],
        /// The coded bytes.
        #[serde(serialize_with = "as_bytes")]
        bytes: &'a [u8],
    },
}

impl<'a> StoredTables<'a> {
    /// The entries' bytes, as they lie in the file.
    pub const fn bytes(&self) -> &'a [u8] {
        match self {
            Self::F16(bytes) | Self::Int8 { bytes, .. } | Self::Coded { bytes, .. } => bytes,
        }
    }

    /// The levels' scales, if they have any.
    pub const fn scales(&self) -> Option<&'a [u8]> {
        match self {
            Self::F16(_) => None,
            Self::Int8 { scales, .. } | Self::Coded { scales, .. } => Some(scales),
        }
    }

    /// `f16`, `int8` or `coded`.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::F16(_) => "f16",
            Self::Int8 { .. } => "int8",
            Self::Coded { .. } => "coded",
        }
    }
}

/// The content of a blob: what the network is a field of.
///
/// A picture goes with 2 inputs and no density head, a scene with 3 inputs and one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Content {
    /// Colour over a plane: a 2D field.
    Picture(PictureFacts),
    /// Density and colour in space.
    Scene(SceneFacts),
}

/// Size of the picture a 2D field was made of. It can be rendered at any other.
///
/// The network takes x to the right and y down, both 0 to 1 over the picture whatever its aspect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PictureFacts {
    /// Pixels to a row, 1 to [`MAX_PICTURE_SIDE`].
    pub width: u32,
    /// Rows, 1 to [`MAX_PICTURE_SIDE`].
    pub height: u32,
}

/// Bounds and conventions of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneFacts {
    /// Smallest corner of the scene box, world units.
    pub min: [f32; 3],
    /// Largest corner of the scene box, world units.
    pub max: [f32; 3],
    /// The distance where the scene begins on the rays of the cameras it was made from, world units along the ray.
    pub near: f32,
    /// The distance where it ends on them.
    pub far: f32,
    /// The samples of a ray.
    pub sampling: SceneSampling,
    /// The background, which shows where opacity is below 1, display-encoded.
    pub background: [f32; 3],
    /// Whether the occupancy grid is part of the model: outside of it the network was never trained,
    /// and rendering without it is refused.
    pub occupancy_required: bool,
    /// Default viewpoint; `None` where the photographs' cameras are not known.
    pub viewpoint: Option<Viewpoint>,
}

/// The viewpoint of somebody who took a scene's photographs: a view from there shows what was seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Viewpoint {
    /// The camera's position, world units.
    pub eye: [f32; 3],
    /// The point that it looks at: the photographs' subject, world units; not along `up` from the eye.
    pub target: [f32; 3],
    /// The upward direction of those who took them; unit length within 1e-3.
    pub up: [f32; 3],
    /// The arc around the target that they covered, radians around `up`, with the eye in the middle: 0 to 2π.
    pub arc: f32,
}

/// The samples of a ray, at which a scene's field is evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum SceneSampling {
    /// The middles of this number of equal bins of `near..far`: the network was trained on these alone. With a proposal,
    /// the number of samples drawn from it. 1 to [`MAX_SAMPLES`].
    Bins(u16),
    /// Even steps of this length, world units, from where the ray enters the scene box to where it leaves it. Finite, above
    /// 0, and at most [`MAX_SAMPLES`] of them to the box's diagonal.
    March(f32),
    /// Steps through all of space, contracted into the scene box, which is a cube: equal ones along the ray where it is
    /// near the middle of that, and at longer ones beyond ([`Contraction`]), from `near` on to `far` behind the middle.
    Contracted {
        /// Radii of the inner ball to a step: above 0, at most 1, and at most [`MAX_SAMPLES`] steps to a
        /// ray that comes from far away.
        step: f32,
        /// The power that steps beyond it grow with: 1, 2 or 4.
        power: u8,
    },
}

impl SceneFacts {
    /// Samples a ray: bins of `near..far`, or steps that the longest ray through the box takes.
    pub fn samples(&self) -> u16 {
        match self.sampling {
            SceneSampling::Bins(samples) => samples,
            SceneSampling::March(step) => steps(self.diagonal(), step).min(MAX_SAMPLES.into()) as u16,
            SceneSampling::Contracted { step, .. } => {
                steps(self.reach(), step).min(MAX_SAMPLES.into()) as u16
            }
        }
    }

    /// World units from sample to sample; of a contracted scene, in the inner ball.
    pub fn step(&self) -> f32 {
        match self.sampling {
            SceneSampling::Contracted { step, .. } => {
                step * self.contraction().map_or(1.0, |contraction| contraction.radius())
            }
            SceneSampling::Bins(samples) => (self.far - self.near) / f32::from(samples),
            SceneSampling::March(step) => step,
        }
    }

    /// The contraction of an unbounded scene.
    pub fn contraction(&self) -> Option<Contraction> {
        let cube = SceneBox { min: Vec3::from(self.min), max: Vec3::from(self.max) };
        match self.sampling {
            SceneSampling::Contracted { power, .. } => Contraction::new(&cube, power),
            SceneSampling::Bins(_) | SceneSampling::March(_) => None,
        }
    }

    /// The length of a ray of a contracted scene that begins at the rim of the inner ball, in radii as its steps count them.
    pub(crate) fn reach(&self) -> f32 {
        self.contraction().map_or(0.0, |contraction| 1.0 + contraction.step_at(self.far))
    }

    /// The longest way through the scene box.
    pub(crate) fn diagonal(&self) -> f32 {
        (Vec3::from(self.max) - Vec3::from(self.min)).length()
    }
}

/// Steps that a way of `length` takes, the last one whole or not; at least 1.
pub(crate) fn steps(length: f32, step: f32) -> u32 {
    let steps = length / step;
    // `as` saturates, and takes NaN to 0.
    let whole = steps as u32;
    if (whole as f32) < steps { whole.saturating_add(1) } else { whole.max(1) }
}

/// The occupancy grid: one bit per cell of the scene box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredOccupancy<'a> {
    /// Cells along x, y, z.
    pub resolution: [u16; 3],
    /// Bit `(x * ny + y) * nz + z`, least significant bit of a byte first; padding bits are 0.
    #[serde(serialize_with = "as_bytes")]
    pub bits: &'a [u8],
}

impl StoredOccupancy<'_> {
    /// Bytes an occupancy grid of this resolution takes; the most there can be where `usize` does not count that far.
    pub fn bytes(resolution: [u16; 3]) -> usize {
        let cells: u64 = resolution.iter().map(|&side| u64::from(side)).product();
        usize::try_from(cells.div_ceil(8)).unwrap_or(usize::MAX)
    }
}

/// Who made the blob, from what, and how good it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance<'a> {
    /// The data it was fitted to, by name.
    pub data: &'a str,
    /// The program and settings that made it.
    pub made_by: &'a str,
    /// Optimiser steps.
    pub steps: u32,
    /// Seed of the run.
    pub seed: u64,
    /// Mean PSNR over the validation views, dB, measured on this very blob; absent if there were none.
    pub psnr_db: Option<f32>,
    /// The convention of the PSNR: views, background, samples.
    pub psnr_convention: &'a str,
    /// PSNR lost on those views by rounding weights and tables to their stored format, dB (negative: a gain); absent if not
    /// measured.
    pub quantisation_loss_db: Option<f32>,
    /// Parameters before folding.
    pub trained_parameters: u32,
}

impl Provenance<'_> {
    /// Provenance that says nothing.
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
