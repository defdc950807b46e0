//! Typed slices out of the caller's memory.

use core::mem::{MaybeUninit, align_of, size_of};

/// One cache line of workspace. A slice of lines is how memory is handed to this crate: it brings
/// the alignment that every tier's loads like.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Line([MaybeUninit<u8>; 64]);

impl Line {
    /// A line nobody has written to.
    pub const UNINIT: Self = Self([MaybeUninit::uninit(); 64]);
}

/// Lines that `count` values of `T` take.
pub const fn lines_for<T>(count: usize) -> usize {
    count.saturating_mul(size_of::<T>()).div_ceil(size_of::<Line>())
}

/// Hands out slices from the front of a workspace.
pub struct Arena<'w> {
    rest: &'w mut [Line],
}

impl<'w> Arena<'w> {
    /// An arena over all of `lines`.
    pub fn new(lines: &'w mut [Line]) -> Self {
        Self { rest: lines }
    }

    /// `count` values, all `value`, on lines of their own; `None` if the memory is used up.
    pub fn slice<T: Copy>(&mut self, count: usize, value: T) -> Option<&'w mut [T]> {
        const { assert!(align_of::<T>() <= align_of::<Line>()) };
        let lines = lines_for::<T>(count);
        let (taken, rest) = core::mem::take(&mut self.rest).split_at_mut_checked(lines)?;
        self.rest = rest;
        let start = taken.as_mut_ptr().cast::<T>();
        for i in 0..count {
            // SAFETY: `taken` spans `count` values (`lines_for`), is aligned for T (asserted above)
            // and borrowed exclusively for 'w.
            unsafe { start.add(i).write(value) };
        }
        // SAFETY: as above, and every value has just been written.
        Some(unsafe { core::slice::from_raw_parts_mut(start, count) })
    }
}
