//! Address ranges, and checks that they do not overlap.

use crate::failure::Failure;
use core::ffi::c_void;

/// An address range of `length` bytes from `start`. `start + length` does not overflow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Span {
    start: usize,
    length: usize,
}

impl Span {
    pub const EMPTY: Self = Self { start: 0, length: 0 };

    /// Returns a range of `length` bytes from `start`; an error if `length` exceeds an `isize` or the end overflows.
    pub fn new(name: &'static str, start: *const c_void, length: usize) -> Result<Self, Failure> {
        let start = start as usize;
        let fits = isize::try_from(length).is_ok() && start.checked_add(length).is_some();
        if fits { Ok(Self { start, length }) } else { Err(Failure::Overflow(name)) }
    }

    /// Returns the address range of `count` values of `T` from `start`; an error if `start` is NULL or misaligned.
    pub fn of<T>(name: &'static str, start: *const T, count: usize) -> Result<Self, Failure> {
        if start.is_null() {
            return Err(Failure::Null(name));
        }
        check_aligned(name, start as usize, align_of::<T>())?;
        let length = count.checked_mul(size_of::<T>()).ok_or(Failure::Overflow(name))?;
        Self::new(name, start.cast(), length)
    }

    /// Returns whether `self` and `other` share a byte.
    #[inline]
    pub fn meets(self, other: Self) -> bool {
        let shared = self.start.max(other.start)..(self.start + self.length).min(other.start + other.length);
        !shared.is_empty()
    }

    /// Returns an error if the ranges share a byte. `name`: name of `self` in the error; `of`: name of `other`.
    pub fn check_apart(self, name: &'static str, other: Self, of: &'static str) -> Result<(), Failure> {
        if self.meets(other) { Err(Failure::Overlap { name, other: of }) } else { Ok(()) }
    }
}

/// Array of elements of `size` bytes, each `stride` bytes after the previous one, all within `span`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pieces {
    pub span: Span,
    pub stride: usize,
    pub size: usize,
}

impl Pieces {
    pub const NONE: Self = Self { span: Span::EMPTY, stride: 1, size: 0 };

    /// Returns an error if an element of `self` may overlap an element of `other`. Interleaved arrays of equal stride
    /// are accepted. `name`, `of`: as in [`Span::check_apart`].
    #[inline]
    pub fn check_apart(self, name: &'static str, other: Self, of: &'static str) -> Result<(), Failure> {
        // Most arrays lie apart as a whole.
        if self.span.meets(other.span) && !self.interleaves(other) {
            return Err(Failure::Overlap { name, other: of });
        }
        Ok(())
    }

    /// Returns whether the arrays have the same stride, and no element of one reaches into an element of the other.
    fn interleaves(self, other: Self) -> bool {
        let behind = other.span.start.wrapping_sub(self.span.start);
        if self.stride == other.stride && self.stride > 0 {
            // Bytes, less than a stride, from an element's start in `self` to the next element's start in `other`.
            let offset = if other.span.start >= self.span.start {
                behind % self.stride
            } else {
                (self.stride - self.span.start.wrapping_sub(other.span.start) % self.stride) % self.stride
            };
            return offset >= self.size && offset + other.size <= self.stride;
        }
        false
    }
}

/// Memory of a plane: `rows` × `columns` disjoint pixels of `size` bytes; gaps between pixels or rows are allowed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlaneBytes {
    /// Lowest address of the plane.
    first: usize,
    columns: usize,
    rows: usize,
    pixel_stride: usize,
    row_stride: usize,
    size: usize,
}

impl PlaneBytes {
    /// Describes the memory of a plane of `columns` × `rows` pixels of `size` bytes. `data`: address of the top left
    /// pixel. Strides are in bytes; `row_stride` may be negative. The caller ensures that no address overflows.
    pub fn new(
        data: usize,
        (columns, rows): (usize, usize),
        (pixel_stride, row_stride): (usize, isize),
        size: usize,
    ) -> Self {
        let up = if row_stride < 0 { rows.saturating_sub(1) * row_stride.unsigned_abs() } else { 0 };
        Self { first: data - up, columns, rows, pixel_stride, row_stride: row_stride.unsigned_abs(), size }
    }

    pub fn check_apart(&self, name: &'static str, other: &Self, of: &'static str) -> Result<(), Failure> {
        if self.meets(other) { Err(Failure::Overlap { name, other: of }) } else { Ok(()) }
    }

    fn meets(&self, other: &Self) -> bool {
        if self.is_empty() || other.is_empty() || self.are_channels_with(other) {
            return false;
        }
        let row_length = self.row_length();
        (0..self.rows).map(|row| self.first + row * self.row_stride).any(|row| {
            let pixels = (0..self.columns).map(|column| row + column * self.pixel_stride);
            other.has_any(row, row_length) && pixels.into_iter().any(|pixel| other.has_any(pixel, self.size))
        })
    }

    fn is_empty(&self) -> bool {
        self.columns == 0 || self.rows == 0
    }

    /// Returns the length of a row, bytes: start of first pixel to end of last pixel. The plane must not be empty.
    fn row_length(&self) -> usize {
        (self.columns - 1) * self.pixel_stride + self.size
    }

    /// Returns whether the pixels of both planes interleave like fields of one structure, without overlap. Compares
    /// only first addresses, strides and pixel sizes.
    fn are_channels_with(&self, other: &Self) -> bool {
        let (low, high) = if self.first <= other.first { (self, other) } else { (other, self) };
        let offset = high.first - low.first;
        (low.pixel_stride, low.row_stride) == (high.pixel_stride, high.row_stride)
            && low.row_stride.checked_div(low.pixel_stride) >= Some(low.columns.max(high.columns))
            && low.size <= offset
            && offset.saturating_add(high.size) <= low.pixel_stride
    }

    /// Returns whether any pixel of the plane overlaps the `length` bytes from address `at`. The plane must not be
    /// empty.
    fn has_any(&self, at: usize, length: usize) -> bool {
        let (start, end) = (at.saturating_sub(self.first), (at + length).saturating_sub(self.first));
        // Index of the first element that ends after offset `place`. An element starts every `stride` bytes.
        let behind = |place: usize, stride: usize, size: usize| {
            place
                .checked_sub(size)
                .and_then(|beyond| beyond.checked_div(stride))
                .map_or(0, |pieces| pieces + 1)
        };
        (behind(start, self.row_stride, self.row_length())..self.rows)
            .map(|row| row * self.row_stride)
            .take_while(|&row| row < end)
            .any(|row| {
                let column = behind(start.saturating_sub(row), self.pixel_stride, self.size);
                column < self.columns && column * self.pixel_stride < end - row
            })
    }
}

/// Returns an error if the address or stride `found` is not a multiple of `expected`, a power of two.
pub(crate) fn check_aligned(name: &'static str, found: usize, expected: usize) -> Result<(), Failure> {
    if found & (expected - 1) == 0 { Ok(()) } else { Err(Failure::Alignment { name, expected, found }) }
}
