//! Radial-tangential lens distortion and its inverse.

#[cfg(test)]
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

    /// Where the ideal point `(x, y)` is seen.
    pub fn distort(&self, x: f32, y: f32) -> (f32, f32) {
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * self.k2);
        (
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// The ideal point that is seen at `(xd, yd)`, by Newton's method from `(xd, yd)` itself.
    ///
    /// `None` where the lens folds over (the Jacobian's determinant is not positive on the way)
    /// or where 20 steps do not bring the residual below 1e-6 of the coordinates (1e-6 itself
    /// within the unit circle): there the model has no inverse
    /// near the start, and a picture would show the same direction twice.
    pub fn undistort(&self, xd: f32, yd: f32) -> Option<(f32, f32)> {
        if *self == Self::NONE {
            return Some((xd, yd));
        }
        let (mut x, mut y) = (xd, yd);
        for _ in 0..20 {
            let (fx, fy) = self.distort(x, y);
            let (ex, ey) = (fx - xd, fy - yd);
            let ([a, b], [c, d]) = self.jacobian(x, y);
            let det = a * d - b * c;
            if det.is_nan() || det <= 1e-3 {
                return None;
            }
            // Beyond the unit circle 1e-6 is finer than f32 resolves.
            let scale = 1.0f32.max(x.abs()).max(y.abs()).max(xd.abs()).max(yd.abs());
            if ex.abs().max(ey.abs()) <= 1e-6 * scale {
                return Some((x, y));
            }
            x -= (d * ex - b * ey) / det;
            y -= (a * ey - c * ex) / det;
        }
        None
    }

    /// Derivatives of [`Self::distort`]: rows are outputs, columns inputs.
    fn jacobian(&self, x: f32, y: f32) -> ([f32; 2], [f32; 2]) {
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * self.k2);
        let slope = 2.0 * self.k1 + 4.0 * self.k2 * r2;
        let cross = x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
        (
            [radial + x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x, cross],
            [cross, radial + y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x],
        )
    }
}
