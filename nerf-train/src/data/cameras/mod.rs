//! Cameras: their look-at point, scene bounds, origin and initial viewpoint; bundle adjustment; files of poses.

pub(crate) mod bundle;
pub(crate) mod geometry;
pub(crate) mod origin;
pub mod path;
pub(crate) mod pose;
pub mod refined;
pub mod viewpoint;

use nerf_core::camera::{Camera, CameraError, Intrinsics, Lens};
use std::collections::BTreeMap;

/// Returns `camera` with its intrinsics scaled to a picture of `width` by `height` pixels.
pub(crate) fn scaled(camera: &Camera, (width, height): (u32, u32)) -> Result<Camera, CameraError> {
    let old = *camera.intrinsics();
    let (sx, sy) = (width as f32 / old.width as f32, height as f32 / old.height as f32);
    let new =
        Intrinsics { width, height, fx: old.fx * sx, fy: old.fy * sy, cx: old.cx * sx, cy: old.cy * sy };
    Camera::new(new, *camera.lens(), *camera.pose())
}

/// Returns principal point (pixels) and lens coefficients of a camera, by their usual names in files, such as `k1`.
pub(crate) fn optics_by_name(camera: &Camera) -> BTreeMap<&'static str, f32> {
    let (&Intrinsics { cx, cy, .. }, &Lens { k1, k2, k3, k4, k5, k6, p1, p2, .. }) =
        (camera.intrinsics(), camera.lens());
    let lens =
        [("k1", k1), ("k2", k2), ("k3", k3), ("k4", k4), ("k5", k5), ("k6", k6), ("p1", p1), ("p2", p2)];
    [("cx", cx), ("cy", cy)].into_iter().chain(lens).collect()
}
