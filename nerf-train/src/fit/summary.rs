//! Summary of a fit, as the file `summary.json`.

use crate::capture::check::Diagnosis;
use crate::capture::check::after::Fitted;
use crate::data::pictures::colour;
use crate::fit::finish::Outcome;
use crate::measure::eval::Scores;
use crate::measure::inspect::GridSummary;
use crate::model::config::Config;
use crate::model::engine::EngineKind;
use crate::system::cpu;
use crate::system::summary::Short;
use crate::train::moving::Moved;
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use serde::Serialize;
use std::path::Path;

/// Contents of the file `summary.json` of a fit; a missing value is null or left out.
#[derive(Debug, Serialize)]
pub struct Summary {
    // Split of the validated views: "test" if the data set has no validation split.
    pub val_split: &'static str,
    // Null, not left out, without validation views: scripts rely on these fields.
    pub val_psnr_db: f64,
    pub val_worst_psnr_db: f64,
    pub val_aligned_psnr_db: f64,
    pub val_lattice: u32,
    pub val_ssim: f64,
    pub val_refined_psnr_db: Option<f64>,
    pub val_refined_worst_psnr_db: Option<f64>,
    pub val_refined_ssim: Option<f64>,
    pub val_depth_error: Option<f64>,
    pub val_near_share: Option<f64>,
    pub poses_pixels: Option<f64>,
    pub poses_refined: bool,
    pub exposure_spread: Option<f64>,
    pub exposure_fitted: bool,
    pub withheld_gap_db: Option<f64>,
    pub weight_decay: f64,
    pub moved: Vec<MovedView>,
    pub views: usize,
    pub flat: bool,
    pub flat_psnr_db: f64,
    pub background: String,
    pub train_seconds: f64,
    pub total_seconds: f64,
    pub steps: u32,
    pub reseeds: u32,
    pub parameters: usize,
    pub blob_bytes: usize,
    pub occupancy_required: bool,
    pub occupied_share: Short,
    pub subnormal_weights: usize,
    pub evaluated_samples_per_second: f64,
    pub trained_samples_per_second: f64,
    pub seed: u64,
    pub engine: EngineKind,
    pub kernel: String,
    pub threads: usize,
    pub cpu: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view_dependence_gain_db: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view_dependence_left_out: Option<bool>,
    pub occupancy_loss_db: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quantisation_loss_db: Option<f64>,
    #[serde(flatten)]
    pub grid: Option<GridSummary>,
    #[serde(flatten)]
    pub trend: TrendSummary,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub z_depth_median_relative_error: Option<f64>,
    #[serde(flatten)]
    pub capture: Option<Capture>,
    pub data: String,
    pub blob: String,
}

impl Summary {
    /// Returns the summary of a fit whose blob was written to the file `blob`; `data`: name of the data set.
    pub fn of(
        outcome: &Outcome,
        config: &Config,
        kernel: Kernel,
        total_seconds: f64,
        data: &str,
        blob: &Path,
    ) -> Self {
        let moved_view =
            |moved: &Moved| MovedView { view: moved.name.clone(), masked_share: Short(moved.share as f32) };
        let [evaluated_samples_per_second, trained_samples_per_second] = outcome.samples_per_second;
        Self {
            val_split: "val",
            val_psnr_db: outcome.scores.psnr_db().unwrap_or(f64::NAN),
            val_worst_psnr_db: outcome.scores.worst_psnr_db().unwrap_or(f64::NAN),
            val_aligned_psnr_db: outcome.scores.aligned_psnr_db().unwrap_or(f64::NAN),
            val_lattice: outcome.lattice,
            val_ssim: outcome.scores.ssim().unwrap_or(f64::NAN),
            val_refined_psnr_db: outcome.refined_scores.as_ref().and_then(Scores::psnr_db),
            val_refined_worst_psnr_db: outcome.refined_scores.as_ref().and_then(Scores::worst_psnr_db),
            val_refined_ssim: outcome.refined_scores.as_ref().and_then(Scores::ssim),
            val_depth_error: outcome.surfaces.depth_error,
            val_near_share: outcome.surfaces.near_share,
            poses_pixels: outcome.poses.map(|found| found.pixels),
            poses_refined: outcome.refined_poses.is_some(),
            exposure_spread: outcome.exposure.map(|found| found.spread),
            exposure_fitted: outcome.exposure.is_some_and(|found| found.fitted),
            withheld_gap_db: outcome.withheld.map(|found| found.gap_db),
            weight_decay: outcome.withheld.map_or(config.optimiser.weight_decay, |found| found.weight_decay),
            moved: outcome.moved.iter().map(moved_view).collect(),
            views: outcome.scores.views.len(),
            flat: outcome.flat,
            flat_psnr_db: outcome.flat_psnr_db,
            background: colour::name(outcome.background),
            train_seconds: outcome.train_seconds,
            total_seconds,
            steps: outcome.steps,
            reseeds: outcome.reseeds,
            parameters: outcome.parameters,
            blob_bytes: outcome.bytes.len(),
            occupancy_required: outcome.occupancy_required,
            occupied_share: Short(outcome.occupied_share),
            subnormal_weights: outcome.subnormal_weights,
            evaluated_samples_per_second,
            trained_samples_per_second,
            seed: config.seed,
            engine: config.engine,
            kernel: kernel.to_string(),
            threads: rayon::current_num_threads(),
            cpu: cpu::name(),
            view_dependence_gain_db: outcome.view_dependence.map(|found| found.gain_db),
            view_dependence_left_out: outcome.view_dependence.map(|found| found.left_out),
            occupancy_loss_db: outcome.occupancy_loss_db,
            quantisation_loss_db: outcome.quantisation_loss_db,
            grid: Blob::open(&outcome.bytes).ok().and_then(|blob| GridSummary::of(&blob)),
            trend: TrendSummary::of(outcome),
            z_depth_median_relative_error: None,
            capture: None,
            data: data.into(),
            blob: blob.display().to_string(),
        }
    }
}

/// Training photograph that shows a moving object. The object's pixels were left out of the loss.
#[derive(Debug, Serialize)]
pub struct MovedView {
    pub view: String,
    pub masked_share: Short,
}

/// Findings about the photographs, before and after the fit.
#[derive(Debug, Serialize)]
pub struct Capture {
    pub folded: Option<bool>,
    pub left_out: Vec<String>,
    #[serde(flatten)]
    pub fitted: Fitted,
}

impl Capture {
    /// Combines the findings before the fit, `diagnosis`, with a judgement of the training photographs' final PSNRs.
    pub fn of(diagnosis: &Diagnosis, outcome: &Outcome) -> Self {
        let photographs: Vec<_> = outcome.trained.iter().map(|score| (&*score.view, score.psnr_db)).collect();
        let fitted = Fitted::of(diagnosis, &photographs, outcome.steps);
        Self { folded: diagnosis.folded, left_out: diagnosis.contradicting.clone(), fitted }
    }
}

/// Validations during training, and the step at which their PSNR stopped rising.
#[derive(Debug, Serialize)]
pub struct TrendSummary {
    pub watched_views: usize,
    pub validations: usize,
    pub last_watched_psnr_db: Option<f64>,
    pub val_stopped_rising_step: Option<u32>,
    pub val_stopped_rising_seconds: Option<f64>,
}

impl TrendSummary {
    fn of(outcome: &Outcome) -> Self {
        let validations: Vec<f64> = outcome.curve.iter().filter_map(|point| point.val_psnr_db).collect();
        let stop = outcome.overfitting.filter(|_| !outcome.watched.is_empty());
        Self {
            watched_views: outcome.watched.len(),
            validations: validations.len(),
            last_watched_psnr_db: validations.last().copied(),
            val_stopped_rising_step: stop.map(|stop| stop.step),
            val_stopped_rising_seconds: stop.map(|stop| stop.seconds),
        }
    }
}
