//! Memory between pages that nobody may touch: one byte too far, read or written, ends the process.
//!
//! Canaries ([`crate::memory`]) see writes alone, and a sanitizer sees what it has compiled; the fence is the machine's
//! own and sees both, whatever instruction it was.

use std::ffi::c_void;
use std::ops::{Deref, DerefMut};
use std::ptr;

/// Where values lie between the two fences.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flush {
    /// Their first byte is the first behind a fence.
    Start,
    /// Their last byte is the last before a fence.
    End,
    /// A page away from both, for what the others are compared with.
    Neither,
}

impl Flush {
    /// At either fence.
    pub const BOTH: [Self; 2] = [Self::Start, Self::End];
}

/// Values on pages of their own; the page before and the one behind cannot be touched.
pub struct Fenced<T> {
    pages: *mut c_void,
    length: usize,
    first: *mut T,
    count: usize,
}

impl<T: Copy> Fenced<T> {
    /// A copy of `values`.
    pub fn of(values: &[T], flush: Flush) -> Self {
        let mut fenced = Self::unwritten(values.len(), flush);
        // SAFETY: as many values lie there, writable, aligned, and in memory of their own.
        unsafe { fenced.first().copy_from_nonoverlapping(values.as_ptr(), values.len()) };
        fenced
    }

    /// `count` times `value`.
    pub fn filled(count: usize, value: T, flush: Flush) -> Self {
        let mut fenced = Self::unwritten(count, flush);
        for i in 0..count {
            // SAFETY: as above.
            unsafe { fenced.first().add(i).write(value) };
        }
        fenced
    }

    fn unwritten(count: usize, flush: Flush) -> Self {
        // SAFETY: asks for a number.
        let page = usize::try_from(unsafe { libc::sysconf(libc::_SC_PAGESIZE) }).expect("a page's size");
        assert!(page.is_multiple_of(align_of::<T>()));
        let bytes = count.checked_mul(size_of::<T>()).expect("so many bytes");
        let room = if flush == Flush::Neither { 2 * page } else { 0 };
        let inside = bytes.next_multiple_of(page) + room;
        let length = inside + 2 * page;
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_NORESERVE;
        // SAFETY: new pages, wherever there is room.
        let pages = unsafe { libc::mmap(ptr::null_mut(), length, libc::PROT_NONE, flags, -1, 0) };
        assert!(pages != libc::MAP_FAILED, "{length} bytes: {}", std::io::Error::last_os_error());
        let inner = pages.wrapping_byte_add(page);
        // SAFETY: pages of the mapping just made; there is one before and one behind them.
        let opened = unsafe { libc::mprotect(inner, inside, libc::PROT_READ | libc::PROT_WRITE) };
        assert!(opened == 0, "{inside} bytes: {}", std::io::Error::last_os_error());
        // A huge page would be resident as a whole where one byte of it is written. A kernel without them refuses.
        // SAFETY: as above.
        unsafe { libc::madvise(inner, inside, libc::MADV_NOHUGEPAGE) };
        let skipped = match flush {
            Flush::Start => 0,
            Flush::End => inside - bytes,
            Flush::Neither => page,
        };
        Self { pages, length, first: inner.wrapping_byte_add(skipped).cast(), count }
    }

    /// The first value's address.
    pub fn first(&mut self) -> *mut T {
        self.first
    }
}

impl Fenced<u8> {
    /// `count` zeros that take memory only where they are written to.
    pub fn zeros(count: usize, flush: Flush) -> Self {
        // New pages are full of zeros.
        Self::unwritten(count, flush)
    }
}

impl<T> Deref for Fenced<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        // SAFETY: as many values lie there, written by whoever made them, and live as long as `self`.
        unsafe { std::slice::from_raw_parts(self.first, self.count) }
    }
}

impl<T> DerefMut for Fenced<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        // SAFETY: as above, and borrowed exclusively.
        unsafe { std::slice::from_raw_parts_mut(self.first, self.count) }
    }
}

impl<T> Drop for Fenced<T> {
    fn drop(&mut self) {
        // SAFETY: the mapping is this value's own, and nobody borrows it any more.
        unsafe { libc::munmap(self.pages, self.length) };
    }
}
