//! Visible part of a ray: a range for a ray of the caller's, the limit of a depth buffer for a camera's.

use crate::camera::Ray;
use glam::Vec3;

/// A ray given by the caller, and its visible distances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RaySegment {
    /// Origin, and direction of unit length.
    pub ray: Ray,
    /// Nearest visible distance, world units along the ray, at least 0.
    pub t_min: f32,
    /// Farthest visible distance, world units along the ray, at least `t_min`; may be infinite. It cuts the bin it
    /// lies in: opacity is continuous in it.
    pub t_max: f32,
}

impl From<Ray> for RaySegment {
    fn from(ray: Ray) -> Self {
        Self { ray, t_min: 0.0, t_max: f32::INFINITY }
    }
}

/// End of a pixel's ray, from a depth buffer. Infinity and NaN mean no end.
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

    /// The limit as a distance along `ray`, of a camera that looks along `forward`; infinite if the ray never meets
    /// the plane.
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
