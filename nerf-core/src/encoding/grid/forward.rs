//! The encoding of a block.

use super::cell::{Cells, unit_positions};
use super::{GridEncoding, GridTables, TableValues};
use crate::kernels::{Op, Tier, head, head_mut, tail_mut};
use crate::math::gather::{F16Table, F32Table, Table};
use crate::math::lanes::Lanes;

/// Encodes a block of samples by a grid.
///
/// `x`: `[inputs][stride]`, in the box of the `tables`; `out`: `[levels · features][stride]`. `stride` is a
/// multiple of 16, or any number on the scalar tier. A position outside of the box is moved onto it, and one
/// that is no number to its smallest corner.
///
/// A sample's values do not depend on the others of its block. f16 and f32 tables of the same values give the
/// same bits. Which cell a sample falls into is the same on every tier.
///
/// # Accuracy
/// Against the same sum in f64: `cells · 2^-23` of the largest difference between neighbouring entries, which
/// is what rounding moves a position by, and `2^-21` of the largest entry.
///
/// # Panics
/// With debug assertions, if a slice is shorter than that. Of tables that are too short, entries that are not
/// there are any others.
#[inline]
pub fn encode_grid_block(
    tier: Tier,
    grid: &GridEncoding,
    tables: &GridTables<'_>,
    stride: usize,
    x: &[f32],
    out: &mut [f32],
) {
    let x = head(x, usize::from(grid.inputs) * stride);
    let out = head_mut(out, grid.outputs() * stride);
    match tables.values {
        TableValues::F16(bytes) => {
            let table = F16Table::new(bytes);
            tier.run_columns(stride, Encode { grid, tables, table, stride, x, out });
        }
        TableValues::F32(values) => {
            let table = F32Table::new(values);
            tier.run_columns(stride, Encode { grid, tables, table, stride, x, out });
        }
    }
}

struct Encode<'a, T> {
    grid: &'a GridEncoding,
    tables: &'a GridTables<'a>,
    table: T,
    stride: usize,
    x: &'a [f32],
    out: &'a mut [f32],
}

impl<T: Table> Op for Encode<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        if self.grid.inputs == 2 { self.encode::<V, 2>() } else { self.encode::<V, 4>() }
    }
}

impl<T: Table> Encode<'_, T> {
    #[inline(always)]
    fn encode<V: Lanes, const ROWS: usize>(self) {
        let (stride, features) = (self.stride, usize::from(self.grid.features));
        for column in (0..stride).step_by(V::COUNT) {
            let inputs = usize::from(self.grid.inputs);
            let unit = unit_positions::<V>(self.tables, inputs, stride, self.x, column);
            for level in self.grid.levels() {
                let cells = Cells::of(&level, unit);
                let rows = cells.rows::<ROWS>(&level);
                let table = self.table.part(level.first * features, level.entries * features);
                let sums = V::weighted_rows(table, &rows, &cells.row_weights::<ROWS>(), features);
                for feature in 0..features.min(4) {
                    let (near, far) = (sums[feature], sums[features.min(4) + feature]);
                    let value = cells.weights[0].mul_add(far.sub(near), near);
                    value.store(tail_mut(self.out, (level.index * features + feature) * stride + column));
                }
            }
        }
    }
}
