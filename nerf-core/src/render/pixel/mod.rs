//! Rays of each pixel, and outputs of the pixel, computed from the results of its rays.
//!
//! Each effect has two files with the same interface: one implements the effect, and the other does nothing, for builds
//! without the effect's feature.

#[cfg_attr(not(feature = "anti-aliasing"), path = "anti_aliasing_off.rs")]
mod anti_aliasing;
#[cfg_attr(not(feature = "depth-of-field"), path = "depth_of_field_off.rs")]
mod depth_of_field;
#[cfg_attr(not(feature = "median"), path = "median_off.rs")]
mod median;
mod pixels;
#[cfg_attr(not(feature = "instances"), path = "placed_off.rs")]
mod placed;
mod rays;
mod rect;
mod surface;
#[cfg_attr(not(feature = "tone-map"), path = "tone_off.rs")]
mod tone;

pub(super) use anti_aliasing::rays as rays_a_pixel;
pub(super) use median::Medians;
pub(super) use pixels::Pixels;
#[cfg(feature = "instances")]
pub(super) use placed::Placed;
pub(super) use rays::{CameraRays, OwnRays, PixelRay, RaySource};
pub use rays::{Limit, RaySegment};
pub use rect::{Rect, Target};
pub(super) use surface::Surface;
pub(super) use tone::samples_to_light;
