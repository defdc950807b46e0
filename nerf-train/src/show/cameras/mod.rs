//! What training sees, in 3D: cameras with frusta and pictures, rays and samples of one step.
//!
//! One [`Scene`] is made from the data and the very code that draws training batches; a PNG of two
//! viewpoints ([`sheet`]) and an interactive page ([`page`]) are two ways to look at it.

mod canvas;
mod drawing;
pub mod page;
mod projection;
pub mod sampling;
pub mod scene;
pub mod sheet;
mod thumbnail;

pub use scene::{Request, Scene, ShowError};
