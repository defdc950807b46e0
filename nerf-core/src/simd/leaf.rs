//! Code shared by the vector types of all instruction sets: macros for methods, and table interpolation that loads four
//! neighbouring values at once, generic over [`Quads`].

use super::lanes::weighted_rows_by_lane;
use super::table::{Table, Value};
use super::{Indices, Lanes};

/// Declares methods of a vector type. The body of each method is an expression of intrinsics. An expression must have
/// its own SAFETY comment if it is unsafe for any reason besides possibly missing instructions.
macro_rules! instructions {
    ($(fn $name:ident $(<const $lane:ident: usize>)? ($($arguments:tt)*) $(-> $type:ty)? = $value:expr;)+) => {$(
        #[inline(always)]
        #[allow(unused_unsafe, reason = "WebAssembly's are safe")]
        fn $name $(<const $lane: usize>)? ($($arguments)*) $(-> $type)? {
            // SAFETY: vectors of this type are used only where the CPU has their instructions.
            unsafe { $value }
        }
    )+};
}

/// Defines `COUNT`, `load`, `store` and `weighted_rows` of [`Lanes`] for a vector type of `$count` f32, which must
/// implement [`Quads`]. The intrinsics `$load` and `$store` must accept any alignment.
macro_rules! lanes_in_memory {
    ($count:literal, $load:ident, $store:ident) => {
        const COUNT: usize = {
            assert!(MAX_LANES.is_multiple_of($count));
            $count
        };

        #[inline(always)]
        fn load(from: &[f32]) -> Self {
            let from = &from[..$count];
            // SAFETY: `from` has `$count` values. Vectors of this type are used only where the CPU has their
            // instructions.
            Self(unsafe { $load(from.as_ptr().cast()) })
        }
        #[inline(always)]
        fn store(self, to: &mut [f32]) {
            let to = &mut to[..$count];
            // SAFETY: `to` has `$count` values. Vectors of this type are used only where the CPU has their
            // instructions.
            unsafe { $store(to.as_mut_ptr().cast(), self.0) }
        }
        #[inline(always)]
        fn weighted_rows<T: Value, const ROWS: usize>(
            table: Table<'_, T>,
            rows: &[Self::Indices; ROWS],
            weights: &[Self; ROWS],
            features: usize,
        ) -> [Self; 8] {
            super::leaf::weighted_rows(table, rows, weights, features)
        }
    };
}
pub(super) use {instructions, lanes_in_memory};

/// Vector operations from which [`weighted_rows`] is built. A vector consists of groups of four lanes. Each lane has
/// its own table rows to sum. The sums are computed in four passes, numbered by `LANE` from 0 to 3. Each pass sums the
/// rows of lane `LANE` of every group. During a pass, the four lanes of a group hold four neighbouring values of one
/// row of lane `LANE`.
pub trait Quads: Lanes {
    /// Whether [`weighted_rows`] moves offsets from vectors to scalar registers through memory. True for instruction
    /// sets on which this is faster.
    const OFFSETS_IN_MEMORY: bool = false;
    /// Whether each pass of [`weighted_rows`] stores its sums to memory instead of keeping them in registers. The store
    /// keeps the compiler from moving loads of the next pass in front of it, which would take too many registers.
    const SUMS_IN_MEMORY: bool = false;
    /// Offset of a table value for each lane, in values from the start of the table.
    type Offsets: Copy;

    fn offsets(indices: Self::Indices) -> Self::Offsets;
    /// Loads four neighbouring values for lane `LANE` of each group, beginning `plus` values after that lane's offset.
    ///
    /// # Safety
    /// The four values of each group must lie inside the table.
    unsafe fn read_four<T: Value, const LANE: usize>(
        table: Table<'_, T>,
        at: &Self::Offsets,
        plus: usize,
    ) -> Self;
    /// Copies lane `LANE` of each group to all four lanes of the group.
    fn repeat<const LANE: usize>(self) -> Self;
    /// Interleaves lanes: returns `[a0, b0, a1, b1]` and `[a2, b2, a3, b3]` for each group `[a0, a1, a2, a3]` of `self`
    /// and the same group `[b0, b1, b2, b3]` of `b`.
    fn zip(self, b: Self) -> [Self; 2];
    /// Interleaves pairs of lanes: returns `[a0, a1, b0, b1]` and `[a2, a3, b2, b3]` for each group `[a0, a1, a2, a3]`
    /// of `self` and the same group `[b0, b1, b2, b3]` of `b`.
    fn zip_pairs(self, b: Self) -> [Self; 2];
}

/// Interpolates in a table: returns the weighted sum of rows for each lane ([`Lanes::weighted_rows`]). Loads four
/// neighbouring values at once, or one by one if the length of a row is no multiple of four.
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
    // A loop, since a closure would not be compiled for the vector's instruction set.
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

/// Returns four weighted sums for each lane. Sum `i` is `Σ weight · values[offset + plus + i]` over the lane's
/// `offsets` and `weights`.
#[inline(always)]
fn four<V: Quads, T: Value, const ROWS: usize>(
    table: Table<'_, T>,
    offsets: &[V::Offsets; ROWS],
    weights: &[V; ROWS],
    plus: usize,
) -> [V; 4] {
    // `s0` to `s3` hold four sums for one lane of each group. Their transpose holds one sum for each lane.
    let s0 = sum_of_lane::<V, T, ROWS, 0>(table, offsets, weights, plus);
    let s1 = sum_of_lane::<V, T, ROWS, 1>(table, offsets, weights, plus);
    let s2 = sum_of_lane::<V, T, ROWS, 2>(table, offsets, weights, plus);
    let s3 = sum_of_lane::<V, T, ROWS, 3>(table, offsets, weights, plus);
    let ([a, b], [c, d]) = (s0.zip(s1), s2.zip(s3));
    let ([v0, v1], [v2, v3]) = (a.zip_pairs(c), b.zip_pairs(d));
    [v0, v1, v2, v3]
}

/// Computes the four sums of [`four`] for lane `LANE` of each group ([`Quads`]), into the group's four lanes.
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

/// Returns the address of value `offset + plus` of a table, without a check that the table has this value.
#[inline(always)]
pub fn address<T: Value>(table: Table<'_, T>, offset: u32, plus: usize) -> *const u8 {
    table.values.as_ptr().wrapping_add(offset as usize + plus).cast()
}

/// Returns the largest index at which a row (two entries) fits inside the table, in entries. [`weighted_rows`] clamps
/// the indices of rows to this index. `None` if the length of a row is no multiple of four values, or if the table is
/// shorter than a row.
#[inline(always)]
fn last_row<T: Value>(table: Table<'_, T>, features: usize) -> Option<u32> {
    let entries = match features {
        2 => table.values.len() / 2,
        4 => table.values.len() / 4,
        _ => return None,
    };
    u32::try_from(entries.checked_sub(2)?).ok()
}

/// Returns the largest offset at which four bytes fit inside `bytes`. Gathers of 32-bit words clamp their offsets to
/// this offset. `None` if `bytes` has fewer than four bytes, or if the offset exceeds 2^31 − 1.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub fn last_word(bytes: &[u8]) -> Option<u32> {
    i32::try_from(bytes.len().checked_sub(4)?).ok().map(i32::cast_unsigned)
}
