//! Density and colour at points, asked on all threads.

use super::ExportError;
use nerf_core::camera::Ray;
use nerf_core::memory::Line;
use nerf_core::plan::Plan;
use nerf_core::render::{RaySegment, Renderer};
use nerf_core::volume::Pixel;
use rayon::prelude::*;

/// Points that one task asks for.
const CHUNK: usize = 4096;

/// A scene that is asked at points.
pub struct Field<'a, 'b> {
    renderer: &'a Renderer<'b>,
    plan: &'a Plan<'a>,
}

impl<'a, 'b> Field<'a, 'b> {
    /// The field of a renderer, as a plan of its scene sees it.
    pub fn new(renderer: &'a Renderer<'b>, plan: &'a Plan<'a>) -> Self {
        Self { renderer, plan }
    }

    /// Whether space is contracted: there is no outside to look from.
    pub fn is_unbounded(&self) -> bool {
        self.renderer.blob().scene().is_some_and(|scene| scene.contraction().is_some())
    }

    /// Densities, 1/world unit; 0 outside of the scene.
    ///
    /// # Errors
    /// [`ExportError::Render`], which points do not cause.
    pub fn densities(&self, points: &[[f32; 3]]) -> Result<Vec<f32>, ExportError> {
        let mut sigma = vec![0.0; points.len()];
        let chunks = points.par_chunks(CHUNK).zip(sigma.par_chunks_mut(CHUNK));
        chunks.try_for_each_init(
            || self.workspace(),
            |workspace, (points, sigma)| {
                let dirs = vec![[0.0, 0.0, -1.0]; points.len()];
                self.renderer.query(self.plan, points, &dirs, workspace, sigma, &mut []).map(drop)
            },
        )?;
        Ok(sigma)
    }

    /// Densities, and display-encoded colours as they are seen along unit directions.
    ///
    /// # Errors
    /// [`ExportError::Render`] on a direction that is not of unit length.
    pub fn seen(
        &self,
        points: &[[f32; 3]],
        dirs: &[[f32; 3]],
    ) -> Result<(Vec<f32>, Vec<[f32; 3]>), ExportError> {
        let (mut sigma, mut rgb) = (vec![0.0; points.len()], vec![[0.0; 3]; points.len()]);
        let asked = points.par_chunks(CHUNK).zip(dirs.par_chunks(CHUNK));
        let found = sigma.par_chunks_mut(CHUNK).zip(rgb.par_chunks_mut(CHUNK));
        asked.zip(found).try_for_each_init(
            || self.workspace(),
            |workspace, ((points, dirs), (sigma, rgb))| {
                self.renderer.query(self.plan, points, dirs, workspace, sigma, rgb).map(drop)
            },
        )?;
        Ok((sigma, rgb))
    }

    /// Distance along each ray at which its opacity crosses 1/2, world units; `None` of one that stays below. The plan has
    /// median distances.
    ///
    /// # Errors
    /// [`ExportError::Render`] on a ray whose direction is not of unit length, or whose range is none.
    pub fn half_way(&self, rays: &[RaySegment]) -> Result<Vec<Option<f32>>, ExportError> {
        // What is nearer than this to where a ray comes from is not part of an unbounded scene.
        let near = self.renderer.blob().scene().map_or(0.0, |scene| scene.near);
        let further = |RaySegment { ray, t_min, t_max }: RaySegment| {
            let ray = Ray { origin: ray.origin - near * ray.dir, ..ray };
            RaySegment { ray, t_min: t_min + near, t_max: t_max + near }
        };
        let rays: Vec<RaySegment> = rays.iter().copied().map(further).collect();
        let mut found = vec![None; rays.len()];
        let chunks = rays.par_chunks(CHUNK).zip(found.par_chunks_mut(CHUNK));
        chunks.try_for_each_init(
            || self.workspace(),
            |workspace, (rays, found)| {
                let mut worker = self.renderer.worker(self.plan, workspace)?;
                let mut take = |i: usize, pixel: &Pixel| {
                    found[i] = (pixel.opacity >= 0.5).then_some(pixel.median_distance - near);
                };
                worker.render_rays(rays, None, &mut take).map(drop)
            },
        )?;
        Ok(found)
    }

    fn workspace(&self) -> Vec<Line> {
        vec![Line::UNINIT; self.renderer.workspace_lines(self.plan)]
    }
}
