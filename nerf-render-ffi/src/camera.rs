//! Where a picture is taken from.

use crate::boundary::{Versioned, read_versioned};
use crate::failure::Failure;
use nerf_core::camera::{self, Intrinsics, Pose};
use nerf_core::lens::Lens;

/// A pinhole camera with an optional lens; looks down −Z, +Y is up, +X right, as in OpenGL.
///
/// Pixel (0, 0) is top left and its centre is at (0.5, 0.5).
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Camera {
    /// `sizeof(nerf_camera)`.
    pub struct_size: usize,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f32,
    /// Focal length along y, pixels.
    pub fy: f32,
    /// Principal point, pixels from the left edge; usually width / 2.
    pub cx: f32,
    /// Principal point, pixels from the top edge; usually height / 2.
    pub cy: f32,
    /// Radial distortion, second order, as in OpenCV; 0 for none.
    pub k1: f32,
    /// Radial distortion, fourth order.
    pub k2: f32,
    /// Tangential distortion.
    pub p1: f32,
    /// Tangential distortion.
    pub p2: f32,
    /// Camera-to-world, the upper three rows of the 4x4 matrix, row-major: a rotation (columns
    /// right, up, backward) and in `c2w[3]`, `c2w[7]`, `c2w[11]` the camera's centre.
    pub c2w: [f32; 12],
    /// Zeros.
    pub reserved: [u32; 6],
}

// SAFETY: `repr(C)`, `struct_size` comes first, and numbers have no invalid bytes.
unsafe impl Versioned for Camera {
    const NAME: &'static str = "camera";
}

impl Camera {
    /// The camera behind a pointer, checked.
    ///
    /// # Safety
    /// `at` is NULL or points to `struct_size` readable bytes.
    pub(crate) unsafe fn read(at: *const Self) -> Result<camera::Camera, Failure> {
        // SAFETY: the caller's promise.
        let c = unsafe { read_versioned(at)? };
        if c.reserved != [0; 6] {
            return Err(Failure::Reserved("camera.reserved"));
        }
        let Self { width, height, fx, fy, cx, cy, k1, k2, p1, p2, .. } = c;
        let row = |i: usize| core::array::from_fn(|j| c.c2w[4 * i + j]);
        let pose = Pose::from_rows([row(0), row(1), row(2)]);
        let intrinsics = Intrinsics { width, height, fx, fy, cx, cy };
        camera::Camera::new(intrinsics, Lens { k1, k2, p1, p2 }, pose).map_err(Failure::Camera)
    }
}
