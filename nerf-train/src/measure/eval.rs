//! How good a blob is on views it was not fitted to.

use crate::data::View;
use crate::measure::frame;
use crate::measure::frame::Frame;
use crate::measure::metrics::{psnr_db, ssim_of};
use nerf_core::Kernel;
use nerf_core::blob::{Blob, BlobError};
use nerf_core::encoding::{GridEncoding, GridTables, TableValues};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, PlanError, Quality};
use nerf_core::render::{Counters, RenderError, Renderer};
use serde::Serialize;

/// An occupancy grid is part of the model if leaving it out changes training views by more than this, dB: a little
/// less than the 0.1 dB that a blob promises for views nobody has seen.
pub const OCCUPANCY_LOSS_DB: f64 = 0.08;

/// One view's figures.
#[derive(Clone, Debug, Serialize)]
pub struct ViewScore {
    /// The view.
    pub view: String,
    /// dB; infinite if every pixel is equal.
    pub psnr_db: f64,
    /// 0..=1.
    pub ssim: f64,
}

/// Figures of a set of views.
#[derive(Clone, Debug)]
pub struct Scores {
    /// View by view.
    pub views: Vec<ViewScore>,
    /// The work all of them took.
    pub counters: Counters,
}

impl Scores {
    /// Mean PSNR over the views, dB; `None` without views.
    pub fn psnr_db(&self) -> Option<f64> {
        mean(self.views.iter().map(|score| score.psnr_db))
    }

    /// PSNR of the worst view, dB; `None` without views.
    pub fn worst_psnr_db(&self) -> Option<f64> {
        self.views.iter().map(|score| score.psnr_db).min_by(f64::total_cmp)
    }

    /// Mean SSIM over the views; `None` without views.
    pub fn ssim(&self) -> Option<f64> {
        mean(self.views.iter().map(|score| score.ssim))
    }
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> Option<f64> {
    let n = values.len();
    (n > 0).then(|| values.sum::<f64>() / n as f64)
}

/// Renders every view over `background` and compares it with its picture over the same, where its pixels count.
///
/// Rays through an unbounded scene begin at the view's own [`View::near`], unless the plan says where.
///
/// `each` sees every view with its frame and truth, in order.
///
/// # Errors
/// As [`frame::render`].
pub fn evaluate<'v>(
    renderer: &Renderer<'_>,
    plan: &Plan<'_>,
    background: [f32; 3],
    views: impl IntoIterator<Item = &'v View>,
    mut each: impl FnMut(&'v View, &Frame, &[[f32; 3]], &ViewScore),
) -> Result<Scores, RenderError> {
    let mut scores = Scores { views: Vec::new(), counters: Counters::default() };
    let (near, far) = plan.range();
    let own_near = near == 0.0 && renderer.blob().scene().is_some_and(|scene| scene.contraction().is_some());
    for view in views {
        let own = if own_near { plan.with_range(view.near, far).unwrap_or(*plan) } else { *plan };
        let frame = frame::render(renderer, &own, &view.camera)?;
        let truth = view.composite_over(background);
        let score = ViewScore {
            view: view.name.clone(),
            psnr_db: psnr_db(&view.counted(&frame.rgb), &view.counted(&truth)),
            ssim: ssim_of(&frame.rgb, &truth, frame.width, frame.height, view.mask.as_deref()),
        };
        each(view, &frame, &truth, &score);
        scores.counters += frame.counters;
        scores.views.push(score);
    }
    Ok(scores)
}

/// Why a blob cannot be measured.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EvalError {
    /// It cannot be opened.
    #[error("{0}")]
    Blob(#[from] BlobError),
    /// It cannot be rendered as asked.
    #[error("{0}")]
    Plan(#[from] PlanError),
    /// It could not be rendered.
    #[error("{0}")]
    Render(#[from] RenderError),
    /// The parameters to measure in place of its own are too few.
    #[error("parameters: expected {expected}, found {found}")]
    Parameters {
        /// What its network has.
        expected: usize,
        /// What was given.
        found: usize,
    },
}

/// Opens a blob and measures it on `views` over `background`.
///
/// `parameters` replaces the blob's rounded weights where given.
///
/// # Errors
/// [`EvalError`] if the blob cannot be opened or rendered as asked.
pub fn measure<'v>(
    blob: &[u8],
    parameters: Option<&[f32]>,
    kernel: Kernel,
    quality: &Quality,
    background: [f32; 3],
    views: impl IntoIterator<Item = &'v View>,
    each: impl FnMut(&'v View, &Frame, &[[f32; 3]], &ViewScore),
) -> Result<Scores, EvalError> {
    let blob = Blob::open(blob)?;
    let plan = Plan::new(&blob, quality, Outputs::ALL, Batch::FULL)?;
    // Of the bins that the network was trained on: a figure is theirs.
    let plan = plan.with_background(background)?.with_own_bins();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = match parameters {
        Some(parameters) => {
            let layers = blob.architecture().parameters();
            let expected = layers + blob.architecture().position.grid().map_or(0, GridEncoding::values);
            let fault = EvalError::Parameters { expected, found: parameters.len() };
            let (layers, tables) = parameters.split_at_checked(layers).ok_or(fault)?;
            let bounds = blob.scene_box();
            let tables = GridTables::new(TableValues::F32(tables), bounds.as_ref());
            Renderer::with_parameters_and_tables(blob, kernel, layers, tables).ok_or(fault)?
        }
        None => Renderer::new(blob, kernel, &mut memory)?,
    };
    Ok(evaluate(&renderer, &plan, background, views, each)?)
}
