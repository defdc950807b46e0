//! Where along a ray the network is asked.

mod bins;
mod grid;
mod random;

#[cfg(test)]
mod tests;

pub use bins::Bins;
pub use grid::SkipGrid;
pub use random::{Purpose, uniform, uniform_u32};
