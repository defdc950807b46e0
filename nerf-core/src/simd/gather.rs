//! Interpolation over a table by vectors that read four neighbouring values at once: written once over [`Quads`].

use crate::simd::lanes::weighted_rows_by_lane;
use crate::simd::table::{Table, Value};
use crate::simd::{Indices, Lanes};

/// The primitives of [`weighted_rows`]. A vector is groups of four lanes; while rows are summed, a group holds the four
/// values of one of its lanes.
pub trait Quads: Lanes {
    /// Whether offsets reach scalar registers through memory, from where each is an address at once.
    const OFFSETS_IN_MEMORY: bool = false;
    /// Whether sums go through memory, so that the reads of the next lanes stay behind those of this one.
    const SUMS_IN_MEMORY: bool = false;
    /// An offset into a table for each lane.
    type Offsets: Copy;

    /// Offsets that are read one by one.
    fn offsets(indices: Self::Indices) -> Self::Offsets;
    /// Four values of lane `LANE` of each group, from `plus` behind its offset on.
    ///
    /// # Safety
    /// They are inside the table.
    unsafe fn read_four<T: Value, const LANE: usize>(
        table: Table<'_, T>,
        at: &Self::Offsets,
        plus: usize,
    ) -> Self;
    /// Lane `LANE` of each group in all four of it.
    fn repeat<const LANE: usize>(self) -> Self;
    /// The transpose of each group: vector `i` of the result has value `i` of each lane.
    fn transpose(lanes: [Self; 4]) -> [Self; 4];
}

/// [`Lanes::weighted_rows`] of a leaf that has [`Quads`].
macro_rules! weighted_rows_by_quads {
    () => {
        #[inline(always)]
        fn weighted_rows<T: Value, const ROWS: usize>(
            table: Table<'_, T>,
            rows: &[Self::Indices; ROWS],
            weights: &[Self; ROWS],
            features: usize,
        ) -> [Self; 8] {
            super::gather::weighted_rows(table, rows, weights, features)
        }
    };
}
pub(super) use weighted_rows_by_quads;

/// [`Lanes::weighted_rows`], four values of a lane at a time; value by value of a table that has no four.
#[inline(always)]
pub fn weighted_rows<V: Quads, T: Value, const ROWS: usize>(
    table: Table<'_, T>,
    rows: &[V::Indices; ROWS],
    weights: &[V; ROWS],
    features: usize,
) -> [V; 8] {
    let Some(last) = last_row(table, features) else {
        return weighted_rows_by_lane(table, rows, weights, features);
    };
    let (last, features_of_each) = (V::Indices::splat(last), V::Indices::splat(features as u32));
    // No closure: it would lose the leaf's instructions.
    let mut offsets = [V::offsets(V::Indices::splat(0)); ROWS];
    for (offsets, row) in offsets.iter_mut().zip(rows) {
        *offsets = V::offsets(row.min(last).mul(features_of_each));
    }
    let offsets = if V::OFFSETS_IN_MEMORY { core::hint::black_box(&offsets) } else { &offsets };
    let zero = V::splat(0.0);
    let [a, b, c, d] = four(table, offsets, weights, 0);
    if features == 2 {
        return [a, b, c, d, zero, zero, zero, zero];
    }
    let [e, f, g, h] = four(table, offsets, weights, 4);
    [a, b, c, d, e, f, g, h]
}

/// Four weighted values of each lane, from `plus` behind each of the `offsets` on.
#[inline(always)]
fn four<V: Quads, T: Value, const ROWS: usize>(
    table: Table<'_, T>,
    offsets: &[V::Offsets; ROWS],
    weights: &[V; ROWS],
    plus: usize,
) -> [V; 4] {
    V::transpose([
        sum_of_lane::<V, T, ROWS, 0>(table, offsets, weights, plus),
        sum_of_lane::<V, T, ROWS, 1>(table, offsets, weights, plus),
        sum_of_lane::<V, T, ROWS, 2>(table, offsets, weights, plus),
        sum_of_lane::<V, T, ROWS, 3>(table, offsets, weights, plus),
    ])
}

/// Four weighted values of lane `LANE` of each group.
#[inline(always)]
fn sum_of_lane<V: Quads, T: Value, const ROWS: usize, const LANE: usize>(
    table: Table<'_, T>,
    offsets: &[V::Offsets; ROWS],
    weights: &[V; ROWS],
    plus: usize,
) -> V {
    let mut sum = V::splat(0.0);
    for (at, weight) in offsets.iter().zip(weights) {
        // SAFETY: `last_row` keeps each row, and with it four values from `plus` on, inside the table.
        let values = unsafe { V::read_four::<T, LANE>(table, at, plus) };
        sum = weight.repeat::<LANE>().mul_add(values, sum);
    }
    if V::SUMS_IN_MEMORY { core::hint::black_box(sum) } else { sum }
}

/// The address of value `offset + plus` of a table.
#[inline(always)]
pub fn address<T: Value>(table: Table<'_, T>, offset: u32, plus: usize) -> *const u8 {
    table.start().wrapping_add(T::FORMAT.bytes() * (offset as usize + plus))
}

/// The last entry that a row of two can begin with and still lie inside the table, where a row is a whole number
/// of four values; `None` where it is not, or where nothing fits.
#[inline(always)]
fn last_row<T: Value>(table: Table<'_, T>, features: usize) -> Option<u32> {
    let entries = match features {
        2 => table.len() / 2,
        4 => table.len() / 4,
        _ => return None,
    };
    u32::try_from(entries.checked_sub(2)?).ok()
}

/// The last byte that four can be read from and still lie inside `bytes`, if an offset to it fits a lane.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub fn last_word(bytes: &[u8]) -> Option<u32> {
    i32::try_from(bytes.len().checked_sub(4)?).ok().map(i32::cast_unsigned)
}
