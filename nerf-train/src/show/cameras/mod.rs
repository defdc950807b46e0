//! What training sees, in 3D: cameras with frusta and pictures, rays and samples of one step.
//!
//! One [`Scene`] is made from the data and the very code that draws training batches; an interactive [`page`] shows it.

mod findings;
pub mod page;
pub mod sampling;
pub mod scene;
mod summary;
mod words;

pub use findings::checked;
pub use scene::{Request, Scene, ShowError};
pub use summary::Summary;
