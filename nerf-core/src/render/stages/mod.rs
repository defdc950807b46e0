//! The stages of a frame. Each stage owns its buffers, and receives the current tile's rays as an argument.

mod colour;
mod columns;
mod compositing;
mod density;
#[cfg_attr(not(feature = "normals"), path = "normals_off.rs")]
mod normals;
mod per_ray;
mod points;
mod proposal;

use super::field::Field;
use super::march::Rays;
use super::pixel::Surface;

pub(super) use colour::Colour;
pub(super) use columns::ColumnMarch;
pub(super) use compositing::Compositing;
pub(super) use density::Density;
pub(super) use normals::Normals;
pub(super) use per_ray::Deferred;
pub(super) use points::evaluate_points;
pub(super) use proposal::{Proposer, propose};
#[cfg(feature = "instances")]
pub(super) use {colour::DirectionShares, normals::Gradients, per_ray::RayNetworks};

/// The rays of the current tile, and the block of samples that is being evaluated.
pub(super) struct TileState<'f, 'w> {
    pub field: Field<'f>,
    pub rays: Rays<'f, 'w>,
    pub density: Density<'w>,
    pub surface: Surface<'w>,
}
