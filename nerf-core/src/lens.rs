//! Radial-tangential lens distortion and its inverse.
//!
//! Without the feature `lens` there is one lens, [`Lens::NONE`]; a camera with another is refused.

#[cfg(feature = "lens")]
#[path = "lens/model.rs"]
mod model;
#[cfg(not(feature = "lens"))]
#[path = "lens/model_off.rs"]
mod model;

#[cfg(all(test, feature = "lens"))]
mod tests;

/// Coefficients of the radial-tangential ("OpenCV") lens model on normalised image coordinates.
///
/// With `r² = x² + y²` an ideal image point `(x, y)` is seen at
/// `x (1 + k1 r² + k2 r⁴) + 2 p1 x y + p2 (r² + 2x²)`, and likewise
/// `y (1 + k1 r² + k2 r⁴) + p1 (r² + 2y²) + 2 p2 x y`, with +y down.
///
/// # Source
/// Brown 1966, in the parameter order of OpenCV's `distCoeffs` and nerfstudio's `k1 k2 p1 p2`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lens {
    /// Radial, second order.
    pub k1: f32,
    /// Radial, fourth order.
    pub k2: f32,
    /// Tangential.
    pub p1: f32,
    /// Tangential.
    pub p2: f32,
}

impl Lens {
    /// A lens that moves nothing.
    pub const NONE: Self = Self { k1: 0.0, k2: 0.0, p1: 0.0, p2: 0.0 };
}
