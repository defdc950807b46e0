//! Requests to render a scene.

use super::{HostError, Image, Scene, threads};
use crate::camera::Camera;
use crate::plan::{Batch, Outputs, Settings};
use crate::render::RaySegment;
use crate::volume::Pixel;
use glam::Vec3;
use std::num::NonZeroUsize;
use std::vec::Vec;

/// A request to render a scene. Settings that the caller does not set have their defaults.
#[derive(Clone, Debug)]
#[must_use = "ask for something: render, render_rays, render_picture"]
pub struct Request<'s> {
    scene: &'s Scene,
    settings: Settings,
    outputs: Outputs,
    threads: NonZeroUsize,
}

impl<'s> Request<'s> {
    pub(super) fn new(scene: &'s Scene) -> Self {
        Self {
            scene,
            settings: Settings::default(),
            outputs: Outputs::ALL,
            threads: std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN),
        }
    }

    /// Sets the outputs that are computed for each pixel; by default [`Outputs::ALL`].
    pub fn outputs(mut self, outputs: Outputs) -> Self {
        self.outputs = outputs;
        self
    }

    /// Sets all settings of the frame, such as quality, effects, background; by default [`Settings::default`].
    pub fn settings(mut self, settings: Settings) -> Self {
        self.settings = settings;
        self
    }

    /// Sets the number of threads that a call uses; by default the number of cores. Pixels do not depend on the number.
    pub fn threads(mut self, threads: NonZeroUsize) -> Self {
        self.threads = threads;
        self
    }

    /// Renders the whole image of `camera`.
    ///
    /// # Errors
    /// [`HostError::Plan`] if a setting is invalid or unsupported; [`HostError::Render`] if there is not enough memory.
    pub fn render(&self, camera: &Camera) -> Result<Image, HostError> {
        let renderer = self.scene.renderer();
        let plan = self.settings.plan(renderer.blob(), self.outputs, Batch::FULL)?;
        Ok(threads::render(&renderer, &plan, camera, self.threads)?)
    }

    /// Renders one pixel per ray. `axis`: unit vector along which `z_depth` is measured; with `None`, `z_depth` is 0.
    ///
    /// # Errors
    /// - [`HostError::Plan`] if a setting is invalid or unsupported
    /// - [`HostError::Render`] if a ray is invalid (the error has the ray's index), if `axis` is not of unit length, or
    ///   if anti-aliasing or depth of field is set, which need a camera
    pub fn render_rays(&self, rays: &[RaySegment], axis: Option<Vec3>) -> Result<Vec<Pixel>, HostError> {
        let renderer = self.scene.renderer();
        // The batch is no larger than the number of rays, to save memory.
        let batch = Batch { rays: rays.len().clamp(1, Batch::FULL.rays), ..Batch::FULL };
        let plan = self.settings.plan(renderer.blob(), self.outputs, batch)?;
        Ok(threads::render_rays(&renderer, &plan, rays, axis, self.threads)?.0)
    }

    /// Renders a 2D field in `width` × `height` pixels. Returns display-encoded colours, row by row from the top left.
    ///
    /// # Errors
    /// [`HostError::Render`] if the file is a scene, if there is not enough memory, or if `width` or `height` is 0 or
    /// above [`MAX_RENDER_SIDE`](crate::render::MAX_RENDER_SIDE).
    pub fn render_picture(&self, width: u32, height: u32) -> Result<Vec<[f32; 3]>, HostError> {
        let renderer = self.scene.renderer();
        let size = [width, height];
        Ok(threads::render_picture(&renderer, self.settings.quality.math, size, self.threads, |_| {})?.0)
    }
}
