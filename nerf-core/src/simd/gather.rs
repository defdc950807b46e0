//! What the leaves' table reads share.

use crate::simd::table::Table;

/// The last entry that a row of two can begin with and still lie inside the table, where a row is a whole number
/// of four values; `None` where it is not, or where nothing fits.
#[inline(always)]
pub fn last_row<T: Table>(table: T, features: usize) -> Option<u32> {
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
