//! How far the reading of many pictures is, for another thread to see.

use std::sync::atomic::{AtomicU64, Ordering};

/// Pictures that are read and to be read; an archive, which is read at once, counts none.
#[derive(Debug, Default)]
pub struct Watch {
    done: AtomicU64,
    total: AtomicU64,
}

impl Watch {
    /// Pictures that are read.
    pub fn done(&self) -> u64 {
        self.done.load(Ordering::Relaxed)
    }

    /// Pictures that are to be read in all, as far as is known; 0 before that.
    pub fn total(&self) -> u64 {
        self.total.load(Ordering::Relaxed)
    }

    pub(super) fn expect(&self, pictures: usize) {
        self.total.fetch_add(pictures as u64, Ordering::Relaxed);
    }

    pub(super) fn count(&self) {
        self.done.fetch_add(1, Ordering::Relaxed);
    }
}
