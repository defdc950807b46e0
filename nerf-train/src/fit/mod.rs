//! Fits of scenes and of 2D fields, from the first step to the blob.

pub mod detail;
pub mod drive;
pub mod finish;
pub mod live;
pub mod pace;
pub mod picture;
pub mod run;
pub mod size;
pub mod snapshot;
pub mod summary;
pub mod trend;
pub mod validation;
