//! Median distance and normal of a ray: the outputs that describe a surface on the ray.
//!
//! No memory is reserved for an output that is not requested.

use super::Medians;
use crate::memory::Layout;
use crate::plan::Plan;
#[cfg(feature = "normals")]
use crate::volume::NormalSum;
use crate::volume::Pixel;

#[cfg(test)]
mod tests;

/// Median distances and normals of the current tile's rays.
pub(in crate::render) struct Surface<'w> {
    pub medians: Medians<'w>,
    /// Weighted sum of normals of each ray, `[rays]`; empty if normals are not requested.
    #[cfg(feature = "normals")]
    pub normals: &'w mut [NormalSum],
}

impl<'w> Surface<'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, plan: &Plan<'_>) -> Self {
        Self {
            medians: Medians::lay_out(layout, plan),
            #[cfg(feature = "normals")]
            normals: layout.slice(if plan.outputs.normals { plan.batch.rays } else { 0 }, NormalSum::NONE),
        }
    }

    /// Resets the median distances and normals of the first `count` rays.
    pub fn begin(&mut self, count: usize) {
        self.medians.begin(count);
        #[cfg(feature = "normals")]
        self.normals.iter_mut().take(count).for_each(|sum| *sum = NormalSum::NONE);
    }

    /// Writes the median distance and the normal of the ray of index `ray` to `pixel`. `start`: distance along the ray,
    /// world units, of the point from which stored distances are counted. `far`: largest median distance, world units;
    /// also written for a ray without a median.
    pub fn finish(&self, ray: usize, start: f32, far: f32, pixel: &mut Pixel) {
        pixel.median_distance = self.medians.finish(ray, start, far);
        #[cfg(feature = "normals")]
        if let Some(sum) = self.normals.get(ray) {
            pixel.normal = sum.finish(pixel.opacity);
        }
    }
}
