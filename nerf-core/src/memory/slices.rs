//! Slicing that panics only in builds with debug assertions.
//!
//! A length that does not fit is a bug. Builds without debug assertions then return a slice that is as long as
//! possible, so that a microcontroller's build contains no panic.

/// Returns the first `n` values of `all`. If `all` is shorter: panics with debug assertions, else returns all values.
#[inline(always)]
pub fn head<T>(all: &[T], n: usize) -> &[T] {
    debug_assert!(n <= all.len(), "expected {n} values, found {}", all.len());
    all.get(..n).unwrap_or(all)
}

/// Returns the first `n` values of `all`. If `all` is shorter: panics with debug assertions, else returns all values.
#[inline(always)]
pub fn head_mut<T>(all: &mut [T], n: usize) -> &mut [T] {
    let found = all.len();
    debug_assert!(n <= found, "expected {n} values, found {found}");
    &mut all[..n.min(found)]
}

/// Returns the values of `all` after the first `n`. If `all` has fewer than `n` values: panics with debug assertions,
/// else returns an empty slice.
#[inline(always)]
pub fn tail<T>(all: &[T], n: usize) -> &[T] {
    debug_assert!(n <= all.len(), "expected {n} values, found {}", all.len());
    all.get(n..).unwrap_or_default()
}

/// Returns the values of `all` after the first `n`. If `all` has fewer than `n` values: panics with debug assertions,
/// else returns an empty slice.
#[inline(always)]
pub fn tail_mut<T>(all: &mut [T], n: usize) -> &mut [T] {
    debug_assert!(n <= all.len(), "expected {n} values, found {}", all.len());
    all.get_mut(n..).unwrap_or_default()
}

/// Reads column `column` of a block of `N` rows, `[N][stride]`. If the block is too short: panics with debug
/// assertions, else returns 0 for each missing value.
#[inline]
pub fn column<const N: usize>(block: &[f32], stride: usize, column: usize) -> [f32; N] {
    debug_assert!((N - 1) * stride + column < block.len(), "column {column} of {stride}");
    core::array::from_fn(|row| block.get(row * stride + column).copied().unwrap_or_default())
}

/// Writes `values` into column `column` of a block of `N` rows, `[N][stride]`. If the block is too short: panics with
/// debug assertions, else does not write the values that would lie beyond the end of the block.
#[inline]
pub fn put_column<const N: usize>(block: &mut [f32], stride: usize, column: usize, values: [f32; N]) {
    for (row, value) in values.into_iter().enumerate() {
        put(block, row * stride + column, value);
    }
}

/// Reads value `i` of `all`. If `i` is beyond the end: panics with debug assertions, else returns `T::default()`.
#[inline(always)]
pub fn at<T: Copy + Default>(all: &[T], i: usize) -> T {
    debug_assert!(i < all.len(), "expected more than {i} values, found {}", all.len());
    all.get(i).copied().unwrap_or_default()
}

/// Writes `value` to element `i` of `all`. If `i` is beyond the end: panics with debug assertions, else does nothing.
#[inline(always)]
pub fn put<T>(all: &mut [T], i: usize, value: T) {
    debug_assert!(i < all.len(), "expected more than {i} values, found {}", all.len());
    if let Some(place) = all.get_mut(i) {
        *place = value;
    }
}
