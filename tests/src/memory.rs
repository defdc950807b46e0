//! Caller's memory at a chosen alignment, with canaries around it.

use std::ffi::c_void;

const CANARY: u8 = 0xc5;
/// More than any picture of these tests takes: one that claims to be larger than it is reaches no other memory.
const MARGIN: usize = 1 << 15;

/// `size` bytes at an address that is `misaligned` bytes beyond a multiple of 64.
pub struct Guarded {
    bytes: Vec<u8>,
    start: usize,
    size: usize,
}

impl Guarded {
    /// Memory full of canaries.
    pub fn new(size: usize, misaligned: usize) -> Self {
        let bytes = vec![CANARY; size + 2 * MARGIN + 64];
        let at = bytes.as_ptr() as usize + MARGIN;
        let start = MARGIN + (at.next_multiple_of(64) - at) + misaligned % 64;
        Self { bytes, start, size }
    }

    /// Its first byte.
    pub fn at(&mut self) -> *mut c_void {
        self.bytes[self.start..].as_mut_ptr().cast()
    }

    /// Its length.
    pub fn size(&self) -> usize {
        self.size
    }

    /// The bytes that were lent.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[self.start..self.start + self.size]
    }

    /// Whether nothing around it was written to.
    pub fn surroundings_are_intact(&self) -> bool {
        let (before, rest) = self.bytes.split_at(self.start);
        before.iter().chain(&rest[self.size..]).all(|&byte| byte == CANARY)
    }

    /// Whether nothing was written at all.
    pub fn is_untouched(&self) -> bool {
        self.bytes.iter().all(|&byte| byte == CANARY)
    }
}
