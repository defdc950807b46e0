//! Lookup of a ray's bins in the occupancy grid, sixteen bins at a time.

use super::coarse::{CandidateBins, points_at};
use crate::camera::Ray;
use crate::sampling::{Bins, OccupancyGrid, OccupancyLanes};
use crate::simd::Lanes;
use crate::space::Contraction;
use core::ops::Range;

#[cfg(test)]
mod tests;

const WIDTH: u32 = 16;

/// Occupancy of sixteen consecutive bins of a ray.
#[derive(Clone, Copy)]
pub(in crate::render) struct Window {
    /// Index of the first bin after the window.
    end: u32,
    /// Bit `i`: whether the sample of bin `end − 16 + i` is in an occupied cell.
    occupied: u32,
}

impl Window {
    pub const NONE: Self = Self { end: 0, occupied: 0 };

    /// Returns the index of the window's first occupied bin at or after bin `from`; `None` if there is no such bin.
    #[inline]
    pub fn left(&self, from: u32) -> Option<u32> {
        let left = if from < self.end { self.occupied >> (from + WIDTH - self.end) } else { 0 };
        (left != 0).then(|| from + left.trailing_zeros())
    }
}

/// Lookup of the bins of one ray: whether the middle of each bin is in an occupied cell.
pub(super) struct LookUp<'a> {
    pub occupancy: &'a OccupancyGrid<'a>,
    pub contraction: Option<&'a Contraction>,
    pub ray: &'a Ray,
    pub bins: &'a Bins,
    /// The bins to look up in the occupancy grid. All other bins are treated as empty.
    pub candidates: &'a CandidateBins,
    /// Whether all cells at the faces of the scene box are known to be empty. The lookup of a bin outside the box reads
    /// one of these cells. If `inner` is `true`, the bin is therefore found empty. If `inner` is `false`, a bin that is
    /// found occupied must also be tested against the box.
    pub inner: bool,
}

impl LookUp<'_> {
    /// Returns the index of the first bin in `from..end` whose middle is in an occupied cell; `end` if there is none.
    /// The result is the same as that of [`Plan::first_occupied`](crate::plan::Plan::first_occupied) without jitter.
    ///
    /// Between calls with the same `window`, `from` must not decrease and the bins must not change.
    #[inline(always)]
    pub fn first_occupied<V: Lanes>(
        &self,
        lanes: &OccupancyLanes<'_, V>,
        window: &mut Window,
        from: u32,
        end: u32,
    ) -> u32 {
        if let Some(bin) = window.left(from) {
            return end.min(bin);
        }
        let from = from.max(window.end);
        if from >= end {
            return end;
        }
        let kept = self.contraction.map_or(0..0, |contraction| self.bins.between(contraction.kept(self.ray)));
        let mut found = Window { end: from, occupied: 0 };
        while found.occupied == 0 && found.end < end {
            let from = self.candidates.next(found.end).min(end);
            let occupied = if from < end { self.occupied(lanes, from, &kept) } else { 0 };
            found = Window { end: from + WIDTH, occupied };
        }
        *window = found;
        end.min(found.end - WIDTH + found.occupied.trailing_zeros())
    }

    /// Looks up sixteen bins. Bit `i` of the result: whether the middle of bin `first + i` is in an occupied cell.
    /// `kept`: bins that the contraction keeps where they are.
    #[inline(always)]
    fn occupied<V: Lanes>(&self, lanes: &OccupancyLanes<'_, V>, first: u32, kept: &Range<u32>) -> u32 {
        let Self { occupancy, ray, bins, .. } = *self;
        let mut occupied = 0;
        let whole = bins.whole_up_to(first + WIDTH - 1);
        if let Some(contraction) = self.contraction {
            let kept = kept.start <= first && first + WIDTH <= kept.end;
            for from in (0..WIDTH).step_by(V::COUNT) {
                let t: V = bins.middles(first + from, whole);
                let found = if kept {
                    let points = points_at(ray, t.mul(V::splat(contraction.radius())));
                    lanes.occupied::<true>(contraction.kept_lanes(points))
                } else {
                    lanes.occupied::<false>(
                        contraction.contract_lanes(points_at(ray, contraction.distance_lanes(t))),
                    )
                };
                occupied |= found << from;
            }
            // No point is outside: the contraction maps all of space into the box.
            return occupied;
        }
        for from in (0..WIDTH).step_by(V::COUNT) {
            let points = points_at::<V>(ray, bins.middles(first + from, whole));
            occupied |= lanes.occupied::<false>(points) << from;
        }
        // A point outside the box is looked up in a cell at a face. If all these cells are empty, no bin needs
        // the test below.
        if occupied == 0 || self.inner {
            return occupied;
        }
        // Rounding preserves order: a point between two points inside the box is inside, too.
        let inside = |i: u32| occupancy.bounds.contains(ray.at(bins.at(first + i, 0.5)));
        if !(inside(0) && inside(WIDTH - 1)) {
            for i in 0..WIDTH {
                occupied &= !(u32::from(!inside(i)) << i);
            }
        }
        occupied
    }
}
