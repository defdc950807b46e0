//! Scenes that own what they need, rendered on all cores: for programs with an operating system (feature `std`).
//!
//! The same bits as by hand from a [`Renderer`], whatever the number of threads.

mod error;
mod image;
mod request;
mod scene;
mod threads;

#[cfg(test)]
mod tests;

pub use error::HostError;
pub use image::Image;
pub use request::Request;
pub use scene::Scene;
pub use threads::{render, render_picture, render_rays};

#[cfg(doc)]
use crate::Renderer;
