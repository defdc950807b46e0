//! Evaluation of a scene file on held-out views.

use crate::data::pictures::colour;
use crate::data::{SparsePoint, View};
use crate::measure::frame::{self, Frame};
use crate::measure::metrics::{aligned_psnr_db, psnr_db, ssim_of};
use crate::measure::surfaces::Surfaces;
use crate::system::cpu;
use anyhow::Context;
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::encoding::{GridEncoding, GridTables, TableValues};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Counters, Renderer};
use serde::Serialize;
use std::time::Instant;

/// Threshold, dB. If leaving out the occupancy grid changes PSNR by more than this, up or down, the grid is part of the
/// model: rendering without it is refused. The value is below the 0.1 dB that the preset `Balanced` may lose.
pub const OCCUPANCY_LOSS_DB: f64 = 0.08;

#[derive(Clone, Debug, Serialize)]
pub struct ViewScore {
    pub view: String,
    /// PSNR of the rendering, dB; infinite if every pixel equals the photograph's.
    pub psnr_db: f64,
    /// PSNR, dB, after each colour channel is multiplied by the gain that brings it nearest to the photograph's.
    pub aligned_psnr_db: f64,
    pub ssim: f64,
}

#[derive(Clone, Debug)]
pub struct Scores {
    pub views: Vec<ViewScore>,
    pub counters: Counters,
    /// Seconds that rendering took, without scoring.
    pub render_seconds: f64,
}

impl Scores {
    /// Returns the mean PSNR over the views, dB; `None` without views.
    pub fn psnr_db(&self) -> Option<f64> {
        mean(self.views.iter().map(|score| score.psnr_db))
    }

    /// Returns the smallest PSNR of a view, dB; `None` without views.
    pub fn worst_psnr_db(&self) -> Option<f64> {
        self.views.iter().map(|score| score.psnr_db).min_by(f64::total_cmp)
    }

    /// Returns the mean over the views of [`ViewScore::aligned_psnr_db`], dB; `None` without views.
    pub fn aligned_psnr_db(&self) -> Option<f64> {
        mean(self.views.iter().map(|score| score.aligned_psnr_db))
    }

    /// Returns the mean SSIM over the views; `None` without views.
    pub fn ssim(&self) -> Option<f64> {
        mean(self.views.iter().map(|score| score.ssim))
    }
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> Option<f64> {
    let n = values.len();
    (n > 0).then(|| values.sum::<f64>() / n as f64)
}

/// Renders every view over `background`, and scores the frame against the view's photograph over the same background.
/// Masked pixels are left out of the scores. Rays begin at the camera, unless the plan limits the range of distances.
/// `each`: function called with every view, its frame, ground truth and score, in order.
pub fn evaluate<'v>(
    renderer: &Renderer<'_>,
    plan: &Plan<'_>,
    background: [f32; 3],
    views: impl IntoIterator<Item = &'v View>,
    mut each: impl FnMut(&'v View, &Frame, &[[f32; 3]], &ViewScore),
) -> anyhow::Result<Scores> {
    let mut scores = Scores { views: Vec::new(), counters: Counters::default(), render_seconds: 0.0 };
    for view in views {
        let start = Instant::now();
        let frame = frame::render(renderer, plan, &view.camera)?;
        scores.render_seconds += start.elapsed().as_secs_f64();
        let truth = view.composite_over(background);
        let (shown, expected) = (view.counted(&frame.rgb), view.counted(&truth));
        let score = ViewScore {
            view: view.name.clone(),
            psnr_db: psnr_db(&shown, &expected),
            aligned_psnr_db: aligned_psnr_db(&shown, &expected),
            ssim: ssim_of(&frame.rgb, &truth, frame.width, frame.height, view.mask.as_deref()),
        };
        each(view, &frame, &truth, &score);
        scores.counters += frame.counters;
        scores.views.push(score);
    }
    Ok(scores)
}

#[derive(Clone, Copy, Debug, Default)]
pub struct EvalOptions {
    /// Background colour; `None`: the background stored in the scene file.
    pub background: Option<[f32; 3]>,
    /// Interval N: PSNR is also measured on every N-th pixel of every N-th row, as in many papers. `None`: it is not.
    pub lattice: Option<u32>,
}

/// Result of an evaluation, written to `summary.json` by the command `eval`.
#[derive(Clone, Debug, Serialize)]
pub struct Evaluation {
    pub val_psnr_db: f64,
    pub val_worst_psnr_db: f64,
    pub val_aligned_psnr_db: f64,
    pub val_ssim: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub val_refined_psnr_db: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub val_refined_ssim: Option<f64>,
    pub val_depth_error: Option<f64>,
    pub val_near_share: Option<f64>,
    pub views: usize,
    pub split: &'static str,
    pub background: String,
    pub steps: u32,
    pub parameters: usize,
    pub blob_bytes: usize,
    pub render_seconds: f64,
    pub density_evaluations_per_ray: f64,
    pub colour_evaluations_per_ray: f64,
    pub proposal_evaluations_per_ray: f64,
    pub invalid_samples: u64,
    pub macs: u64,
    pub kernel: String,
    pub threads: usize,
    pub cpu: String,
    pub view_scores: Vec<ViewScore>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lattice_psnr_db: Option<f64>,
}

impl Evaluation {
    /// Renders `views` with `plan`, and compares each with its photograph, as [`evaluate`] does. `bytes`: scene file of
    /// `plan`; `split`: name of the views' split; `points`: sparse points, to which rendered depths are compared.
    /// `each` is called with every view, its frame and score, in order.
    pub fn of<'v>(
        bytes: &[u8],
        plan: &Plan<'_>,
        kernel: Kernel,
        options: EvalOptions,
        (split, views): (&'static str, Vec<&'v View>),
        points: &[SparsePoint],
        mut each: impl FnMut(&'v View, &Frame, &ViewScore),
    ) -> anyhow::Result<Self> {
        let blob = Blob::open(bytes)?;
        let background = options.background.unwrap_or(own_background(&blob));
        let plan = plan.with_background(background)?;
        let (parameters, steps) = (blob.architecture().parameters(), blob.provenance().steps);
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob, kernel, &mut memory)?;
        let mut lattice_db = Vec::new();
        let asked = views.clone();
        let scores = evaluate(&renderer, &plan, background, views, |view, frame, truth, score| {
            if let Some(step) = options.lattice {
                let on = |picture| lattice(picture, frame.width, step as usize);
                lattice_db.push(psnr_db(&on(&frame.rgb), &on(truth)));
            }
            each(view, frame, score);
        })?;
        let surfaces = Surfaces::with(&renderer, &plan, &asked, points)?;
        let c = &scores.counters;
        let a_ray = |count: u64| count as f64 / c.rays.max(1) as f64;
        Ok(Self {
            val_psnr_db: scores.psnr_db().unwrap_or(f64::NAN),
            val_worst_psnr_db: scores.worst_psnr_db().unwrap_or(f64::NAN),
            val_aligned_psnr_db: scores.aligned_psnr_db().unwrap_or(f64::NAN),
            val_ssim: scores.ssim().unwrap_or(f64::NAN),
            val_refined_psnr_db: None,
            val_refined_ssim: None,
            val_depth_error: surfaces.depth_error,
            val_near_share: surfaces.near_share,
            views: scores.views.len(),
            split,
            background: colour::name(background),
            steps,
            parameters,
            blob_bytes: bytes.len(),
            render_seconds: scores.render_seconds,
            density_evaluations_per_ray: a_ray(c.density_evaluations),
            colour_evaluations_per_ray: a_ray(c.colour_evaluations),
            proposal_evaluations_per_ray: a_ray(c.proposal_evaluations),
            invalid_samples: c.invalid_samples,
            macs: c.macs,
            kernel: kernel.to_string(),
            threads: rayon::current_num_threads(),
            cpu: cpu::name(),
            view_scores: scores.views,
            lattice_psnr_db: mean(lattice_db.into_iter()),
        })
    }

    /// Renders `views`, the evaluated views with refined poses, and adds their mean PSNR and SSIM to this evaluation.
    pub fn add_refined(
        &mut self,
        bytes: &[u8],
        plan: &Plan<'_>,
        kernel: Kernel,
        options: EvalOptions,
        views: &[View],
    ) -> anyhow::Result<()> {
        let views = views.iter().collect();
        let refined = Self::of(bytes, plan, kernel, options, (self.split, views), &[], |_, _, _| {})?;
        self.val_refined_psnr_db = Some(refined.val_psnr_db);
        self.val_refined_ssim = Some(refined.val_ssim);
        Ok(())
    }
}

/// Returns the background colour of a blob's scene; black for a 2D field.
pub fn own_background(blob: &Blob<'_>) -> [f32; 3] {
    blob.scene().map_or([0.0; 3], |scene| scene.background)
}

/// Returns the pixels whose column and row are multiples of `step`. `picture`: `[height * width]`.
fn lattice(picture: &[[f32; 3]], width: usize, step: usize) -> Vec<[f32; 3]> {
    let rows = picture.chunks_exact(width).step_by(step);
    rows.flat_map(|row| row.iter().step_by(step)).copied().collect()
}

/// Renders `views` of the scene file `blob` over `background`, and compares them with photographs as [`evaluate`] does.
/// `parameters`: f32 weights in place of the file's rounded weights; `None`: the file's weights.
pub fn measure<'v>(
    blob: &[u8],
    parameters: Option<&[f32]>,
    kernel: Kernel,
    quality: &Quality,
    background: [f32; 3],
    views: impl IntoIterator<Item = &'v View>,
    each: impl FnMut(&'v View, &Frame, &[[f32; 3]], &ViewScore),
) -> anyhow::Result<Scores> {
    let blob = Blob::open(blob)?;
    let plan = Plan::new(&blob, quality, Outputs::ALL, Batch::FULL)?;
    // Samples lie in the bins that the network was trained with.
    let plan = plan.with_background(background)?.with_own_bins();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = match parameters {
        Some(parameters) => {
            let layers = blob.architecture().parameters();
            let expected = layers + blob.architecture().position.grid().map_or(0, GridEncoding::values);
            let fault = || format!("parameters: expected {expected}, found {}", parameters.len());
            let (layers, tables) = parameters.split_at_checked(layers).with_context(fault)?;
            let bounds = blob.scene_box();
            let tables = GridTables::new(TableValues::F32(tables), bounds.as_ref());
            Renderer::with_parameters(blob, kernel, layers, Some(tables)).with_context(fault)?
        }
        None => Renderer::new(blob, kernel, &mut memory)?,
    };
    evaluate(&renderer, &plan, background, views, each)
}
