//! Placement of the samples along a ray, and the occupancy grid.

mod bins;
mod importance;
mod interval;
#[cfg(feature = "jitter")]
mod jitter;
#[cfg(not(feature = "jitter"))]
#[path = "jitter_off.rs"]
mod jitter;
mod occupancy;
#[allow(dead_code, reason = "each effect draws its own part of it")]
pub(crate) mod random;

#[cfg(test)]
mod tests;

pub use bins::Bins;
pub(crate) use bins::Ends;
pub use importance::{sample_interval, sample_pdf};
pub(crate) use interval::{SampleInterval, Spacing, along};
pub(crate) use jitter::SampleJitter;
pub use occupancy::OccupancyGrid;
pub(crate) use occupancy::OccupancyLanes;
#[cfg(feature = "train")]
pub use random::{Purpose, uniform, uniform_u32};
