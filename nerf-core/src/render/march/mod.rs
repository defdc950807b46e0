//! Ray marching: the state of each ray, and its march to the next sample in an occupied cell.

mod coarse;
mod ray;
mod rays;
mod window;

pub(crate) use coarse::CoarseOccupancy;
pub(super) use coarse::Packets;
pub(super) use ray::{PROPOSAL_BUILT, RayState};
pub(super) use rays::Rays;
