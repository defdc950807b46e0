//! Where along a ray the network is asked.

mod bins;
#[cfg(feature = "proposal")]
mod importance;
mod occupancy;
mod random;

#[cfg(test)]
mod tests;

pub use bins::Bins;
pub(crate) use bins::Ends;
#[cfg(feature = "proposal")]
pub use importance::{WEIGHT_FLOOR, sample_interval, sample_pdf};
pub use occupancy::OccupancyGrid;
pub use random::{Purpose, uniform, uniform_u32};
