//! March of one ray in training: its samples in occupied cells, sixteen tested at a time.

use crate::train::occupancy::OccupiedCells;
use glam::Vec3;
use nerf_core::camera::Ray;
use nerf_core::simd::{Indices, Lanes, Op};
use nerf_core::space::{Contraction, SceneBox};

/// Number of samples whose cells are tested together.
const GROUP: usize = 16;
/// Index of each sample within its group.
const IN_GROUP: [f32; GROUP] =
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];

/// Number of cells along each side of a block. The march skips empty blocks.
const BLOCK_SIDE: usize = 8;

/// Occupied cells of a scene box, and a coarse grid of blocks by which the march skips empty space.
#[derive(Clone, Debug)]
pub struct MarchCells {
    bounds: SceneBox,
    resolution: [u16; 3],
    /// Occupancy bit of each cell at index `(x ny + y) nz + z`, least significant bit of a byte first.
    bits: Vec<u8>,
    blocks: [u16; 3],
    /// One bit per block, in the order of `bits`: whether the block or a neighbouring block has an occupied cell.
    near: Vec<u8>,
}

impl MarchCells {
    pub fn new(cells: &OccupiedCells) -> Self {
        let (bits, resolution) = (cells.bits(), cells.resolution());
        let blocks = resolution.map(|side| side.div_ceil(BLOCK_SIDE as u16));
        let [nx, ny, nz] = resolution.map(usize::from);
        let [bx, by, bz] = blocks.map(usize::from);
        let mut live = vec![false; bx * by * bz];
        for (x, y) in (0..nx).flat_map(|x| (0..ny).map(move |y| (x, y))) {
            let (row, block) = ((x * ny + y) * nz, (x / BLOCK_SIDE * by + y / BLOCK_SIDE) * bz);
            for (z, live) in live[block..][..bz].iter_mut().enumerate() {
                let (first, count) = (row + z * BLOCK_SIDE, BLOCK_SIDE.min(nz - z * BLOCK_SIDE));
                let byte = |i: usize| u32::from(bits.get(first / 8 + i).copied().unwrap_or(0));
                *live |= (byte(0) | byte(1) << 8) >> (first % 8) & ((1 << count) - 1) != 0;
            }
        }
        // Extends occupied blocks by their neighbours, axis by axis: one block grows to 3 × 3 × 3.
        for (stride, side) in [(by * bz, bx), (bz, by), (1, bz)] {
            let before = live.clone();
            for (i, live) in live.iter_mut().enumerate() {
                let at = i / stride % side;
                *live |= at > 0 && before[i - stride] || at + 1 < side && before[i + stride];
            }
        }
        let near =
            live.chunks(8).map(|live| live.iter().rev().fold(0, |byte, &live| byte << 1 | u8::from(live)));
        Self { bounds: cells.bounds(), resolution, bits: bits.to_vec(), blocks, near: near.collect() }
    }

    pub fn bounds(&self) -> SceneBox {
        self.bounds
    }

    fn lookup(&self, ray: &Ray) -> Lookup<'_> {
        Lookup::new(&self.bits, self.resolution, self.resolution.map(f32::from), &self.bounds, ray)
    }

    /// Prepares lookups of `near`, the blocks' bits, at points of `ray`. The last blocks may extend beyond the box.
    fn block_lookup(&self, ray: &Ray) -> Lookup<'_> {
        let sides = self.resolution.map(|side| f32::from(side) / BLOCK_SIDE as f32);
        Lookup::new(&self.near, self.blocks, sides, &self.bounds, ray)
    }
}

struct Lookup<'a> {
    bits: &'a [u8],
    resolution: [u32; 3],
    last: [f32; 3],
    /// Origin of the ray in cells or blocks, minus one half: rounding a point gives the index of its cell or block.
    from: [f32; 3],
    along: [f32; 3],
}

impl<'a> Lookup<'a> {
    /// Prepares lookups of `bits`, one per cell or block, at points of `ray`. `resolution`: number of cells or blocks
    /// per axis. `sides`: lengths of the box's sides in cells or blocks; a length in blocks may be a fraction.
    fn new(bits: &'a [u8], resolution: [u16; 3], sides: [f32; 3], bounds: &SceneBox, ray: &Ray) -> Self {
        let scale = Vec3::from(sides) / (bounds.max - bounds.min);
        Self {
            bits,
            resolution: resolution.map(u32::from),
            last: resolution.map(|side| f32::from(side) - 1.0),
            from: ((ray.origin - bounds.min) * scale - 0.5).to_array(),
            along: (ray.dir * scale).to_array(),
        }
    }

    /// Looks up the occupancy of sixteen points of the ray. Bit `i` of the result is the occupancy of point `i`, which
    /// is at `t = first + (base + i) step`. For a point outside the box, the nearest cell is read.
    #[inline(always)]
    fn live<V: Lanes>(&self, first: f32, step: f32, base: u32) -> u32 {
        let mut live = 0;
        for from in (0..GROUP).step_by(V::COUNT) {
            let mut at = [group_distances::<V>(first, step, base, from); 3];
            for (axis, at) in at.iter_mut().enumerate() {
                *at = V::splat(self.from[axis]).add(at.mul(V::splat(self.along[axis])));
            }
            live |= occupied(self.bits, self.resolution, self.last, at) << from;
        }
        live
    }
}

/// Returns the distances `first + (base + i) step` of a group's samples `i` from `from` on, one per lane.
#[inline(always)]
fn group_distances<V: Lanes>(first: f32, step: f32, base: u32, from: usize) -> V {
    let number = V::splat(base as f32).add(V::load(&IN_GROUP[from..]));
    V::splat(first).add(number.mul(V::splat(step)))
}

/// Returns a mask with one bit per lane: whether the lane's point is in an occupied cell. `at`: the points in units of
/// cells, minus one half, so that rounding gives the cell's indices. `last`: largest index on each axis. A point outside
/// the box has the bit of the nearest cell.
#[inline(always)]
fn occupied<V: Lanes>(bits: &[u8], resolution: [u32; 3], last: [f32; 3], at: [V; 3]) -> u32 {
    let mut index = V::Indices::splat(0);
    for ((at, last), side) in at.into_iter().zip(last).zip(resolution) {
        let cell = at.max_of(V::splat(0.0)).min_of(V::splat(last)).round_even();
        index = index.mul(V::Indices::splat(side)).add(cell.to_indices());
    }
    V::bits(bits, index)
}

/// Returns the bit mask of the first `count` samples of a group; of all sixteen if `count` is larger.
#[inline(always)]
fn first_bits(count: u32) -> u32 {
    u32::MAX >> (32 - Ord::min(count, GROUP as u32))
}

/// Ray march in a bounded scene. Appends to `positions` the points of `ray` in occupied cells, at `t = first + i step`
/// for `i < count`. All points must be inside the box. A point on the face between two cells may be in either.
pub(super) struct March<'a> {
    pub cells: &'a MarchCells,
    pub ray: &'a Ray,
    pub first: f32,
    pub step: f32,
    pub count: u32,
    pub positions: &'a mut Vec<[f32; 3]>,
}

impl Op for March<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { cells, ray, first, step, count, positions } = self;
        let (origin, dir) = (ray.origin.to_array(), ray.dir.to_array());
        let (lookup, blocks) = (cells.lookup(ray), cells.block_lookup(ray));
        // Distance from the middle of a group to its ends, in cells. If it is less than a block, rounding included, the
        // block at the middle and its neighbours contain the whole group.
        let half = 0.5 * (GROUP - 1) as f32;
        let reach = lookup.along.iter().fold(0.0f32, |most, along| most.max(along.abs())) * half * step;
        let by_blocks = reach < BLOCK_SIDE as f32 - 0.5;
        let groups = count.div_ceil(GROUP as u32);
        for group in (0..groups).step_by(GROUP) {
            let mut near = first_bits(groups - group);
            if by_blocks {
                near &= blocks.live::<V>(first + half * step, GROUP as f32 * step, group);
            }
            while near != 0 {
                let base = (group + near.trailing_zeros()) * GROUP as u32;
                near &= near - 1;
                let mut live = lookup.live::<V>(first, step, base) & first_bits(count - base);
                while live != 0 {
                    let t = first + (base + live.trailing_zeros()) as f32 * step;
                    live &= live - 1;
                    positions.push(std::array::from_fn(|axis| origin[axis] + t * dir[axis]));
                }
            }
        }
    }
}

/// Ray march in an unbounded scene; see [`March`]. `ray`: moved by [`Contraction::centred`]. `start`: world-space
/// distance from the camera to the origin of `ray`. `first`, `step`: in units of `s` in [`Contraction::distance`].
///
/// Appends to `samples` contracted points, step lengths in world units, and factors on the samples' gradients. A factor
/// is the squared distance from the camera, in radii of the uncontracted ball, and at most 1. Without these factors,
/// the many rays through cells near a camera would produce floaters near the camera.
///
/// # Source
/// Philip and Deschaintre 2023, "Floaters No More".
pub(super) struct MarchContracted<'a> {
    pub cells: &'a MarchCells,
    pub contraction: &'a Contraction,
    pub ray: &'a Ray,
    pub first: f32,
    pub step: f32,
    pub count: u32,
    pub start: f32,
    pub samples: &'a mut Samples,
}

#[derive(Default)]
pub(super) struct Samples {
    pub positions: Vec<[f32; 3]>,
    pub deltas: Vec<f32>,
    pub gradient_scales: Vec<f32>,
    /// Position of each sample along its ray: `s` in [`Contraction::distance`], which converts it to a distance.
    pub steps: Vec<f32>,
}

impl Op for MarchContracted<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { cells, contraction, ray, first, step, count, start, samples } = self;
        let sides = cells.resolution.map(f32::from);
        let extent = (cells.bounds.max - cells.bounds.min).to_array();
        let (origin, dir) = (ray.origin.to_array(), ray.dir.to_array());
        let min = cells.bounds.min.to_array();
        let scale: [f32; 3] = std::array::from_fn(|axis| sides[axis] / extent[axis]);
        let last = sides.map(|side| side - 1.0);
        let resolution = cells.resolution.map(u32::from);
        let (half, per_radius) = (V::splat(0.5 * step), V::splat(contraction.radius().recip()));
        for base in (0..count).step_by(GROUP) {
            let (mut at, mut points) = ([0.0f32; GROUP], [[0.0f32; GROUP]; 3]);
            let mut live = 0;
            for from in (0..GROUP).step_by(V::COUNT) {
                let s = group_distances::<V>(first, step, base, from);
                s.store(&mut at[from..]);
                let t = contraction.distance_lanes(s);
                let mut p = [t; 3];
                for (axis, p) in p.iter_mut().enumerate() {
                    *p = V::splat(origin[axis]).add(V::splat(dir[axis]).mul(t));
                }
                let mut p = contraction.contract_lanes(p);
                for (axis, p) in p.iter_mut().enumerate() {
                    p.store(&mut points[axis][from..]);
                    *p = p.sub(V::splat(min[axis])).mul(V::splat(scale[axis])).sub(V::splat(0.5));
                }
                live |= occupied(&cells.bits, resolution, last, p) << from;
            }
            live &= first_bits(count - base);
            if live == 0 {
                continue;
            }
            let (mut lengths, mut scales, steps) = ([0.0f32; GROUP], [0.0f32; GROUP], at);
            for from in (0..GROUP).step_by(V::COUNT) {
                let at = V::load(&at[from..]);
                let radii = contraction.distance_lanes(at).add(V::splat(start)).mul(per_radius);
                V::splat(1.0).min_of(radii.mul(radii)).store(&mut scales[from..]);
                let length =
                    contraction.distance_lanes(at.add(half)).sub(contraction.distance_lanes(at.sub(half)));
                length.store(&mut lengths[from..]);
            }
            while live != 0 {
                let i = live.trailing_zeros() as usize;
                live &= live - 1;
                samples.positions.push([points[0][i], points[1][i], points[2][i]]);
                samples.deltas.push(lengths[i]);
                samples.gradient_scales.push(scales[i]);
                samples.steps.push(steps[i]);
            }
        }
    }
}
