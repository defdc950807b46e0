//! The fisheye lens model and its inverse.

use super::Lens;
use super::model::FOLD;
use crate::math::polynomial::{angle, sin_cos};
use core::f32::consts::PI;
use glam::{Vec2, Vec3};

/// Number of equal intervals into which 0 to π is divided to bracket an angle.
const STEPS: u8 = 32;

impl Lens {
    /// Returns the image distance of a direction `theta` radians off the axis, and the derivative of the image distance
    /// with respect to `theta`. An image distance is a distance from the principal point, in focal lengths.
    fn angle_seen(&self, theta: f32) -> (f32, f32) {
        let t = theta * theta;
        let seen = 1.0 + t * (self.k1 + t * (self.k2 + t * (self.k3 + t * self.k4)));
        let slope =
            1.0 + t * (3.0 * self.k1 + t * (5.0 * self.k2 + t * (7.0 * self.k3 + t * (9.0 * self.k4))));
        (theta * seen, slope)
    }

    /// Projects a direction (right, down, forward), of any length but 0, to normalised image coordinates.
    pub(super) fn fisheye_seen(&self, dir: Vec3) -> (f32, f32) {
        let across = Vec2::new(dir.x, dir.y).length();
        if across == 0.0 {
            return (0.0, 0.0);
        }
        let (seen, _) = self.angle_seen(angle(across, dir.z));
        (dir.x / across * seen, dir.y / across * seen)
    }

    /// Finds the unit direction (right, down, forward) that is seen at the normalised image point `(xd, yd)`.
    ///
    /// Newton's method inside a bracket finds the smallest angle to the axis that has the image distance
    /// ([`Self::angle_seen`]) of `(xd, yd)`. `None` if no f32 angle up to π has this image distance within 1e-6. For an
    /// image distance above 1, the tolerance is 1e-6 times the image distance. `None` also if the lens folds at a
    /// smaller image distance. Beyond a fold, the image distance no longer grows with the angle.
    pub(super) fn fisheye_direction(&self, xd: f32, yd: f32) -> Option<Vec3> {
        let seen = Vec2::new(xd, yd).length();
        if seen == 0.0 {
            return Some(Vec3::Z);
        }
        let theta = self.angle_of(seen)?;
        let (sin, cos) = sin_cos(theta);
        Some(Vec3::new(xd / seen * sin, yd / seen * sin, cos))
    }

    fn angle_of(&self, seen: f32) -> Option<f32> {
        let (mut low, mut high) = self.angles_around(seen)?;
        let mut theta = seen.max(low).min(high);
        for _ in 0..30 {
            let (at, slope) = self.angle_seen(theta);
            let off = at - seen;
            if off.abs() <= 1.2e-7 * seen.max(theta) {
                break;
            }
            if off > 0.0 {
                high = theta
            } else {
                low = theta
            }
            let next = theta - off / slope;
            // Bisects if Newton's step leaves the bracket.
            let inside = next > low && next < high;
            let next = if inside { next } else { 0.5 * (low + high) };
            if next == theta {
                break;
            }
            theta = next;
        }
        // If the distortion is very steep, no f32 angle is seen close enough to the distance `seen`.
        let off = (self.angle_seen(theta).0 - seen).abs();
        (off <= 1e-6 * seen.max(1.0)).then_some(theta)
    }

    /// Brackets the angle whose image distance ([`Self::angle_seen`]) is `seen`: returns a smaller and a larger angle,
    /// radians. `None` if the lens folds at a smaller image distance, or if the image distances of all angles up to π
    /// are smaller.
    fn angles_around(&self, seen: f32) -> Option<(f32, f32)> {
        let mut low = 0.0;
        for step in 1..=STEPS {
            let high = PI * f32::from(step) / f32::from(STEPS);
            let (at, slope) = self.angle_seen(high);
            let turns = slope.is_nan() || slope <= FOLD;
            let high = if turns { self.last_rising(low, high) } else { high };
            if self.angle_seen(high).0 >= seen {
                return Some((low, high));
            }
            if turns || at.is_nan() {
                return None;
            }
            low = high;
        }
        None
    }

    /// Finds the angle between `low` and `high`, radians, at which the lens folds, by bisection. The caller ensures
    /// that the derivative of the image distance ([`Self::angle_seen`]) is above [`FOLD`] at `low`, but not at `high`.
    fn last_rising(&self, mut low: f32, mut high: f32) -> f32 {
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if self.angle_seen(middle).1 > FOLD { low = middle } else { high = middle }
        }
        low
    }

    /// Whether the lens folds between the axis and the direction `dir` (right, down, forward; unit length). Past a
    /// fold, one image point shows two directions.
    pub(super) fn fisheye_folds_before(&self, dir: Vec3) -> bool {
        let theta = angle(Vec2::new(dir.x, dir.y).length(), dir.z);
        (1..=128u8).any(|step| {
            let slope = self.angle_seen(theta * f32::from(step) / 128.0).1;
            slope.is_nan() || slope <= FOLD
        })
    }
}
