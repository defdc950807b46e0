//! Progress of reading pictures, shown by another thread.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Number of pictures read so far, and in total. For an archive, which is read at once, these numbers stay 0.
#[derive(Debug, Default)]
pub struct Watch {
    done: AtomicU64,
    total: AtomicU64,
    set_aside: AtomicU64,
}

impl Watch {
    pub fn done(&self) -> u64 {
        self.done.load(Ordering::Relaxed)
    }

    /// Returns the total number of pictures to be read; 0 until it is known.
    pub fn total(&self) -> u64 {
        self.total.load(Ordering::Relaxed)
    }

    /// Returns the time spent on shared cameras (one camera for each device), which does not count as fit time.
    pub fn set_aside(&self) -> Duration {
        Duration::from_micros(self.set_aside.load(Ordering::Relaxed))
    }

    pub(super) fn set_time_aside(&self, spent: Duration) {
        self.set_aside.fetch_add(spent.as_micros() as u64, Ordering::Relaxed);
    }

    pub(super) fn expect(&self, pictures: usize) {
        self.total.fetch_add(pictures as u64, Ordering::Relaxed);
    }

    pub(super) fn count(&self) {
        self.done.fetch_add(1, Ordering::Relaxed);
    }
}
