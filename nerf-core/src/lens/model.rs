//! The lens model.

use super::Lens;
use glam::Vec2;

/// The model folds over where its slope, or its Jacobian's determinant, is no more than this.
const FOLD: f32 = 1e-3;
/// Where the slope falls to no more than this and rises again, Newton's method may leap over what is between
/// (measured: up to 0.01).
const TURN: f32 = 2e-2;

impl Lens {
    /// Whether this build has lens distortion.
    pub(crate) const BUILT: bool = true;

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
    /// `None` where the lens folds over (the Jacobian's determinant is at most 1e-3 on the way)
    /// or where 20 steps do not bring the residual below 1e-6 of the coordinates (1e-6 itself
    /// within the unit circle): there the model has no inverse
    /// near the start, and a picture would show the same direction twice.
    ///
    /// # Domain
    /// The finite points around the axis up to the fold. With `k1 < 0` alone that is the circle of radius
    /// `2/3 / √(−3 k1)`, to the last hundredth; with `k1, k2 >= 0` and no tangential part there is no fold, and
    /// 20 steps reach every point that is seen at up to 10 times its own radius. Elsewhere only the answer
    /// tells; [`Camera::new`](crate::camera::Camera::new) asks on a lattice over the image, unless the lens is too
    /// gentle to fail there.
    #[inline(never)]
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
            if det.is_nan() || det <= FOLD {
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

    /// Bound on how far [`Self::jacobian`] is from the identity (operator norm) anywhere within `r` of the axis.
    ///
    /// The radial part's slopes are `3 k1 r² + 5 k2 r⁴` along `r` and less across; the tangential part's Jacobian is
    /// `2 (p·q) I + 2 (p qᵀ + q pᵀ)` with `p = (p2, p1)` and `q` the point.
    pub(super) fn bend(&self, r: f32) -> f32 {
        let r2 = r * r;
        r2 * (3.0 * self.k1.abs() + 5.0 * self.k2.abs() * r2) + 6.0 * (self.p1.abs() + self.p2.abs()) * r
    }

    /// Whether the model bends so little that for every point seen within `radius` of the axis
    /// [`Self::undistort`] finds the ideal point, with no fold before it: a camera need ask no further.
    ///
    /// With a bend `b` of at most 1/8 within 9/7 of `radius`, `x ↦ seen − (distort(x) − x)` contracts the disc of
    /// 8/7 `radius` into itself, so that it holds one ideal point. Newton's method starts within 1/7 `radius` of it
    /// and keeps at most `2b / (1 − b)`, 2/7, of the distance a step, without leaving the larger disc.
    pub(crate) fn is_gentle(&self, radius: f32) -> bool {
        self.bend(9.0 / 7.0 * radius) <= 0.125
    }

    /// The ideal point that is seen at `(xd, yd)`, if it can be found and, `from_axis`, lies in front of every fold.
    pub(crate) fn invert(&self, xd: f32, yd: f32, from_axis: bool) -> Option<(f32, f32)> {
        self.undistort(xd, yd).filter(|&(x, y)| {
            let starts_inside = xd * xd + yd * yd <= x * x + y * y;
            !from_axis || (starts_inside || self.starts_well(xd, yd)) && !self.folds_before(x, y)
        })
    }

    /// Whether Newton's method may start at `(xd, yd)`, beyond the point it looks for: in front of every fold, and
    /// with a first step that cannot leap over the axis to what is behind it.
    fn starts_well(&self, xd: f32, yd: f32) -> bool {
        let (fx, fy) = self.distort(xd, yd);
        let (ex, ey) = (fx - xd, fy - yd);
        let ([a, b], [c, d]) = self.jacobian(xd, yd);
        let det = a * d - b * c;
        let step = ((d * ex - b * ey) / det, (a * ey - c * ex) / det);
        step.0 * step.0 + step.1 * step.1 <= xd * xd + yd * yd && !self.folds_before(xd, yd)
    }

    /// Whether the model turns back on the way from the axis to the ideal point `(x, y)`.
    ///
    /// Newton's method, started behind a fold, finds the point behind it: one of the directions that are seen
    /// there, and not the one that a lens shows.
    fn folds_before(&self, x: f32, y: f32) -> bool {
        let r2 = x * x + y * y;
        // No slope below 0.1 and no determinant below its square.
        if self.bend(Vec2::new(x, y).length()) <= 0.9 {
            return false;
        }
        // `distort(s x, s y)` is s + tilt/2 s² + second/3 s³ + fourth/5 s⁵, along (x, y) and in units of it.
        let (second, fourth) = (3.0 * self.k1 * r2, 5.0 * self.k2 * r2 * r2);
        let tilt = 6.0 * (self.p2 * x + self.p1 * y);
        let slope = |s: f32| 1.0 + s * (tilt + s * (second + s * s * fourth));
        // Without the tilt it is least at s² = turn, which steps could pass over, or else at an end; a tilt below 0
        // takes more from it, one above may lift it.
        let turn = -second / (2.0 * fourth);
        if tilt <= 0.0 && fourth > 0.0 && turn > 0.0 && turn < 1.0 && 1.0 + 0.5 * second * turn <= TURN {
            return true;
        }
        let last = slope(1.0);
        if last.is_nan() || last <= FOLD {
            return true;
        }
        if self.p1 == 0.0 && self.p2 == 0.0 {
            return false;
        }
        let least = TURN.min(last);
        (1..=64u8).any(|step| {
            let s = f32::from(step) / 64.0;
            let ([a, b], [c, d]) = self.jacobian(s * x, s * y);
            slope(s) < least || a * d - b * c <= FOLD
        })
    }

    /// [`Lens::undistort`] for a camera, whose lens was gentle or invertible on a lattice when it was made: where a strong
    /// tangential part folds between its points, the distorted direction stays, which is off but finite.
    #[inline]
    pub(crate) fn straighten(&self, xd: f32, yd: f32) -> (f32, f32) {
        self.undistort(xd, yd).unwrap_or((xd, yd))
    }

    /// Derivatives of [`Self::distort`]: rows are outputs, columns inputs.
    pub(super) fn jacobian(&self, x: f32, y: f32) -> ([f32; 2], [f32; 2]) {
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
