//! Experiments: settings, their runs, and the results.
//!
//! lists of settings → one run each, kept as one small file in the experiment's folder → rows. Tables, plots and
//! pages of these are in `show/reports`.

mod shard;
pub mod study;
pub mod sweep;

pub use shard::Shard;
