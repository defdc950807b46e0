//! Equal bins between near and far.

use crate::ray::BoundsError;

/// `near..far` cut into `count` equal bins; every ray of a picture shares them.
///
/// `t_edges[i] = near + i delta`, `t_mid[i] = near + (i + ½) delta`, world units along the ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bins {
    near: f32,
    far: f32,
    delta: f32,
    count: u32,
}

impl Bins {
    /// `count` bins of width `(far − near) / count`.
    ///
    /// # Errors
    /// [`BoundsError::Range`] unless `0 <= near < far`, both finite, and the bins have a width.
    pub fn new(near: f32, far: f32, count: u32) -> Result<Self, BoundsError> {
        let delta = (far - near) / count as f32;
        let valid = near >= 0.0 && near < far && far.is_finite() && delta > 0.0 && delta.is_finite();
        if valid { Ok(Self { near, far, delta, count }) } else { Err(BoundsError::Range { near, far }) }
    }

    /// Number of bins.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// Width of a bin.
    pub fn delta(&self) -> f32 {
        self.delta
    }

    /// The point of bin `i` at fraction `u` in `[0, 1]`; its middle at ½. Never beyond `far`, as rounding may be.
    #[inline]
    pub fn at(&self, i: u32, u: f32) -> f32 {
        let t = self.near + (i as f32 + u) * self.delta;
        if t < self.far { t } else { self.far }
    }

    /// The point of bin `i` at fraction `u` in `[0, 1)`, never on the edge where the next bin begins: rounding may
    /// put [`Bins::at`] there.
    #[inline]
    pub fn within(&self, i: u32, u: f32) -> f32 {
        let (start, end) = (self.at(i, 0.0), self.at(i, 1.0));
        // Bins without a number in between are all edge.
        self.at(i, u).min(end.next_down()).max(start)
    }

    /// The middle of the bin that `t` lies in, from its front edge up to the next; of the first or last beyond them.
    #[inline]
    pub fn middle_around(&self, t: f32) -> f32 {
        let last = self.count - 1;
        // `as` saturates, and takes NaN to 0. Near an edge the quotient may round to the bin beside it.
        let bin = (((t - self.near) / self.delta) as u32).min(last);
        let bin = if t < self.at(bin, 0.0) {
            bin.saturating_sub(1)
        } else if bin < last && t >= self.at(bin + 1, 0.0) {
            bin + 1
        } else {
            bin
        };
        self.at(bin, 0.5)
    }

    /// The bins that may have a point in `enter..=exit`, the middle or another: a superset, by one or two
    /// at each end as long as a bin is wider than the spacing of f32 at `far`.
    pub fn overlapping(&self, enter: f32, exit: f32) -> core::ops::Range<u32> {
        let index = |t: f32| (t - self.near) / self.delta;
        // Far from the origin `at` rounds by many bins at once; so does this.
        let far = self.near + self.count as f32 * self.delta;
        let rounding = 2.0 * f32::EPSILON * far / self.delta;
        // `as` saturates, and takes NaN to 0.
        let first = (index(enter) - 1.0 - rounding) as u32;
        let last = (index(exit) + 2.0 + rounding) as u32;
        first.min(self.count)..last.min(self.count)
    }
}
