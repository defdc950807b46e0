//! Equal bins along a ray.

use crate::simd::{LANES, Lanes};
use crate::space::BoundsError;
use core::ops::Range;

/// `near..far` cut into `count` equal bins; every ray of a picture shares them.
///
/// `t_edges[i] = near + i delta`, `t_mid[i] = near + (i + ½) delta`, world units along the ray. A ray that uses only a
/// part of them has its first and last bin cut to that ([`Bins::cut`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bins {
    near: f32,
    delta: f32,
    count: u32,
    ends: Ends,
}

/// Where the part of the bins that a ray uses begins and ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ends {
    /// What of the first bin counts, if that is not all of it: from `start`, to `low` where it ends; −∞ else.
    start: f32,
    low: f32,
    /// Where the last bin begins, if it is cut, or +∞; where it ends, and up to where it counts.
    high: f32,
    far: f32,
    stop: f32,
}

impl Ends {
    /// Of a ray without bins.
    pub const NONE: Self = Self {
        start: f32::NEG_INFINITY,
        low: f32::NEG_INFINITY,
        high: f32::INFINITY,
        far: 0.0,
        stop: f32::INFINITY,
    };

    /// Number of [`Ends::parts`].
    pub const PARTS: usize = 5;

    /// All of it.
    #[inline]
    pub fn parts(&self) -> [f32; Self::PARTS] {
        [self.start, self.low, self.high, self.far, self.stop]
    }

    /// The ends that [`Ends::parts`] gives.
    #[inline]
    pub fn of_parts([start, low, high, far, stop]: [f32; Self::PARTS]) -> Self {
        Self { start, low, high, far, stop }
    }

    /// The distance nearest to `t` in the part of its bin that counts, and that part's width: [`Bins::part_around`] of a vector
    /// of rays. `delta` is the width of a bin, `ends` are [`Ends::parts`] of each ray.
    #[inline(always)]
    pub fn part_around<V: Lanes>(ends: [V; Self::PARTS], t: V, delta: V) -> (V, V) {
        let [start, low, high, _, stop] = ends;
        let (first, not_last) = (t.less(low), t.less(high));
        let (from, to) = (V::select(first, start, high), V::select(not_last, low, stop));
        let whole = |whole: V, cut: V| V::select(first, cut, V::select(not_last, whole, cut));
        (whole(t, t.max_of(from).min_of(to)), whole(delta, to.sub(from)))
    }
}

impl Bins {
    /// `count` bins of width `(far − near) / count`.
    ///
    /// # Errors
    /// [`BoundsError::Range`] unless `0 <= near < far`, both finite, and the bins have a width.
    pub fn new(near: f32, far: f32, count: u32) -> Result<Self, BoundsError> {
        let delta = (far - near) / count as f32;
        let valid = near >= 0.0 && near < far && far.is_finite() && delta > 0.0 && delta.is_finite();
        let ends = Ends { far, ..Ends::NONE };
        if valid { Ok(Self { near, delta, count, ends }) } else { Err(BoundsError::Range { near, far }) }
    }

    /// `count` bins of width `delta` from `near` on.
    pub(crate) fn of_width(near: f32, delta: f32, count: u32) -> Self {
        let far = near + count as f32 * delta;
        Self { near, delta, count, ends: Ends { far, ..Ends::NONE } }
    }

    /// What [`Bins::cut`] made of these bins.
    #[inline]
    pub(crate) fn with(&self, ends: Ends) -> Self {
        Self { ends, ..*self }
    }

    /// Where they begin and end.
    #[inline]
    pub(crate) fn ends(&self) -> Ends {
        self.ends
    }

    /// The same bins for a ray that ends at `far` and of which `start..stop` counts, and the numbers of those that do.
    ///
    /// At `far` the last bin is cut: it has its samples in front of that. `start` and `stop` cut widths alone: the sample
    /// stays where it is, so that what it gives goes continuously with both. Other bins do not move by a bit.
    pub fn cut(&self, start: f32, far: f32, stop: f32) -> (Self, Range<u32>) {
        let (mut ends, mut bins) = (self.ends, 0..self.count);
        if start > self.near {
            // `as` saturates, and takes NaN to 0.
            bins.start = ((start - self.near) / self.delta) as u32;
            (ends.start, ends.low) = (start, self.edge(bins.start.saturating_add(1)));
        }
        let stop = stop.min(far);
        if stop < ends.far {
            let bin = ((stop - self.near) / self.delta) as u32;
            // Beginning where the part ends is beginning behind it.
            let last = if self.edge(bin) < stop { bin } else { bin.saturating_sub(1) };
            bins.end = bins.end.min(last.saturating_add(1));
            ends = Ends { high: self.edge(last), far: self.edge(last + 1).min(far), stop, ..ends };
        }
        (self.with(ends), bins)
    }

    /// By how much bins have to move, by whole ones, to be where `enter..exit` is; 0 if they are.
    pub(crate) fn shift(&self, enter: f32, exit: f32) -> f32 {
        let index = (enter - self.near) / self.delta;
        if index >= 0.0 && exit <= self.ends.far {
            return 0.0;
        }
        // From 2^23 on there are no fractions.
        let whole = if index.abs() < 8_388_608.0 { (index as i32) as f32 } else { index };
        (if whole > index { whole - 1.0 } else { whole }) * self.delta
    }

    /// [`Bins::cut`] of a vector of rays, as [`Ends::parts`]; the numbers of bins are whole.
    #[inline(always)]
    pub(crate) fn cut_lanes<V: Lanes>(&self, start: V, far: V, stop: V) -> ([V; Ends::PARTS], [V; 2]) {
        let [all_start, all_low, all_high, all_far, all_stop] = self.ends.parts().map(V::splat);
        let (near, delta, one) = (V::splat(self.near), V::splat(self.delta), V::splat(1.0));
        let edge = |i: V| near.add(i.mul(delta));
        let bin_at = |t: V| whole(t.sub(near).div(delta));
        let (late, first) = (near.less(start), bin_at(start));
        let stop = stop.min_of(far);
        let (early, bin) = (stop.less(all_far), bin_at(stop));
        let last = V::select(edge(bin).less(stop), bin, bin.sub(one).max_of(V::splat(0.0)));
        let (count, end) = (V::splat(self.count as f32), last.add(one));
        let ends = [
            V::select(late, start, all_start),
            V::select(late, edge(first.add(one)), all_low),
            V::select(early, edge(last), all_high),
            V::select(early, edge(end).min_of(far), all_far),
            V::select(early, stop, all_stop),
        ];
        (ends, [V::select(late, first, V::splat(0.0)), V::select(early, end.min_of(count), count)])
    }

    /// [`Bins::shift`] of a vector of rays.
    #[inline(always)]
    pub(crate) fn shift_lanes<V: Lanes>(&self, enter: V, exit: V) -> V {
        let (zero, delta) = (V::splat(0.0), V::splat(self.delta));
        let index = enter.sub(V::splat(self.near)).div(delta);
        let shift = index.floor().mul(delta);
        let fits = V::select(V::splat(self.ends.far).less(exit), shift, zero);
        V::select(index.less(zero), shift, fits)
    }

    /// [`Bins::overlapping`] of a vector of rays; the numbers are whole.
    #[inline(always)]
    pub(crate) fn overlapping_lanes<V: Lanes>(&self, enter: V, exit: V) -> [V; 2] {
        let (near, delta, count) = (V::splat(self.near), V::splat(self.delta), V::splat(self.count as f32));
        let rounding = V::splat(self.rounding());
        let index = |t: V| t.sub(near).div(delta);
        let first = index(enter).sub(V::splat(1.0)).sub(rounding);
        let last = index(exit).add(V::splat(2.0)).add(rounding);
        [whole(first).min_of(count), whole(last).min_of(count)]
    }

    /// Far from the origin [`Bins::at`] rounds by many bins at once: by how many.
    #[inline]
    fn rounding(&self) -> f32 {
        let far = self.near + self.count as f32 * self.delta;
        2.0 * f32::EPSILON * far / self.delta
    }

    /// Where bin `i` would begin if it were not cut.
    #[inline]
    fn edge(&self, i: u32) -> f32 {
        self.near + i as f32 * self.delta
    }

    /// The middle of bin `i` if that is not cut.
    pub(crate) fn middle(&self, i: u32) -> f32 {
        self.near + (i as f32 + 0.5) * self.delta
    }

    /// Number of bins.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// Width of a bin that is not cut.
    pub fn delta(&self) -> f32 {
        self.delta
    }

    /// Of the bin that `t` lies in: what is nearest to `t` of the part that counts, its middle, and its width. There is no
    /// middle where all of the bin counts ([`Bins::middle_around`]).
    #[inline]
    pub(crate) fn part_around(&self, t: f32) -> (f32, Option<f32>, f32) {
        let Ends { start, low, high, stop, .. } = self.ends;
        let (first, last) = (t < low, t >= high);
        if !first && !last {
            return (t, None, self.delta);
        }
        let (from, to) = (if first { start } else { high }, if last { stop } else { low });
        (t.max(from).min(to), Some(from + 0.5 * (to - from)), to - from)
    }

    /// Of the bin that `t` lies in: what is nearest to `t` of the part that counts, and where that begins and ends.
    #[inline]
    pub(crate) fn ends_around(&self, t: f32) -> (f32, f32, f32) {
        let Ends { start, low, high, stop, .. } = self.ends;
        // `as` saturates. Near an edge the quotient may round to the bin beside it.
        let bin = ((t - self.near) / self.delta) as u32;
        let bin = if t < self.edge(bin) { bin.saturating_sub(1) } else { bin };
        let bin = if t < self.edge(bin + 1) { bin } else { bin + 1 };
        let from = if t < low { start } else { self.edge(bin) };
        let to = if t >= high { stop } else { self.edge(bin + 1) };
        (t.max(from).min(to), from, to)
    }

    /// The point of bin `i` at fraction `u` in `[0, 1]`; its middle at ½. Never beyond `far`, as rounding may be.
    #[inline]
    pub fn at(&self, i: u32, u: f32) -> f32 {
        let Ends { high, far, .. } = self.ends;
        let t = if self.edge(i) < high {
            self.near + (i as f32 + u) * self.delta
        } else {
            high + u * (far - high)
        };
        if t < far { t } else { far }
    }

    /// The middles of a vector of bins, each of its own ray with [`Ends::parts`]: [`Bins::at`] ½ of each.
    #[inline(always)]
    pub(crate) fn middles_of<V: Lanes>(&self, bins: V, ends: [V; Ends::PARTS]) -> V {
        let [_, _, high, far, _] = ends;
        let (near, delta, half) = (V::splat(self.near), V::splat(self.delta), V::splat(0.5));
        let whole = near.add(bins.mul(delta)).less(high);
        let t = V::select(whole, near.add(bins.add(half).mul(delta)), high.add(half.mul(far.sub(high))));
        V::select(t.less(far), t, far)
    }

    /// Whether the middle of bin `last`, and of each before it, is that of a whole bin.
    #[inline(always)]
    pub(crate) fn whole_up_to(&self, last: u32) -> bool {
        let Ends { high, far, .. } = self.ends;
        self.edge(last) < high && self.near + (last as f32 + 0.5) * self.delta < far
    }

    /// The middles of a vector of bins from `first` on, a number below 2^23: [`Bins::at`] ½ of each; `whole`: as
    /// [`Bins::whole_up_to`] says of the last.
    #[inline(always)]
    pub(crate) fn middles<V: Lanes>(&self, first: u32, whole: bool) -> V {
        let Ends { high, far, .. } = self.ends;
        let (near, delta, half) = (V::splat(self.near), V::splat(self.delta), V::splat(0.5));
        let i = V::splat(first as f32).add(V::load(&LANES));
        let middle = near.add(i.add(half).mul(delta));
        if whole {
            return middle;
        }
        let cut = V::splat(high + 0.5 * (far - high));
        let t = V::select(near.add(i.mul(delta)).less(V::splat(high)), middle, cut);
        V::select(t.less(V::splat(far)), t, V::splat(far))
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
    pub fn overlapping(&self, enter: f32, exit: f32) -> Range<u32> {
        let index = |t: f32| (t - self.near) / self.delta;
        let rounding = self.rounding();
        // `as` saturates, and takes NaN to 0.
        let first = (index(enter) - 1.0 - rounding) as u32;
        let last = (index(exit) + 2.0 + rounding) as u32;
        first.min(self.count)..last.min(self.count)
    }
}

/// `as u32`, as far as bins are counted by vectors: [`Lanes::to_indices`] takes the result.
#[inline(always)]
fn whole<V: Lanes>(x: V) -> V {
    x.max_of(V::splat(0.0)).min_of(V::splat(8_388_608.0)).floor()
}
