//! Reference renderer (oracle) of a radiance field in f64: slow and simple, written from the papers and from the
//! description of the file format.
//!
//! The oracle shares no code with `nerf-core`. `tests/tests/laws/oracle.rs` checks the oracle against numbers worked
//! out by hand, and against numbers of the CS180 course and of the original TensorFlow code.

pub mod contraction;
pub mod encoding;
pub mod gradient;
pub mod grid;
pub mod lens;
pub mod network;
pub mod sampling;
pub mod volume;
