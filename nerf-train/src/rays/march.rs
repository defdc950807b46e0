//! The samples of one ray in occupied cells, sixteen at a time.

use nerf_core::contraction::Contraction;
use nerf_core::kernels::{Op, Tier};
use nerf_core::math::lanes::Lanes;
use nerf_core::ray::{Ray, SceneBox};

/// Samples that are looked up together.
const GROUP: usize = 16;
/// Added to a number from 0 to 2^22, it leaves the nearest whole one in the last bits.
const MAGIC: f32 = 8_388_608.0;

/// Occupied cells of a scene box, as a march takes them.
#[derive(Clone, Copy)]
pub(super) struct Cells<'a> {
    /// The box.
    pub bounds: SceneBox,
    /// Cells along x, y, z.
    pub resolution: [u16; 3],
    /// Bit `(x ny + y) nz + z`, least significant bit of a byte first.
    pub bits: &'a [u8],
}

/// Appends to `positions` the points `t = first + i step` of `ray`, `i` in `0..count`, that lie in occupied cells.
///
/// A point is taken as one of the box; on a face between two cells, as one of either.
pub(super) fn march(
    tier: Tier,
    cells: &Cells<'_>,
    ray: &Ray,
    first: f32,
    step: f32,
    count: u32,
    positions: &mut Vec<[f32; 3]>,
) {
    tier.run(March { cells, ray, first, step, count, positions });
}

struct March<'a> {
    cells: &'a Cells<'a>,
    ray: &'a Ray,
    first: f32,
    step: f32,
    count: u32,
    positions: &'a mut Vec<[f32; 3]>,
}

impl Op for March<'_> {
    type Output = ();

    // The loops over a group are written for the compiler to vectorise with the tier's instructions.
    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { cells, ray, first, step, count, positions } = self;
        let sides = cells.resolution.map(f32::from);
        let extent = (cells.bounds.max - cells.bounds.min).to_array();
        let (origin, dir) = (ray.origin.to_array(), ray.dir.to_array());
        let min = cells.bounds.min.to_array();
        let scale: [f32; 3] = std::array::from_fn(|axis| sides[axis] / extent[axis]);
        // In cells, half a cell back: what rounds to a whole number is then that cell.
        let from: [f32; 3] = std::array::from_fn(|axis| (origin[axis] - min[axis]) * scale[axis] - 0.5);
        let along: [f32; 3] = std::array::from_fn(|axis| dir[axis] * scale[axis]);
        let last = sides.map(|side| side - 1.0);
        let [_, ny, nz] = cells.resolution.map(u32::from);
        for base in (0..count).step_by(GROUP) {
            let mut index = [0u32; GROUP];
            for (i, index) in index.iter_mut().enumerate() {
                let t = first + (base + i as u32) as f32 * step;
                let cell = |axis: usize| {
                    let x = (from[axis] + t * along[axis]).max(0.0).min(last[axis]);
                    (x + MAGIC).to_bits() & 0x007f_ffff
                };
                *index = (cell(0) * ny + cell(1)) * nz + cell(2);
            }
            let mut live = 0u32;
            for (i, &index) in index.iter().enumerate() {
                let byte = cells.bits.get(index as usize / 8).copied().unwrap_or(0);
                live |= u32::from(byte >> (index % 8) & 1) << i;
            }
            while live != 0 {
                let i = base + live.trailing_zeros();
                live &= live - 1;
                if i < count {
                    let t = first + i as f32 * step;
                    positions.push(std::array::from_fn(|axis| origin[axis] + t * dir[axis]));
                }
            }
        }
    }
}

/// As [`march`], of a ray through an unbounded scene: the points are at `first + i step` of the steps of its contraction
/// ([`Contraction::distance`]), contracted; `deltas` gets how long each step is, world units.
pub(super) fn march_contracted(
    tier: Tier,
    cells: &Cells<'_>,
    contraction: &Contraction,
    ray: &Ray,
    (first, step, count): (f32, f32, u32),
    (positions, deltas): (&mut Vec<[f32; 3]>, &mut Vec<f32>),
) {
    tier.run(MarchContracted { cells, contraction, ray, first, step, count, positions, deltas });
}

struct MarchContracted<'a> {
    cells: &'a Cells<'a>,
    contraction: &'a Contraction,
    ray: &'a Ray,
    first: f32,
    step: f32,
    count: u32,
    positions: &'a mut Vec<[f32; 3]>,
    deltas: &'a mut Vec<f32>,
}

impl Op for MarchContracted<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { cells, contraction, ray, first, step, count, positions, deltas } = self;
        let sides = cells.resolution.map(f32::from);
        let extent = (cells.bounds.max - cells.bounds.min).to_array();
        let (origin, dir) = (ray.origin.to_array(), ray.dir.to_array());
        let min = cells.bounds.min.to_array();
        let scale: [f32; 3] = std::array::from_fn(|axis| sides[axis] / extent[axis]);
        let last = sides.map(|side| side - 1.0);
        let [_, ny, nz] = cells.resolution.map(u32::from);
        let half = V::splat(0.5 * step);
        for base in (0..count).step_by(GROUP) {
            let mut at = [0.0f32; GROUP];
            for (i, at) in at.iter_mut().enumerate() {
                *at = first + (base + i as u32) as f32 * step;
            }
            let mut points = [[0.0f32; GROUP]; 3];
            for from in (0..GROUP).step_by(V::COUNT) {
                let t = contraction.distance_lanes(V::load(&at[from..]));
                let mut p = [t; 3];
                for (axis, p) in p.iter_mut().enumerate() {
                    *p = V::splat(origin[axis]).add(V::splat(dir[axis]).mul(t));
                }
                let p = contraction.contract_lanes(p);
                for (axis, p) in p.into_iter().enumerate() {
                    p.store(&mut points[axis][from..]);
                }
            }
            let mut live = 0u32;
            let [xs, ys, zs] = &points;
            for (i, ((&x, &y), &z)) in xs.iter().zip(ys).zip(zs).enumerate() {
                let cell = |axis: usize, x: f32| {
                    let x = (x - min[axis]) * scale[axis] - 0.5;
                    (x.max(0.0).min(last[axis]) + MAGIC).to_bits() & 0x007f_ffff
                };
                let index = (cell(0, x) * ny + cell(1, y)) * nz + cell(2, z);
                let byte = cells.bits.get(index as usize / 8).copied().unwrap_or(0);
                live |= u32::from(byte >> (index % 8) & 1) << i;
            }
            live &= u32::MAX >> (32 - (count - base).min(GROUP as u32));
            if live == 0 {
                continue;
            }
            let mut lengths = [0.0f32; GROUP];
            for from in (0..GROUP).step_by(V::COUNT) {
                let at = V::load(&at[from..]);
                let length =
                    contraction.distance_lanes(at.add(half)).sub(contraction.distance_lanes(at.sub(half)));
                length.store(&mut lengths[from..]);
            }
            while live != 0 {
                let i = live.trailing_zeros() as usize;
                live &= live - 1;
                positions.push([points[0][i], points[1][i], points[2][i]]);
                deltas.push(lengths[i]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use nerf_core::sampling::{OccupancyGrid, Purpose, uniform};

    #[test]
    fn the_samples_of_a_march_are_those_in_occupied_cells() {
        let bounds = SceneBox::new(Vec3::new(-1.0, -0.5, 0.25), Vec3::new(1.0, 2.0, 1.0)).expect("a box");
        let resolution = [9u16, 17, 5];
        let draw = |i: u64| uniform(7, Purpose::Cell, 0, i);
        let bits: Vec<u8> = (0..96u64).map(|i| (draw(i) * 256.0) as u8).collect();
        let cells = Cells { bounds, resolution, bits: &bits };
        let occupancy = OccupancyGrid::new(bounds, resolution, &bits);
        let (mut found, mut expected, mut apart) = (0, 0, 0);
        for i in 0..200u64 {
            let v =
                |j: u64| Vec3::new(draw(1000 + 6 * i + j), draw(2000 + 6 * i + j), draw(3000 + 6 * i + j));
            let origin = bounds.min + (bounds.max - bounds.min) * v(0);
            let Some(dir) = (v(1) - Vec3::splat(0.5)).try_normalize() else { continue };
            let ray = Ray { origin, dir };
            let Some((enter, exit)) = bounds.clip(&ray, 0.0, 1e9) else { continue };
            let step = 0.013;
            let count = ((exit - enter) / step) as u32;
            let mut positions = Vec::new();
            march(Tier::detect(), &cells, &ray, enter, step, count, &mut positions);
            let points = (0..count).map(|i| ray.at(enter + i as f32 * step));
            let oracle: Vec<Vec3> = points.filter(|&p| occupancy.occupied(p)).collect();
            found += positions.len();
            expected += oracle.len();
            apart += positions.len().abs_diff(oracle.len());
        }
        // Points on a face belong to either cell.
        assert!(expected > 4_000 && apart <= 3, "{found} found, {expected} expected, {apart} apart");
    }

    #[test]
    fn the_samples_of_a_contracted_march_are_those_in_occupied_cells() {
        let bounds = Contraction::cube(Vec3::new(0.5, -1.0, 2.0), 1.5);
        let contraction = Contraction::new(&bounds, 2).expect("a cube");
        let resolution = [9u16, 17, 5];
        let draw = |i: u64| uniform(7, Purpose::Cell, 1, i);
        let bits: Vec<u8> = (0..96u64).map(|i| (draw(i) * 256.0) as u8).collect();
        let cells = Cells { bounds, resolution, bits: &bits };
        let occupancy = OccupancyGrid::new(bounds, resolution, &bits);
        let (mut expected, mut apart) = (0, 0);
        for i in 0..200u64 {
            let v =
                |j: u64| Vec3::new(draw(1000 + 6 * i + j), draw(2000 + 6 * i + j), draw(3000 + 6 * i + j));
            let origin = bounds.min + (bounds.max - bounds.min) * v(0);
            let Some(dir) = (v(1) - Vec3::splat(0.5)).try_normalize() else { continue };
            let (ray, _) = contraction.centred(&Ray { origin, dir });
            // No whole number of groups.
            let (first, step, count) = (-1.3, 0.03, 130);
            let (mut positions, mut deltas) = (Vec::new(), Vec::new());
            let walk = (first, step, count);
            let to = (&mut positions, &mut deltas);
            march_contracted(Tier::detect(), &cells, &contraction, &ray, walk, to);
            assert_eq!(positions.len(), deltas.len());
            let at = (0..count).map(|i| first + i as f32 * step);
            let point = |s: f32| contraction.contract(ray.at(contraction.distance(s)));
            let oracle: Vec<f32> = at.filter(|&s| occupancy.occupied(point(s))).collect();
            expected += oracle.len();
            apart += positions.len().abs_diff(oracle.len());
            if positions.len() == oracle.len() {
                for ((p, delta), &s) in positions.iter().zip(deltas).zip(&oracle) {
                    let length = contraction.distance(s + 0.5 * step) - contraction.distance(s - 0.5 * step);
                    assert!((Vec3::from(*p) - point(s)).length() < 1e-4, "{p:?} at {s}");
                    assert!((delta - length).abs() < 1e-3 * length, "{delta}, not {length}");
                }
            }
        }
        // Points on a face belong to either cell.
        assert!(expected > 4_000 && apart <= 3, "{expected} expected, {apart} apart");
    }
}
