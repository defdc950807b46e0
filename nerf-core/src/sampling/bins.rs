//! Equal bins along a ray.

use crate::simd::{LANES, Lanes};
use crate::space::BoundsError;
use core::ops::Range;

/// The range `near..far` of a ray, split into `count` equal bins. All rays of an image have the same bins.
///
/// Bin `i` begins at `near + i delta` and has the width `delta`. The unit is world units along the ray or, with a
/// contraction, positions [`s`](crate::space::Contraction::distance). A ray's first and last bin may be cut
/// ([`Bins::cut`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bins {
    near: f32,
    delta: f32,
    count: u32,
    pub(crate) ends: Ends,
}

/// Cuts of a ray's first and last bin: positions along the ray, in the unit of [`Bins`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ends {
    /// Beginning of the used part of the first bin, if this bin is cut; otherwise −∞.
    pub start: f32,
    /// End of the first bin, if this bin is cut; otherwise −∞.
    pub low: f32,
    /// Beginning of the last bin, if this bin is cut; otherwise +∞.
    pub high: f32,
    /// Upper limit of the sample's position in the last bin. If the last bin is not cut: end of all bins.
    pub far: f32,
    /// End of the used part of the last bin, at most `far`; +∞ if the last bin is not cut. The sample may lie between
    /// `stop` and `far`: its density is then used for the part of the bin in front of `stop`.
    pub stop: f32,
}

impl Ends {
    /// No cuts, with `far` = 0: the ends of a ray without bins.
    pub const NONE: Self = Self {
        start: f32::NEG_INFINITY,
        low: f32::NEG_INFINITY,
        high: f32::INFINITY,
        far: 0.0,
        stop: f32::INFINITY,
    };

    /// Number of values that [`Ends::parts`] returns: one per field.
    pub const PARTS: usize = 5;

    /// `start`, `low`, `high`, `far` and `stop`, in this order.
    #[inline]
    pub fn parts(&self) -> [f32; Self::PARTS] {
        [self.start, self.low, self.high, self.far, self.stop]
    }
}

impl Bins {
    /// Divides `near..far` into `count` bins of width `(far − near) / count`.
    ///
    /// # Errors
    /// [`BoundsError::Range`] unless `0 <= near < far`, both finite, and the width of a bin is above 0 and finite.
    pub fn new(near: f32, far: f32, count: u32) -> Result<Self, BoundsError> {
        let delta = (far - near) / count as f32;
        let valid = near >= 0.0 && near < far && far.is_finite() && delta > 0.0 && delta.is_finite();
        let ends = Ends { far, ..Ends::NONE };
        if valid { Ok(Self { near, delta, count, ends }) } else { Err(BoundsError::Range { near, far }) }
    }

    /// Makes `count` bins of width `delta`, the first of which begins at `near`. The arguments are not checked.
    pub(crate) fn of_width(near: f32, delta: f32, count: u32) -> Self {
        let far = near + count as f32 * delta;
        Self { near, delta, count, ends: Ends { far, ..Ends::NONE } }
    }

    /// Returns a copy of these bins with the cuts `ends` of a ray, as computed by [`Bins::cut`].
    #[inline]
    pub(crate) fn with(&self, ends: Ends) -> Self {
        Self { ends, ..*self }
    }

    /// Cuts the bins for a ray. All samples lie in front of `far`, and only the part `start..stop` of the ray is used
    /// (units as in [`Bins`]). Returns the cut bins, and the index range of the bins that overlap `start..stop`.
    ///
    /// The bin that contains `far` ends there, and its sample moves in front of `far`. The widths of the bins that
    /// contain `start` and `stop` shrink to the used part, but their samples do not move. A sample's contribution is
    /// therefore continuous in `start` and `stop`. Bins without a cut stay bit-identical.
    pub fn cut(&self, start: f32, far: f32, stop: f32) -> (Self, Range<u32>) {
        let (mut ends, mut bins) = (self.ends, 0..self.count);
        if start > self.near {
            // `as` saturates, and converts NaN to 0.
            bins.start = self.position(start) as u32;
            (ends.start, ends.low) = (start, self.distance(bins.start.saturating_add(1) as f32));
        }
        let stop = stop.min(far);
        if stop < ends.far {
            let bin = self.position(stop) as u32;
            // A bin that begins exactly at `stop` is not used.
            let last = if self.distance(bin as f32) < stop { bin } else { bin.saturating_sub(1) };
            bins.end = bins.end.min(last.saturating_add(1));
            let (high, end) = (self.distance(last as f32), self.distance((last + 1) as f32));
            ends = Ends { high, far: end.min(far), stop, ..ends };
        }
        (self.with(ends), bins)
    }

    /// Distance, a multiple of the bin width, by which the bins must move to begin at or just before the distance
    /// `enter` along the ray. 0 if the bins already cover the part `enter..exit` of the ray.
    #[inline(always)]
    pub(crate) fn shift<V: Lanes>(&self, enter: V, exit: V) -> V {
        let (zero, index) = (V::splat(0.0), self.position(enter));
        let shift = index.floor().mul(V::splat(self.delta));
        let fits = V::select(V::splat(self.ends.far).less(exit), shift, zero);
        V::select(index.less(zero), shift, fits)
    }

    /// Cuts the bins for a vector of rays, as [`Bins::cut`] does for one ray. Returns the cuts, in the order of
    /// [`Ends::parts`], and the index range of the bins used: first bin and end, whole numbers stored as floats.
    #[inline(always)]
    pub(crate) fn cut_lanes<V: Lanes>(&self, start: V, far: V, stop: V) -> ([V; Ends::PARTS], [V; 2]) {
        let [all_start, all_low, all_high, all_far, all_stop] = self.ends.parts().map(V::splat);
        let one = V::splat(1.0);
        let (late, first) = (V::splat(self.near).less(start), whole(self.position(start)));
        let stop = stop.min_of(far);
        let (early, bin) = (stop.less(all_far), whole(self.position(stop)));
        let last = V::select(self.distance(bin).less(stop), bin, bin.sub(one).max_of(V::splat(0.0)));
        let (count, end) = (V::splat(self.count as f32), last.add(one));
        let ends = [
            V::select(late, start, all_start),
            V::select(late, self.distance(first.add(one)), all_low),
            V::select(early, self.distance(last), all_high),
            V::select(early, self.distance(end).min_of(far), all_far),
            V::select(early, stop, all_stop),
        ];
        (ends, [V::select(late, first, V::splat(0.0)), V::select(early, end.min_of(count), count)])
    }

    /// Finds the bins that may have a point in `enter..=exit`, for a vector of rays ([`Bins::overlapping`]). Returns
    /// the index range of these bins: first bin and end, whole numbers stored as floats.
    #[inline(always)]
    pub(crate) fn overlapping_lanes<V: Lanes>(&self, enter: V, exit: V) -> [V; 2] {
        let (count, rounding) = (V::splat(self.count as f32), V::splat(self.rounding()));
        let first = self.position(enter).sub(V::splat(1.0)).sub(rounding);
        let last = self.position(exit).add(V::splat(2.0)).add(rounding);
        [whole(first).min_of(count), whole(last).min_of(count)]
    }

    /// Bound on the rounding error of the points that [`Bins::at`] returns, in bin widths. The bound is many bin widths
    /// if the bins are narrow and far from the ray's origin.
    #[inline]
    fn rounding(&self) -> f32 {
        2.0 * f32::EPSILON * self.distance(self.count as f32) / self.delta
    }

    /// Converts a position counted in bins to a distance along the ray. Bin `i` begins at position `i`, also if
    /// the bin is cut at the ray's start or end.
    #[inline(always)]
    pub(crate) fn distance<V: Lanes>(&self, position: V) -> V {
        V::splat(self.near).add(position.mul(V::splat(self.delta)))
    }

    /// Converts a distance along the ray to a position counted in bins: the inverse of [`Bins::distance`].
    #[inline(always)]
    fn position<V: Lanes>(&self, distance: V) -> V {
        distance.sub(V::splat(self.near)).div(V::splat(self.delta))
    }

    /// Index range of the bins that lie between two positions along the ray.
    #[inline]
    pub(crate) fn between(&self, [from, to]: [f32; 2]) -> Range<u32> {
        self.position(from) as u32 + 1..self.position(to) as u32
    }

    /// Number of bins.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// Width of a bin without cuts, in the unit of [`Bins`].
    pub fn delta(&self) -> f32 {
        self.delta
    }

    /// Finds the used part of the bin that contains `t`. Returns three positions: `t` clamped to the used part, the
    /// beginning of the used part, and the end of the used part. `ends`: cuts of the bins, in the order of
    /// [`Ends::parts`].
    #[inline(always)]
    pub(crate) fn edges_around<V: Lanes>(&self, ends: [V; Ends::PARTS], t: V) -> [V; 3] {
        let [start, low, high, _, stop] = ends;
        let bin = self.bin_around(t);
        let from = V::select(t.less(low), start, self.distance(bin));
        let to = V::select(t.less(high), self.distance(bin.add(V::splat(1.0))), stop);
        [t.max_of(from).min_of(to), from, to]
    }

    /// Index of the bin that contains the distance `t`. At least 0, but above the last index if `t` is beyond all bins.
    #[inline(always)]
    fn bin_around<V: Lanes>(&self, t: V) -> V {
        let (bin, one) = (whole(self.position(t)), V::splat(1.0));
        // Near an edge the quotient may round to the neighbouring bin.
        let bin = V::select(t.less(self.distance(bin)), bin.sub(one).max_of(V::splat(0.0)), bin);
        V::select(t.less(self.distance(bin.add(one))), bin, bin.add(one))
    }

    /// Distance along the ray of the point at fraction `u` of bin `i`: 0 is the beginning, ½ the middle, 1 the end.
    /// Never beyond the end of the last bin, in spite of rounding.
    #[inline]
    pub fn at(&self, i: u32, u: f32) -> f32 {
        self.points(i as f32, u, self.ends.parts())
    }

    /// Computes [`Bins::at`] for a vector of rays, one per lane: the distance of the point at fraction `u` of the bin
    /// with index `bins`. `ends`: cuts of these rays, in the order of [`Ends::parts`].
    #[inline(always)]
    pub(crate) fn points<V: Lanes>(&self, bins: V, u: V, ends: [V; Ends::PARTS]) -> V {
        let [_, _, high, far, _] = ends;
        let whole = self.distance(bins).less(high);
        let t = V::select(whole, self.distance(bins.add(u)), high.add(u.mul(far.sub(high))));
        V::select(t.less(far), t, far)
    }

    /// Whether none of the bins `0..=last` is cut at its end. If so, no cut changes the middles of these bins.
    #[inline(always)]
    pub(crate) fn whole_up_to(&self, last: u32) -> bool {
        let (last, Ends { high, far, .. }) = (last as f32, self.ends);
        self.distance(last) < high && self.distance(last + 0.5) < far
    }

    /// Middles of the bins `first`, `first` + 1, …, one per lane: [`Bins::at`] with `u` = ½. Indices must be below
    /// 2^23. `whole`: the result of [`Bins::whole_up_to`] for the last of these bins.
    #[inline(always)]
    pub(crate) fn middles<V: Lanes>(&self, first: u32, whole: bool) -> V {
        let (i, half) = (V::splat(first as f32).add(V::load(&LANES)), V::splat(0.5));
        if whole {
            return self.distance(i.add(half));
        }
        let [start, low, high, far, stop] = self.ends.parts();
        self.points(i, half, [V::splat(start), V::splat(low), V::splat(high), V::splat(far), V::splat(stop)])
    }

    /// Distance along the ray of the point at fraction `u` of bin `i`; never rounded up to the next bin's start. `u`
    /// must be in `[0, 1)`.
    #[inline]
    pub fn within(&self, i: u32, u: f32) -> f32 {
        let (start, end) = (self.at(i, 0.0), self.at(i, 1.0));
        // A bin may be too narrow for a number between its edges.
        self.at(i, u).min(end.next_down()).max(start)
    }

    /// Middle of the bin that contains distance `t`. If `t` is outside all bins, the middle of the first or last bin.
    #[inline]
    pub fn middle_around(&self, t: f32) -> f32 {
        self.at((self.bin_around(t) as u32).min(self.count - 1), 0.5)
    }

    /// Index range of the bins that may have a point in `enter..=exit`. To allow for rounding errors, the range
    /// includes a few more bins at each end, or many more if bins are narrower than the spacing of f32 at the last bin.
    pub fn overlapping(&self, enter: f32, exit: f32) -> Range<u32> {
        let rounding = self.rounding();
        // `as` saturates, and converts NaN to 0.
        let first = (self.position(enter) - 1.0 - rounding) as u32;
        let last = (self.position(exit) + 2.0 + rounding) as u32;
        first.min(self.count)..last.min(self.count)
    }
}

/// Rounds `x` down and clamps it to `0..=2^23`, the integers that [`Lanes::to_indices`] accepts. A NaN becomes 0.
#[inline(always)]
fn whole<V: Lanes>(x: V) -> V {
    x.max_of(V::splat(0.0)).min_of(V::splat(8_388_608.0)).floor()
}
