//! Rays.

use glam::Vec3;

/// A half line in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start, world units.
    pub origin: Vec3,
    /// Direction, **unit length**, so that `t` is a distance in world units.
    pub dir: Vec3,
}

impl Ray {
    /// The point `origin + t * dir`.
    #[inline]
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.dir * t
    }
}

/// Maximum error of a unit vector's squared length, loose enough for inexact normalisation.
const NEARLY_UNIT: f32 = 1e-3;

/// Whether `dir` has unit length: its squared length is 1 within 1e-3.
pub fn is_unit(dir: Vec3) -> bool {
    (dir.length_squared() - 1.0).abs() <= NEARLY_UNIT
}
