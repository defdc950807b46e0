//! Experiments: settings, their runs, and tables of them.

pub mod study;
pub mod sweep;
