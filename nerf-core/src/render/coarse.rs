//! A coarse occupancy grid: which packets of rays pass no occupied cell, and where those begin that do.

use super::window::points_at;
use crate::camera::{Ray, SceneBox};
use crate::plan::{Lattice, Plan};
use crate::sampling::OccupancyGrid;
use crate::simd::{Isa, LANES, Lanes, Op, VECTORS};
use glam::Vec3;

#[cfg(test)]
mod tests;

/// Bytes of a grid's bits; without vectors none is made.
const BYTES: usize = if VECTORS { 4096 } else { 0 };
/// Cells of the occupancy grid along each side of a block, unless there would be too many blocks.
const SIDE: u16 = 4;
/// What rounding may move a point by, in cells.
const SLACK: f32 = 0.5;

/// Blocks of an occupancy grid's cells that hold, or have a neighbour that holds, an occupied one.
#[derive(Clone, Debug)]
pub(crate) struct CoarseOccupancy {
    bits: [u8; BYTES],
    /// Cells along each side of a block; 0 where there are no blocks.
    side: u16,
}

impl CoarseOccupancy {
    const NONE: Self = Self { bits: [0; BYTES], side: 0 };

    /// The blocks of a scene's `occupancy`.
    pub fn new(occupancy: Option<&OccupancyGrid<'_>>) -> Self {
        let mut coarse = Self::NONE;
        let Some(occupancy) = occupancy.filter(|_| VECTORS) else { return coarse };
        let blocks = |side| occupancy.blocks(side).map(usize::from).iter().product::<usize>();
        let Some(side) = (SIDE..=SIDE << 9).find(|&side| blocks(side) <= 8 * BYTES) else { return coarse };
        coarse.side = side;
        occupancy.mark_blocks(side, &mut coarse.bits);
        dilate(&mut coarse.bits, occupancy.blocks(side).map(usize::from));
        coarse
    }

    /// How packets of rays are looked up in it for frames of `plan`; `None` where its samples do not lie along them.
    pub(super) fn packets<'c>(&'c self, plan: &Plan<'c>, around: Option<SceneBox>) -> Option<Packets<'c>> {
        let straight = plan.lattice != Lattice::Contracted && plan.proposal.is_none();
        if straight { self.packets_of(plan.occupancy.as_ref()?, around?) } else { None }
    }

    /// The same of the `occupancy` it was made of; `around`: a box around all occupied cells.
    fn packets_of<'c>(&'c self, occupancy: &OccupancyGrid<'c>, around: SceneBox) -> Option<Packets<'c>> {
        if !VECTORS || self.side == 0 {
            return None;
        }
        let reach = (f32::from(self.side) - SLACK) / occupancy.cells_per_unit().max_element();
        Some(Packets {
            blocks: occupancy.of_blocks(self.side, &self.bits),
            around: SceneBox { min: around.min - reach, max: around.max + reach },
            reach,
        })
    }
}

/// Sets each block that has a neighbour that is set.
fn dilate(bits: &mut [u8], [nx, ny, nz]: [usize; 3]) {
    let axes = [(ny * nz, nx), (nz, ny), (1, nz)];
    for (stride, side) in axes {
        // What was set behind the block at hand, before this axis: each row is walked once.
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

/// How packets of rays are looked up in a [`CoarseOccupancy`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Packets<'c> {
    blocks: OccupancyGrid<'c>,
    /// A box around all occupied cells, wider than that by `reach` on every side.
    around: SceneBox,
    /// How far from an empty block no cell is occupied, along each axis; world units.
    reach: f32,
}

impl Packets<'_> {
    /// Where along some rays occupied cells may be, from one distance to another; `None` if nowhere.
    ///
    /// The mean of the rays is looked up at [`POINTS`] points, each of which stands for all rays around it.
    pub fn range_of(&self, isa: Isa, rays: &[Ray]) -> Option<(f32, f32)> {
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
        // No ray is longer where it leaves the box, and none farther from the mean.
        let SceneBox { min, max } = self.around;
        let farthest = (0.5 * (min + max) - mean.origin).length() + 0.5 * (max - min).length();
        let aside = apart + turned * farthest * LENGTH;
        // A ray that is no number leaves none of the mean's.
        if aside > self.reach || !(mean.origin.is_finite() && mean.dir.is_finite()) {
            return Some((0.0, f32::MAX));
        }
        // Whatever of a ray lies around occupied cells, the mean is near to that.
        let (near, far) = self.around.clip(&mean, 0.0, f32::MAX)?;
        let step = (far - near) / POINTS as f32;
        let rounding = 8.0 * f32::EPSILON * (mean.origin.abs().max_element() + far);
        if aside + 0.5 * step + rounding > self.reach {
            return Some((0.0, f32::MAX));
        }
        let found = isa.run(LookUp { packets: self, ray: &mean, near, step });
        if found == 0 {
            return None;
        }
        let (first, last) = (found.trailing_zeros(), 63 - found.leading_zeros());
        Some((near + first as f32 * step - rounding, near + (last + 1) as f32 * step + rounding))
    }
}

/// More than the inverse length of a direction, which is 1 within 1e-3.
const LENGTH: f32 = 1.002;
/// Points that a packet of rays is looked up at.
const POINTS: u32 = 64;

/// Which of the [`POINTS`] stretches of `step` from `near` on may hold something; bit 0 is the first.
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
        let mut found = 0;
        for first in (0..POINTS).step_by(V::COUNT) {
            let i = V::splat(first as f32).add(V::load(&LANES)).add(half);
            let points = points_at(self.ray, near.add(i.mul(step)));
            found |= u64::from(self.packets.blocks.occupied_lanes(points)) << first;
        }
        found
    }
}
