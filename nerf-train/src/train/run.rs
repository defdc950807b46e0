//! One run from first step to blob: progress, validation, snapshots, checkpoints, Ctrl-C.

use super::checkpoint::{Checkpoint, CheckpointError};
use super::schedule::{Budget, Clock, duration};
use super::{About, CurvePoint, TrainError, Trainer};
use crate::config::Config;
use crate::dataset::{Dataset, View};
use crate::eval::{EvalError, Scores, measure};
use crate::occupancy::Occupancy;
use crate::output::OutputError;
use crate::report::error::ReportError;
use crate::report::progress::{Message, Progress, ProgressStyle, Total};
use nerf_core::kernels::Tier;
use nerf_core::plan::Quality;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Validation views a run looks at in the end, spread over the split.
pub const FINAL_VIEWS: usize = 10;
/// Validation views it looks at on the way.
const WATCHED_VIEWS: usize = 2;
/// Times it looks on the way, where no interval is given.
const LOOKS: f64 = 8.0;
/// A grid is part of the model if leaving it out changes training views by more than this, dB: a little
/// less than the 0.1 dB that a blob promises for views nobody has seen.
const GRID_LOSS_DB: f64 = 0.08;
/// Training views that the grid's loss is measured on.
const GRID_VIEWS: usize = 3;

/// How a run is conducted.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Limits.
    pub budget: Budget,
    /// Where checkpoints go; none are written without.
    pub checkpoint: Option<PathBuf>,
    /// Seconds between checkpoints.
    pub checkpoint_every: f64,
    /// Whether to take up the checkpoint.
    pub resume: bool,
    /// Where snapshots go.
    pub report: Option<PathBuf>,
    /// Steps at which a validation view is written as a picture.
    pub snapshots: Vec<u32>,
    /// Steps between looks at validation views; an eighth of the budget if absent.
    pub validate_every: Option<u32>,
    /// Kernel tier.
    pub tier: Tier,
    /// Display.
    pub style: ProgressStyle,
}

/// What a run made.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The blob.
    pub bytes: Vec<u8>,
    /// Validation scores of that very blob, over `background`; empty without validation views.
    pub scores: Scores,
    /// The background of the scores, display-encoded.
    pub background: [f32; 3],
    /// dB that rounding to f16 cost on the same views.
    pub quantisation_loss_db: Option<f64>,
    /// dB that leaving the grid out cost on training views.
    pub grid_loss_db: f64,
    /// Whether the grid is part of the model.
    pub grid_required: bool,
    /// Weights that became f16 subnormals.
    pub subnormal_weights: usize,
    /// The curve.
    pub curve: Vec<CurvePoint>,
    /// Steps.
    pub steps: u32,
    /// Parameters as trained.
    pub parameters: usize,
    /// Live share of the exported grid.
    pub occupancy: f32,
    /// Seconds from the start until the last step, reading and validation included.
    pub train_seconds: f64,
    /// Peak rate: live samples trained on, a second of training.
    pub samples_per_second: f64,
}

/// How a run ended.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "made once a run")]
pub enum Ended {
    /// With a blob.
    Finished(Outcome),
    /// By Ctrl-C, with a checkpoint if there is a place for one.
    Interrupted {
        /// Steps done.
        step: u32,
        /// Where the checkpoint is.
        checkpoint: Option<PathBuf>,
    },
}

/// Why a run failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// Training.
    #[error("{0}")]
    Train(#[from] TrainError),
    /// The blob cannot be measured.
    #[error("own blob: {0}")]
    Eval(#[from] EvalError),
    /// A checkpoint.
    #[error("{0}")]
    Checkpoint(#[from] CheckpointError),
    /// A file.
    #[error("{0}")]
    Output(#[from] OutputError),
    /// A picture.
    #[error("{0}")]
    Report(#[from] ReportError),
}

/// At most `count` views, spread over all of them.
pub fn spread(views: &[View], count: usize) -> Vec<&View> {
    views.iter().step_by(views.len().div_ceil(count).max(1)).collect()
}

/// The views that are looked at on the way: some of those of the end, so that the curve is of a piece.
fn watched(views: &[View]) -> Vec<&View> {
    let all = spread(views, FINAL_VIEWS);
    all.iter().step_by(all.len().div_ceil(WATCHED_VIEWS).max(1)).copied().collect()
}

/// Runs until the budget is used or `stop` is set; `clock` started when the command did.
///
/// # Errors
/// [`RunError`]; a checkpoint written earlier stays as it is.
pub fn run(
    dataset: &Dataset,
    config: Config,
    options: &RunOptions,
    stop: &AtomicBool,
) -> Result<Ended, RunError> {
    run_since(Clock::resume(Duration::ZERO), dataset, config, options, stop)
}

/// As [`run`], with the time since `clock` counted in.
///
/// # Errors
/// As [`run`].
pub fn run_since(
    mut clock: Clock,
    dataset: &Dataset,
    config: Config,
    options: &RunOptions,
    stop: &AtomicBool,
) -> Result<Ended, RunError> {
    let mut trainer = Trainer::new(dataset, config, options.tier)?;
    if let Some(path) = options.checkpoint.as_deref().filter(|_| options.resume) {
        let checkpoint = Checkpoint::read(path)?;
        checkpoint.check_belongs(path, trainer.config(), (&dataset.name, trainer.fingerprint()))?;
        clock = Clock::resume(duration(checkpoint.seconds));
        trainer.restore(checkpoint)?;
    }
    Session::new(trainer, dataset, options, clock).run(stop)
}

struct Session<'a, 'd> {
    trainer: Trainer<'d>,
    dataset: &'d Dataset,
    options: &'a RunOptions,
    clock: Clock,
    /// Seconds that the work after the last step is expected to take.
    reserve: f64,
    last_look: f64,
    last_look_step: u32,
    last_checkpoint: Instant,
    last_val_psnr_db: Option<f64>,
}

impl<'a, 'd> Session<'a, 'd> {
    fn new(trainer: Trainer<'d>, dataset: &'d Dataset, options: &'a RunOptions, clock: Clock) -> Self {
        let reserve = options.budget.seconds.map_or(0.0, |seconds| 0.15 * seconds);
        let last_val_psnr_db = trainer.curve.iter().rev().find_map(|point| point.val_psnr_db);
        Self {
            last_look: 0.0,
            last_look_step: trainer.progressed().step,
            trainer,
            dataset,
            options,
            clock,
            reserve,
            last_checkpoint: Instant::now(),
            last_val_psnr_db,
        }
    }

    fn run(mut self, stop: &AtomicBool) -> Result<Ended, RunError> {
        let budget = self.options.budget;
        let total = match (budget.steps, budget.seconds) {
            (Some(steps), Some(seconds)) => Total::StepsOrTime(u64::from(steps), duration(seconds)),
            (Some(steps), None) => Total::Steps(u64::from(steps)),
            (None, Some(seconds)) => Total::Time(duration(seconds)),
            (None, None) => Total::Unknown,
        };
        let mut progress = Progress::new("train", total, self.options.style)
            .resume_at(u64::from(self.trainer.progressed().step));
        let started = (Instant::now(), *self.trainer.progressed());
        let b = self.trainer.bounds().scene_box;
        progress.println(format!(
            "scene box {} .. {}; {:.1} % of its cells may hold something; {} pixels to draw from",
            b.min,
            b.max,
            100.0 * self.trainer.occupancy(),
            self.trainer.pixels()
        ));
        if self.options.snapshots.contains(&0) && self.trainer.progressed().step == 0 {
            self.look(true)?;
        }
        loop {
            let p = *self.trainer.progressed();
            let share = budget.share(p.step, self.clock.seconds(), self.reserve);
            if share >= 1.0 {
                break;
            }
            if stop.load(Ordering::Relaxed) {
                let checkpoint = self.save()?;
                progress.finish(format!("interrupted after step {}", p.step));
                return Ok(Ended::Interrupted { step: p.step, checkpoint });
            }
            let before = p.reseeds;
            self.trainer.step(share)?;
            let p = *self.trainer.progressed();
            if p.reseeds != before {
                (self.last_look, self.last_look_step) = (0.0, 0);
                progress.println(format!(
                    "every density became 0 (a known failure of ReLU densities); starting anew with another seed, \
                     attempt {} of 4",
                    p.reseeds + 1
                ));
            }
            self.after_step(share)?;
            let rays = p.rays.saturating_sub(started.1.rays) as f64;
            progress.update(
                u64::from(p.step),
                &Message {
                    rays_per_s: Some(rays / started.0.elapsed().as_secs_f64().max(1e-9)),
                    train_psnr_db: Some(self.trainer.train_psnr_db()),
                    val_psnr_db: self.last_val_psnr_db,
                    note: String::new(),
                },
            );
        }
        let p = *self.trainer.progressed();
        let seconds = started.0.elapsed().as_secs_f64().max(1e-9);
        let samples = p.samples.saturating_sub(started.1.samples) as f64 / seconds;
        progress.finish(format!("{} steps, {:.0} thousand live samples/s", p.step, samples / 1e3));
        self.save()?;
        self.finish(samples).map(Ended::Finished)
    }

    /// Looks, snapshots and checkpoints that are due.
    fn after_step(&mut self, share: f64) -> Result<(), RunError> {
        let step = self.trainer.progressed().step;
        let snapshot = self.options.snapshots.contains(&step);
        let due = match self.options.validate_every {
            Some(every) => step - self.last_look_step.min(step) >= every.max(1),
            None => share - self.last_look >= 1.0 / LOOKS,
        };
        if due || snapshot {
            self.last_look = share;
            self.last_look_step = step;
            self.look(snapshot)?;
        } else if step.is_multiple_of(20) {
            let point = self.point(None);
            self.trainer.curve.push(point);
        }
        if self.last_checkpoint.elapsed().as_secs_f64() >= self.options.checkpoint_every {
            self.save()?;
        }
        Ok(())
    }

    fn point(&self, val_psnr_db: Option<f64>) -> CurvePoint {
        CurvePoint {
            step: self.trainer.progressed().step,
            seconds: self.clock.seconds(),
            train_psnr_db: self.trainer.train_psnr_db(),
            val_psnr_db,
        }
    }

    /// Renders a few validation views and notes their PSNR; writes them if asked to.
    fn look(&mut self, snapshot: bool) -> Result<(), RunError> {
        let start = Instant::now();
        let parameters = self.trainer.exported_parameters();
        let occupancy = self.trainer.current_grid();
        let bytes = self.export(&parameters, &occupancy, false, None, None)?;
        let views = watched(&self.dataset.val);
        let (background, step) = (self.trainer.background(), self.trainer.progressed().step);
        let folder = self.options.report.as_deref().filter(|_| snapshot);
        let mut written = Ok(());
        let scores = measure(
            &bytes,
            None,
            self.options.tier,
            &Quality::default(),
            background,
            views.iter().copied(),
            |view, frame, _, _| {
                if let (Some(folder), Ok(())) = (folder, &written) {
                    let name = format!("step_{step:06}_{}.png", file_name(&view.name));
                    written = frame.picture().write_png(folder.join("snapshots").join(name));
                }
            },
        )?;
        written?;
        self.last_val_psnr_db = scores.psnr_db();
        let point = self.point(self.last_val_psnr_db);
        self.trainer.curve.push(point);
        if !views.is_empty()
            && let Some(seconds) = self.options.budget.seconds
        {
            // Final views twice (f16 and f32), and dense views, some ten times as dear.
            let a_view = start.elapsed().as_secs_f64() / views.len() as f64;
            let guess = 1.0 + a_view * (2 * FINAL_VIEWS + 11 * GRID_VIEWS) as f64;
            // An untrained network's views are dear, and no guess may eat the run.
            self.reserve = guess.min(0.15 * seconds);
        }
        Ok(())
    }

    /// Writes a checkpoint if there is a place for it.
    fn save(&mut self) -> Result<Option<PathBuf>, RunError> {
        self.last_checkpoint = Instant::now();
        let Some(path) = &self.options.checkpoint else { return Ok(None) };
        self.trainer.checkpoint(self.clock.seconds()).write(path)?;
        Ok(Some(path.clone()))
    }

    fn export(
        &self,
        parameters: &[f32],
        occupancy: &Occupancy,
        grid_required: bool,
        scores: Option<(f64, &str)>,
        quantisation_loss_db: Option<f64>,
    ) -> Result<Vec<u8>, TrainError> {
        let about = About {
            parameters,
            occupancy,
            grid_required,
            psnr_db: scores.map(|(db, _)| db),
            convention: scores.map_or("", |(_, convention)| convention),
            quantisation_loss_db,
        };
        Ok(self.trainer.export(&about)?.bytes)
    }

    /// Exports, and measures the very blob that is exported.
    fn finish(mut self, samples_per_second: f64) -> Result<Outcome, RunError> {
        let train_seconds = self.clock.seconds();
        let parameters = self.trainer.exported_parameters();
        let occupancy = self.trainer.exported_grid(&parameters);
        let (tier, background) = (self.options.tier, self.trainer.background());
        let draft = self.export(&parameters, &occupancy, false, None, None)?;
        let quality = Quality::default();

        let psnr = |quality: &Quality| -> Result<f64, EvalError> {
            let views = spread(&self.dataset.train, GRID_VIEWS);
            let scores = measure(&draft, None, tier, quality, background, views, |_, _, _, _| {})?;
            Ok(scores.psnr_db().unwrap_or(f64::NAN))
        };
        let grid_loss_db = psnr(&quality)? - psnr(&Quality { skip_grid: false, ..quality })?;
        let grid_required = grid_loss_db.is_nan() || grid_loss_db.abs() > GRID_LOSS_DB;

        let views = spread(&self.dataset.val, FINAL_VIEWS);
        let score = |parameters| {
            measure(&draft, parameters, tier, &quality, background, views.iter().copied(), |_, _, _, _| {})
        };
        let scores = score(None)?;
        let unrounded = score(Some(&parameters))?.psnr_db();
        let psnr_db = scores.psnr_db();
        let quantisation_loss_db = unrounded.zip(psnr_db).map(|(unrounded, rounded)| unrounded - rounded);
        let rgb = background.map(|c| (c * 255.0).round());
        let convention = format!(
            "mean over {} validation views, background sRGB ({}, {}, {}), {} samples a ray",
            views.len(),
            rgb[0],
            rgb[1],
            rgb[2],
            self.trainer.config().sampling.samples
        );
        let about = About {
            parameters: &parameters,
            occupancy: &occupancy,
            grid_required,
            psnr_db,
            convention: &convention,
            quantisation_loss_db,
        };
        let exported = self.trainer.export(&about)?;
        let names: Vec<&str> = watched(&self.dataset.val).iter().map(|view| view.name.as_str()).collect();
        let of_watched = Scores {
            views: scores
                .views
                .iter()
                .filter(|score| names.contains(&score.view.as_str()))
                .cloned()
                .collect(),
            counters: scores.counters,
        };
        let mut point = self.point(of_watched.psnr_db());
        point.seconds = train_seconds;
        self.trainer.curve.push(point);
        Ok(Outcome {
            bytes: exported.bytes,
            scores,
            background,
            quantisation_loss_db,
            grid_loss_db,
            grid_required,
            subnormal_weights: exported.subnormal_weights,
            steps: self.trainer.progressed().step,
            parameters: self.trainer.parameters(),
            occupancy: occupancy.grid().occupancy(),
            train_seconds,
            samples_per_second,
            curve: self.trainer.curve,
        })
    }
}

/// A view's name as part of a file name.
pub fn file_name(name: &str) -> String {
    let stem = Path::new(name).with_extension("");
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = stem.to_string_lossy().trim_start_matches("./").chars().map(plain).collect();
    name.trim_end_matches('_').to_string()
}
