//! Why nothing was rendered.

use super::Rect;
use crate::blob::BlobError;
use crate::camera::MAX_IMAGE_SIDE;
use crate::plan::{Batch, PlanError};

/// Why nothing was rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum RenderError {
    /// The blob is a scene, not a 2D field.
    NotAPicture,
    /// The plan was made for another blob.
    OtherScene,
    /// A picture with a side of 0 or beyond [`MAX_RENDER_SIDE`](super::MAX_RENDER_SIDE).
    Size {
        /// Pixels to a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A batch of nothing, of more than [`Batch::MAX_RAYS`] rays or of more than 64
    /// samples.
    Batch {
        /// What was asked for.
        found: Batch,
    },
    /// The rectangle is not inside the image.
    Rect {
        /// What was asked for.
        rect: Rect,
        /// Width of the image, pixels.
        width: u32,
        /// Height of the image, pixels.
        height: u32,
    },
    /// Too little memory, in lines of 64 bytes.
    Memory {
        /// Lines that are needed.
        expected: usize,
        /// Lines that were given.
        found: usize,
    },
    /// Parameters or tables that are not those of the scene's architecture.
    Network,
    /// Coded tables of a blob that [`Blob::open`](crate::blob::Blob::open) refuses.
    Tables(BlobError),
    /// An image of more pixels than there is memory for.
    #[cfg(all(feature = "std", not(target_os = "none")))]
    ImageMemory {
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
    },
    /// A ray of the caller's that is not finite or whose direction is not of unit length.
    Ray {
        /// Which one.
        index: usize,
    },
    /// A ray of the caller's whose range is none: not `0 <= t_min <= t_max`.
    RayRange {
        /// Which one.
        index: usize,
        /// From which distance on it was to be seen.
        t_min: f32,
        /// Up to which.
        t_max: f32,
    },
    /// A random number of a ray that is not in `[0, 1]`, or is not there, or has no ray.
    Random {
        /// Which one.
        index: usize,
    },
    /// An axis for z_depth that is not of unit length.
    Axis {
        /// What was given.
        found: [f32; 3],
    },
    /// Rays of the caller's under a plan with several rays a pixel or with an aperture, which only a camera has.
    CameraEffects,
    /// No field to look at.
    #[cfg(feature = "instances")]
    NoInstances,
    /// An instance that cannot be rendered with the others.
    #[cfg(feature = "instances")]
    Instance {
        /// Which one.
        index: usize,
        /// Why.
        problem: InstanceProblem,
    },
    /// The slices of a query differ in length.
    Lengths {
        /// Length of `positions`.
        positions: usize,
        /// Length of `dirs`.
        dirs: usize,
        /// Length of `sigma`.
        sigma: usize,
        /// Length of `rgb`.
        rgb: usize,
    },
    /// A direction of a query for colour that is not of unit length.
    Direction {
        /// Which one.
        index: usize,
        /// What was given.
        found: [f32; 3],
    },
}

impl RenderError {
    /// The same of a part that begins at index `first` of the whole.
    #[cfg(all(feature = "std", not(target_os = "none")))]
    pub(crate) fn behind(self, first: usize) -> Self {
        match self {
            Self::Ray { index } => Self::Ray { index: first + index },
            Self::RayRange { index, t_min, t_max } => Self::RayRange { index: first + index, t_min, t_max },
            Self::Random { index } => Self::Random { index: first + index },
            other => other,
        }
    }
}

impl core::fmt::Display for RenderError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotAPicture => write!(f, "blob: expected a 2D field, found a scene"),
            Self::OtherScene => write!(f, "plan: expected one of this scene, found one of another"),
            Self::Size { width, height } => {
                write!(f, "size: expected sides of 1 to {MAX_IMAGE_SIDE} pixels, found {width}x{height}")
            }
            Self::Batch { found } => PlanError::Batch { found: *found }.fmt(f),
            Self::Rect { rect, width, height } => write!(
                f,
                "rectangle: expected it inside the {width}x{height} image, found {}x{} at ({}, {})",
                rect.width, rect.height, rect.x, rect.y
            ),
            Self::Memory { expected, found } => {
                write!(f, "workspace: expected {expected} lines of 64 bytes, found {found}")
            }
            Self::Network => {
                write!(f, "network: expected the parameters and tables of its architecture, found others")
            }
            Self::Tables(error) => error.fmt(f),
            #[cfg(all(feature = "std", not(target_os = "none")))]
            Self::ImageMemory { width, height } => {
                write!(f, "image: expected free memory for {width}x{height} pixels, found less")
            }
            Self::Lengths { positions, dirs, sigma, rgb } => write!(
                f,
                "query: expected slices of one length, found positions {positions}, dirs {dirs}, sigma {sigma}, \
                 rgb {rgb}"
            ),
            Self::Ray { index } => {
                write!(f, "rays[{index}]: expected a finite origin and a direction of unit length")
            }
            Self::RayRange { index, t_min, t_max } => {
                write!(f, "rays[{index}]: expected 0 <= t_min <= t_max, found t_min {t_min}, t_max {t_max}")
            }
            Self::Random { index } => {
                write!(f, "random[{index}]: expected a number in [0, 1] for every ray and no more")
            }
            Self::Axis { found } => write!(f, "axis: expected a vector of unit length, found {found:?}"),
            Self::CameraEffects => {
                write!(
                    f,
                    "effects: expected no anti-aliasing and no aperture, which are a camera's, for rays"
                )
            }
            #[cfg(feature = "instances")]
            Self::NoInstances => write!(f, "instances: expected at least one, found none"),
            #[cfg(feature = "instances")]
            Self::Instance { index, problem } => write!(f, "instances[{index}]: {problem}"),
            Self::Direction { index, found } => {
                write!(f, "dirs[{index}]: expected a vector of unit length, found {found:?}")
            }
        }
    }
}

impl core::error::Error for RenderError {}

/// What keeps an instance from being rendered with the others.
#[cfg(feature = "instances")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum InstanceProblem {
    /// Its plan was made for another blob.
    OtherScene,
    /// Outputs, effects or batch are not those of the last.
    OtherRequest,
    /// It draws samples from a proposal network: [`Quality::proposal`](crate::plan::Quality) is to be off.
    Proposal,
    /// It is unbounded, and not the last.
    Unbounded,
}

#[cfg(feature = "instances")]
impl core::fmt::Display for InstanceProblem {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::OtherScene => "expected a plan of this scene, found one of another",
            Self::OtherRequest => "expected outputs, effects and batch of the last instance, found others",
            Self::Proposal => "expected a plan without a proposal network, found one with it",
            Self::Unbounded => {
                "expected an unbounded scene as the last instance alone, found one in front of it"
            }
        })
    }
}
