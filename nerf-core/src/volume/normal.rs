//! The normal of a pixel: the weighted mean of the normals of its ray's samples.

use super::mean_direction;
use crate::math::Sum;
use glam::Vec3;

/// Weighted sum of the normals of a ray's samples, `Σ weight · −∇sigma/|∇sigma|`, added up from front to back.
///
/// The normal of a sample is the unit vector opposite to the density gradient `∇sigma`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct NormalSum([Sum; 3]);

impl NormalSum {
    /// The sum of a ray without samples.
    pub const NONE: Self = Self([Sum::ZERO; 3]);

    /// Adds the normal of a sample, multiplied by the sample's `weight`. `gradient`: density gradient at the sample.
    ///
    /// A gradient that is 0 or not finite adds nothing.
    #[inline]
    pub fn add(&mut self, weight: f32, gradient: Vec3) {
        let largest = gradient.abs().max_element();
        if !gradient.is_finite() || largest == 0.0 {
            return;
        }
        // Scaled to at most 1 first, so that squares neither overflow nor vanish.
        let normal = -(gradient / largest).normalize();
        for (sum, x) in self.0.iter_mut().zip(normal.to_array()) {
            sum.add(weight * x);
        }
    }

    /// Returns the direction of the mean normal, unit length; 0 if `opacity`, the sum of the ray's weights, is at most
    /// [`super::OPACITY_EPSILON`], or if the normals cancel.
    pub fn finish(&self, opacity: f32) -> [f32; 3] {
        mean_direction(self.0.map(|sum| sum.value), opacity, opacity)
    }
}
