//! Scenes that own their data, rendered on all cores: for programs with an operating system (feature `std`).
//!
//! Results are bit-identical to those of a [`Renderer`](crate::Renderer), for any number of threads.

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
