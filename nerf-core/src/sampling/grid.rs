//! The skip grid: which cells of the scene box may hold something.

use crate::ray::SceneBox;
use glam::Vec3;

/// A borrowed bit per cell of the scene box, x slowest.
#[derive(Clone, Copy, Debug)]
pub struct SkipGrid<'a> {
    bounds: SceneBox,
    cells_per_unit: Vec3,
    resolution: [u16; 3],
    bits: &'a [u8],
}

impl<'a> SkipGrid<'a> {
    /// A grid of `resolution` cells over `bounds`; bit `(x * ny + y) * nz + z`, LSB first.
    ///
    /// A cell without a bit counts as empty, and so does everything where `resolution` has a 0.
    pub fn new(bounds: SceneBox, resolution: [u16; 3], bits: &'a [u8]) -> Self {
        let sides = Vec3::from(resolution.map(f32::from));
        let bits = if resolution.contains(&0) { &[] } else { bits };
        Self { bounds, cells_per_unit: sides / (bounds.max - bounds.min), resolution, bits }
    }

    /// Cells along x, y, z.
    pub fn resolution(&self) -> [u16; 3] {
        self.resolution
    }

    /// Whether the cell of `p` may hold something; `false` outside the box.
    ///
    /// The box is closed, exactly as [`SceneBox::contains`] has it: a point on its largest face belongs
    /// to the last cell.
    #[inline]
    pub fn occupied(&self, p: Vec3) -> bool {
        // Asked of `p` itself: scaled to cells, rounding moves a face by a cell's last digit.
        if !self.bounds.contains(p) {
            return false;
        }
        let at = (p - self.bounds.min) * self.cells_per_unit;
        let [nx, ny, nz] = self.resolution;
        let index = |axis: f32, side: u16| (axis as usize).min(usize::from(side).saturating_sub(1));
        let (x, y, z) = (index(at.x, nx), index(at.y, ny), index(at.z, nz));
        self.bit((x * usize::from(ny) + y) * usize::from(nz) + z)
    }

    /// Whether cell `index` may hold something.
    #[inline]
    pub fn bit(&self, index: usize) -> bool {
        self.bits.get(index / 8).is_some_and(|byte| byte >> (index % 8) & 1 == 1)
    }

    /// Share of the cells that may hold something.
    pub fn occupancy(&self) -> f32 {
        let cells: usize = self.resolution.iter().map(|&side| usize::from(side)).product();
        let set: u32 = self.bits.iter().map(|byte| byte.count_ones()).sum();
        set as f32 / cells.max(1) as f32
    }
}
