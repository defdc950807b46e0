//! Densities and colours at points, evaluated on all threads.

use nerf_core::camera::Ray;
use nerf_core::memory::Line;
use nerf_core::plan::Plan;
use nerf_core::render::Renderer;
use rayon::prelude::*;
use std::f32::consts::LN_2;

/// Number of points that one task evaluates.
const CHUNK: usize = 4096;

/// Radiance field of a scene, evaluated at points.
pub struct Field<'a, 'b> {
    renderer: &'a Renderer<'b>,
    plan: &'a Plan<'a>,
}

impl<'a, 'b> Field<'a, 'b> {
    /// Creates the field of a renderer's scene. `plan`: decides the precision, and whether empty cells have density 0.
    pub fn new(renderer: &'a Renderer<'b>, plan: &'a Plan<'a>) -> Self {
        Self { renderer, plan }
    }

    /// Returns whether the scene uses contracted space, and so has no outside from which rays could find surfaces.
    pub fn is_unbounded(&self) -> bool {
        self.renderer.blob().scene().is_some_and(|scene| scene.contraction().is_some())
    }

    /// Returns the densities at `points`, 1/world unit; 0 outside of the scene.
    pub fn densities(&self, points: &[[f32; 3]]) -> anyhow::Result<Vec<f32>> {
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

    /// Returns densities at `points`, 1/world unit, and display-encoded colours seen along the unit directions `dirs`.
    pub fn seen(&self, points: &[[f32; 3]], dirs: &[[f32; 3]]) -> anyhow::Result<(Vec<f32>, Vec<[f32; 3]>)> {
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

    /// Finds the distance along each ray at which the opacity reaches 1/2, world units; `None` if it stays below 1/2.
    /// Each ray is `length` world units long, and has one sample in the middle of each of `steps` equal bins.
    pub fn half_way(&self, rays: &[Ray], length: f32, steps: usize) -> anyhow::Result<Vec<Option<f32>>> {
        let delta = length / steps as f32;
        let points = |ray: &Ray| {
            let ray = *ray;
            (0..steps).map(move |i| ray.at((i as f32 + 0.5) * delta).into())
        };
        let points: Vec<[f32; 3]> = rays.iter().flat_map(points).collect();
        let sigma = self.densities(&points)?;
        Ok(sigma.chunks(steps).map(|sigma| crossing(sigma, delta)).collect())
    }

    fn workspace(&self) -> Vec<Line> {
        vec![Line::UNINIT; self.renderer.workspace_lines(self.plan)]
    }
}

/// Finds the distance along a ray at which the optical depth reaches ln 2, which is opacity 1/2; `None` if it does not.
/// `sigma`: density in each bin of the ray; `delta`: width of a bin, in the unit of the distance.
fn crossing(sigma: &[f32], delta: f32) -> Option<f32> {
    let mut depth = 0.0;
    for (i, sigma) in sigma.iter().enumerate() {
        let next = depth + sigma * delta;
        if next >= LN_2 {
            return Some((i as f32 + (LN_2 - depth) / (next - depth)) * delta);
        }
        depth = next;
    }
    None
}
