//! Reports of experiments: tables, plots, pages of text.

pub mod fit;
pub mod picture;
pub mod study;
pub mod sweep;
