//! What a ray's samples say beyond means of what they have: the median distance and the normal.
//!
//! Each has a file that does it and one with the same interface that does nothing, in builds without its
//! feature. Where it is not asked for, it has no memory, and its calls end at that.

#[cfg_attr(not(feature = "median"), path = "median_off.rs")]
mod median;
#[cfg_attr(not(feature = "normals"), path = "normals_off.rs")]
mod normals;

#[cfg(test)]
mod tests;

pub(super) use median::Medians;
pub(super) use normals::Normals;
