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
#[cfg_attr(not(feature = "train"), allow(dead_code, reason = "each effect draws its own part of it"))]
mod random;

#[cfg(test)]
mod tests;

pub use bins::Bins;
pub(crate) use bins::Ends;
#[cfg(all(feature = "proposal", feature = "train"))]
pub use importance::WEIGHT_FLOOR;
pub use importance::{sample_interval, sample_pdf};
pub(crate) use interval::{SampleInterval, Spacing, along};
pub(crate) use jitter::SampleJitter;
pub use occupancy::OccupancyGrid;
pub(crate) use occupancy::OccupancyLanes;
#[cfg(any(feature = "jitter", feature = "depth-of-field"))]
pub(crate) use random::pixel_stream;
#[cfg(any(feature = "depth-of-field", feature = "train"))]
pub use random::uniform_u32;
#[cfg(any(feature = "anti-aliasing", feature = "depth-of-field"))]
pub(crate) use random::{GOLDEN, rank};
#[cfg(any(feature = "jitter", feature = "depth-of-field", feature = "train"))]
pub use random::{Purpose, uniform};
