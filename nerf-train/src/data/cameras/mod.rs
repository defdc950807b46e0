//! What follows from cameras alone: where the scene is, how near it begins, where its world's origin should be,
//! where to look at it from.

pub(crate) mod bundle;
pub(crate) mod geometry;
pub(crate) mod origin;
pub mod path;
pub(crate) mod pose;
pub mod refined;
pub(crate) mod viewpoint;

use nerf_core::camera::{Camera, CameraError, Intrinsics};

/// The same view in another size, pixels.
pub(crate) fn scaled(camera: &Camera, (width, height): (u32, u32)) -> Result<Camera, CameraError> {
    let old = *camera.intrinsics();
    let (sx, sy) = (width as f32 / old.width as f32, height as f32 / old.height as f32);
    let new =
        Intrinsics { width, height, fx: old.fx * sx, fy: old.fy * sy, cx: old.cx * sx, cy: old.cy * sy };
    Camera::new(new, *camera.lens(), *camera.pose())
}
