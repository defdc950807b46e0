//! The radial-tangential lens model, its inverse, and tests for folds, past which an image point shows two directions.

use super::{Lens, Projection};
use glam::{Vec2, Vec3};

/// Threshold of the tests for folds. The lens counts as folded if the distortion's slope along a line from the axis, or
/// the determinant of the distortion's Jacobian, is at most `FOLD`. Past a fold, one image point shows two directions.
pub(super) const FOLD: f32 = 1e-3;
/// Threshold for minima of the distortion's slope along a line from the axis. The lens counts as folded if the slope
/// has a minimum of at most `TURN`, even if the minimum is above [`FOLD`]. The reason: a step of Newton's method may
/// jump across a low minimum. Measurements found such jumps for minima of up to 0.01.
const TURN: f32 = 2e-2;

impl Lens {
    /// Whether this build supports lens distortion.
    pub(crate) const BUILT: bool = true;

    /// Projects a direction (right, down, forward; of any length but 0) to normalised image coordinates. `None` if the
    /// lens is perspective and the direction does not point forward.
    pub fn project(&self, dir: Vec3) -> Option<(f32, f32)> {
        match self.projection {
            Projection::Fisheye => Some(self.fisheye_seen(dir)),
            Projection::Perspective => (dir.z > 0.0).then(|| self.distort(dir.x / dir.z, dir.y / dir.z)),
        }
    }

    /// Distorts the ideal (undistorted) point `(x, y)`; point and result are in normalised image coordinates.
    pub fn distort(&self, x: f32, y: f32) -> (f32, f32) {
        if self.projection == Projection::Fisheye {
            return self.fisheye_seen(Vec3::new(x, y, 1.0));
        }
        self.distort_perspective(x, y)
    }

    /// [`Self::distort`] for a perspective lens. Inlined, as is the Jacobian, since Newton's method needs both at each
    /// point, and they share the radial factor.
    #[inline(always)]
    fn distort_perspective(&self, x: f32, y: f32) -> (f32, f32) {
        let r2 = x * x + y * y;
        let (radial, _) = self.radial(r2);
        (
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Finds the ideal (undistorted) point that is seen at `(xd, yd)`: the inverse of [`Lens::distort`]. Both points
    /// are in normalised image coordinates.
    ///
    /// - Perspective lens with `k3 k4 k5 k6` all 0: Newton's method from `(xd, yd)`, at most 20 steps. `None` if a step
    ///   begins at or past a fold (the Jacobian's determinant is at most 1e-3).
    /// - Other perspective lens: at most 40 Newton steps. Each step is halved until the step reduces the residual and
    ///   does not pass a fold.
    /// - Fisheye: [`Lens::direction`], scaled so that its forward component is 1; `None` if that direction does not
    ///   point forward.
    ///
    /// For a perspective lens, also `None` if the residual is still above 1e-6 after the last step. If a coordinate
    /// exceeds 1 in magnitude, this limit is multiplied by the largest magnitude. Past a fold, one image point shows
    /// two directions, so that the model has no inverse.
    ///
    /// # Domain
    /// An inverse is found for the seen points `(xd, yd)` from the axis up to the fold:
    /// - If `k1 < 0` and all other coefficients are 0, these points fill a circle of radius `2/3 / √(−3 k1)`. In at
    ///   most the outer hundredth of this radius, no inverse is found.
    /// - If `k1, k2 >= 0` and all other coefficients are 0, there is no fold. The 20 steps suffice if the seen point is
    ///   at most 10 times as far from the axis as the ideal point.
    /// - For other lenses success cannot be predicted: [`Camera::new`](crate::camera::Camera::new) tries a grid of
    ///   image points.
    #[inline(never)]
    pub fn undistort(&self, xd: f32, yd: f32) -> Option<(f32, f32)> {
        if *self == Self::NONE {
            return Some((xd, yd));
        }
        if self.projection == Projection::Fisheye {
            let dir = self.fisheye_direction(xd, yd)?;
            return (dir.z > 0.0).then(|| (dir.x / dir.z, dir.y / dir.z));
        }
        if self.is_rational() {
            return self.undistort_damped(xd, yd);
        }
        let (mut x, mut y) = (xd, yd);
        for _ in 0..20 {
            let (fx, fy) = self.distort_perspective(x, y);
            let (ex, ey) = (fx - xd, fy - yd);
            let ([a, b], [c, d]) = self.jacobian(x, y);
            let det = a * d - b * c;
            if det.is_nan() || det <= FOLD {
                return None;
            }
            // Residuals are relative to the largest coordinate if it exceeds 1, where f32 does not resolve 1e-6.
            let scale = 1.0f32.max(x.abs()).max(y.abs()).max(xd.abs()).max(yd.abs());
            if ex.abs().max(ey.abs()) <= 1e-6 * scale {
                return Some((x, y));
            }
            x -= (d * ex - b * ey) / det;
            y -= (a * ey - c * ex) / det;
        }
        None
    }

    /// Finds the direction (right, down, forward; of any length) that is seen at the normalised image coordinates
    /// `(xd, yd)`. `None` if no inverse of the distortion is found. The direction of a fisheye may point backward.
    pub fn direction(&self, xd: f32, yd: f32) -> Option<Vec3> {
        match self.projection {
            Projection::Fisheye => self.fisheye_direction(xd, yd),
            Projection::Perspective => self.undistort(xd, yd).map(|(x, y)| Vec3::new(x, y, 1.0)),
        }
    }

    /// Whether at least one of `k3 k4 k5 k6` is not 0. The radial factor then has more terms than `1 + k1 r² + k2 r⁴`.
    fn is_rational(&self) -> bool {
        [self.k3, self.k4, self.k5, self.k6] != [0.0; 4]
    }

    /// Finds the ideal (undistorted) point that is seen at `(xd, yd)`, by damped Newton steps: each step is halved
    /// until the step reduces the residual and does not pass a fold. Lenses with `k3 k4 k5 k6` need damping, since full
    /// steps may diverge. The first step starts at `(xd, yd)`; if this point is past a fold, the start is moved towards
    /// the axis. `None` if no start before the fold is found, if 11 halvings of a step do not suffice, or if 40 steps
    /// do not suffice.
    fn undistort_damped(&self, xd: f32, yd: f32) -> Option<(f32, f32)> {
        let seen = Vec2::new(xd, yd);
        let residual = |p: Vec2| Vec2::from(self.distort(p.x, p.y)) - seen;
        // Whether a step may end at point `p`: before the fold, and before the pole of the radial part.
        let sound = |p: Vec2| {
            let ([a, b], [c, d]) = self.jacobian(p.x, p.y);
            self.denominator(p.length_squared()).0 > FOLD && a * d - b * c > FOLD
        };
        let mut p = seen;
        // Moves the start towards the axis until it is before the fold. `seen` may be beyond the radius of the fold
        // while its ideal point is before the fold.
        for _ in 0..12 {
            if sound(p) {
                break;
            }
            p *= 0.7;
        }
        if !sound(p) {
            return None;
        }
        for _ in 0..40 {
            let off = residual(p);
            if off.abs().max_element()
                <= 1e-6 * 1.0f32.max(p.abs().max_element()).max(seen.abs().max_element())
            {
                return Some((p.x, p.y));
            }
            let ([a, b], [c, d]) = self.jacobian(p.x, p.y);
            let step = Vec2::new(d * off.x - b * off.y, a * off.y - c * off.x) / (a * d - b * c);
            let halved = (0..12u8).map(|i| p - step / f32::from(1u16 << i));
            p = { halved }.find(|&q| sound(q) && residual(q).length_squared() < off.length_squared())?;
        }
        None
    }

    /// Returns the radial factor at `r2`, the squared distance from the axis, and its derivative with respect to `r2`.
    #[inline(always)]
    fn radial(&self, r2: f32) -> (f32, f32) {
        let above = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let slope = self.k1 + r2 * (2.0 * self.k2 + r2 * (3.0 * self.k3));
        if [self.k4, self.k5, self.k6] == [0.0; 3] {
            return (above, slope);
        }
        let (below, below_slope) = self.denominator(r2);
        (above / below, (slope - above / below * below_slope) / below)
    }

    fn denominator(&self, r2: f32) -> (f32, f32) {
        (
            1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6)),
            self.k4 + r2 * (2.0 * self.k5 + r2 * (3.0 * self.k6)),
        )
    }

    /// Upper bound on the operator norm of [`Self::jacobian`] minus the identity, anywhere within `r` of the axis.
    /// Valid for lenses with `k3 k4 k5 k6` all 0.
    ///
    /// The radial part's slope differs from 1 by `3 k1 r² + 5 k2 r⁴` along the radius, and by `k1 r² + k2 r⁴` across
    /// the radius. The tangential part's Jacobian at point `q` is `2 (p·q) I + 2 (p qᵀ + q pᵀ)` with `p = (p2, p1)`.
    pub(super) fn bend(&self, r: f32) -> f32 {
        let r2 = r * r;
        r2 * (3.0 * self.k1.abs() + 5.0 * self.k2.abs() * r2) + 6.0 * (self.p1.abs() + self.p2.abs()) * r
    }

    /// Whether the distortion is provably weak. [`Self::undistort`] then finds the ideal point of every point seen
    /// within `radius` of the axis, and no fold lies between the axis and the ideal point: no further check is needed.
    ///
    /// Proof: let `seen` be a point within `radius` of the axis, and let `b = bend(9/7 radius)` be at most 1/8
    /// ([`Self::bend`]). The map `x ↦ seen − (distort(x) − x)`, whose fixed point is the ideal point, contracts the
    /// disc of radius `8/7 radius` into itself, so that the disc holds exactly one ideal point. Newton's method starts
    /// at `seen`, which is within `1/7 radius` of the ideal point. Each step multiplies the distance to the ideal point
    /// by at most `2b / (1 − b)`, which is at most 2/7. No step leaves the disc of radius `9/7 radius`, in which `b`
    /// bounds the bend.
    ///
    /// `false` for fisheyes and for lenses with `k3 k4 k5 k6`, to which the proof does not apply.
    pub(crate) fn is_gentle(&self, radius: f32) -> bool {
        self.projection == Projection::Perspective
            && !self.is_rational()
            && self.bend(9.0 / 7.0 * radius) <= 0.125
    }

    /// Finds the direction (right, down, forward) seen at the normalised image coordinates `(xd, yd)`. `None` if
    /// [`Lens::direction`] is `None`, or if `from_axis` is true and the lens folds between axis and direction.
    pub(crate) fn invert(&self, xd: f32, yd: f32, from_axis: bool) -> Option<Vec3> {
        let dir = self.direction(xd, yd)?;
        let folds = || match self.projection {
            Projection::Fisheye => self.fisheye_folds_before(dir),
            Projection::Perspective => {
                let starts_inside = xd * xd + yd * yd <= dir.x * dir.x + dir.y * dir.y;
                !(starts_inside || self.is_rational() || self.starts_well(xd, yd))
                    || self.folds_before(dir.x, dir.y)
            }
        };
        (!from_axis || !folds()).then_some(dir)
    }

    /// Whether Newton's method may start at the seen point `(xd, yd)`: no fold lies between the axis and this point,
    /// and the first step cannot jump across the axis. The caller ensures that the ideal point (the method's result) is
    /// nearer to the axis than the seen point.
    fn starts_well(&self, xd: f32, yd: f32) -> bool {
        let (fx, fy) = self.distort(xd, yd);
        let (ex, ey) = (fx - xd, fy - yd);
        let ([a, b], [c, d]) = self.jacobian(xd, yd);
        let det = a * d - b * c;
        let step = ((d * ex - b * ey) / det, (a * ey - c * ex) / det);
        step.0 * step.0 + step.1 * step.1 <= xd * xd + yd * yd && !self.folds_before(xd, yd)
    }

    /// Whether the distortion folds between the axis and the ideal point `(x, y)`.
    ///
    /// If Newton's method starts beyond a fold, the method may return an ideal point beyond the fold. This ideal point
    /// is wrong: at the same image point, a real lens shows another ideal point, which lies before the fold.
    fn folds_before(&self, x: f32, y: f32) -> bool {
        let r2 = x * x + y * y;
        if self.is_rational() {
            return self.folds_on_the_way(x, y);
        }
        // With a bend of at most 0.9, all slopes are at least 0.1 and all determinants at least 0.01: no fold.
        if self.bend(Vec2::new(x, y).length()) <= 0.9 {
            return false;
        }
        // The component of `distort(s x, s y)` along (x, y), divided by the length of (x, y), is s + tilt/2 s² +
        // second/3 s³ + fourth/5 s⁵.
        let (second, fourth) = (3.0 * self.k1 * r2, 5.0 * self.k2 * r2 * r2);
        let tilt = 6.0 * (self.p2 * x + self.p1 * y);
        let slope = |s: f32| 1.0 + s * (tilt + s * (second + s * s * fourth));
        // Without the tilt, the slope is least at s² = `turn` or at an end of 0..1. The steps below could miss `turn`.
        // A negative tilt lowers the slope; a positive tilt may raise it.
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

    /// Whether the distortion of a lens with `k3 k4 k5 k6` folds on the segment from the axis to the ideal point
    /// `(x, y)`. Tests 128 points of the segment. The lens folds if one of three values is at most [`FOLD`] at a tested
    /// point: the slope along the segment, the determinant of the distortion's Jacobian, or the denominator of the
    /// radial factor.
    fn folds_on_the_way(&self, x: f32, y: f32) -> bool {
        let r2 = x * x + y * y;
        (1..=128u8).any(|step| {
            let s = f32::from(step) / 128.0;
            let ([a, b], [c, d]) = self.jacobian(s * x, s * y);
            let slope = (x * (a * x + b * y) + y * (c * x + d * y)) / r2;
            let sound = slope > FOLD && a * d - b * c > FOLD && self.denominator(s * s * r2).0 > FOLD;
            !sound && r2 > 0.0
        })
    }

    /// Finds the direction (right, down, forward; any length) seen at the normalised image coordinates `(xd, yd)`.
    /// [`Camera::new`](crate::camera::Camera::new) has checked the lens at a grid of image points only. If the lens
    /// folds between these points (possible with strong `p1 p2`), returns `(xd, yd, 1)`, which is wrong but finite.
    #[inline]
    pub(crate) fn straighten(&self, xd: f32, yd: f32) -> Vec3 {
        if *self == Self::NONE {
            return Vec3::new(xd, yd, 1.0);
        }
        self.direction(xd, yd).unwrap_or(Vec3::new(xd, yd, 1.0))
    }

    /// Returns the Jacobian of [`Self::distort`] at `(x, y)`: rows are outputs, columns inputs.
    #[inline(always)]
    pub(super) fn jacobian(&self, x: f32, y: f32) -> ([f32; 2], [f32; 2]) {
        let r2 = x * x + y * y;
        let (radial, slope) = self.radial(r2);
        let slope = 2.0 * slope;
        let cross = x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
        (
            [radial + x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x, cross],
            [cross, radial + y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x],
        )
    }
}
