//! The end of a run: what is exported, and how good it is.

use super::CurvePoint;
use super::candidate::About;
use super::direction::ViewDependence;
use super::look::{FINAL_VIEWS, GRID_VIEWS};
use super::run::{RunError, Session, spread};
use super::snapshot::Snapshot;
use super::trend::Trend;
use crate::eval::{EvalError, Scores, measure};
use crate::report::metrics::{flat_psnr_db, gain_db, is_flat, mean_flat_psnr_db};
use nerf_core::plan::Quality;

/// A grid is part of the model if leaving it out changes training views by more than this, dB: a little
/// less than the 0.1 dB that a blob promises for views nobody has seen.
pub const GRID_LOSS_DB: f64 = 0.08;

/// What a run made.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The blob.
    pub bytes: Vec<u8>,
    /// Validation scores of that very blob, over `background`; empty without validation views.
    pub scores: Scores,
    /// The background of the scores, display-encoded.
    pub background: [f32; 3],
    /// Mean PSNR that a flat colour would have on the same views, each its own, dB; on training views without any.
    /// Views that are flat themselves do not count.
    pub flat_psnr_db: f64,
    /// Whether the blob shows no more than that on any of them: too fast a rate, or too few steps.
    pub flat: bool,
    /// dB that rounding to f16 cost on the same views.
    pub quantisation_loss_db: Option<f64>,
    /// dB that leaving the grid out cost on training views.
    pub grid_loss_db: f64,
    /// Whether the grid is part of the model.
    pub grid_required: bool,
    /// What view dependence is worth; `None` if that was not asked.
    pub view_dependence: Option<ViewDependence>,
    /// Weights that became f16 subnormals.
    pub subnormal_weights: usize,
    /// The curve.
    pub curve: Vec<CurvePoint>,
    /// What the curve says of the end of the run.
    pub trend: Trend,
    /// How the exported step was chosen; `None` without validation views.
    pub chosen: Option<Chosen>,
    /// The step that was exported: the one chosen, or the last.
    pub exported_step: u32,
    /// Pictures that were taken on the way.
    pub snapshots: Vec<Snapshot>,
    /// Steps that pictures were asked for and that the run did not come by.
    pub missed_snapshots: Vec<u32>,
    /// Steps.
    pub steps: u32,
    /// Times the run was started anew with another seed because every density had become 0.
    pub reseeds: u32,
    /// Parameters as trained.
    pub parameters: usize,
    /// Live share of the exported grid.
    pub occupancy: f32,
    /// Seconds from the start until the last step, reading and validation included.
    pub train_seconds: f64,
    /// Peak rate: live samples trained on, a second of training.
    pub samples_per_second: f64,
}

/// How validation chose the step that is exported.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// Names of the watched views that it was chosen by; they are among those of the final scores.
    pub watched: Vec<String>,
    /// Looks it was chosen from.
    pub looks: usize,
    /// Seconds since the start when it was looked at.
    pub seconds: f64,
    /// Mean PSNR of the watched views at that look and from the blob, dB.
    pub val_psnr_db: f64,
    /// The same at the last look, dB.
    pub last_val_psnr_db: f64,
}

impl Session<'_, '_> {
    /// Exports what validation liked best, or the last, and measures the very blob that is exported.
    pub(super) fn finish(self, train_seconds: f64, samples_per_second: f64) -> Result<Outcome, RunError> {
        let mut candidate = match self.trainer.best() {
            Some(best) => best.candidate.clone(),
            None => self.trainer.candidate(),
        };
        let view_dependence = self.ask_direction(&mut candidate)?;
        let (tier, background) = (self.options.tier, self.trainer.background());
        let draft = self.trainer.export(&candidate, &About::default())?.bytes;
        let quality = Quality::default();

        let trained = spread(&self.dataset.train, GRID_VIEWS);
        let on_trained = |quality: &Quality| -> Result<Scores, EvalError> {
            let views = trained.iter().copied();
            measure(&draft, None, tier, quality, background, views, |_, _, _, _| {})
        };
        let trained_scores = on_trained(&quality)?;
        let without_grid = on_trained(&Quality { skip_grid: false, ..quality })?;
        let db = |scores: &Scores| scores.psnr_db().unwrap_or(f64::NAN);
        let grid_loss_db = gain_db(db(&trained_scores), db(&without_grid));
        let grid_required = grid_loss_db.is_nan() || grid_loss_db.abs() > GRID_LOSS_DB;

        let views = spread(&self.dataset.val, FINAL_VIEWS);
        let score = |parameters| {
            measure(&draft, parameters, tier, &quality, background, views.iter().copied(), |_, _, _, _| {})
        };
        let scores = score(None)?;
        let unrounded = score(Some(&candidate.parameters))?.psnr_db();
        let psnr_db = scores.psnr_db();
        let quantisation_loss_db =
            unrounded.zip(psnr_db).map(|(unrounded, rounded)| gain_db(unrounded, rounded));
        let (judged, judged_scores) =
            if views.is_empty() { (&trained, &trained_scores) } else { (&views, &scores) };
        let flats: Vec<f64> =
            judged.iter().map(|view| flat_psnr_db(&view.composite_over(background))).collect();
        let judged_db = judged_scores.views.iter().map(|score| score.psnr_db);
        let flat = is_flat(judged_db.zip(flats.iter().copied()));
        let convention = self.convention(views.len());
        let about = About { grid_required, psnr_db, convention: &convention, quantisation_loss_db };
        let exported = self.trainer.export(&candidate, &about)?;
        Ok(Outcome {
            bytes: exported.bytes,
            scores,
            background,
            flat_psnr_db: mean_flat_psnr_db(flats),
            flat,
            quantisation_loss_db,
            grid_loss_db,
            grid_required,
            view_dependence,
            subnormal_weights: exported.subnormal_weights,
            trend: Trend::of(&self.trainer.curve),
            chosen: self.chosen(),
            exported_step: candidate.step,
            missed_snapshots: self.missed_snapshots(),
            steps: self.trainer.progressed().step,
            reseeds: self.trainer.progressed().reseeds,
            parameters: self.trainer.parameters(),
            occupancy: candidate.live.grid().occupancy(),
            train_seconds,
            samples_per_second,
            snapshots: self.trainer.snapshots,
            curve: self.trainer.curve,
        })
    }

    /// What the final scores mean.
    fn convention(&self, views: usize) -> String {
        let [r, g, b] = self.trainer.background().map(|c| (c * 255.0).round());
        let samples = self.trainer.config().sampling.samples;
        format!(
            "mean over {views} validation views, background sRGB ({r}, {g}, {b}), {samples} samples a ray"
        )
    }

    fn chosen(&self) -> Option<Chosen> {
        let best = self.trainer.best()?;
        let names = self.watched.iter().filter_map(|&view| self.dataset.val.get(view));
        Some(Chosen {
            watched: names.map(|view| view.name.clone()).collect(),
            looks: self.trainer.curve.iter().filter(|point| point.val_psnr_db.is_some()).count(),
            seconds: best.seconds,
            val_psnr_db: best.val_psnr_db,
            last_val_psnr_db: self.last_val_psnr_db()?,
        })
    }

    fn missed_snapshots(&self) -> Vec<u32> {
        let taken = &self.trainer.snapshots;
        self.options.snapshots.as_ref().map_or_else(Vec::new, |options| options.missed(taken))
    }
}
