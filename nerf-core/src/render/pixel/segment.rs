//! Which part of a ray is seen: of the caller's own, and of a camera's behind a depth buffer.

use crate::camera::Ray;
use glam::Vec3;

/// A ray given by the caller, and its visible distances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RaySegment {
    /// From where, in which direction.
    pub ray: Ray,
    /// What is nearer is not seen, world units along the ray, at least 0.
    pub t_min: f32,
    /// What is farther is not seen, world units along the ray, at least `t_min`; may be infinite. It cuts the bin it lies
    /// in: opacity goes continuously with it.
    pub t_max: f32,
}

impl From<Ray> for RaySegment {
    fn from(ray: Ray) -> Self {
        Self { ray, t_min: 0.0, t_max: f32::INFINITY }
    }
}

/// Where a pixel's ray ends: what a depth buffer has there. Infinity, or a NaN, is no end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    /// World units along the ray.
    RayDistance(f32),
    /// World units along the view axis.
    ZDepth(f32),
}

impl Limit {
    /// No end.
    pub const NONE: Self = Self::RayDistance(f32::INFINITY);

    /// The same along a ray of a camera that looks along `forward`; a plane it never meets is no end.
    #[inline]
    pub(crate) fn along(self, ray: &Ray, forward: Vec3) -> f32 {
        match self {
            Self::RayDistance(t) => t,
            Self::ZDepth(z) => {
                let cosine = ray.dir.dot(forward);
                if cosine > 0.0 { z / cosine } else { f32::INFINITY }
            }
        }
    }
}
