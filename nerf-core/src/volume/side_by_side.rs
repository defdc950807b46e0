//! Compositing of several rays at once. The state is a table with one row for each value of
//! [`Accumulator`](super::Accumulator), except colour, and one column for each ray.

use super::{MAX_TAU, alpha, light};
use crate::math::Math;
use crate::simd::{BLOCK, Lanes};

pub(crate) const ROWS: usize = 8;
/// The compositing state of a block of rays, `[row][ray]`.
pub(crate) type Rows = [[f32; BLOCK]; ROWS];
/// Row that holds the sum of optical thickness of each ray. The row after `TAU`, `OPACITY` or `DISTANCE` holds the
/// rounding error of the sum in that row.
const TAU: usize = 0;
const OPACITY: usize = 2;
const DISTANCE: usize = 4;
/// Row that holds the summed weights of each ray's samples since the last added colour. The next row, `LEFT`, holds the
/// transmittance.
const UNCOLOURED: usize = 6;
pub(crate) const LEFT: usize = 7;

/// Composites the density of one sample on each of several rays: lane `i` of each vector belongs to the ray in column
/// `from + i` of `rows`. If a ray's sum in row `UNCOLOURED` is then above `cut`, returns this sum in the ray's lane and
/// resets the sum in `rows` to 0; else returns 0 and keeps the sum. The results are those of `Accumulator::add_density`
/// and then `Accumulator::take_uncoloured`, called for each ray.
///
/// `sigma`: 1/world unit, a NaN is treated as 0. `t`: distance along the ray, `delta`: bin width, world units.
#[inline(always)]
pub(crate) fn add_samples<M: Math, V: Lanes>(
    rows: &mut Rows,
    from: usize,
    [sigma, t, delta]: [V; 3],
    cut: f32,
) -> V {
    let (zero, most) = (V::splat(0.0), V::splat(f32::MAX));
    // A sample without density must leave the ray's state bit-identical.
    let dense = zero.less(sigma);
    let sigma = V::select(dense, sigma, zero).min_of(most);
    let tau = sigma.mul(delta.max_of(zero).min_of(most)).min_of(V::splat(MAX_TAU));
    let total = add((&mut *rows, from), TAU, tau, zero.less(tau));
    let before = V::load(&rows[LEFT][from..]);
    V::select(dense, light::<M, V>(total), before).store(&mut rows[LEFT][from..]);
    let weight = V::select(dense, before.mul(alpha::<M, V>(tau)), zero);
    let counts = zero.less(weight);
    add((&mut *rows, from), OPACITY, weight, counts);
    add((&mut *rows, from), DISTANCE, weight.mul(t), counts);
    let waiting = V::load(&rows[UNCOLOURED][from..]).add(weight);
    let takes = V::splat(cut).less(waiting);
    V::select(takes, zero, waiting).store(&mut rows[UNCOLOURED][from..]);
    V::select(takes, waiting, zero)
}

/// Adds `x` to one compensated sum per ray (`Sum::add`), only in lanes whose mask `counts` is set. Row `first` holds
/// the sums, the next row their rounding errors. Returns the sums.
#[inline(always)]
fn add<V: Lanes>((rows, from): (&mut Rows, usize), first: usize, x: V, counts: V::Mask) -> V {
    let (value, lost) = (V::load(&rows[first][from..]), V::load(&rows[first + 1][from..]));
    let corrected = x.sub(lost);
    let more = value.add(corrected);
    let sum = V::select(counts, more, value);
    sum.store(&mut rows[first][from..]);
    V::select(counts, more.sub(value).sub(corrected), lost).store(&mut rows[first + 1][from..]);
    sum
}
