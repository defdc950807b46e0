//! Ranges of addresses, checked before anything is made of them.

use crate::failure::Failure;
use core::ffi::c_void;

/// `length` bytes from `start` on; the end does not overflow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Span {
    start: usize,
    length: usize,
}

impl Span {
    /// Nothing.
    pub const EMPTY: Self = Self { start: 0, length: 0 };

    /// The bytes from `start` on; an error where no Rust slice could be that long.
    pub fn new(name: &'static str, start: *const c_void, length: usize) -> Result<Self, Failure> {
        let start = start as usize;
        let fits = isize::try_from(length).is_ok() && start.checked_add(length).is_some();
        if fits { Ok(Self { start, length }) } else { Err(Failure::Overflow(name)) }
    }

    /// `count` values of `T`, aligned for it, not at NULL.
    pub fn of<T>(name: &'static str, start: *const T, count: usize) -> Result<Self, Failure> {
        if start.is_null() {
            return Err(Failure::Null(name));
        }
        check_aligned(name, start as usize, align_of::<T>())?;
        let length = count.checked_mul(size_of::<T>()).ok_or(Failure::Overflow(name))?;
        Self::new(name, start.cast(), length)
    }

    /// Whether a byte belongs to both.
    fn meets(self, other: Self) -> bool {
        let shared = self.start.max(other.start)..(self.start + self.length).min(other.start + other.length);
        !shared.is_empty()
    }

    /// An error where the two share a byte.
    pub fn check_apart(self, name: &'static str, other: Self, of: &'static str) -> Result<(), Failure> {
        if self.meets(other) { Err(Failure::Overlap { name, other: of }) } else { Ok(()) }
    }
}

/// Pieces of `size` bytes, each a `stride` behind the one before; they lie in `span`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pieces {
    pub span: Span,
    pub stride: usize,
    pub size: usize,
}

impl Pieces {
    /// None.
    pub const NONE: Self = Self { span: Span::EMPTY, stride: 1, size: 0 };

    /// An error where the two share a byte, or may: fields of the same structures do not.
    pub fn check_apart(self, name: &'static str, other: Self, of: &'static str) -> Result<(), Failure> {
        let behind = other.span.start.wrapping_sub(self.span.start);
        if self.stride == other.stride && self.stride > 0 {
            // Where the other's pieces begin in the gaps of these: the address space is a multiple of no stride.
            let offset = if other.span.start >= self.span.start {
                behind % self.stride
            } else {
                (self.stride - self.span.start.wrapping_sub(other.span.start) % self.stride) % self.stride
            };
            if offset >= self.size && offset + other.size <= self.stride {
                return Ok(());
            }
        }
        self.span.check_apart(name, other.span, of)
    }
}

/// An error unless `value` is a multiple of `expected`.
pub(crate) fn check_aligned(name: &'static str, value: usize, expected: usize) -> Result<(), Failure> {
    if value.is_multiple_of(expected) {
        Ok(())
    } else {
        Err(Failure::Alignment { name, expected, found: value })
    }
}
