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

    /// The point of the bin around `t` that is nearest to `t`, and where that bin begins and ends, cut to `ends`
    /// ([`Ends::parts`]).
    #[inline(always)]
    pub(crate) fn edges_around<V: Lanes>(&self, ends: [V; Ends::PARTS], t: V) -> [V; 3] {
        let [start, low, high, _, stop] = ends;
        let (near, delta, one) = (V::splat(self.near), V::splat(self.delta), V::splat(1.0));
        let edge = |i: V| near.add(i.mul(delta));
        let bin = self.bin_around(t);
        let from = V::select(t.less(low), start, edge(bin));
        let to = V::select(t.less(high), edge(bin.add(one)), stop);
        [t.max_of(from).min_of(to), from, to]
    }

    /// Number of the bin around `t`, as if there were any number of them from 0 on.
    #[inline(always)]
    fn bin_around<V: Lanes>(&self, t: V) -> V {
        let (near, delta, one) = (V::splat(self.near), V::splat(self.delta), V::splat(1.0));
        let edge = |i: V| near.add(i.mul(delta));
        // Near an edge the quotient may round to the bin beside it.
        let bin = whole(t.sub(near).div(delta));
        let bin = V::select(t.less(edge(bin)), bin.sub(one).max_of(V::splat(0.0)), bin);
        V::select(t.less(edge(bin.add(one))), bin, bin.add(one))
    }

    /// Whether the bin around `t` is not cut.
    #[inline]
    pub(crate) fn is_whole_around(&self, t: f32) -> bool {
        t >= self.ends.low && t < self.ends.high
    }

    /// The point of bin `i` at fraction `u` in `[0, 1]`; its middle at ½. Never beyond `far`, as rounding may be.
    #[inline]
    pub fn at(&self, i: u32, u: f32) -> f32 {
        self.points(i as f32, u, self.ends.parts())
    }

    /// [`Bins::at`] of a vector of bins, each of its own ray with [`Ends::parts`].
    #[inline(always)]
    pub(crate) fn points<V: Lanes>(&self, bins: V, u: V, ends: [V; Ends::PARTS]) -> V {
        let [_, _, high, far, _] = ends;
        let (near, delta) = (V::splat(self.near), V::splat(self.delta));
        let whole = near.add(bins.mul(delta)).less(high);
        let t = V::select(whole, near.add(bins.add(u).mul(delta)), high.add(u.mul(far.sub(high))));
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
        let (i, half) = (V::splat(first as f32).add(V::load(&LANES)), V::splat(0.5));
        if whole {
            return V::splat(self.near).add(i.add(half).mul(V::splat(self.delta)));
        }
        let [start, low, high, far, stop] = self.ends.parts();
        self.points(i, half, [V::splat(start), V::splat(low), V::splat(high), V::splat(far), V::splat(stop)])
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
        self.at((self.bin_around(t) as u32).min(self.count - 1), 0.5)
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
