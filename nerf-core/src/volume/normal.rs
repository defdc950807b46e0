//! The normal of the surface a ray sees: the mean of its samples' directions.

use super::mean_direction;
use crate::math::Sum;
use glam::Vec3;

/// The sum of a ray's normals, front to back: `Σ weight · −∇sigma/|∇sigma|`.
///
/// Every sample has a vote of its weight, however steep its density is.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct NormalSum([Sum; 3]);

impl NormalSum {
    /// A ray that has met nothing.
    pub const NONE: Self = Self([Sum::ZERO; 3]);

    /// Adds a sample of this `weight`, where the density's gradient points along `gradient`.
    ///
    /// Only its direction counts. Where it is 0 or not finite the sample has none and adds nothing.
    #[inline]
    pub fn add(&mut self, weight: f32, gradient: Vec3) {
        let largest = gradient.abs().max_element();
        if !gradient.is_finite() || largest == 0.0 {
            return;
        }
        // Squares of what is at most 1 neither overflow nor vanish.
        let normal = -(gradient / largest).normalize();
        for (sum, x) in self.0.iter_mut().zip(normal.to_array()) {
            sum.add(weight * x);
        }
    }

    /// The mean's direction, unit length; 0 where `opacity`, Σ weights, is at most [`super::OPACITY_EPSILON`], and
    /// where the directions cancel.
    pub fn finish(&self, opacity: f32) -> [f32; 3] {
        mean_direction(self.0.map(|sum| sum.value), opacity, opacity)
    }
}
