//! Rays on their way: the state of each, and how it gets to its next sample in an occupied cell.

mod coarse;
mod ray;
mod rays;
#[cfg_attr(not(feature = "proposal"), path = "samples_off.rs")]
mod samples;
mod window;

pub(crate) use coarse::CoarseOccupancy;
pub(super) use coarse::Packets;
pub(super) use ray::RayState;
pub(super) use rays::Rays;
