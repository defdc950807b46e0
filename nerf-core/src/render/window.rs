//! Sixteen bins of a ray at a time: which of them have their sample in an occupied cell.

use crate::kernels::{Op, Tier};
use crate::math::lanes::Lanes;
use crate::ray::Ray;
use crate::sampling::{Bins, OccupancyGrid};

/// Bins of a window.
const WIDTH: usize = 16;

/// What of a ray's bins has been looked up.
#[derive(Clone, Copy)]
pub(super) struct Window {
    /// The first bin behind it.
    end: u32,
    /// Its live bins; bit `i` is bin `end − 16 + i`.
    live: u32,
}

impl Window {
    /// Nothing has.
    pub const NONE: Self = Self { end: 0, live: 0 };

    /// The first live one of the bins `from..end`, or `end`; what [`OccupancyGrid::first_live`] says, bit for bit.
    ///
    /// `from` never falls from call to call, and the bins stay those of the first.
    #[inline]
    pub fn first_live(
        &mut self,
        tier: Tier,
        occupancy: &OccupancyGrid<'_>,
        ray: &Ray,
        bins: &Bins,
        from: u32,
        end: u32,
    ) -> u32 {
        // Beyond, vectors do not count by ones.
        if tier == Tier::Scalar || end > 1 << 22 {
            return occupancy.first_live(ray, bins, from, end);
        }
        let mut bin = from;
        while bin < end {
            if bin < self.end {
                let left = self.live >> (bin + WIDTH as u32 - self.end);
                if left != 0 {
                    return end.min(bin + left.trailing_zeros());
                }
                bin = self.end;
            } else {
                let live = tier.run(LookUp { occupancy, ray, bins, first: bin });
                *self = Self { end: bin + WIDTH as u32, live };
            }
        }
        end
    }
}

/// [`OccupancyGrid::occupied`] of the samples of a window that begins with bin `first`.
struct LookUp<'a> {
    occupancy: &'a OccupancyGrid<'a>,
    ray: &'a Ray,
    bins: &'a Bins,
    first: u32,
}

impl Op for LookUp<'_> {
    type Output = u32;

    #[inline(always)]
    fn run<V: Lanes>(self) -> u32 {
        let Self { occupancy, ray, bins, first } = self;
        let (origin, dir) = (ray.origin.to_array(), ray.dir.to_array());
        let mut live = 0;
        for from in (0..WIDTH).step_by(V::COUNT) {
            let t: V = bins.middles(first + from as u32);
            let mut points = [t; 3];
            for (axis, point) in points.iter_mut().enumerate() {
                *point = V::splat(origin[axis]).add(V::splat(dir[axis]).mul(t));
            }
            live |= occupancy.occupied_lanes(points) << from;
        }
        if live == 0 {
            return 0;
        }
        // Rounding keeps order: what lies between two points of the box is in it.
        let inside = |i: usize| occupancy.contains(ray.at(bins.at(first + i as u32, 0.5)));
        if !(inside(0) && inside(WIDTH - 1)) {
            for i in 0..WIDTH {
                live &= !(u32::from(!inside(i)) << i);
            }
        }
        live
    }
}
