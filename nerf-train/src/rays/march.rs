//! The samples of one ray in occupied cells, sixteen at a time.

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
}
