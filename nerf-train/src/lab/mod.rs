//! Experiments: settings, their runs, and what they came to.
//!
//! lists of settings → one run each, kept as one small file in the experiment's folder → rows. What draws tables, plots and
//! pages of them is in `show/reports`.

mod shard;
pub mod study;
pub mod sweep;

pub use shard::Shard;
