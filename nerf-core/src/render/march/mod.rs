//! Ray marching: the state of each ray, and its march to the next sample in an occupied cell.

mod coarse;
mod rays;
mod samples;
mod window;

pub(crate) use coarse::CoarseOccupancy;
pub(super) use coarse::Packets;
pub(super) use rays::{RayState, Rays};
pub(super) use samples::PROPOSAL_BUILT;
