//! The interval of a ray that a sample represents, and the sample's point in space.

use super::{Bins, Ends};
use crate::simd::Lanes;
use crate::space::Contraction;

/// The interval of a ray over which a sample's density is taken as constant, world units along the ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SampleInterval<V = f32> {
    /// Distance of the sample; may differ from the middle `mid` of the interval.
    pub t: V,
    pub mid: V,
    pub delta: V,
}

/// Spacing of the samples along a ray: bins of equal width, in world units or, with a contraction, in the position `s`
/// that [`Contraction::distance`] converts to a distance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spacing<'a> {
    pub bins: &'a Bins,
    /// Contraction of an unbounded scene; `None` in a bounded scene.
    pub contraction: Option<&'a Contraction>,
}

impl Spacing<'_> {
    /// Returns the point of a ray at `t`, in the space of the network's inputs. `t` is a distance in world units or,
    /// with a contraction, the position `s` that [`Contraction::distance`] converts to a distance.
    #[inline(always)]
    pub fn point<V: Lanes>(&self, origin: [V; 3], dir: [V; 3], t: V) -> [V; 3] {
        match self.contraction {
            Some(contraction) => {
                contraction.contract_lanes(along(origin, dir, contraction.distance_lanes(t)))
            }
            None => along(origin, dir, t),
        }
    }

    /// Returns the interval of the sample at `t`. `t`: unit as in [`Spacing::point`]. `ends`: cuts of the ray's first
    /// and last bin, in the order of [`Ends::parts`]. `near`: least distance of a sample from the point at which `t` is
    /// 0, world units; used only in an unbounded scene.
    #[inline(always)]
    pub fn interval<V: Lanes>(&self, ends: [V; Ends::PARTS], near: V, t: V) -> SampleInterval<V> {
        if self.contraction.is_some() {
            let [t, from, to] = self.edges(ends, near, t);
            let delta = to.sub(from);
            // `mid` is computed from `delta`, since `from + to` may overflow f32 in the last bin.
            return SampleInterval { t, mid: from.add(V::splat(0.5).mul(delta)), delta };
        }
        let [_, low, high, ..] = ends;
        let cut = self.interval_of_cut(ends, t);
        let (first, not_last) = (t.less(low), t.less(high));
        let if_cut = |whole: V, cut: V| V::select(first, cut, V::select(not_last, whole, cut));
        SampleInterval {
            t: if_cut(t, cut.t),
            mid: if_cut(t, cut.mid),
            delta: if_cut(V::splat(self.bins.delta()), cut.delta),
        }
    }

    /// Returns the interval of a sample in a cut bin of a bounded scene. `t`: distance of the sample. Only a ray's
    /// first and last bin may be cut; for samples in bins without a cut, the result is wrong. `ends`: as in
    /// [`Spacing::interval`].
    #[inline(always)]
    pub fn interval_of_cut<V: Lanes>(&self, ends: [V; Ends::PARTS], t: V) -> SampleInterval<V> {
        let [start, low, high, _, stop] = ends;
        let (from, to) = (V::select(t.less(low), start, high), V::select(t.less(high), low, stop));
        let delta = to.sub(from);
        SampleInterval { t: t.max_of(from).min_of(to), mid: from.add(V::splat(0.5).mul(delta)), delta }
    }

    /// Returns three distances along the ray, world units: that of the sample at `t`, the beginning of the sample's
    /// interval, and the end of this interval. `ends`, `near` and `t`: as in [`Spacing::interval`]. Neighbouring
    /// intervals share their ends bit for bit.
    #[inline(always)]
    pub fn edges<V: Lanes>(&self, ends: [V; Ends::PARTS], near: V, t: V) -> [V; 3] {
        let [t, from, to] = self.bins.edges_around(ends, t);
        match self.contraction {
            // Rounding of a position `s` changes its distance: at a thousand radii, by 1e-4 of the distance. Distances
            // are clamped to `near`.
            Some(contraction) => {
                let from = contraction.distance_lanes(from).max_of(near);
                let to = contraction.distance_lanes(to).max_of(from);
                [contraction.distance_lanes(t).max_of(near), from, to]
            }
            None => [t, from, to],
        }
    }
}

/// Returns x, y and z of the points at distance `t` along the rays, one ray per lane.
#[inline(always)]
pub(crate) fn along<V: Lanes>(origin: [V; 3], dir: [V; 3], t: V) -> [V; 3] {
    let mut points = [t; 3];
    for axis in 0..3 {
        points[axis] = origin[axis].add(dir[axis].mul(t));
    }
    points
}
