//! A radiance field in f64, slow and obvious, written from the papers and from the file format's page.
//!
//! It shares no code with `nerf-core`: what both say alike is said twice. `tests/tests/laws/oracle.rs` checks it in its
//! turn, against numbers worked out by hand, the CS180 course's and the original TensorFlow code's.

pub mod contraction;
pub mod encoding;
pub mod gradient;
pub mod grid;
pub mod network;
pub mod sampling;
pub mod volume;
