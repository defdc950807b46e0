//! Unscaled placement of a single field. Rays are transformed to the field's coordinates; distances stay the same.

use crate::camera::{Camera, Ray};
use crate::space::Placement;
use glam::Vec3;

/// Placement of a frame's single, unscaled field. `None` for the identity, or if `Merge` transforms the rays itself.
#[derive(Clone, Copy)]
pub(in crate::render) struct Placed(pub Option<Placement>);

impl Placed {
    pub const NONE: Self = Self(None);

    pub fn camera(&self, camera: &Camera) -> Camera {
        self.0.map_or(*camera, |placement| placement.camera_in_field(camera))
    }

    #[inline]
    pub fn ray(&self, ray: Ray) -> Ray {
        self.0.map_or(ray, |placement| placement.ray_in_field(&ray))
    }

    /// Transforms rays from the world's coordinates to the field's, as [`Placed::ray`] does for one ray.
    pub fn rays(&self, rays: &mut [Ray]) {
        if let Some(placement) = &self.0 {
            for ray in rays {
                *ray = placement.ray_in_field(ray);
            }
        }
    }

    /// Transforms a direction from the world's coordinates to the field's.
    pub fn dir(&self, dir: Vec3) -> Vec3 {
        self.0.map_or(dir, |placement| placement.dir_in_field(dir))
    }

    /// Transforms a normal from the field's coordinates to the world's.
    pub fn normal(&self, normal: [f32; 3]) -> [f32; 3] {
        self.0.map_or(normal, |placement| placement.dir_in_world(normal.into()).into())
    }
}
