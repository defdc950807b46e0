//! The occupancy grid, which marks the cells of the scene box that may have density.

use super::Bins;
use crate::camera::Ray;
use crate::simd::{Indices, Lanes};
use crate::space::SceneBox;
use glam::Vec3;

/// Maximum number of cells for which every index is exact in f32 and fits [`Lanes::to_indices`].
const EXACT_CELLS: u64 = 1 << 23;

/// The occupancy grid: one bit for each cell of the scene box, x slowest, 1 if the cell is occupied. Borrows the bits.
#[derive(Clone, Copy, Debug)]
pub struct OccupancyGrid<'a> {
    pub(crate) bounds: SceneBox,
    pub(crate) cells_per_unit: Vec3,
    resolution: [u16; 3],
    bits: &'a [u8],
}

/// An [`OccupancyGrid`] with its constants in vectors, for lookups of several points at once.
pub(crate) struct OccupancyLanes<'a, V> {
    min: [V; 3],
    scale: [V; 3],
    last: [V; 3],
    /// Number of cells along y and z.
    sides: [V; 2],
    exact: bool,
    bits: &'a [u8],
}

impl<V: Lanes> OccupancyLanes<'_, V> {
    /// Looks up a vector of points: bit `i` of the result is 1 if the point in lane `i` lies in an occupied cell.
    /// `cells`: x, y and z of the points. `INSIDE`: whether all points are known to lie in the box, away from its
    /// faces. Otherwise, a point outside the box is looked up in the nearest cell.
    #[inline(always)]
    pub fn occupied<const INSIDE: bool>(&self, mut cells: [V; 3]) -> u32 {
        for (axis, cell) in cells.iter_mut().enumerate() {
            // Rounded and clamped as in `cell_of`.
            let at = cell.sub(self.min[axis]).mul(self.scale[axis]).floor();
            *cell = if INSIDE { at } else { at.min_of(self.last[axis]).max_of(V::splat(0.0)) };
        }
        let ([x, y, z], [ny, nz]) = (cells, self.sides);
        let index = if self.exact {
            x.mul_add(ny, y).mul_add(nz, z).to_indices()
        } else {
            let row = x.to_indices().mul(ny.to_indices()).add(y.to_indices());
            row.mul(nz.to_indices()).add(z.to_indices())
        };
        V::bits(self.bits, index)
    }
}

impl<'a> OccupancyGrid<'a> {
    /// Makes an occupancy grid of `resolution` cells over `bounds`. Cell x, y, z has bit `(x * ny + y) * nz + z` of
    /// `bits`, LSB first.
    ///
    /// A cell whose bit would lie beyond the end of `bits` is empty. All cells are empty if `resolution` contains a 0,
    /// or if the number of cells exceeds 2^32 − 1.
    pub fn new(bounds: SceneBox, resolution: [u16; 3], bits: &'a [u8]) -> Self {
        let sides = Vec3::from(resolution.map(f32::from));
        let cells: u64 = resolution.iter().map(|&side| u64::from(side)).product();
        let bits = if cells > 0 && u32::try_from(cells).is_ok() { bits } else { &[] };
        Self { bounds, cells_per_unit: sides / (bounds.max - bounds.min), resolution, bits }
    }

    /// Number of cells along x, y, z.
    pub fn resolution(&self) -> [u16; 3] {
        self.resolution
    }

    /// Whether the cell that contains `p` is occupied; `false` outside the box.
    ///
    /// The box is closed, as in [`SceneBox::contains`]: a point at the box's maximum along an axis is in the last cell.
    #[inline]
    pub fn occupied(&self, p: Vec3) -> bool {
        self.cell_of(p).is_some_and(|cell| self.bit(self.index_of(cell)))
    }

    #[inline(always)]
    pub(crate) fn lanes<V: Lanes>(&self) -> OccupancyLanes<'a, V> {
        let resolution = self.resolution.map(f32::from);
        let count: u64 = self.resolution.iter().map(|&side| u64::from(side)).product();
        OccupancyLanes {
            min: self.bounds.min.to_array().map(V::splat),
            scale: self.cells_per_unit.to_array().map(V::splat),
            last: self.resolution.map(|side| V::splat(f32::from(side.saturating_sub(1)))),
            sides: [V::splat(resolution[1]), V::splat(resolution[2])],
            exact: count <= EXACT_CELLS,
            bits: self.bits,
        }
    }

    /// Indices x, y, z of the cell that contains `p`; `None` outside the box.
    #[inline]
    fn cell_of(&self, p: Vec3) -> Option<[usize; 3]> {
        // Tests `p` itself, since after scaling to cells rounding may move the point across a face.
        if !self.bounds.contains(p) {
            return None;
        }
        let at = (p - self.bounds.min) * self.cells_per_unit;
        let [nx, ny, nz] = self.resolution;
        let index = |axis: f32, side: u16| (axis as usize).min(usize::from(side).saturating_sub(1));
        Some([index(at.x, nx), index(at.y, ny), index(at.z, nz)])
    }

    /// Index in `bits` of the cell with indices x, y, z.
    #[inline]
    fn index_of(&self, [x, y, z]: [usize; 3]) -> usize {
        let [_, ny, nz] = self.resolution.map(usize::from);
        // Grids with more cells than `u32` can count have no bits (`new`), so that wrapping is harmless.
        x.wrapping_mul(ny).wrapping_add(y).wrapping_mul(nz).wrapping_add(z)
    }

    /// Finds the first bin of `from..end` whose sample lies in an occupied cell. Returns `end` if no sample does. The
    /// sample of `bin` lies at `t(bin)`, which must not decrease from bin to bin.
    ///
    /// The result is as if each bin's sample were tested with [`OccupancyGrid::occupied`]. If bins are smaller than
    /// cells, bins in an empty cell may be skipped without a test.
    ///
    /// # Source
    /// Amanatides and Woo 1987; deviation: only the bins' samples are tested, not each cell that the ray crosses. The
    /// distance to the exit from an empty cell gives an estimate of the number of bins to skip. Jitter may make the
    /// estimate wrong by one. Bins are therefore skipped only if the last skipped sample lies in the same cell.
    /// The samples in between then lie in this cell, too, since rounding is monotone: a coordinate that does not
    /// decrease along the ray does not decrease in f32 either.
    #[inline]
    pub fn first_occupied(&self, ray: &Ray, bins: &Bins, from: u32, end: u32, t: impl Fn(u32) -> f32) -> u32 {
        let cells_per_bin = ray.dir.abs() * self.cells_per_unit * bins.delta();
        let passes_cells = cells_per_bin.max_element() >= 1.0;
        let mut bin = from;
        while bin < end {
            let p = ray.at(t(bin));
            if let Some(cell) = self.cell_of(p) {
                if self.bit(self.index_of(cell)) {
                    return bin;
                }
                if !passes_cells {
                    let ahead = self.bins_to_exit(p, cell, ray.dir, cells_per_bin);
                    let last = bin + Ord::min(ahead, end - 1 - bin);
                    if self.cell_of(ray.at(t(last))) == Some(cell) {
                        bin = last;
                    }
                }
            }
            bin += 1;
        }
        end
    }

    /// Estimates the number of bins from the point `p` to the point where a ray of direction `dir` leaves `cell`, the
    /// cell of `p`. `cells_per_bin`: number of cells that the ray crosses in one bin, along x, y, z.
    #[inline]
    fn bins_to_exit(&self, p: Vec3, cell: [usize; 3], dir: Vec3, cells_per_bin: Vec3) -> u32 {
        let low = Vec3::from(cell.map(|side| side as f32));
        let behind = (p - self.bounds.min) * self.cells_per_unit - low;
        let ahead = Vec3::select(dir.cmpge(Vec3::ZERO), Vec3::ONE - behind, behind);
        // 0/0 is NaN, which `as` converts to 0: the march then advances by one bin.
        (ahead / cells_per_bin).min_element() as u32
    }

    /// Bounding box of all occupied cells, enlarged by a cell on every side and clipped to the scene box; `None` if all
    /// cells are empty. Points outside of this box are never [`OccupancyGrid::occupied`].
    pub fn occupied_box(&self) -> Option<SceneBox> {
        let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
        self.each_occupied(|cell| {
            for axis in 0..3 {
                low[axis] = low[axis].min(cell[axis]);
                high[axis] = high[axis].max(cell[axis]);
            }
        });
        let size = self.cells_per_unit.recip();
        let corner = |cell: [usize; 3]| self.bounds.min + Vec3::from(cell.map(|side| side as f32)) * size;
        (low[0] <= high[0]).then(|| SceneBox {
            min: corner(low.map(|side| side.saturating_sub(1))).max(self.bounds.min),
            max: corner(high.map(|side| side + 2)).min(self.bounds.max),
        })
    }

    /// Number of blocks along x, y, z. A block has `side` cells along each axis; the last blocks may have fewer.
    pub(crate) fn blocks(&self, side: u16) -> [u16; 3] {
        self.resolution.map(|cells| cells.div_ceil(side))
    }

    /// Divides the grid into blocks of `side`³ cells. If a block contains an occupied cell, sets its bit in `blocks`;
    /// other bits stay as they are. Blocks are in row-major order, x slowest.
    pub(crate) fn mark_blocks(&self, side: u16, blocks: &mut [u8]) {
        let [_, ny, nz] = self.blocks(side).map(usize::from);
        let side = usize::from(side);
        self.each_occupied(|[x, y, z]| {
            let block = (x / side * ny + y / side) * nz + z / side;
            if let Some(byte) = blocks.get_mut(block / 8) {
                *byte |= 1 << (block % 8);
            }
        });
    }

    /// Calls `found` with the indices x, y, z of each occupied cell.
    #[inline]
    fn each_occupied(&self, mut found: impl FnMut([usize; 3])) {
        let [_, ny, nz] = self.resolution.map(usize::from);
        for (i, &byte) in self.bits.iter().enumerate().filter(|(_, byte)| **byte != 0) {
            for bit in (0..8).filter(|bit| byte >> bit & 1 == 1) {
                let index = 8 * i + bit;
                // A grid with bits has no side of 0. The `max` inside the loops tells the compiler that the divisions
                // cannot panic; in front of the loops it does not.
                let (ny, nz) = (ny.max(1), nz.max(1));
                found([index / nz / ny, index / nz % ny, index % nz]);
            }
        }
    }

    /// Returns a coarser grid, whose cells are blocks of `side`³ cells of this grid. `blocks`: occupancy bits of
    /// the blocks, from [`OccupancyGrid::mark_blocks`].
    pub(crate) fn of_blocks<'b>(&self, side: u16, blocks: &'b [u8]) -> OccupancyGrid<'b> {
        OccupancyGrid {
            bounds: self.bounds,
            cells_per_unit: self.cells_per_unit / f32::from(side),
            resolution: self.blocks(side),
            bits: blocks,
        }
    }

    /// Whether the cell with index `(x * ny + y) * nz + z` is occupied; `false` beyond the end of the bits.
    #[inline]
    pub fn bit(&self, index: usize) -> bool {
        self.bits.get(index / 8).is_some_and(|byte| byte >> (index % 8) & 1 == 1)
    }

    /// Fraction of the cells that are occupied, 0 to 1; 0 for a grid without cells.
    pub fn occupied_share(&self) -> f32 {
        let cells: u64 = self.resolution.iter().map(|&side| u64::from(side)).product();
        let set: u32 = self.bits.iter().map(|byte| byte.count_ones()).sum();
        set as f32 / cells.max(1) as f32
    }
}
