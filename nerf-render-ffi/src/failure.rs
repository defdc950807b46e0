//! Why a call failed: a status for programs, a sentence for people.

use crate::boundary::Reason;
#[cfg(feature = "instances")]
use crate::instance::Problem;
use crate::pixel::{Channel, PixelFormat};
use crate::status::Status;
use core::fmt;
use nerf_core::blob::BlobError;
use nerf_core::camera::CameraError;
use nerf_core::memory::Line;
use nerf_core::plan::PlanError;
use nerf_core::render::RenderError;

/// Why a call failed; names the argument, and what was expected and found.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Failure {
    Null(&'static str),
    StructSize {
        name: &'static str,
        expected: usize,
        found: usize,
    },
    Reserved(&'static str),
    Alignment {
        name: &'static str,
        expected: usize,
        found: usize,
    },
    Memory {
        name: &'static str,
        expected: usize,
        found: usize,
    },
    Overlap {
        name: &'static str,
        other: &'static str,
    },
    Overflow(&'static str),
    /// An integer setting that is none of its named values.
    Setting {
        name: &'static str,
        expected: &'static str,
        found: u32,
    },
    Kernel(nerf_core::Kernel),
    #[cfg(feature = "std")]
    KernelVariable,
    Stride {
        name: &'static str,
        expected: usize,
        found: usize,
    },
    Format {
        channel: Channel,
        found: u32,
    },
    /// A plane that the worker was not opened for.
    NotRequested(&'static str),
    /// A worker that another call works with.
    Busy,
    /// A request with neither a scene nor instances, or with both.
    SceneOrInstances,
    /// Something that this build of the library lacks.
    NotBuilt(&'static str),
    /// One of the instances of a request, but for its transform.
    #[cfg(feature = "instances")]
    Instance {
        index: usize,
        problem: Problem,
    },
    #[cfg(feature = "instances")]
    Placement {
        index: usize,
        error: nerf_core::camera::PlacementError,
    },
    NoPlane,
    /// Limits of both kinds.
    TwoLimits,
    /// A plane of limits beside rays, whose ends are `t_max`.
    LimitOfRays(&'static str),
    /// Random numbers given for rays that are rendered, not sampled.
    RandomOfRendered,
    /// A tone map, or exposure of display-encoded values, of an RGBA plane.
    ToneOfAlpha,
    /// A plane that a picture has not.
    ScenePlane(&'static str),
    /// A choice that only a measured front can make.
    NoFront,
    /// An eye, a target and an up that make no camera.
    NoView,
    /// An image point without a direction.
    NoRay {
        x: f32,
        y: f32,
    },
    Cancelled,
    #[cfg(feature = "std")]
    Panic,
    Blob(BlobError),
    Camera(CameraError),
    Plan(PlanError),
    Render(RenderError),
}

impl Failure {
    /// The same of one of the instances of a request.
    #[cfg(feature = "instances")]
    pub fn of_instance(self, index: usize) -> Self {
        let problem = match self {
            Self::StructSize { expected, found, .. } => Problem::StructSize { expected, found },
            Self::Reserved(_) => Problem::Reserved,
            Self::Null(_) => Problem::NullScene,
            Self::Alignment { expected, found, .. } => Problem::SceneAlignment { expected, found },
            Self::Plan(error) => Problem::Plan(error),
            other => return other,
        };
        Self::Instance { index, problem }
    }

    /// The failure of a workspace that the renderer refuses; sizes are in bytes.
    pub fn of_workspace(error: RenderError) -> Self {
        match error {
            RenderError::Memory { expected, found } => Self::Memory {
                name: "workspace",
                expected: expected.saturating_mul(size_of::<Line>()),
                found: found.saturating_mul(size_of::<Line>()),
            },
            other => Self::Render(other),
        }
    }
}

impl From<BlobError> for Failure {
    fn from(error: BlobError) -> Self {
        Self::Blob(error)
    }
}

impl Reason for Failure {
    #[cfg(feature = "std")]
    fn panic() -> Self {
        Self::Panic
    }

    fn status(&self) -> Status {
        match self {
            Self::Null(_) => Status::NullPointer,
            Self::StructSize { .. } => Status::StructSize,
            Self::Reserved(_) => Status::Reserved,
            Self::Alignment { .. } => Status::Alignment,
            Self::Memory { .. } | Self::Render(RenderError::Memory { .. }) => Status::Memory,
            Self::Overlap { .. } => Status::Overlap,
            Self::Overflow(_) => Status::Overflow,
            Self::Setting { .. } => Status::Options,
            #[cfg(feature = "std")]
            Self::KernelVariable => Status::Options,
            Self::Kernel(_) => Status::Kernel,
            Self::Stride { .. }
            | Self::Format { .. }
            | Self::NoPlane
            | Self::TwoLimits
            | Self::LimitOfRays(_)
            | Self::NotRequested(_)
            | Self::ScenePlane(_)
            | Self::ToneOfAlpha => Status::Target,
            Self::Busy => Status::Busy,
            Self::SceneOrInstances | Self::NotBuilt(_) => Status::Options,
            #[cfg(feature = "instances")]
            Self::Instance { problem, .. } => problem.status(),
            #[cfg(feature = "instances")]
            Self::Placement { .. } => Status::Transform,
            Self::NoFront => Status::NoFront,
            Self::RandomOfRendered => Status::Ray,
            Self::Cancelled => Status::Cancelled,
            #[cfg(feature = "std")]
            Self::Panic => Status::Panic,
            Self::Blob(error) => match error {
                BlobError::NotABlob => Status::BlobMagic,
                BlobError::Truncated { .. } => Status::BlobTruncated,
                BlobError::TrailingBytes { .. } => Status::BlobTrailing,
                BlobError::Version { .. } => Status::BlobVersion,
                BlobError::Endian { .. } => Status::BlobEndian,
                BlobError::Flags { .. } | BlobError::Reserved { .. } => Status::BlobFlags,
                BlobError::Checksum { .. } => Status::BlobChecksum,
                _ => Status::BlobContent,
            },
            Self::Camera(_) | Self::NoView | Self::NoRay { .. } => Status::Camera,
            Self::Plan(PlanError::NotAScene) => Status::NotAScene,
            Self::Plan(PlanError::OccupancyRequired) => Status::OccupancyRequired,
            Self::Plan(_) => Status::Options,
            Self::Render(RenderError::Network) => Status::BlobContent,
            Self::Render(RenderError::Rect { .. }) => Status::Rect,
            Self::Render(RenderError::NotAPicture) => Status::NotAPicture,
            Self::Render(RenderError::Direction { .. }) => Status::Direction,
            Self::Render(
                RenderError::Ray { .. } | RenderError::RayRange { .. } | RenderError::Random { .. },
            ) => Status::Ray,
            Self::Render(RenderError::Axis { .. }) => Status::Direction,
            Self::Render(_) => Status::Options,
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Null(name) => write!(f, "{name}: expected an address, found NULL"),
            Self::StructSize { name, expected, found } => {
                write!(
                    f,
                    "{name}.struct_size: expected {expected} (to 4096 with a tail of zeros), found {found}"
                )
            }
            Self::Reserved(name) => write!(f, "{name}: expected zeros in reserved and unknown fields"),
            Self::Alignment { name, expected, found } => {
                write!(f, "{name}: expected a multiple of {expected}, found {found:#x}")
            }
            Self::Memory { name, expected, found } => {
                write!(f, "{name}: expected at least {expected} bytes, found {found}")
            }
            Self::Overlap { name, other } => write!(f, "{name}: overlaps {other}"),
            Self::Overflow(name) => write!(f, "{name}: reaches beyond the address space"),
            Self::Setting { name, expected, found } => {
                write!(f, "{name}: expected {expected}, found {found}")
            }
            Self::Kernel(kernel) => write!(f, "kernel {kernel}: not on this machine"),
            #[cfg(feature = "std")]
            Self::KernelVariable => {
                write!(
                    f,
                    "environment variable NERF_KERNEL: expected portable, avx2, avx512, simd128 or neon, perhaps with -f16 or -bf16 behind it"
                )
            }
            Self::Stride { name, expected, found } => {
                write!(f, "{name}: expected a stride of at least {expected} bytes, found {found}")
            }
            Self::Format { channel, found } => {
                write!(f, "{}: expected {}, found ", channel.name(), channel.formats())?;
                match PixelFormat::name_of(*found) {
                    Some(name) => f.write_str(name),
                    None => write!(f, "{found}, which is no nerf_format"),
                }
            }
            Self::NotRequested(name) => {
                write!(f, "{name}: expected NULL, since the worker was opened without it in request.outputs")
            }
            Self::Busy => write!(
                f,
                "worker: expected one that no other call works with, and of which no call has panicked"
            ),
            Self::SceneOrInstances => write!(
                f,
                "request: expected either a scene, or instances and how many they are, found both or neither"
            ),
            Self::NotBuilt(name) => write!(f, "{name}: this build of the library has none"),
            #[cfg(feature = "instances")]
            Self::Instance { index, problem } => write!(f, "instances[{index}]{problem}"),
            #[cfg(feature = "instances")]
            Self::Placement { index, error } => write!(f, "instances[{index}].to_world: {error}"),
            Self::NoPlane => write!(f, "target: expected at least one plane, found none"),
            Self::TwoLimits => {
                write!(f, "target: expected limit_ray_distance or limit_z_depth, found both")
            }
            Self::LimitOfRays(name) => {
                write!(f, "{name}: expected NULL for rays, each of which ends at its own t_max")
            }
            Self::RandomOfRendered => {
                write!(
                    f,
                    "rays.random: expected NULL for nerf_render_rays, found numbers for nerf_sample_rays"
                )
            }
            Self::ToneOfAlpha => write!(
                f,
                "target.rgb: expected an RGB format where options.effects has tone_map, or exposure without linear, \
                 found RGBA, whose values are premultiplied"
            ),
            Self::ScenePlane(name) => {
                write!(f, "{name}: expected NULL for a picture, which has colour alone")
            }
            Self::NoFront => {
                write!(
                    f,
                    "scene: expected a front of accuracy against work (nerf-train study) that this build can \
                     render, with a time where time is asked for, found none"
                )
            }
            Self::NoView => write!(
                f,
                "eye, target, up: expected finite numbers, an eye apart from the target and an up that is not along \
                 the view, found otherwise"
            ),
            Self::NoRay { x, y } => write!(
                f,
                "x, y: expected a point with a direction in f32 and in front of every fold of the lens, found ({x}, {y})"
            ),
            Self::Cancelled => write!(f, "cancelled by the progress callback"),
            #[cfg(feature = "std")]
            Self::Panic => write!(f, "a defect of this library: please report it"),
            Self::Blob(error) => error.fmt(f),
            Self::Camera(error) => error.fmt(f),
            Self::Plan(error) => error.fmt(f),
            Self::Render(error) => error.fmt(f),
        }
    }
}
