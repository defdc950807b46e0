//! Cameras on a circle around a scene.

use glam::Vec3;
use nerf_core::camera::{Camera, CameraError, Intrinsics, Lens, Pose, SceneBox};

/// A circle of cameras that look at its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// What they look at, world units.
    pub centre: Vec3,
    /// Their distance from it, world units.
    pub radius: f32,
    /// Their height above the plane through the centre, degrees.
    pub elevation: f32,
    /// World direction that is up.
    pub up: Vec3,
}

impl Orbit {
    /// Around the middle of a scene box, half way between near and far.
    pub fn around(bounds: SceneBox, near: f32, far: f32) -> Self {
        let centre = 0.5 * (bounds.min + bounds.max);
        Self { centre, radius: 0.5 * (near + far), elevation: 25.0, up: Vec3::Z }
    }

    /// The camera at `turn` of a full circle, with a horizontal field of view of `fov` degrees.
    ///
    /// # Errors
    /// As [`Camera::new`], and [`CameraError::PoseNotFinite`] at an elevation of ±90°.
    pub fn camera(&self, turn: f32, width: u32, height: u32, fov: f32) -> Result<Camera, CameraError> {
        let azimuth = turn * std::f32::consts::TAU;
        let elevation = self.elevation.to_radians();
        let up = self.up.normalize_or_zero();
        let (side, ahead) = up.any_orthonormal_pair();
        let flat = side * azimuth.cos() + ahead * azimuth.sin();
        let eye = self.centre + self.radius * (flat * elevation.cos() + up * elevation.sin());
        let pose = Pose::look_at(eye, self.centre, up).ok_or(CameraError::PoseNotFinite)?;
        let focal = 0.5 * width as f32 / (0.5 * fov.to_radians()).tan();
        Camera::new(Intrinsics::centred(width, height, focal), Lens::NONE, pose)
    }
}
