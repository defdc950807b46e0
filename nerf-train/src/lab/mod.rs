//! Experiments: settings, their runs, and the results.
//!
//! A sweep does a run for each combination of listed values, and keeps each result as one file in the sweep's folder.
//! The modules in `show/reports` turn results into tables, plots and pages.

pub mod cross_validation;
mod shard;
pub mod study;
pub mod sweep;

pub use shard::Shard;
