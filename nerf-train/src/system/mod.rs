//! Services of the operating system that the commands need: files, signals, child processes, memory, messages.

pub mod child;
pub mod cpu;
pub mod input;
pub mod memory;
pub mod output;
pub mod printable;
pub mod progress;
pub mod stop;
pub mod summary;

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks a mutex, even after a panic of a thread that held the lock. Only for values that remain valid after a panic.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
