//! Errors of making a renderer, of rendering and of queries.

use super::Rect;
use crate::blob::BlobError;
use crate::camera::MAX_IMAGE_SIDE;
use crate::errors::errors;
use crate::memory::Line;
use crate::plan::{Batch, PlanError};

errors! {
    /// Reason why a renderer could not be made, or why nothing was rendered or queried.
    RenderError:
    /// An image of a 2D field was requested, but the blob holds a scene.
    NotAPicture => "blob: expected a 2D field, found a scene";
    /// The plan and the renderer were made for different blobs.
    OtherScene => "plan: expected one of this scene, found one of another";
    /// A side of the requested image of a 2D field is 0 or above [`MAX_RENDER_SIDE`](super::MAX_RENDER_SIDE).
    Size { width: u32, height: u32 } =>
        "size: expected sides of 1 to {MAX_IMAGE_SIDE} pixels, found {width}x{height}";
    /// The batch does not have 1 to [`Batch::MAX_RAYS`] rays, or does not have 1 to 64 samples per block.
    Batch { found: Batch } => "{error}", error = PlanError::Batch { found: *found };
    /// The rectangle is not inside the image of `width` × `height` pixels.
    Rect { rect: Rect, width: u32, height: u32 } =>
        "rectangle: expected it inside the {width}x{height} image, found {w}x{h} at ({x}, {y})",
        w = rect.width, h = rect.height, x = rect.x, y = rect.y;
    /// The memory passed by the caller is too small; `expected` and `found` are numbers of lines of 64 bytes.
    Memory { expected: usize, found: usize } => "workspace: expected {expected} lines of 64 bytes, found {found}";
    /// The blob's parameters or grid tables do not fit its architecture.
    Network => "network: expected the parameters and tables of its architecture, found others";
    /// The blob's entropy-coded grid tables cannot be decoded. [`Blob::open`](crate::blob::Blob::open) refuses such a
    /// blob; [`Blob::open_undecoded`](crate::blob::Blob::open_undecoded) does not check the tables.
    Tables(error: BlobError) => "{error}";
    /// The image has more pixels than free memory can hold.
    #[cfg(all(feature = "std", not(target_os = "none")))]
    ImageMemory { width: usize, height: usize } =>
        "image: expected free memory for {width}x{height} pixels, found less";
    /// The slices passed to [`Worker::query`](super::Worker::query) differ in length; only `rgb` may also be empty.
    Lengths { positions: usize, dirs: usize, sigma: usize, rgb: usize } =>
        "query: expected slices of one length, found positions {positions}, dirs {dirs}, sigma {sigma}, rgb {rgb}";
    /// The caller's ray at `index` has an origin that is not finite, or a direction that is not of unit length.
    Ray { index: usize } => "rays[{index}]: expected a finite origin and a direction of unit length";
    /// The caller's ray at `index` does not satisfy `0 <= t_min <= t_max`, or its `t_min` is infinite.
    RayRange { index: usize, t_min: f32, t_max: f32 } =>
        "rays[{index}]: expected 0 <= t_min <= t_max, found t_min {t_min}, t_max {t_max}";
    /// The random number at `index` is outside `[0, 1]`. If there are more or fewer random numbers than rays, `index`
    /// is the smaller of the two counts.
    Random { index: usize } => "random[{index}]: expected a number in [0, 1] for every ray and no more";
    /// The axis along which z_depth is measured is not of unit length.
    Axis { found: [f32; 3] } => "axis: expected a vector of unit length, found {found:?}";
    /// The caller passes rays, but the plan has an effect that needs a camera: anti-aliasing or depth of field.
    CameraEffects => "effects: expected no anti-aliasing and no aperture, which are a camera's, for rays";
    /// The list of instances is empty.
    #[cfg(feature = "instances")]
    NoInstances => "instances: expected at least one, found none";
    /// The instance at `index` cannot be rendered together with the other instances.
    #[cfg(feature = "instances")]
    Instance { index: usize, problem: InstanceProblem } => "instances[{index}]: {problem}";
    /// The queried direction at `index` is not of unit length. Directions are checked only if colour is requested.
    Direction { index: usize, found: [f32; 3] } =>
        "dirs[{index}]: expected a vector of unit length, found {found:?}";
}

/// Returns [`RenderError::Memory`] if `memory` has fewer than `expected` lines of 64 bytes.
pub(super) fn check_memory(expected: usize, memory: &[Line]) -> Result<(), RenderError> {
    let found = memory.len();
    if found < expected { Err(RenderError::Memory { expected, found }) } else { Ok(()) }
}

#[cfg(feature = "instances")]
errors! {
    /// Reason why an instance cannot be rendered together with the other instances.
    #[derive(Eq)]
    InstanceProblem:
    /// The instance's plan was made for another blob than the instance's renderer.
    OtherScene => "expected a plan of this scene, found one of another";
    /// The instance's outputs, effects or batch differ from those of the last instance.
    OtherRequest => "expected outputs, effects and batch of the last instance, found others";
    /// The instance's plan uses a proposal network: [`Quality::proposal`](crate::plan::Quality) must be off.
    Proposal => "expected a plan without a proposal network, found one with it";
    /// The instance is an unbounded scene, but not the last instance. Only the last instance may be unbounded.
    Unbounded => "expected an unbounded scene as the last instance alone, found one in front of it";
}
