//! The part of a ray that is sampled, and the bins of its samples.

use super::Plan;
use crate::camera::Ray;
use crate::sampling::{Bins, Ends, along};
use crate::simd::{Lanes, MAX_LANES, Op};
use crate::space::{Contraction, SceneBox};
use core::ops::Range;
use glam::Vec3;

#[cfg(test)]
mod tests;

/// Placement of a plan's bins on a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lattice {
    /// Only the bins used in training, from near to far.
    Own,
    /// The bins used in training, and further bins of the same width in front of near and behind far, so that the bins
    /// cover the ray's part inside the scene box.
    Extended,
    /// Bins as wide as one marching step. The first bin begins where the ray enters the scene box, or at the nearest
    /// visible distance if this is farther.
    March,
    /// For unbounded scenes: bins of equal width in the argument `s` of [`Contraction::distance`]. `s` is 0 at the
    /// ray's point nearest to the contraction's centre.
    Contracted,
}

/// The part of a ray that is sampled.
pub(crate) struct Span {
    /// The ray, with its origin moved to the point from which the samples' distances are measured.
    pub ray: Ray,
    /// Distance along the ray from the original to the moved origin, world units; added to distances that are output.
    pub start: f32,
    /// Index range of the bins that may contain a sample.
    pub bins: Range<u32>,
    /// Cuts of the first and the last bin at the limits of the sampled part.
    pub ends: Ends,
}

/// Largest rounding error of a point on a ray, divided by the distance of the point along the ray. Covers the errors of
/// [`SceneBox::clip`] and of `Ray::at`.
const ROUNDING: f32 = 4.0 * f32::EPSILON;

impl Span {
    /// Returns the part of `ray` that is sampled: inside the box `around` and between the two distances in `range`
    /// ([`Plan::range_of`]). `None` if the part is empty.
    ///
    /// Moves the ray's origin to the box (with a contraction: to the ray's point nearest to the centre), so that
    /// distances of samples are small. Does not move the origin for [`Lattice::Own`], nor for [`Lattice::Extended`] if
    /// the bins already cover the ray's part inside the box.
    pub fn new(plan: &Plan<'_>, around: &SceneBox, ray: &Ray, range: [f32; 2]) -> Option<Self> {
        if range[0] >= range[1] {
            return None;
        }
        if let Some(contraction) = &plan.contraction {
            let Ray { origin, dir } = ray;
            return Spans::contracted(plan, contraction, origin.to_array(), dir.to_array(), range).span(ray);
        }
        let bins = plan.marched_bins();
        // With a proposal network the range cuts the drawn samples, not the bins.
        let (t_min, t_max) = if plan.proposal.is_some() { (0.0, f32::MAX) } else { range.into() };
        let (near, far) = match plan.lattice {
            Lattice::Own => (plan.near.max(t_min), plan.far.min(t_max)),
            Lattice::Extended | Lattice::March | Lattice::Contracted => (t_min, t_max),
        };
        // If the range cuts a bin short, the bin's sample may lie outside of the range.
        let margin = if plan.lattice == Lattice::March { 0.0 } else { bins.delta() };
        let (enter, exit) = around.clip(ray, near - margin, far + margin)?;
        let (origin, start, end) = match plan.lattice {
            Lattice::Own | Lattice::Contracted => (ray.origin, 0.0, f32::MAX),
            Lattice::Extended => {
                let start = bins.shift(enter, exit);
                (ray.at(start), start, f32::MAX)
            }
            Lattice::March => {
                // Clips again, from a point next to the box, since the first result's error grows with the distance.
                let beside = Ray { origin: ray.at(enter), ..*ray };
                let (first, last) = plan.bounds.clip(&beside, near - enter, f32::MAX)?;
                (beside.at(first), enter + first, last - first)
            }
        };
        let slack = ROUNDING * start.abs();
        let seen = bins.overlapping(enter - start - slack, exit - start + slack);
        let (Bins { ends, .. }, own) = bins.cut(near - start, end, far - start);
        let bins = seen.start.max(own.start)..seen.end.min(own.end);
        Some(Span { ray: Ray { origin, ..*ray }, start, bins, ends })
    }
}

/// One value for each of up to [`MAX_LANES`] rays.
type Row = [f32; MAX_LANES];

/// The sampled parts ([`Span`]) of up to [`MAX_LANES`] rays. `Spans<V>` has one ray in each lane of a vector.
pub(crate) struct Spans<T = Row> {
    origin: [T; 3],
    start: T,
    /// Index of the first bin and index after the last bin of each ray; an empty range if nothing is sampled.
    bins: [T; 2],
    /// Cuts of each ray's first and last bin, in the order of [`Ends::parts`].
    ends: [T; Ends::PARTS],
}

impl<V: Lanes> Spans<V> {
    /// Computes the sampled parts of a vector of rays through a bounded scene, as [`Span::new`] does for one ray.
    /// `t_min` and `t_max`: nearest and farthest visible distance along each ray, world units.
    #[inline(always)]
    fn new(plan: &Plan<'_>, around: &SceneBox, origin: [V; 3], dir: [V; 3], [t_min, t_max]: [V; 2]) -> Self {
        if let Some(contraction) = &plan.contraction {
            return Self::contracted(plan, contraction, origin, dir, [t_min, t_max]);
        }
        let (zero, bins, most) = (V::splat(0.0), plan.marched_bins(), V::splat(f32::MAX));
        let (near, far) = match plan.lattice {
            Lattice::Own => (V::splat(plan.near).max_of(t_min), V::splat(plan.far).min_of(t_max)),
            Lattice::Extended | Lattice::March | Lattice::Contracted => (t_min, t_max),
        };
        let margin = V::splat(if plan.lattice == Lattice::March { 0.0 } else { bins.delta() });
        let (enter, exit, mut meets) = around.clip_lanes(origin, dir, near.sub(margin), far.add(margin));
        let (origin, start, end) = match plan.lattice {
            Lattice::Own | Lattice::Contracted => (origin, zero, most),
            Lattice::Extended => {
                let start = bins.shift(enter, exit);
                (along(origin, dir, start), start, most)
            }
            Lattice::March => {
                let beside = along(origin, dir, enter);
                let (first, last, again) = plan.bounds.clip_lanes(beside, dir, near.sub(enter), most);
                meets = meets.mul(again);
                (along(beside, dir, first), enter.add(first), last.sub(first))
            }
        };
        let slack = V::splat(ROUNDING).mul(start.abs());
        let seen = bins.overlapping_lanes(enter.sub(start).sub(slack), exit.sub(start).add(slack));
        let (ends, own) = bins.cut_lanes(near.sub(start), end, far.sub(start));
        let meets = V::select(t_min.less(t_max), meets, zero);
        let last = V::select(zero.less(meets), seen[1].min_of(own[1]), zero);
        Self { origin, start, bins: [seen[0].max_of(own[0]), last], ends }
    }

    /// Computes the sampled parts of a vector of rays through an unbounded scene. `from`: the rays' origins.
    ///
    /// The part begins at [`Plan::near`] or at `t_min`, whichever is farther. The part ends at [`Plan::far`] or at
    /// `t_max`, whichever is nearer. `far` is a distance from the ray's point nearest to the contraction's centre;
    /// `near`, `t_min` and `t_max` are distances from the ray's origin.
    #[inline(always)]
    fn contracted(
        plan: &Plan<'_>,
        contraction: &Contraction,
        from: [V; 3],
        dir: [V; 3],
        [t_min, t_max]: [V; 2],
    ) -> Self {
        let (zero, last) = (V::splat(0.0), V::splat(plan.far));
        let start = contraction.nearest(from, dir);
        let origin = along(from, dir, start);
        // 0 if all values are finite, else NaN. The origin overflows if the ray begins near the largest f32.
        let mut finite = zero;
        for axis in 0..3 {
            for x in [from[axis], dir[axis], origin[axis]] {
                finite = finite.add(x.sub(x));
            }
        }
        let enter = contraction.step_at(V::splat(plan.near).max_of(t_min).sub(start));
        let far = V::splat(contraction.step_at(plan.far));
        let stop = t_max.sub(start);
        let stop = V::select(stop.less(last), contraction.step_at(stop), far);
        let (ends, [first, end]) = plan.bins.cut_lanes(enter, far, stop);
        let end = V::select(enter.less(far.min_of(stop)), end, zero);
        Self { origin, start, bins: [first, V::select(finite.equals(zero), end, zero)], ends }
    }
}

impl Spans {
    pub const NONE: Self = Self {
        origin: [[0.0; MAX_LANES]; 3],
        start: [0.0; MAX_LANES],
        bins: [[0.0; MAX_LANES]; 2],
        ends: [[0.0; MAX_LANES]; Ends::PARTS],
    };

    /// Returns the sampled part of ray `i`; `None` if nothing is sampled. `ray`: element `i` of [`SpanAll::rays`].
    #[inline]
    pub fn of(&self, i: usize, ray: &Ray) -> Option<Span> {
        let at = |row: &Row| row[i % MAX_LANES];
        let bins = [at(&self.bins[0]), at(&self.bins[1])];
        // Copies field by field, since `map` on an array compiles to a function call.
        let ([x, y, z], [start, low, high, far, stop]) = (&self.origin, &self.ends);
        let ends = [at(start), at(low), at(high), at(far), at(stop)];
        Spans { origin: [at(x), at(y), at(z)], start: at(&self.start), bins, ends }.span(ray)
    }
}

impl Spans<f32> {
    /// Returns the sampled part of `ray`, which the values were computed from; `None` if nothing is sampled.
    #[inline]
    fn span(self, ray: &Ray) -> Option<Span> {
        let Self { origin, start, bins: [first, end], ends: [from, low, high, far, stop] } = self;
        let ray = Ray { origin: Vec3::from_array(origin), ..*ray };
        let (bins, ends) = (first as u32..end as u32, Ends { start: from, low, high, far, stop });
        (bins.start < bins.end).then_some(Span { ray, start, bins, ends })
    }
}

/// Operation that computes [`Span::new`] for up to [`MAX_LANES`] rays at once, with bit-identical results. For scenes
/// without a proposal network.
pub(crate) struct SpanAll<'a> {
    pub plan: &'a Plan<'a>,
    pub around: &'a SceneBox,
    pub rays: &'a [Ray],
    /// Nearest and farthest visible distance of each ray, world units ([`Plan::range_of`]).
    pub ranges: &'a [Row; 2],
    pub to: &'a mut Spans,
}

impl Op for SpanAll<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { plan, around, to, .. } = self;
        let (mut origins, mut dirs) = ([[0.0; MAX_LANES]; 3], [[0.0; MAX_LANES]; 3]);
        for (i, ray) in self.rays.iter().enumerate().take(MAX_LANES) {
            let (origin, dir) = (ray.origin.to_array(), ray.dir.to_array());
            for axis in 0..3 {
                (origins[axis][i], dirs[axis][i]) = (origin[axis], dir[axis]);
            }
        }
        for from in (0..self.rays.len().min(MAX_LANES)).step_by(V::COUNT) {
            let load = |rows: &[Row; 3]| rows.each_ref().map(|row| V::load(&row[from..]));
            let range = self.ranges.each_ref().map(|row| V::load(&row[from..]));
            let Spans { origin, start, bins, ends } =
                Spans::<V>::new(plan, around, load(&origins), load(&dirs), range);
            let rows = to.origin.iter_mut().chain([&mut to.start]).chain(&mut to.bins).chain(&mut to.ends);
            let values = origin.into_iter().chain([start]).chain(bins).chain(ends);
            for (row, value) in rows.zip(values) {
                value.store(&mut row[from..]);
            }
        }
    }
}
