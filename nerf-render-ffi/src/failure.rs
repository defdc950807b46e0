//! Reasons why calls fail, each with a status for programs and a sentence for people.

use crate::boundary::Reason;
#[cfg(feature = "instances")]
use crate::instance::Problem;
use crate::pixel::FormatNumber;
use crate::status::Status;
use nerf_core::blob::BlobError;
use nerf_core::camera::CameraError;
use nerf_core::memory::Line;
use nerf_core::plan::PlanError;
use nerf_core::render::RenderError;

/// Declares an enum of reasons for failures, each with a status and a sentence on what was expected and found.
macro_rules! reasons {
    ($(#[$about:meta])* $reason:ident: $($(#[cfg($built:meta)])? $name:ident
        $(($($at:ident: $of:ty),+))? $({$($field:ident: $type:ty),+})? => $status:expr, $sentence:literal;)+
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug)]
        pub(crate) enum $reason {
            $($(#[cfg($built)])? $name $(($($of),+))? $({$($field: $type),+})?,)+
        }

        impl $reason {
            #[allow(unused_variables, reason = "a status does not depend on what was found")]
            pub(crate) fn status(&self) -> $crate::status::Status {
                use $crate::status::Status::*;
                match self {
                    $($(#[cfg($built)])? Self::$name $(($($at),+))? $({$($field),+})? => $status,)+
                }
            }
        }

        impl core::fmt::Display for $reason {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                match self {
                    $($(#[cfg($built)])? Self::$name $(($($at),+))? $({$($field),+})? => write!(f, $sentence),)+
                }
            }
        }
    };
}
#[cfg(feature = "instances")]
pub(crate) use reasons;

reasons! {
    /// Reason why a call failed: a status for programs, and a displayed sentence for people.
    Failure:
    Null(name: &'static str) => NullPointer, "{name}: expected an address, found NULL";
    StructSize { name: &'static str, expected: usize, found: usize } => StructSize,
        "{name}.struct_size: expected {expected} (to 4096 with a tail of zeros), found {found}";
    Reserved(name: &'static str) => Reserved, "{name}: expected zeros in reserved and unknown fields";
    Alignment { name: &'static str, expected: usize, found: usize } => Alignment,
        "{name}: expected a multiple of {expected}, found {found:#x}";
    Memory { name: &'static str, expected: usize, found: usize } => Memory,
        "{name}: expected at least {expected} bytes, found {found}";
    Overlap { name: &'static str, other: &'static str } => Overlap, "{name}: overlaps {other}";
    Overflow(name: &'static str) => Overflow, "{name}: reaches beyond the address space";
    Setting { name: &'static str, expected: &'static str, found: u32 } => Options,
        "{name}: expected {expected}, found {found}";
    Kernel(kernel: nerf_core::Kernel) => Kernel, "kernel {kernel}: not on this machine";
    #[cfg(feature = "std")]
    KernelVariable => Options,
        "environment variable NERF_KERNEL: expected portable, avx2, avx512, simd128 or neon, perhaps with -f16 or \
         -bf16 behind it";
    Stride { name: &'static str, expected: usize, found: usize } => Target,
        "{name}: expected a stride of at least {expected} bytes, found {found}";
    Format { name: &'static str, expected: &'static str, found: FormatNumber } => Target,
        "{name}: expected {expected}, found {found}";
    NotRequested(name: &'static str) => Target,
        "{name}: expected NULL, since the worker was opened without it in request.outputs";
    Busy => Busy, "worker: expected one that no other call works with, and of which no call has panicked";
    SceneOrInstances => Options,
        "request: expected either a scene, or instances and how many they are, found both or neither";
    NotBuilt(name: &'static str) => Options, "{name}: this build of the library has none";
    #[cfg(feature = "instances")]
    Instance { index: usize, problem: Problem } => problem.status(), "instances[{index}]{problem}";
    #[cfg(feature = "instances")]
    Placement { index: usize, error: nerf_core::space::PlacementError } => Transform,
        "instances[{index}].to_world: {error}";
    NoPlane => Target, "target: expected at least one plane, found none";
    TwoLimits => Target, "target: expected limit_ray_distance or limit_z_depth, found both";
    LimitOfRays(name: &'static str) => Target,
        "{name}: expected NULL for rays, each of which ends at its own t_max";
    RandomOfRendered => Ray,
        "rays.random: expected NULL for nerf_render_rays, found numbers for nerf_sample_rays";
    ToneOfAlpha => Target,
        "target.rgb: expected an RGB format where options.effects has tone_map, or exposure without linear, found \
         RGBA, whose values are premultiplied";
    ScenePlane(name: &'static str) => Target, "{name}: expected NULL for a picture, which has colour alone";
    NoFront => NoFront,
        "scene: expected a Pareto front of accuracy against work (nerf-train study) that this build can render, with a \
         time where time is asked for, found none";
    NoView => Camera,
        "eye, target, up: expected finite numbers, an eye apart from the target and an up that is not along the \
         view, found otherwise";
    NoRay { x: f32, y: f32 } => Camera,
        "x, y: expected a point with a direction in f32 and in front of every fold of the lens, found ({x}, {y})";
    Cancelled => Cancelled, "cancelled by the progress callback";
    #[cfg(feature = "std")]
    Panic => Panic, "a defect of this library: please report it";
    Blob(error: BlobError) => status_of_blob(error), "{error}";
    Camera(error: CameraError) => Camera, "{error}";
    Plan(error: PlanError) => status_of_plan(error), "{error}";
    Render(error: RenderError) => status_of_render(error), "{error}";
}

fn status_of_blob(error: &BlobError) -> Status {
    match error {
        BlobError::NotABlob => Status::BlobMagic,
        BlobError::Truncated { .. } => Status::BlobTruncated,
        BlobError::TrailingBytes { .. } => Status::BlobTrailing,
        BlobError::Version { .. } => Status::BlobVersion,
        BlobError::Endian { .. } => Status::BlobEndian,
        BlobError::Flags { .. } | BlobError::Reserved { .. } => Status::BlobFlags,
        BlobError::Checksum { .. } => Status::BlobChecksum,
        _ => Status::BlobContent,
    }
}

fn status_of_plan(error: &PlanError) -> Status {
    match error {
        PlanError::NotAScene => Status::NotAScene,
        PlanError::OccupancyRequired => Status::OccupancyRequired,
        _ => Status::Options,
    }
}

fn status_of_render(error: &RenderError) -> Status {
    match error {
        RenderError::Memory { .. } => Status::Memory,
        RenderError::Network => Status::BlobContent,
        RenderError::Tables(error) => status_of_blob(error),
        RenderError::Rect { .. } => Status::Rect,
        RenderError::NotAPicture => Status::NotAPicture,
        RenderError::Direction { .. } | RenderError::Axis { .. } => Status::Direction,
        RenderError::Ray { .. } | RenderError::RayRange { .. } | RenderError::Random { .. } => Status::Ray,
        _ => Status::Options,
    }
}

impl Failure {
    /// Converts this failure to a failure of instance `index`, whose message begins with `instances[index]`.
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

    /// Converts an error of the renderer; sizes of a workspace are converted from 64-byte lines to bytes.
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

macro_rules! from_errors {
    ($($name:ident($error:ty)),+) => {
        $(impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Self::$name(error)
            }
        })+
    };
}
from_errors!(Blob(BlobError), Camera(CameraError), Plan(PlanError), Render(RenderError));

impl Reason for Failure {
    #[cfg(feature = "std")]
    fn panic() -> Self {
        Self::Panic
    }

    fn status(&self) -> Status {
        self.status()
    }
}
