//! Errors of a field's surfaces against the sparse points of held-out photographs. Fog in front of surfaces without
//! texture hardly lowers PSNR. The fog shows in surface distances that are smaller than those of the sparse points.

use crate::capture::sights::{Sight, Sights};
use crate::data::{SparsePoint, View};
use crate::measure::frame::threads;
use nerf_core::blob::Blob;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{RaySegment, RenderError, Renderer};
use nerf_core::{Kernel, host};

/// Approximate number of pixels per view, on a regular grid, at which median distances are measured.
const ASKED_PIXELS: u64 = 10_000;
/// Distance below which a surface is too near, as a fraction of the distance to the view's nearest sparse point.
const TOO_NEAR: f32 = 0.9;

/// Errors of a field's surfaces, which lie at the median distances of rays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Surfaces {
    /// Median relative error of `median_distance` against the distance of the sparse point on the same ray, over all
    /// points and views. `None` if no view shows a point.
    pub depth_error: Option<f64>,
    /// Fraction of pixels whose `median_distance` is less than 0.9 times the distance of the nearest sparse point in
    /// the view; mean over the views. `None` if no view shows a sparse point.
    pub near_share: Option<f64>,
}

impl Surfaces {
    /// Measures the surfaces of the scene file `bytes`, at the default quality, against the sparse points of `views`.
    pub fn of(bytes: &[u8], kernel: Kernel, views: &[&View], points: &[SparsePoint]) -> anyhow::Result<Self> {
        let blob = Blob::open(bytes)?;
        let plan = Plan::new(&blob, &Quality::default(), Self::OUTPUTS, Batch::FULL)?.with_own_bins();
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        Ok(Self::with(&Renderer::new(blob, kernel, &mut memory)?, &plan, views, points)?)
    }

    /// Outputs that a plan must have for [`Self::with`].
    pub const OUTPUTS: Outputs = Outputs { median_distance: true, ..Outputs::ALL };

    /// Measures the surfaces of a renderer's field against the `points` that `views` show and [`Sights`] accepts. Both
    /// errors are `None` if there are no accepted points. `plan` must have the outputs [`Self::OUTPUTS`].
    pub fn with(
        renderer: &Renderer<'_>,
        plan: &Plan<'_>,
        views: &[&View],
        points: &[SparsePoint],
    ) -> Result<Self, RenderError> {
        let sights = Sights::of(views, points);
        if sights.count() == 0 {
            return Ok(Self::default());
        }
        let median = |rays: &[RaySegment]| -> Result<Vec<f32>, RenderError> {
            let (pixels, _) = host::render_rays(renderer, plan, rays, None, threads())?;
            Ok(pixels.iter().map(|pixel| pixel.median_distance).collect())
        };
        let (mut errors, mut shares) = (Vec::new(), Vec::new());
        for (view, sights) in views.iter().zip(&sights.of_views).filter(|(_, sights)| !sights.is_empty()) {
            let ray = |sight: &Sight| RaySegment::from(view.camera.ray(sight.at[0], sight.at[1]));
            let found = median(&sights.iter().map(ray).collect::<Vec<_>>())?;
            let error = |(found, sight): (&f32, &Sight)| f64::from((found / sight.distance - 1.0).abs());
            errors.extend(found.iter().zip(sights).map(error));
            let nearest = sights.iter().map(|sight| sight.distance).fold(f32::INFINITY, f32::min);
            let found = median(&lattice(view))?;
            let near = found.iter().filter(|&&distance| distance < TOO_NEAR * nearest).count();
            shares.push(near as f64 / found.len().max(1) as f64);
        }
        errors.sort_unstable_by(f64::total_cmp);
        let mean = shares.iter().sum::<f64>() / shares.len().max(1) as f64;
        Ok(Self { depth_error: errors.get(errors.len() / 2).copied(), near_share: Some(mean) })
    }
}

/// Returns rays through about `ASKED_PIXELS` pixels on a regular grid over a view, without masked pixels.
fn lattice(view: &View) -> Vec<RaySegment> {
    let (width, height) = view.size();
    let pixels = u64::from(width) * u64::from(height);
    let step = ((pixels as f64 / ASKED_PIXELS as f64).sqrt().round() as usize).max(1);
    let columns = |y: u32| (0..width).step_by(step).map(move |x| (x, y));
    let all = (0..height).step_by(step).flat_map(columns);
    let counts = |&(x, y): &(u32, u32)| view.counts((y * width + x) as usize);
    all.filter(counts).map(|(x, y)| view.camera.ray(x as f32 + 0.5, y as f32 + 0.5).into()).collect()
}
