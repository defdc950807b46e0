//! Lattice of cubes of equal size over a box.

use super::Field;
use anyhow::bail;
use glam::Vec3;
use half::f16;
use nerf_core::space::SceneBox;

/// Lattice of cubes over a box, with one more layer around it, which closes surfaces that reach the box's sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Position of the lattice's lower corner, world units.
    pub min: Vec3,
    /// Side of a cube, world units.
    pub cell: f32,
    /// Number of cubes along each axis, with the layer around the box.
    pub cells: [usize; 3],
}

impl Lattice {
    /// Creates a lattice of `resolution` cubes along the box's longest side, plus one cube at each end of each axis.
    pub fn new(bounds: &SceneBox, resolution: u32) -> anyhow::Result<Self> {
        let (cell, cells) = cubes(bounds, resolution)?;
        let cells = cells.map(|count| count + 2);
        Ok(Self { min: bounds.min - cell, cell, cells })
    }

    pub fn corner(&self, [x, y, z]: [usize; 3]) -> Vec3 {
        self.min + self.cell * Vec3::new(x as f32, y as f32, z as f32)
    }

    /// Returns the positions of the corners whose index along z is `z`, world units; x varies fastest, then y.
    pub fn slice(&self, z: usize) -> Vec<[f32; 3]> {
        let [width, height] = self.corners();
        let corner = |i: usize| self.corner([i % width, i / width, z]).into();
        (0..width * height).map(corner).collect()
    }

    /// Returns the optical depth at the corners of slice `z`: density times a cube's side; 0 at the outermost corners.
    pub fn cell_depths(&self, field: &Field<'_, '_>, z: usize) -> anyhow::Result<Vec<f16>> {
        let [width, height] = self.corners();
        let side = |i: usize| {
            let ends = |at: usize, corners: usize| at == 0 || at + 1 == corners;
            ends(i % width, width) || ends(i / width, height) || ends(z, self.cells[2] + 1)
        };
        let found = field.densities(&self.slice(z))?;
        let depth = |(i, sigma): (usize, f32)| {
            if side(i) { f16::ZERO } else { f16::from_f32((sigma * self.cell).min(6e4)) }
        };
        Ok(found.into_iter().enumerate().map(depth).collect())
    }

    /// Returns the point nearest to `point` in the lattice without its outermost layer of cubes.
    pub fn clamp(&self, point: Vec3) -> Vec3 {
        let last = self.cells.map(|count| count - 1);
        point.clamp(self.corner([1; 3]), self.corner(last))
    }

    /// Returns the number of corners of a slice along x and y.
    pub fn corners(&self) -> [usize; 2] {
        [self.cells[0] + 1, self.cells[1] + 1]
    }
}

/// Returns the side of a cube, world units, and number of cubes along each axis, for a box with `resolution` cubes
/// along its longest side. A lattice's additional layer is not counted. Fails for an empty box or tiny cubes.
pub(super) fn cubes(bounds: &SceneBox, resolution: u32) -> anyhow::Result<(f32, [usize; 3])> {
    let extent = bounds.max - bounds.min;
    let cell = extent.max_element() / resolution.max(1) as f32;
    let furthest = bounds.min.abs().max(bounds.max.abs()).max_element();
    if !(extent.is_finite()
        && extent.min_element() > 0.0
        && cell.is_normal()
        && cell > 8.0 * f32::EPSILON * furthest)
    {
        bail!(
            "--box: expected three sides above 0 in cells that 32-bit coordinates tell apart, found sides {:?} and cells of {cell}",
            extent.to_array()
        );
    }
    // The tolerance keeps rounding from adding a cube to a side that is a whole number of cubes long.
    Ok((cell, extent.to_array().map(|side| (side / cell - 1e-3).ceil().max(1.0) as usize)))
}
