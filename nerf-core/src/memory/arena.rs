//! Typed slices in the caller's memory. Each stage of the renderer has one function that requests the stage's buffers
//! from a [`Layout`]: [`Measure`] counts the 64-byte lines of memory, and [`Arena`] allocates the buffers.

use core::mem::{MaybeUninit, align_of, size_of};

/// One cache line of workspace, 64 bytes. Callers pass memory to this crate as slices of lines. A line's alignment
/// suits the vector loads of every instruction set.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Line([MaybeUninit<u8>; 64]);

impl Line {
    /// A line of 64 uninitialised bytes. `[Line::UNINIT; n]` is a workspace of `n` lines.
    pub const UNINIT: Self = Self([MaybeUninit::uninit(); 64]);
}

/// Number of 64-byte lines that `count` values of `T` occupy.
pub const fn lines_for<T>(count: usize) -> usize {
    count.saturating_mul(size_of::<T>()).div_ceil(size_of::<Line>())
}

/// Source of the buffers of a rendering stage: [`Measure`] counts the 64-byte lines that the buffers need, [`Arena`]
/// allocates the buffers.
pub trait Layout<'w> {
    /// Returns a slice of `count` copies of `value`, aligned to 64 bytes (a [`Line`]). [`Measure`] always returns an
    /// empty slice. [`Arena`] returns an empty slice if too little memory is left.
    fn slice<T: Copy>(&mut self, count: usize, value: T) -> &'w mut [T];
}

/// A [`Layout`] that only counts the 64-byte lines that the requested buffers need, and returns empty slices.
#[derive(Clone, Copy, Debug, Default)]
pub struct Measure {
    /// Number of lines counted so far.
    pub lines: usize,
}

impl Measure {
    /// Runs `lay_out` and returns the number of 64-byte lines that the requested buffers need.
    #[inline]
    pub fn lines_of<T>(lay_out: impl FnOnce(&mut Self) -> T) -> usize {
        let mut measure = Self::default();
        lay_out(&mut measure);
        measure.lines
    }
}

impl<'w> Layout<'w> for Measure {
    fn slice<T: Copy>(&mut self, count: usize, _: T) -> &'w mut [T] {
        self.lines = self.lines.saturating_add(lines_for::<T>(count));
        &mut []
    }
}

/// Allocator that cuts slices from a workspace, one after another, from the beginning.
pub struct Arena<'w> {
    rest: &'w mut [Line],
}

impl<'w> Arena<'w> {
    /// Makes an arena that allocates slices from `lines`.
    pub fn new(lines: &'w mut [Line]) -> Self {
        Self { rest: lines }
    }
}

impl<'w> Layout<'w> for Arena<'w> {
    fn slice<T: Copy>(&mut self, count: usize, value: T) -> &'w mut [T] {
        const { assert!(align_of::<T>() <= align_of::<Line>()) };
        let lines = lines_for::<T>(count);
        let Some((taken, rest)) = core::mem::take(&mut self.rest).split_at_mut_checked(lines) else {
            return &mut [];
        };
        self.rest = rest;
        let start = taken.as_mut_ptr().cast::<T>();
        for i in 0..count {
            // SAFETY: `taken` spans `count` values (`lines_for`), is aligned for T (asserted above)
            // and borrowed exclusively for 'w.
            unsafe { start.add(i).write(value) };
        }
        // SAFETY: `taken` spans `count` values, is aligned for T, and the loop has written every value.
        unsafe { core::slice::from_raw_parts_mut(start, count) }
    }
}
