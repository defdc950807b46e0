//! The space of a scene: the scene box, the contraction of unbounded scenes, and the placement in a host's world.

#[cfg(feature = "contraction")]
mod contraction;
#[cfg(not(feature = "contraction"))]
#[path = "contraction_off.rs"]
mod contraction;
#[cfg(feature = "instances")]
mod placement;
mod scene_box;

pub use contraction::Contraction;
#[cfg(feature = "instances")]
pub use placement::{Placement, PlacementError};
pub use scene_box::{BoundsError, SceneBox};
