//! Memory that the caller supplies. A rendering stage requests its buffers from a [`Layout`]: [`Measure`] counts the
//! 64-byte lines that the buffers need, and [`Arena`] allocates the buffers.

#[allow(unsafe_code, reason = "values are placed in the caller's bytes")]
mod arena;
mod slices;

pub use arena::{Arena, Layout, Line, Measure, lines_for};
pub(crate) use slices::{at, column, head, head_mut, put, put_column, tail, tail_mut};
