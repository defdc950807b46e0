//! The grid cell that contains a sample, with the table entries and interpolation weights of its corners.

use super::level::{HASH_Y, HASH_Z};
use super::{GridLevel, GridTables};
use crate::memory::tail;
use crate::simd::{Indices, Lanes};

/// Maps positions to 0..1 on each axis of the box that the grid spans. `x`: positions, `[inputs][stride]`, in the
/// coordinates of the box. SIMD lane `i` of the result is the position in column `column + i` of `x`.
///
/// A coordinate outside of the box is moved to the nearest face. A NaN becomes 0.
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

/// The cells of one level that contain a vector of samples, one sample per SIMD lane.
pub(super) struct Cells<V: Lanes> {
    /// Index of the cell along x: 0 at the smallest x of the box. `y` and `z` are the indices along y and z.
    x: V::Indices,
    y: V::Indices,
    z: V::Indices,
    /// Position of the sample inside the cell along each axis, 0 to 1. Also the interpolation weight, along the same
    /// axis, of the corners at the larger coordinate.
    pub weights: [V; 3],
}

impl<V: Lanes> Cells<V> {
    /// Finds the cells that contain the positions `unit`, 0 to 1 on each axis. A position on a face between two cells
    /// is in the cell with the larger index. A coordinate of 1 is in the last cell along its axis.
    #[inline(always)]
    pub fn of(level: &GridLevel, unit: [V; 3]) -> Self {
        let [nx, ny, nz] = level.cells;
        let (x, wx) = locate(unit[0], nx);
        let (y, wy) = locate(unit[1], ny);
        let (z, wz) = locate(unit[2], nz);
        Self { x, y, z, weights: [wx, wy, wz] }
    }

    /// Returns, for each row of corners, the index of the row's first table entry, counted from [`GridLevel::first`]. A
    /// row is two corners that differ only in x. The first entry belongs to the corner at the smaller x, the next entry
    /// to the corner at the larger x. Rows are at (y, z), (y+1, z), and in 3D also at (y, z+1), (y+1, z+1).
    #[inline(always)]
    pub fn rows<const ROWS: usize>(&self, level: &GridLevel) -> [V::Indices; ROWS] {
        let number = V::Indices::splat;
        let mut rows = [self.x; ROWS];
        match level.mask {
            Some(mask) => {
                let (y, z) = (self.y.mul(number(HASH_Y)), self.z.mul(number(HASH_Z)));
                let of_y = [y, y.add(number(HASH_Y))];
                let of_z = [z, z.add(number(HASH_Z))];
                for (r, row) in rows.iter_mut().enumerate() {
                    let h = of_y[r & 1].xor(of_z[r >> 1 & 1]);
                    *row = h.xor(h.shift_right_15()).and(number(mask)).add(self.x);
                }
            }
            None => {
                let [nx, ny, _] = level.cells;
                let (along_y, rows_of_y) = (nx.wrapping_add(1), ny.wrapping_add(1));
                let along_z = along_y.wrapping_mul(rows_of_y);
                let row = self.z.mul(number(rows_of_y)).add(self.y).mul(number(along_y)).add(self.x);
                for (r, to) in rows.iter_mut().enumerate() {
                    let (dy, dz) = (r as u32 & 1, r as u32 >> 1);
                    *to = row.add(number((dy * along_y).wrapping_add(dz * along_z)));
                }
            }
        }
        rows
    }

    /// Returns the interpolation weight of each row (two corners that differ only in x), without the weight along x. A
    /// row's weight is the weight along y in 2D (`ROWS` = 2), and the product of the weights along y and z in 3D
    /// (`ROWS` = 4).
    #[inline(always)]
    pub fn row_weights<const ROWS: usize>(&self) -> [V; ROWS] {
        let [_, wy, wz] = self.weights;
        let one = V::splat(1.0);
        let of_y = [one.sub(wy), wy];
        let of_z = [one.sub(wz), wz];
        let mut weights = [one; ROWS];
        for (r, weight) in weights.iter_mut().enumerate() {
            *weight = if ROWS == 2 { of_y[r & 1] } else { of_y[r & 1].mul(of_z[r >> 1 & 1]) };
        }
        weights
    }

    /// Derivative of each row's weight ([`Cells::row_weights`]) with respect to y, where y is counted in cells.
    #[cfg(feature = "normals")]
    #[inline(always)]
    pub fn row_weights_by_y(&self) -> [V; 4] {
        let [_, _, wz] = self.weights;
        let near = V::splat(1.0).sub(wz);
        [near.neg(), near, wz.neg(), wz]
    }

    /// Derivative of each row's weight ([`Cells::row_weights`]) with respect to z, counted in cells. Only for 3D.
    #[cfg(feature = "normals")]
    #[inline(always)]
    pub fn row_weights_by_z(&self) -> [V; 4] {
        let [_, wy, _] = self.weights;
        let near = V::splat(1.0).sub(wy);
        [near.neg(), wy.neg(), near, wy]
    }
}

/// Returns, for one axis with `cells` cells, the index of the cell that contains the position `unit` (0 to 1 in the
/// box), and the position inside that cell (0 to 1).
#[inline(always)]
fn locate<V: Lanes>(unit: V, cells: u32) -> (V::Indices, V) {
    let g = unit.mul(V::splat(cells as f32));
    let cell = g.floor().min_of(V::splat(cells.saturating_sub(1) as f32));
    (cell.to_indices(), g.sub(cell))
}
