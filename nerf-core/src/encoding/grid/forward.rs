//! Encoding of a block of samples by a grid.

use super::cell::{Cells, unit_positions};
use super::{GridEncoding, GridLevel, GridTables, TableValues, with_table};
use crate::memory::{head, head_mut, put, tail_mut};
use crate::simd::{Isa, Lanes, Op, Table, VECTORS, Value};

/// Encodes a block of samples by a grid.
///
/// `x`: `[inputs][stride]`, in the coordinates of the box of `tables`. `out`: `[levels · features][stride]`. `stride`:
/// number of samples. If `stride` is not a multiple of [`Isa::columns`], samples are encoded one by one. A position
/// outside of the box is moved onto the box's surface. A NaN is replaced by the smallest coordinate of the box on that
/// axis.
///
/// A sample's values do not depend on the other samples of its block. Results are bit-identical whether the same table
/// values are stored as f16, as f32, or as int8 with scales that are powers of two. All instruction sets find the same
/// cell for a sample. If a table is too short, arbitrary numbers are used in place of its missing values.
///
/// # Accuracy
/// An encoded value differs from the same interpolation in f64 by at most `2^-24 (n (6 cells + 6) + 12)` times the
/// largest |value| at the corners of the sample's cell. `n` is the number of axes, and `cells` the largest number of
/// cells along an axis. The bound covers rounding of the position and of the interpolation's sum.
///
/// # Panics
/// With debug assertions, if `x` or `out` is too short.
pub fn encode_grid_block(
    isa: Isa,
    grid: &GridEncoding,
    tables: &GridTables<'_>,
    stride: usize,
    x: &[f32],
    out: &mut [f32],
) {
    let x = head(x, usize::from(grid.inputs) * stride);
    let out = head_mut(out, grid.outputs() * stride);
    if !VECTORS || !isa.fills(stride) {
        return encode_one_by_one(grid, tables, stride, x, out);
    }
    with_table!(tables.values, table => isa.run_columns(stride, Encode { grid, tables, table, stride, x, out }));
}

/// Encodes one sample and one level at a time, with a run-time number of features: for blocks that are not a multiple of
/// [`Isa::columns`], and in builds without vector instructions, where code size matters more than speed. A 2D sample also
/// reads two rows of corners with weight 0, which leaves the result bit-identical.
pub(super) fn encode_one_by_one(
    grid: &GridEncoding,
    tables: &GridTables<'_>,
    stride: usize,
    x: &[f32],
    out: &mut [f32],
) {
    let features = usize::from(grid.features).min(4);
    for column in 0..stride {
        let unit = unit_positions::<f32>(tables, usize::from(grid.inputs), stride, x, column);
        for level in grid.levels() {
            let read = Read::<f32, 4>::of(&level, unit);
            let values = with_table!(tables.values, table => read.interpolate(table, &level, features));
            for (feature, value) in values.into_iter().enumerate().take(features) {
                put(out, (level.index * features + feature) * stride + column, value);
            }
        }
    }
}

/// Number of vectors of samples that are encoded together at a level, so that the level's constants stay in registers.
const AT_ONCE: usize = 8;

struct Encode<'a, T> {
    grid: &'a GridEncoding,
    tables: &'a GridTables<'a>,
    table: Table<'a, T>,
    stride: usize,
    x: &'a [f32],
    out: &'a mut [f32],
}

impl<T: Value> Op for Encode<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        // Sizes that are faster with a constant number of features. 3D with four features takes as long without.
        match (self.grid.inputs, self.grid.features) {
            (2, 2) => self.encode::<V, 2, 2>(),
            (3, 1) => self.encode::<V, 4, 1>(),
            (3, 2) => self.encode::<V, 4, 2>(),
            _ => self.encode::<V, 4, 0>(),
        }
    }
}

impl<T: Value> Encode<'_, T> {
    /// `FEATURES`: number of features per level; 0 for a run-time number. `ROWS`: number of rows of corners, 2 or 4; with
    /// 4, a 2D sample also reads two rows with weight 0, which leaves the result bit-identical.
    #[inline(always)]
    fn encode<V: Lanes, const ROWS: usize, const FEATURES: usize>(self) {
        let (stride, inputs) = (self.stride, usize::from(self.grid.inputs));
        for first in (0..stride).step_by(AT_ONCE * V::COUNT) {
            let mut units = heapless::Vec::<[V; 3], AT_ONCE>::new();
            for column in (first..stride).step_by(V::COUNT).take(AT_ONCE) {
                let _ = units.push(unit_positions(self.tables, inputs, stride, self.x, column));
            }
            let reads = &mut heapless::Vec::new();
            for level in self.grid.levels() {
                let to = (first, stride, &mut *self.out);
                encode_level::<V, T, ROWS, FEATURES>(self.table, self.grid, &level, &units, reads, to);
            }
        }
    }
}

/// Encodes the positions `units`, 0 to 1 on each axis of the box, at one level. Writes the encoded values to `out`,
/// `[outputs][stride]`, from column `first` on. `reads`: working memory, overwritten.
///
/// Not inlined in WebAssembly: in a larger function, V8 recomputes the level's constants for each vector.
#[cfg_attr(target_arch = "wasm32", inline(never))]
#[cfg_attr(not(target_arch = "wasm32"), inline(always))]
fn encode_level<V: Lanes, T: Value, const ROWS: usize, const FEATURES: usize>(
    table: Table<'_, T>,
    grid: &GridEncoding,
    level: &GridLevel,
    units: &[[V; 3]],
    reads: &mut heapless::Vec<Read<V, ROWS>, AT_ONCE>,
    (first, stride, out): (usize, usize, &mut [f32]),
) {
    let features = if FEATURES == 0 { usize::from(grid.features).min(4) } else { FEATURES };
    // Two loops, since the values of one loop fit into the registers, but those of a combined loop do not.
    reads.clear();
    for &unit in units {
        let _ = reads.push(Read::of(level, unit));
    }
    let mut column = level.index * features * stride + first;
    for read in &*reads {
        let values = read.interpolate(table, level, features);
        for (feature, value) in values.into_iter().enumerate().take(features) {
            value.store(tail_mut(out, column + feature * stride));
        }
        column += V::COUNT;
    }
}

/// The rows of table entries that a vector of samples reads at one level, and their interpolation weights.
#[derive(Clone, Copy)]
struct Read<V: Lanes, const ROWS: usize> {
    rows: [V::Indices; ROWS],
    weights: [V; ROWS],
    /// Weight of the entries at the larger x, 0 to 1.
    far: V,
}

impl<V: Lanes, const ROWS: usize> Read<V, ROWS> {
    #[inline(always)]
    fn of(level: &GridLevel, unit: [V; 3]) -> Self {
        let cells = Cells::of(level, unit);
        Self { rows: cells.rows(level), weights: cells.row_weights(), far: cells.weights[0] }
    }

    /// Returns the level's encoded values, one vector for each of `features` features. The remaining vectors are 0.
    #[inline(always)]
    fn interpolate<T: Value>(&self, table: Table<'_, T>, level: &GridLevel, features: usize) -> [V; 4] {
        let part = table.part(level.first * features, level.entries * features);
        let scale = V::splat(table.scale(level.index));
        let sums = V::weighted_rows(part, &self.rows, &self.weights, features);
        let mut values = [V::splat(0.0); 4];
        for (feature, value) in values.iter_mut().enumerate().take(features) {
            let (near, far) = (sums[feature], sums[features + feature]);
            *value = self.far.mul_add(far.sub(near), near).mul(scale);
        }
        values
    }
}
