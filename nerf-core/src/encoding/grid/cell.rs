//! The cell of a level that a sample falls into: its corners' entries and their weights.

use super::{GridLevel, GridTables};
use crate::kernels::tail;
use crate::math::lanes::{Lanes, MAX_LANES};

/// Row by row of a cell's corners, the same of every lane: [`MAX_LANES`], of which [`Lanes::COUNT`] are used.
pub(super) type RowIndices<const ROWS: usize> = [[u32; MAX_LANES]; ROWS];

/// A vector of positions in 0..1 on each axis of the box.
///
/// What is outside by rounding is moved to the face, and what is no number to 0.
#[inline(always)]
pub(super) fn unit_positions<V: Lanes>(
    tables: &GridTables<'_>,
    inputs: usize,
    stride: usize,
    x: &[f32],
    column: usize,
) -> [V; 3] {
    let mut unit = [V::splat(0.0); 3];
    for (axis, unit) in unit.iter_mut().enumerate().take(inputs) {
        let x = V::load(tail(x, axis * stride + column));
        let u = x.sub(V::splat(tables.min[axis])).div(V::splat(tables.sides[axis]));
        *unit = u.max_of(V::splat(0.0)).min_of(V::splat(1.0));
    }
    unit
}

/// Cells of a vector of samples at one level.
pub(super) struct Cells<V> {
    /// The corner nearest to 0, in vertices along y and z; x is in `first`.
    y: [u32; MAX_LANES],
    z: [u32; MAX_LANES],
    x: [u32; MAX_LANES],
    /// How far from that corner to the opposite one, 0 to 1 on each axis.
    pub weights: [V; 3],
}

impl<V: Lanes> Cells<V> {
    /// The cells that hold the positions `unit`: on a face between two, the one further on; the last one holds
    /// the box's own face, too.
    #[inline(always)]
    pub fn of(level: &GridLevel, unit: [V; 3]) -> Self {
        let [(x, wx), (y, wy), (z, wz)] = [0, 1, 2].map(|axis| locate(unit[axis], level.cells[axis]));
        Self { x, y, z, weights: [wx, wy, wz] }
    }

    /// The entry of each row's corner at x, from the level's first; that at x + 1 follows. Rows are
    /// (y, z), (y + 1, z), and in three dimensions (y, z + 1), (y + 1, z + 1).
    #[inline(always)]
    pub fn rows<const ROWS: usize>(&self, level: &GridLevel) -> RowIndices<ROWS> {
        let mut rows = [[0; MAX_LANES]; ROWS];
        for (r, row) in rows.iter_mut().enumerate() {
            let (dy, dz) = (r as u32 & 1, r as u32 >> 1);
            for lane in 0..V::COUNT {
                row[lane] = level.row(self.y[lane] + dy, self.z[lane] + dz).wrapping_add(self.x[lane]);
            }
        }
        rows
    }

    /// The rows' weights, without x's share: of y, or in three dimensions of y and z.
    #[inline(always)]
    pub fn row_weights<const ROWS: usize>(&self) -> [V; ROWS] {
        let [_, wy, wz] = self.weights;
        let one = V::splat(1.0);
        let of_y = [one.sub(wy), wy];
        let of_z = [one.sub(wz), wz];
        core::array::from_fn(|r| if ROWS == 2 { of_y[r] } else { of_y[r & 1].mul(of_z[r >> 1]) })
    }

    /// Derivatives of [`Cells::row_weights`] by y, in units of a cell.
    #[cfg(feature = "normals")]
    #[inline(always)]
    pub fn row_weights_by_y<const ROWS: usize>(&self) -> [V; ROWS] {
        let [_, _, wz] = self.weights;
        let one = V::splat(1.0);
        let of_z = if ROWS == 2 { [one; 2] } else { [one.sub(wz), wz] };
        core::array::from_fn(|r| if r & 1 == 0 { of_z[r >> 1].neg() } else { of_z[r >> 1] })
    }

    /// Derivatives of [`Cells::row_weights`] by z, in units of a cell; for three dimensions.
    #[cfg(feature = "normals")]
    #[inline(always)]
    pub fn row_weights_by_z<const ROWS: usize>(&self) -> [V; ROWS] {
        let [_, wy, _] = self.weights;
        let of_y = [V::splat(1.0).sub(wy), wy];
        core::array::from_fn(|r| if r >> 1 == 0 { of_y[r & 1].neg() } else { of_y[r & 1] })
    }
}

/// Index of the cell along one axis, and the weight of its far side.
#[inline(always)]
fn locate<V: Lanes>(unit: V, cells: u32) -> ([u32; MAX_LANES], V) {
    /// Added to a whole number from 0 to 2^23, it leaves that number in the last bits.
    const MAGIC: f32 = 8_388_608.0;
    let g = unit.mul(V::splat(cells as f32));
    let nearest = g.round_even();
    let floor = V::select(g.less(nearest), nearest.sub(V::splat(1.0)), nearest);
    let cell = floor.min_of(V::splat(cells.saturating_sub(1) as f32));
    let mut bits = [0.0; MAX_LANES];
    cell.add(V::splat(MAGIC)).store(&mut bits);
    (bits.map(|x| x.to_bits() & 0x007f_ffff), g.sub(cell))
}
