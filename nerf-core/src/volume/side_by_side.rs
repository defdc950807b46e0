//! Compositing of several rays at once: the state of [`Accumulator`] without colour, a row a value and a column a ray.

use super::{Accumulator, MAX_TAU, alpha, light};
use crate::math::{Math, Sum};
use crate::memory::{at, put, tail, tail_mut};
use crate::simd::Lanes;

/// Number of rows.
pub(crate) const ROWS: usize = 8;
/// First row of each sum, whose value is followed by what rounding lost.
const TAU: usize = 0;
const OPACITY: usize = 2;
const DISTANCE: usize = 4;
/// Weight without a colour yet, and transmittance.
const UNCOLOURED: usize = 6;
const LEFT: usize = 7;

impl Accumulator {
    /// Writes its state, without colours, to column `column` of `[ROWS][stride]`.
    pub(crate) fn put_column(&self, rows: &mut [f32], stride: usize, column: usize) {
        let Self { tau, opacity, distance, uncoloured, left, .. } = self;
        let sums = [tau, opacity, distance].map(|sum| [sum.value, sum.lost]);
        let values = sums.into_iter().flatten().chain([*uncoloured, *left]);
        for (row, value) in values.enumerate() {
            put(rows, row * stride + column, value);
        }
    }

    /// Reads its state from column `column` of `[ROWS][stride]`; colours stay.
    pub(crate) fn take_column(&mut self, rows: &[f32], stride: usize, column: usize) {
        let row = |row: usize| at(rows, row * stride + column);
        let sum = |first: usize| Sum { value: row(first), lost: row(first + 1) };
        (self.tau, self.opacity, self.distance) = (sum(TAU), sum(OPACITY), sum(DISTANCE));
        (self.uncoloured, self.left) = (row(UNCOLOURED), row(LEFT));
    }
}

/// Transmittance of the ray in column `column` of `[ROWS][stride]`.
pub(crate) fn left_of(rows: &[f32], stride: usize, column: usize) -> f32 {
    at(rows, LEFT * stride + column)
}

/// Adds a sample to each ray of a vector that begins at `column`: [`Accumulator::add_density`]. Returns the weight that
/// [`Accumulator::take_uncoloured`] gives for each, or 0.
///
/// `rows`: `[ROWS][stride]`; `sigma` 1/world unit, NaN as 0; `t`, `delta`: world units along the ray.
#[inline(always)]
pub(crate) fn add_samples<M: Math, V: Lanes>(
    (rows, stride, column): (&mut [f32], usize, usize),
    [sigma, t, delta]: [V; 3],
    cut: f32,
) -> V {
    let (zero, most) = (V::splat(0.0), V::splat(f32::MAX));
    // No sample without a density changes a bit.
    let dense = zero.less(sigma);
    let sigma = V::select(dense, sigma, zero).min_of(most);
    let tau = sigma.mul(delta.max_of(zero).min_of(most)).min_of(V::splat(MAX_TAU));
    let total = add((&mut *rows, stride, column), TAU, tau, zero.less(tau));
    let load = |rows: &[f32], row: usize| V::load(tail(rows, row * stride + column));
    let before = load(rows, LEFT);
    V::select(dense, light::<M, V>(total), before).store(tail_mut(rows, LEFT * stride + column));
    let weight = V::select(dense, before.mul(alpha::<M, V>(tau)), zero);
    let counts = zero.less(weight);
    add((&mut *rows, stride, column), OPACITY, weight, counts);
    add((&mut *rows, stride, column), DISTANCE, weight.mul(t), counts);
    let waiting = load(rows, UNCOLOURED).add(weight);
    let takes = V::splat(cut).less(waiting);
    V::select(takes, zero, waiting).store(tail_mut(rows, UNCOLOURED * stride + column));
    V::select(takes, waiting, zero)
}

/// Adds `x` where it `counts` to the sums whose value is row `first` and whose rest is the next: [`Sum::add`].
#[inline(always)]
fn add<V: Lanes>(
    (rows, stride, column): (&mut [f32], usize, usize),
    first: usize,
    x: V,
    counts: V::Mask,
) -> V {
    let at = [first, first + 1].map(|row| row * stride + column);
    let [value, lost] = at.map(|at| V::load(tail(rows, at)));
    let corrected = x.sub(lost);
    let more = value.add(corrected);
    let sum = V::select(counts, more, value);
    sum.store(tail_mut(rows, at[0]));
    V::select(counts, more.sub(value).sub(corrected), lost).store(tail_mut(rows, at[1]));
    sum
}
