//! Table entries and interpolation weights that the grid encoding uses for a block of samples. A trainer adds gradients
//! to these entries.

use super::cell::{Cells, unit_positions};
use super::{GridEncoding, GridLevel, GridTables};
use crate::memory::{head, head_mut, tail_mut};
use crate::simd::{Indices, Isa, Lanes, MAX_LANES, Op};

/// The corners of the cells that contain a block of samples at one level, in rows. A row is two corners that differ
/// only in x. A cell has 2 rows in two dimensions and 4 rows in three.
///
/// Let `g` be the gradient of the loss with respect to one encoded feature of sample `i`. For each row `r`, a trainer
/// adds `weight[r][i] · (1 − x[i]) · g` to the gradient of the same feature of table entry `entry[r][i]`, and
/// `weight[r][i] · x[i] · g` to the gradient of the next entry. If several corners of a cell share an entry, the
/// gradients of all these corners are added to this entry.
#[derive(Debug)]
pub struct GridCorners<'w> {
    /// `[rows][stride]`: index, counted over all levels, of the table entry at the row's smaller x.
    pub entry: &'w mut [u32],
    /// `[rows][stride]`: interpolation weight of the row, 0 to 1.
    pub weight: &'w mut [f32],
    /// `[stride]`: interpolation weight of the corners at the larger x, 0 to 1.
    pub x: &'w mut [f32],
}

/// Writes to `corners` the indices and the interpolation weights of the table entries that
/// [`encode_grid_block`](super::encode_grid_block) reads at `level`, for a trainer's backward pass. The weights are
/// bit-identical to the weights in `encode_grid_block`.
///
/// `x` and `stride`: as for `encode_grid_block`. Of `tables`, only the box is used.
///
/// # Panics
/// With debug assertions, if a slice is too short.
pub fn grid_corners_block(
    isa: Isa,
    grid: &GridEncoding,
    tables: &GridTables<'_>,
    level: &GridLevel,
    stride: usize,
    x: &[f32],
    corners: &mut GridCorners<'_>,
) {
    let inputs = usize::from(grid.inputs);
    let x = head(x, inputs * stride);
    isa.run_columns(stride, Corners { inputs, tables, level, stride, x, corners });
}

struct Corners<'a, 'w> {
    inputs: usize,
    tables: &'a GridTables<'a>,
    level: &'a GridLevel,
    stride: usize,
    x: &'a [f32],
    corners: &'a mut GridCorners<'w>,
}

impl Op for Corners<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        if self.inputs == 2 { self.corners::<V, 2>() } else { self.corners::<V, 4>() }
    }
}

impl Corners<'_, '_> {
    #[inline(always)]
    fn corners<V: Lanes, const ROWS: usize>(self) {
        let stride = self.stride;
        let GridCorners { entry, weight, x } = self.corners;
        for column in (0..stride).step_by(V::COUNT) {
            let unit = unit_positions::<V>(self.tables, self.inputs, stride, self.x, column);
            let cells = Cells::of(self.level, unit);
            let rows = cells.rows::<ROWS>(self.level);
            let first = V::Indices::splat(self.level.first as u32);
            for (r, weights) in cells.row_weights::<ROWS>().into_iter().enumerate() {
                weights.store(tail_mut(weight, r * stride + column));
                let mut entries = [0; MAX_LANES];
                rows[r].add(first).store(&mut entries);
                let to = head_mut(tail_mut(entry, r * stride + column), V::COUNT);
                for (to, &entry) in to.iter_mut().zip(&entries) {
                    *to = entry;
                }
            }
            cells.weights[0].store(tail_mut(x, column));
        }
    }
}
