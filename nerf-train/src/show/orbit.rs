//! Cameras on a circle around a scene.

use glam::Vec3;
use nerf_core::blob::{SceneFacts, Viewpoint};
use nerf_core::camera::{Camera, CameraError, Intrinsics, Lens, Pose};
use std::f32::consts::TAU;

/// Largest elevation of an orbit through the scene file's viewpoint, degrees. Without this limit, an unusual up
/// direction could give an orbit around the pole.
const STEEPEST: f32 = 80.0;

/// Circle, or arc of a circle, of cameras that all look at a centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    pub centre: Vec3,
    pub radius: f32,
    /// Elevation of the cameras above the plane through the centre that is perpendicular to `up`, degrees.
    pub elevation: f32,
    /// World direction that is up, unit length.
    pub up: Vec3,
    /// Direction from the circle's axis to the first camera: unit length, perpendicular to `up`.
    pub start: Vec3,
    /// Angle of the arc, radians; 2π for the full circle. The first camera is in the middle of the arc.
    pub arc: f32,
}

impl Orbit {
    /// Returns the orbit through the camera of [`SceneFacts::viewpoint`] or, without one, around the middle of the
    /// scene box, with the mean of near and far as radius. `up`: up direction; `None`: the viewpoint's, or +z.
    pub fn of(scene: &SceneFacts, up: Option<Vec3>) -> Self {
        match &scene.viewpoint {
            Some(viewpoint) => {
                Self::through(viewpoint, up.unwrap_or(viewpoint.up.into()).normalize_or_zero())
            }
            None => Self::around(scene, up.unwrap_or(Vec3::Z)),
        }
    }

    fn around(scene: &SceneFacts, up: Vec3) -> Self {
        Self {
            centre: 0.5 * (Vec3::from(scene.min) + Vec3::from(scene.max)),
            radius: 0.5 * (scene.near + scene.far),
            elevation: 25.0,
            up,
            start: up.any_orthonormal_pair().0,
            arc: TAU,
        }
    }

    fn through(viewpoint: &Viewpoint, up: Vec3) -> Self {
        let centre = Vec3::from(viewpoint.target);
        let back = Vec3::from(viewpoint.eye) - centre;
        let height = back.dot(up);
        let flat = back - height * up;
        Self {
            centre,
            radius: back.length(),
            elevation: height.atan2(flat.length()).to_degrees().clamp(-STEEPEST, STEEPEST),
            up,
            start: flat.try_normalize().unwrap_or_else(|| up.any_orthonormal_pair().0),
            arc: viewpoint.arc,
        }
    }

    /// Returns the camera on the circle or arc. `turn`: fraction, 0 to 1, of a period: one turn of the full circle, or
    /// a swing from the middle of an arc to both ends and back. `fov`: horizontal field of view, degrees.
    pub fn camera(&self, turn: f32, width: u32, height: u32, fov: f32) -> Result<Camera, CameraError> {
        let azimuth = if self.arc < TAU { 0.5 * self.arc * (turn * TAU).sin() } else { turn * TAU };
        let elevation = self.elevation.to_radians();
        let flat = self.start * azimuth.cos() + self.up.cross(self.start) * azimuth.sin();
        let eye = self.centre + self.radius * (flat * elevation.cos() + self.up * elevation.sin());
        let pose = Pose::look_at(eye, self.centre, self.up).ok_or(CameraError::PoseNotFinite)?;
        let focal = 0.5 * width as f32 / (0.5 * fov.to_radians()).tan();
        Camera::new(Intrinsics::centred(width, height, focal), Lens::NONE, pose)
    }
}
