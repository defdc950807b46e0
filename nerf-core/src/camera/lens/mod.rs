//! Lens distortion and its inverse: radial-tangential lenses and fisheyes.
//!
//! Without the feature `lens` only [`Lens::NONE`] is supported; a camera with another lens is refused.

#[cfg(feature = "lens")]
mod fisheye;
#[cfg(feature = "lens")]
mod model;
#[cfg(not(feature = "lens"))]
#[path = "model_off.rs"]
mod model;

#[cfg(all(test, feature = "lens"))]
mod tests;

/// Distortion coefficients of a lens, which apply to normalised image coordinates, +y down.
///
/// [`Projection::Perspective`]: with `r² = x² + y²` and `radial = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ +
/// k6 r⁶)`, an ideal (undistorted) point `(x, y)` is seen at `(x', y')`, where
/// `x' = x radial + 2 p1 x y + p2 (r² + 2x²)` and `y' = y radial + p1 (r² + 2y²) + 2 p2 x y`.
///
/// [`Projection::Fisheye`]: a direction `θ` radians off the axis is seen at distance `θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ +
/// k4 θ⁸)` from the principal point. The lens does not change the azimuth. `k5 k6 p1 p2` must be 0.
///
/// # Source
/// Brown 1966 and Kannala, Brandt 2006, as in OpenCV and COLMAP. COLMAP's camera model OPENCV has the perspective
/// coefficients `k1 k2 p1 p2`, FULL_OPENCV has all eight, and OPENCV_FISHEYE has the fisheye's `k1 k2 k3 k4`.
#[derive(Clone, Copy, Default, PartialEq)]
#[allow(missing_docs, reason = "the formulas say what each coefficient is")]
pub struct Lens {
    pub k1: f32,
    pub k2: f32,
    pub p1: f32,
    pub p2: f32,
    pub k3: f32,
    pub k4: f32,
    pub k5: f32,
    pub k6: f32,
    /// The distortion model that the coefficients belong to.
    pub projection: Projection,
}

/// Projection without distortion: maps the angle between direction and axis to a distance from the principal point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Projection {
    /// Pinhole: distance from the principal point, in focal lengths, is the tangent of the angle to the axis.
    #[default]
    Perspective,
    /// Equidistant: distance from the principal point, in focal lengths, is the angle to the axis, radians, up to π.
    Fisheye,
}

impl Lens {
    /// The perspective lens without distortion.
    pub const NONE: Self = Self {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
        k4: 0.0,
        k5: 0.0,
        k6: 0.0,
        projection: Projection::Perspective,
    };

    /// Returns the eight distortion coefficients, each with its name.
    pub(crate) fn coefficients(&self) -> [(&'static str, f32); 8] {
        let Self { k1, k2, p1, p2, k3, k4, k5, k6, .. } = *self;
        [("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2), ("k3", k3), ("k4", k4), ("k5", k5), ("k6", k6)]
    }
}

/// Debug output: always `k1 k2 p1 p2`; another coefficient only if not 0; the projection only if not perspective.
impl core::fmt::Debug for Lens {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let mut lens = f.debug_struct("Lens");
        for (index, (name, value)) in self.coefficients().iter().enumerate() {
            if index < 4 || *value != 0.0 {
                lens.field(name, value);
            }
        }
        if self.projection != Projection::Perspective {
            lens.field("projection", &self.projection);
        }
        lens.finish()
    }
}
