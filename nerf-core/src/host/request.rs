//! Requests to render a scene.

use super::{HostError, Image, Scene, threads};
use crate::blob::Blob;
use crate::camera::Camera;
use crate::plan::{Batch, Outputs, Plan, PlanError, Settings};
use crate::render::RaySegment;
use crate::volume::Pixel;
use glam::Vec3;
use std::num::NonZeroUsize;
use std::vec::Vec;

/// A request to render a scene; settings that are not given have their defaults.
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

    /// The outputs of a pixel; by default [`Outputs::ALL`].
    pub fn outputs(mut self, outputs: Outputs) -> Self {
        self.outputs = outputs;
        self
    }

    /// The settings of a frame, in place of [`Settings::default`]: shortcuts, effects, background, range.
    pub fn settings(mut self, settings: Settings) -> Self {
        self.settings = settings;
        self
    }

    /// The number of threads that share a call; by default as many as there are cores. Pixels do not depend on it.
    pub fn threads(mut self, threads: NonZeroUsize) -> Self {
        self.threads = threads;
        self
    }

    /// The plan of these settings for a blob of the scene.
    ///
    /// # Errors
    /// [`PlanError`] names the setting that does not go with the scene.
    pub fn plan<'b>(&self, blob: &Blob<'b>) -> Result<Plan<'b>, PlanError> {
        self.settings.plan(blob, self.outputs, Batch::FULL)
    }

    /// Renders an image.
    ///
    /// # Errors
    /// [`HostError::Plan`] names the setting that does not go with the scene.
    pub fn render(&self, camera: &Camera) -> Result<Image, HostError> {
        let renderer = self.scene.renderer();
        let plan = self.plan(renderer.blob())?;
        Ok(threads::render(&renderer, &plan, camera, self.threads)?)
    }

    /// Renders rays of the caller's, each a pixel of its own with a `z_depth` of 0.
    ///
    /// # Errors
    /// As [`Request::render`], and [`HostError::Render`] with the index of the first ray that is invalid.
    pub fn render_rays(&self, rays: &[RaySegment]) -> Result<Vec<Pixel>, HostError> {
        self.render_rays_along(rays, None)
    }

    /// [`Request::render_rays`] with a `z_depth` along `axis`, of unit length.
    ///
    /// # Errors
    /// As [`Request::render_rays`].
    pub fn render_rays_along(
        &self,
        rays: &[RaySegment],
        axis: Option<Vec3>,
    ) -> Result<Vec<Pixel>, HostError> {
        let renderer = self.scene.renderer();
        // Memory is prepared for no more rays than there are.
        let batch = Batch { rays: rays.len().clamp(1, Batch::FULL.rays), ..Batch::FULL };
        let plan = self.settings.plan(renderer.blob(), self.outputs, batch)?;
        Ok(threads::render_rays(&renderer, &plan, rays, axis, self.threads)?.0)
    }

    /// Renders a 2D field in `width` × `height` pixels, display-encoded, row by row.
    ///
    /// # Errors
    /// [`HostError::Render`] if the file is a scene, and on a side of 0 or beyond
    /// [`MAX_RENDER_SIDE`](crate::render::MAX_RENDER_SIDE).
    pub fn render_picture(&self, width: u32, height: u32) -> Result<Vec<[f32; 3]>, HostError> {
        let renderer = self.scene.renderer();
        let size = [width, height];
        Ok(threads::render_picture(&renderer, self.settings.quality.math, size, self.threads, |_| {})?.0)
    }
}
