//! [`Plan::span`] of several rays at once, bit for bit.

use super::Plan;
use super::span::{Lattice, ROUNDING, Span};
use crate::camera::Ray;
use crate::sampling::Ends;
use crate::simd::{Lanes, MAX_LANES, Op};
use crate::space::SceneBox;
use glam::Vec3;

#[cfg(test)]
mod tests;

/// One value for each ray of a vector.
type Row = [f32; MAX_LANES];

/// The parts of up to [`MAX_LANES`] rays that are sampled.
pub(crate) struct Spans {
    origin: [Row; 3],
    start: Row,
    /// The first bin and the end of them, which is not behind that where nothing is sampled.
    bins: [Row; 2],
    ends: [Row; Ends::PARTS],
}

impl Spans {
    pub const NONE: Self = Self {
        origin: [[0.0; MAX_LANES]; 3],
        start: [0.0; MAX_LANES],
        bins: [[0.0; MAX_LANES]; 2],
        ends: [[0.0; MAX_LANES]; Ends::PARTS],
    };

    /// That of `ray`, which is number `i`.
    #[inline]
    pub fn of(&self, i: usize, ray: &Ray) -> Option<Span> {
        let at = |row: &Row| row[i % MAX_LANES];
        let bins = at(&self.bins[0]) as u32..at(&self.bins[1]) as u32;
        // `map` of an array is a call.
        let ([x, y, z], [start, low, high, far, stop]) = (&self.origin, &self.ends);
        let ray = Ray { origin: Vec3::new(at(x), at(y), at(z)), ..*ray };
        let ends = Ends::of_parts([at(start), at(low), at(high), at(far), at(stop)]);
        (bins.start < bins.end).then_some(Span { ray, start: at(&self.start), bins, ends })
    }
}

/// Works out the spans of rays through a scene with an end, without a proposal.
pub(crate) struct SpanAll<'a> {
    pub plan: &'a Plan<'a>,
    pub around: &'a SceneBox,
    pub rays: &'a [Ray],
    /// [`Plan::range_of`] of each.
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
            let (origin, start, bins, ends) = plan.span_lanes(around, load(&origins), load(&dirs), range);
            let rows = to.origin.iter_mut().chain([&mut to.start]).chain(&mut to.bins).chain(&mut to.ends);
            let values = origin.into_iter().chain([start]).chain(bins).chain(ends);
            for (row, value) in rows.zip(values) {
                value.store(&mut row[from..]);
            }
        }
    }
}

impl Plan<'_> {
    /// Origins, starts, bins and [`Ends::parts`].
    #[inline(always)]
    fn span_lanes<V: Lanes>(
        &self,
        around: &SceneBox,
        origin: [V; 3],
        dir: [V; 3],
        [t_min, t_max]: [V; 2],
    ) -> ([V; 3], V, [V; 2], [V; Ends::PARTS]) {
        let (zero, walk, most) = (V::splat(0.0), &self.bins, V::splat(f32::MAX));
        let at = |from: [V; 3], t: V| {
            let mut point = from;
            for (point, dir) in point.iter_mut().zip(dir) {
                *point = point.add(dir.mul(t));
            }
            point
        };
        let (near, far) = match self.lattice {
            Lattice::Own => (V::splat(self.near).max_of(t_min), V::splat(self.far).min_of(t_max)),
            Lattice::Extended | Lattice::March | Lattice::Contracted => (t_min, t_max),
        };
        let margin = V::splat(if self.lattice == Lattice::March { 0.0 } else { walk.delta() });
        let (enter, exit, mut hits) = around.clip_lanes(origin, dir, near.sub(margin), far.add(margin));
        let (origin, start, end) = match self.lattice {
            Lattice::Own | Lattice::Contracted => (origin, zero, most),
            Lattice::Extended => {
                let start = walk.shift_lanes(enter, exit);
                (at(origin, start), start, most)
            }
            Lattice::March => {
                let beside = at(origin, enter);
                let (first, last, again) = self.bounds.clip_lanes(beside, dir, near.sub(enter), most);
                hits = hits.mul(again);
                (at(beside, first), enter.add(first), last.sub(first))
            }
        };
        let slack = V::splat(ROUNDING).mul(start.abs());
        let seen = walk.overlapping_lanes(enter.sub(start).sub(slack), exit.sub(start).add(slack));
        let (ends, own) = walk.cut_lanes(near.sub(start), end, far.sub(start));
        let hits = V::select(t_min.less(t_max), hits, zero);
        let last = V::select(zero.less(hits), seen[1].min_of(own[1]), zero);
        (origin, start, [seen[0].max_of(own[0]), last], ends)
    }
}
