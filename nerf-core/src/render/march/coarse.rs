//! Coarse occupancy grid, for skipping empty space. A packet is a group of neighbouring rays. If all cells along a
//! packet are empty, all rays of the packet are skipped. In other packets, empty intervals along the rays are skipped.

use crate::camera::Ray;
use crate::plan::{Lattice, Plan};
use crate::sampling::{Bins, OccupancyGrid, along};
use crate::simd::{Isa, LANES, Lanes, Op, VECTORS};
use crate::space::SceneBox;
use glam::Vec3;

#[cfg(test)]
mod tests;

/// Size of [`CoarseOccupancy::bits`], bytes; 0 in builds without SIMD vectors.
const BYTES: usize = if VECTORS { 4096 } else { 0 };
/// Least number of cells of the occupancy grid along each side of a block. The blocks of a large grid have more cells,
/// so that the bits of all blocks fit in [`BYTES`].
const SIDE: u16 = 4;
/// Upper bound of the distance by which rounding moves a looked-up point, in cells of the occupancy grid.
const SLACK: f32 = 0.5;

/// Coarse copy of an occupancy grid: a box around all occupied cells, and one bit for each block of cells.
#[derive(Clone, Debug)]
pub(crate) struct CoarseOccupancy {
    pub(in crate::render) around: Option<SceneBox>,
    /// One bit per block of cells: 1 if the block or a neighbouring block has an occupied cell.
    bits: [u8; BYTES],
    /// Number of cells along each side of a block; 0 if there are no blocks.
    side: u16,
}

impl CoarseOccupancy {
    /// Computes the box around the occupied cells of `occupancy`, and the bits of the blocks.
    pub fn new(occupancy: Option<&OccupancyGrid<'_>>) -> Self {
        let around = occupancy.and_then(|occupancy| occupancy.occupied_box());
        let mut coarse = Self { around, bits: [0; BYTES], side: 0 };
        let Some(occupancy) = occupancy.filter(|_| VECTORS) else { return coarse };
        let blocks = |side| occupancy.blocks(side).map(usize::from).iter().product::<usize>();
        let Some(side) = (SIDE..=SIDE << 9).find(|&side| blocks(side) <= 8 * BYTES) else { return coarse };
        coarse.side = side;
        occupancy.mark_blocks(side, &mut coarse.bits);
        dilate(&mut coarse.bits, occupancy.blocks(side).map(usize::from));
        coarse
    }

    /// Returns the packet test for frames of `plan`. Returns `None` if the plan has a contraction, a proposal network
    /// or no occupancy grid, if no cell is occupied, or if `self` has no blocks.
    pub(in crate::render) fn packets<'c>(&'c self, plan: &Plan<'c>) -> Option<Packets<'c>> {
        let straight = plan.lattice != Lattice::Contracted && plan.proposal.is_none();
        if straight { self.packets_of(plan.occupancy.as_ref()?) } else { None }
    }

    /// Returns the packet test of `occupancy`, which `self` was made from. `None` without blocks or occupied cells.
    fn packets_of<'c>(&'c self, occupancy: &OccupancyGrid<'c>) -> Option<Packets<'c>> {
        let around = self.around.filter(|_| VECTORS && self.side > 0)?;
        let reach = (f32::from(self.side) - SLACK) / occupancy.cells_per_unit.max_element();
        Some(Packets {
            blocks: occupancy.of_blocks(self.side, &self.bits),
            around: SceneBox { min: around.min - reach, max: around.max + reach },
            reach,
        })
    }
}

/// Sets the bit of each block that touches a block with a set bit, also at a corner. `[nx, ny, nz]`: numbers of blocks.
fn dilate(bits: &mut [u8], [nx, ny, nz]: [usize; 3]) {
    let axes = [(ny * nz, nx), (nz, ny), (1, nz)];
    for (stride, side) in axes {
        // Each row is visited once. `before`, `here`: whether the previous and the current block were set before this
        // axis was dilated.
        for row in (0..nx * ny * nz).filter(|at| at / stride % side == 0) {
            let mut before = false;
            for i in 0..side {
                let at = row + i * stride;
                let here = bit(bits, at);
                let after = i + 1 < side && bit(bits, at + stride);
                if before || after {
                    set(bits, at);
                }
                before = here;
            }
        }
    }
}

fn bit(bits: &[u8], at: usize) -> bool {
    bits.get(at / 8).is_some_and(|byte| byte >> (at % 8) & 1 == 1)
}

pub(crate) fn set(bits: &mut [u8], at: usize) {
    if let Some(byte) = bits.get_mut(at / 8) {
        *byte |= 1 << (at % 8);
    }
}

/// Test of packets of neighbouring rays against the coarse grid: finds the distances at which occupied cells may lie.
#[derive(Clone, Copy, Debug)]
pub(in crate::render) struct Packets<'c> {
    blocks: OccupancyGrid<'c>,
    /// Box around all occupied cells, enlarged by `reach` on every side.
    around: SceneBox,
    /// Half the side, world units, of the cube that one lookup covers. The looked-up point is the centre of the cube.
    /// If the bit of the point's block is 0, all cells in the cube are empty.
    reach: f32,
}

impl Packets<'_> {
    /// Returns the intervals of distance along `rays` in which occupied cells may lie. Returns `None` if all cells
    /// along the rays are empty.
    ///
    /// Looks up [`INTERVALS`] points of the mean ray in the coarse grid. One lookup covers one interval of all rays.
    /// Returns [`Intervals::ALL`] if the rays are too far apart or an interval is too long for one lookup, or if
    /// rounding errors are too large.
    pub fn intervals_of(&self, isa: Isa, rays: &[Ray]) -> Option<Intervals> {
        let share = 1.0 / rays.len() as f32;
        let (mut origin, mut dir) = (Vec3::ZERO, Vec3::ZERO);
        for ray in rays {
            origin += ray.origin;
            dir += ray.dir;
        }
        let mean = Ray { origin: origin * share, dir: dir * share };
        let (mut apart, mut turned) = (0.0f32, 0.0f32);
        for ray in rays {
            apart = apart.max((ray.origin - mean.origin).abs().max_element());
            turned = turned.max((ray.dir - mean.dir).abs().max_element());
        }
        // `farthest`: upper bound of the distance at which a ray leaves the box. `aside`: upper bound, along each axis,
        // of the distance between a ray and the mean ray inside the box.
        let SceneBox { min, max } = self.around;
        let farthest = (0.5 * (min + max) - mean.origin).length() + 0.5 * (max - min).length();
        let aside = apart + turned * farthest * LENGTH;
        // A ray that is not finite makes the mean not finite.
        if aside > self.reach || !(mean.origin.is_finite() && mean.dir.is_finite()) {
            return Some(Intervals::ALL);
        }
        // The box is enlarged by `reach`: where a ray passes occupied cells, the mean ray is inside of the box.
        let (near, far) = self.around.clip(&mean, 0.0, f32::MAX)?;
        let step = (far - near) / INTERVALS as f32;
        let rounding = 8.0 * f32::EPSILON * (mean.origin.abs().max_element() + far);
        if aside + 0.5 * step + rounding > self.reach || rounding > MOST_ROUNDING * step {
            return Some(Intervals::ALL);
        }
        let found = isa.run(LookUp { packets: self, ray: &mean, near, step });
        (found != 0).then_some(Intervals { found: found | found << 1 | found >> 1, near, step })
    }
}

/// Intervals of distance along the rays of a packet, each marked if occupied cells may lie in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::render) struct Intervals {
    /// Bit `i`: whether occupied cells may lie in interval `i` or in a neighbouring interval. Interval `i` begins at
    /// `near + i · step`.
    found: u64,
    near: f32,
    /// Width of an interval, world units along the rays; +∞ in [`Intervals::ALL`].
    step: f32,
}

impl Intervals {
    /// Intervals for a packet of which nothing is known: occupied cells may lie in every interval.
    pub const ALL: Self = Self { found: u64::MAX, near: 0.0, step: f32::INFINITY };
}

/// Bins of a ray that may have a sample in an occupied cell: the [`Intervals`] of the ray's packet, converted to bins.
#[derive(Clone, Copy, Debug)]
pub(in crate::render) struct CandidateBins {
    found: u64,
    /// Distance, in interval widths, from the start of the first interval to the middle of bin 0.
    first: f32,
    /// Bin width divided by interval width; 0 if all bins are candidates.
    per_bin: f32,
    /// Interval width divided by bin width; 0 if all bins are candidates.
    bins: f32,
}

impl CandidateBins {
    pub const ALL: Self = Self { found: u64::MAX, first: 0.0, per_bin: 0.0, bins: 0.0 };

    /// Finds the bins among `bins` that overlap intervals in which occupied cells may lie. `start`: distance along the
    /// ray, world units, of the point from which the distances of `bins` are counted.
    #[inline]
    pub fn new(intervals: &Intervals, bins: &Bins, start: f32) -> Self {
        let Intervals { found, near, step } = *intervals;
        let per_bin = bins.delta() / step;
        // A sample is at most half a bin from the middle of its bin. If the bin is short enough, the sample is in the
        // interval of that middle or in a neighbouring interval.
        if !(per_bin > 0.0 && 0.5 * per_bin + MOST_ROUNDING <= 1.0) {
            return Self::ALL;
        }
        let first = (bins.distance(0.5) + (start - near)) / step;
        Self { found, first, per_bin, bins: step / bins.delta() }
    }

    /// Returns the index of the first bin, at or after `bin`, that may have a sample in an occupied cell; the largest
    /// `u32` if there is none.
    #[inline]
    pub fn next(&self, bin: u32) -> u32 {
        // The cast saturates. Rounding may put a bin just behind the last interval.
        let at = ((self.first + bin as f32 * self.per_bin) as u32).min(INTERVALS - 1);
        match (self.found >> at).trailing_zeros() {
            0 => bin,
            64 => u32::MAX,
            more => bin.max((((at + more) as f32 - self.first) * self.bins) as u32),
        }
    }

    /// Returns an upper bound, exclusive, of the indices of candidate bins; the largest `u32` if no bound is known.
    #[inline]
    pub fn end(&self) -> u32 {
        let intervals = 64 - self.found.leading_zeros();
        if self.per_bin == 0.0 || intervals == INTERVALS {
            return u32::MAX;
        }
        (((intervals as f32 - self.first) * self.bins) as u32).saturating_add(2)
    }
}

/// Upper bound of 1 / length of a ray's direction. A direction is accepted if its squared length is within 1e-3 of 1.
const LENGTH: f32 = 1.002;
/// Number of equal intervals into which the path of a packet through the box [`Packets::around`] is divided. The coarse
/// grid is looked up at the middle of each interval.
const INTERVALS: u32 = 64;
/// Largest accepted rounding error of a distance along the ray, in interval widths. If the error may be larger, all
/// intervals are treated as possibly occupied.
const MOST_ROUNDING: f32 = 0.25;

/// Vector loop that looks up the middles of [`INTERVALS`] intervals of `ray` in the coarse grid; interval `i` begins at
/// distance `near + i · step`. Output bit `i`: whether occupied cells may lie in interval `i`.
struct LookUp<'a> {
    packets: &'a Packets<'a>,
    ray: &'a Ray,
    near: f32,
    step: f32,
}

impl Op for LookUp<'_> {
    type Output = u64;

    #[inline(always)]
    fn run<V: Lanes>(self) -> u64 {
        let (near, step, half) = (V::splat(self.near), V::splat(self.step), V::splat(0.5));
        let (blocks, mut found) = (self.packets.blocks.lanes::<V>(), 0);
        for first in (0..INTERVALS).step_by(V::COUNT) {
            let i = V::splat(first as f32).add(V::load(&LANES)).add(half);
            let points = points_at(self.ray, near.add(i.mul(step)));
            found |= u64::from(blocks.occupied::<false>(points)) << first;
        }
        found
    }
}

/// Returns x, y and z of the points of `ray` at the distances `t`, one point per SIMD lane.
#[inline(always)]
pub(super) fn points_at<V: Lanes>(ray: &Ray, t: V) -> [V; 3] {
    let (mut origin, mut dir) = ([t; 3], [t; 3]);
    for axis in 0..3 {
        (origin[axis], dir[axis]) =
            (V::splat(ray.origin.to_array()[axis]), V::splat(ray.dir.to_array()[axis]));
    }
    along(origin, dir, t)
}
