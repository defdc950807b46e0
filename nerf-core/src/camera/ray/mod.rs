//! Rays and their overlap with the scene box.

use glam::Vec3;

#[cfg(test)]
mod tests;

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

/// How far the square of a unit vector's length may be off 1: sloppy roots pass, what is no direction does not.
const NEARLY_UNIT: f32 = 1e-3;

/// Whether `dir` may stand for a direction: its squared length is 1 within 1e-3.
pub fn is_unit(dir: Vec3) -> bool {
    (dir.length_squared() - 1.0).abs() <= NEARLY_UNIT
}

/// An axis-aligned box in world space; outside of it density is zero and the network is never asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneBox {
    /// Smallest corner, world units.
    pub min: Vec3,
    /// Largest corner, world units.
    pub max: Vec3,
}

impl SceneBox {
    /// A box of the given corners.
    ///
    /// # Errors
    /// [`BoundsError::Box`] unless every corner is finite and `min < max` on every axis.
    pub fn new(min: Vec3, max: Vec3) -> Result<Self, BoundsError> {
        if min.is_finite() && max.is_finite() && min.cmplt(max).all() && (max - min).is_finite() {
            Ok(Self { min, max })
        } else {
            Err(BoundsError::Box { min: min.into(), max: max.into() })
        }
    }

    /// Whether `p` lies inside or on the surface.
    #[inline]
    pub fn contains(&self, p: Vec3) -> bool {
        p.cmpge(self.min).all() && p.cmple(self.max).all()
    }

    /// The part of `[near, far]` that lies inside the box, or `None` if the ray misses it.
    ///
    /// Slab by slab; a ray parallel to a slab is inside it for all `t` or for none, so that
    /// neither 1/0 nor 0·inf ever decides. A ray on a face counts as inside; a NaN or an infinity in
    /// the ray, or a range that is empty or NaN, meets nothing.
    ///
    /// # Source
    /// Kay and Kajiya 1986; deviation: parallel slabs are tested apart.
    pub fn clip(&self, ray: &Ray, near: f32, far: f32) -> Option<(f32, f32)> {
        // `max` and `min` below would drop a NaN and let the other axes decide.
        let ordered = near <= far;
        if !(ordered && ray.origin.is_finite() && ray.dir.is_finite()) {
            return None;
        }
        let (mut enter, mut exit) = (near, far);
        for axis in 0..3 {
            let (origin, dir) = (ray.origin[axis], ray.dir[axis]);
            let (low, high) = (self.min[axis], self.max[axis]);
            // A component this small moves less than the spacing of f32 over any finite scene.
            if dir.abs() < f32::MIN_POSITIVE {
                if origin < low || origin > high {
                    return None;
                }
                continue;
            }
            let (a, b) = ((low - origin) / dir, (high - origin) / dir);
            // None is a NaN: plain comparisons, where `min` is a call in WebAssembly.
            let (first, last) = if b < a { (b, a) } else { (a, b) };
            enter = if first > enter { first } else { enter };
            exit = if last < exit { last } else { exit };
        }
        (enter <= exit).then_some((enter, exit))
    }
}

/// Bounds that hold no scene.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum BoundsError {
    /// The scene box is empty, inverted or not finite.
    Box {
        /// The smallest corner that was given.
        min: [f32; 3],
        /// The largest corner that was given.
        max: [f32; 3],
    },
    /// `0 <= near < far < inf` does not hold.
    Range {
        /// The near distance that was given.
        near: f32,
        /// The far distance that was given.
        far: f32,
    },
}

impl core::fmt::Display for BoundsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Box { min, max } => {
                write!(f, "scene box: expected finite min < max on every axis, found {min:?} .. {max:?}")
            }
            Self::Range { near, far } => {
                write!(f, "near/far: expected 0 <= near < far, both finite, found near {near}, far {far}")
            }
        }
    }
}

impl core::error::Error for BoundsError {}
