//! Memory between inaccessible pages (fences): a read or write of one byte beyond the memory ends the process.
//!
//! Canaries ([`crate::memory`]) detect only writes, and a sanitizer checks only code that it has compiled. The
//! processor checks every access of every instruction.

use std::ffi::c_void;
use std::ops::{Deref, DerefMut};
use std::ptr;

/// Position of values between the two fences.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flush {
    /// The first value begins where the first fence ends.
    Start,
    /// The last value ends where the second fence begins.
    End,
    /// The values are at least a page away from each fence; results at the other positions are compared with this one.
    Neither,
}

impl Flush {
    /// The two positions beside a fence.
    pub const BOTH: [Self; 2] = [Self::Start, Self::End];
}

/// Values on pages of their own, between two pages that cannot be accessed.
pub struct Fenced<T> {
    pages: *mut c_void,
    length: usize,
    first: *mut T,
    count: usize,
}

impl<T: Copy> Fenced<T> {
    /// Makes a copy of `values` at the position `flush`.
    pub fn of(values: &[T], flush: Flush) -> Self {
        let mut fenced = Self::unwritten(values.len(), flush);
        // SAFETY: as many values lie there, writable, aligned, and in memory of their own.
        unsafe { fenced.first().copy_from_nonoverlapping(values.as_ptr(), values.len()) };
        fenced
    }

    /// Makes `count` copies of `value` at the position `flush`.
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

    /// Returns the address of the first value.
    pub fn first(&mut self) -> *mut T {
        self.first
    }
}

impl Fenced<u8> {
    /// Makes `count` zeros. A page takes memory only once it is written to.
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
