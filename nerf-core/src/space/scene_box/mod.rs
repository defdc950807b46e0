//! The scene box, and its overlap with a ray.

use crate::camera::Ray;
use crate::errors::errors;
use crate::simd::Lanes;
use glam::Vec3;

#[cfg(test)]
mod tests;

/// An axis-aligned box, such as the scene box. Outside the scene box density is zero and the network is never
/// evaluated, unless the scene has a contraction, which maps all of space into the box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneBox {
    /// Corner with the smallest x, y and z, world units.
    pub min: Vec3,
    /// Corner with the largest x, y and z, world units.
    pub max: Vec3,
}

impl SceneBox {
    /// Makes a box from its corners.
    ///
    /// # Errors
    /// [`BoundsError::Box`] unless corners and size are finite and `min < max` on every axis.
    pub fn new(min: Vec3, max: Vec3) -> Result<Self, BoundsError> {
        if min.is_finite() && max.is_finite() && min.cmplt(max).all() && (max - min).is_finite() {
            Ok(Self { min, max })
        } else {
            Err(BoundsError::Box { min: min.into(), max: max.into() })
        }
    }

    /// Whether `p` lies inside the box or on its surface.
    #[inline]
    pub fn contains(&self, p: Vec3) -> bool {
        p.cmpge(self.min).all() && p.cmple(self.max).all()
    }

    /// Clips the ray: returns the distances at which the part of `[near, far]` inside the box begins and ends, or
    /// `None` if no part is inside.
    ///
    /// A ray on a face is inside. Also returns `None` if the ray contains a NaN or an infinity, or if the range
    /// `[near, far]` is empty or contains a NaN.
    ///
    /// # Source
    /// Kay and Kajiya 1986: the box is the intersection of three slabs, each between two opposite faces. Deviation:
    /// slabs parallel to the ray are tested separately, without division by 0.
    pub fn clip(&self, ray: &Ray, near: f32, far: f32) -> Option<(f32, f32)> {
        // The comparisons below would ignore a NaN on one axis and clip the ray by the other axes.
        let ordered = near <= far;
        if !(ordered && ray.origin.is_finite() && ray.dir.is_finite()) {
            return None;
        }
        // One call for each axis, since a loop over the axes takes 1.5 times as long.
        let slab = |axis: usize, (enter, exit): (f32, f32)| {
            let (origin, dir) = (ray.origin.to_array()[axis], ray.dir.to_array()[axis]);
            let (low, high) = (self.min.to_array()[axis], self.max.to_array()[axis]);
            // Along this axis the ray moves less than the spacing of f32 in any finite scene.
            if dir.abs() < f32::MIN_POSITIVE {
                return (origin >= low && origin <= high).then_some((enter, exit));
            }
            let (a, b) = ((low - origin) / dir, (high - origin) / dir);
            // Neither `a` nor `b` is NaN, so that comparisons suffice. `f32::min` is a function call in WebAssembly.
            let (first, last) = if b < a { (b, a) } else { (a, b) };
            Some((if first > enter { first } else { enter }, if last < exit { last } else { exit }))
        };
        let (enter, exit) = slab(2, slab(1, slab(0, (near, far))?)?)?;
        (enter <= exit).then_some((enter, exit))
    }

    /// Clips a vector of rays, as [`SceneBox::clip`] does for one ray. Returns the distances of entry and exit, and 1
    /// for rays that hit the box, 0 for other rays.
    #[inline(always)]
    pub(crate) fn clip_lanes<V: Lanes>(&self, origin: [V; 3], dir: [V; 3], near: V, far: V) -> (V, V, V) {
        let (zero, one) = (V::splat(0.0), V::splat(1.0));
        let (min, max) = (self.min.to_array(), self.max.to_array());
        let mut meets = V::select(near.less(far), one, V::select(near.equals(far), one, zero));
        let (mut enter, mut exit) = (near, far);
        for axis in 0..3 {
            let (low, high) = (V::splat(min[axis]).sub(origin[axis]), V::splat(max[axis]).sub(origin[axis]));
            // `x − x` is 0 only for a finite `x`.
            let finite = origin[axis].sub(origin[axis]).add(dir[axis].sub(dir[axis])).equals(zero);
            meets = V::select(finite, meets, zero);
            let parallel = dir[axis].abs().less(V::splat(f32::MIN_POSITIVE));
            let beside = V::select(zero.less(low), zero, V::select(high.less(zero), zero, meets));
            meets = V::select(parallel, beside, meets);
            let (a, b) = (low.div(dir[axis]), high.div(dir[axis]));
            let turned = b.less(a);
            let (first, last) = (V::select(turned, b, a), V::select(turned, a, b));
            let later = V::select(enter.less(first), first, enter);
            let sooner = V::select(last.less(exit), last, exit);
            (enter, exit) = (V::select(parallel, enter, later), V::select(parallel, exit, sooner));
        }
        (enter, exit, V::select(exit.less(enter), zero, meets))
    }
}

errors! {
    /// Reason why a scene's bounds are invalid: its box, or its near and far distances.
    BoundsError:
    Box { min: [f32; 3], max: [f32; 3] } =>
        "scene box: expected finite min < max on every axis, found {min:?} .. {max:?}";
    Range { near: f32, far: f32 } =>
        "near/far: expected 0 <= near < far, both finite, found near {near}, far {far}";
}
