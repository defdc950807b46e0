//! Experiments: settings, their runs, and the results.
//!
//! lists of settings → one run each, kept as one small file in the experiment's folder → table rows. The modules in
//! `show/reports` turn rows into tables, plots and pages.

pub mod cross_validation;
mod shard;
pub mod study;
pub mod sweep;

pub use shard::Shard;
