//! Memory that a C caller lends: at a chosen alignment, between canaries.

use std::ffi::c_void;

const CANARY: u8 = 0xc5;
/// Number of canary bytes before and behind the memory. The margin is larger than any image in these tests, so that a
/// plane that claims to be larger than its memory still reaches no other memory.
const MARGIN: usize = 1 << 15;

/// A block of `size` bytes between canaries, at an address that is `misaligned` bytes beyond a multiple of 64.
pub struct Guarded {
    bytes: Vec<u8>,
    start: usize,
    size: usize,
}

impl Guarded {
    /// Allocates a block; all its bytes are canaries, too.
    pub fn new(size: usize, misaligned: usize) -> Self {
        let bytes = vec![CANARY; size + 2 * MARGIN + 64];
        let at = bytes.as_ptr() as usize + MARGIN;
        let start = MARGIN + (at.next_multiple_of(64) - at) + misaligned % 64;
        Self { bytes, start, size }
    }

    /// Returns the address of the block's first byte.
    pub fn at(&mut self) -> *mut c_void {
        self.bytes[self.start..].as_mut_ptr().cast()
    }

    /// Returns the block's size, bytes.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Returns the bytes of the block.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[self.start..self.start + self.size]
    }

    /// Returns whether all canaries around the block are intact.
    pub fn surroundings_are_intact(&self) -> bool {
        let (before, rest) = self.bytes.split_at(self.start);
        before.iter().chain(&rest[self.size..]).all(|&byte| byte == CANARY)
    }

    /// Returns whether all canaries are intact, in the block and around the block.
    pub fn is_untouched(&self) -> bool {
        self.bytes.iter().all(|&byte| byte == CANARY)
    }
}
