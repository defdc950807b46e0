//! What a run leaves for people to read: pictures, plots, tables, summaries, progress.

pub mod metrics;
