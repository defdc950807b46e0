//! What follows from cameras alone: where the scene is, how near it begins, where its world's origin should be,
//! where to look at it from.

pub(crate) mod bundle;
pub(crate) mod geometry;
pub(crate) mod nearest;
pub(crate) mod origin;
pub mod path;
pub(crate) mod pose;
pub mod refined;
pub(crate) mod viewpoint;
