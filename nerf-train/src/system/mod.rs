//! The operating system as far as commands need it: files, signals, child processes, memory, messages.

pub mod child;
pub mod cpu;
pub mod input;
pub mod memory;
pub mod output;
pub mod printable;
pub mod progress;
pub mod stop;
pub mod summary;
