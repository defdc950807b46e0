//! The derivative of the grid encoding with respect to the position.

use super::cell::{Cells, unit_positions};
use super::{GridEncoding, GridLevel, GridTables};
use crate::math::polynomial::exp;
use crate::memory::{tail, tail_mut};
use crate::simd::{Lanes, Op, Table, VECTORS, Value};

/// Arguments of [`GridEncoding::gradient`], with each slice cut to its exact length.
pub(super) struct Gradient<'a, T> {
    pub grid: &'a GridEncoding,
    pub tables: &'a GridTables<'a>,
    pub table: Table<'a, T>,
    pub stride: usize,
    pub x: &'a [f32],
    pub of_encoded: &'a [f32],
    pub blur: f32,
    pub of_x: &'a mut [f32],
}

impl<T: Value> Op for Gradient<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        // The presets have two features. One lane, and builds without vectors, favour code size.
        if VECTORS && V::COUNT > 1 && self.grid.features == 2 {
            self.gradient::<V, 2>();
        } else {
            self.gradient::<V, 0>();
        }
    }
}

impl<T: Value> Gradient<'_, T> {
    /// `FEATURES`: number of features per level; 0 for a run-time number. A 2D sample also reads two rows of corners with
    /// weight 0, which leaves the result bit-identical.
    #[inline(always)]
    pub(super) fn gradient<V: Lanes, const FEATURES: usize>(self) {
        let stride = self.stride;
        let features = if FEATURES == 0 { usize::from(self.grid.features).min(4) } else { FEATURES };
        let inputs = usize::from(self.grid.inputs);
        for column in (0..stride).step_by(V::COUNT) {
            let unit = unit_positions::<V>(self.tables, inputs, stride, self.x, column);
            let mut sums = [V::splat(0.0); 3];
            for level in self.grid.levels() {
                let cells = Cells::of(&level, unit);
                let rows = cells.rows::<4>(&level);
                let table = self.table.part(level.first * features, level.entries * features);
                let along = |weights: [V; 4]| V::weighted_rows(table, &rows, &weights, features);
                let by_x = along(cells.row_weights());
                let by_y = along(cells.row_weights_by_y());
                let by_z = along(cells.row_weights_by_z());
                let mut of_cell = [V::splat(0.0); 3];
                for feature in 0..features {
                    let far = features + feature;
                    let channel = level.index * features + feature;
                    let of = V::load(tail(self.of_encoded, channel * stride + column));
                    let at_x =
                        |rows: &[V; 8]| cells.weights[0].mul_add(rows[far].sub(rows[feature]), rows[feature]);
                    of_cell[0] = of.mul_add(by_x[far].sub(by_x[feature]), of_cell[0]);
                    of_cell[1] = of.mul_add(at_x(&by_y), of_cell[1]);
                    of_cell[2] = of.mul_add(at_x(&by_z), of_cell[2]);
                }
                let damped = damping(&level, self.tables, inputs, self.blur) * self.table.scale(level.index);
                for axis in 0..inputs.min(3) {
                    let cells_per_unit = level.cells[axis] as f32 / self.tables.sides[axis];
                    sums[axis] = of_cell[axis].mul_add(V::splat(cells_per_unit * damped), sums[axis]);
                }
            }
            for (axis, sum) in sums.into_iter().enumerate().take(inputs) {
                sum.store(tail_mut(self.of_x, axis * stride + column));
            }
        }
    }
}

/// Weight of a level in a gradient averaged over a Gaussian of standard deviation `blur`, world units:
/// `erf(c / (√8 blur))`, where `c` is the level's smallest cell width. The weight is 1 if `blur` is 0.
#[inline]
fn damping(level: &GridLevel, tables: &GridTables<'_>, inputs: usize, blur: f32) -> f32 {
    if blur <= 0.0 {
        return 1.0;
    }
    let mut narrowest = f32::MAX;
    for axis in 0..inputs.min(3) {
        narrowest = narrowest.min_of(tables.sides[axis] / level.cells[axis] as f32);
    }
    erf(narrowest / (2.828_427 * blur))
}

/// The error function erf for `x >= 0`, with an absolute error of 5e-7.
///
/// # Source
/// Abramowitz and Stegun 1964, 7.1.26.
#[inline]
fn erf(x: f32) -> f32 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let p = [1.061_405_4, -1.453_152, 1.421_413_8, -0.284_496_74, 0.254_829_6];
    let p = p.into_iter().fold(0.0, |sum, c| sum * t + c) * t;
    1.0 - p * exp(-(x * x))
}
