//! Where along a ray the network is asked.

mod bins;
mod grid;
#[cfg(feature = "proposal")]
mod importance;
mod random;

#[cfg(test)]
mod tests;

pub use bins::Bins;
pub(crate) use bins::Ends;
pub use grid::SkipGrid;
#[cfg(feature = "proposal")]
pub use importance::{WEIGHT_FLOOR, draw, stretch};
pub use random::{Purpose, uniform, uniform_u32};
