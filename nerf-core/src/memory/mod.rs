//! Memory that the caller gives: what a stage needs is listed once ([`Layout`]), measured by [`Measure`] and cut out by
//! [`Arena`].

#[allow(unsafe_code, reason = "values are placed in the caller's bytes")]
mod arena;
mod slices;

pub use arena::{Arena, Layout, Line, Measure, lines_for};
pub(crate) use slices::{at, column, head, head_mut, put, put_column, tail, tail_mut};
