//! One run from first step to blob: progress, validation, snapshots, checkpoints, Ctrl-C.

use crate::data::rgb_error::ReportError;
use crate::data::system::output::{OutputError, ensure_folder};
use crate::data::system::progress::{Message, Progress, ProgressStyle};
use crate::data::system::stop::{Claim, Cover};
use crate::data::{Dataset, View};
use crate::fit::finish::Outcome;
use crate::fit::pace::Pace;
use crate::fit::snapshot::{SnapshotError, SnapshotOptions};
use crate::fit::validation::{ASKED_VIEWS, pixels_of, spread_indices, watched};
use crate::measure::eval::EvalError;
use crate::model::config::Config;
use crate::train::checkpoint::{Checkpoint, CheckpointError};
use crate::train::schedule::{Budget, Clock, duration};
use crate::train::{Progressed, TrainError, Trainer};
use nerf_core::Kernel;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Seconds that a step may take without a checkpoint at hand for a signal that comes meanwhile.
const LONG_STEP: f64 = 0.3;

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
    /// Pictures of validation views on the way; none are taken without.
    pub snapshots: Option<SnapshotOptions>,
    /// Whether a report is written afterwards, which takes pictures and time.
    pub report: bool,
    /// Steps between validations on the way; an eighth of the budget if absent.
    pub validate_every: Option<u32>,
    /// What view dependence must gain to be exported, dB; it is not asked if absent.
    pub effect_threshold_db: Option<f64>,
    /// What to run with.
    pub kernel: Kernel,
    /// Display.
    pub style: ProgressStyle,
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
    /// Pictures that cannot be taken.
    #[error("{0}")]
    Snapshot(#[from] SnapshotError),
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
    spread_indices(views.len(), count).map(|i| &views[i]).collect()
}

/// Runs until the budget is used or `stop` says so, which is asked between steps with the steps done.
///
/// # Errors
/// [`RunError`]; a checkpoint written earlier stays as it is.
pub fn run(
    dataset: &Dataset,
    config: Config,
    options: &RunOptions,
    stop: &dyn Fn(u32) -> bool,
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
    stop: &dyn Fn(u32) -> bool,
) -> Result<Ended, RunError> {
    let watched = watched(dataset.val.len());
    let mut pictured = Vec::new();
    if let Some(snapshots) = &options.snapshots {
        pictured = snapshots.views_of(dataset, &watched)?;
        ensure_folder(snapshots.folder.join("snapshots"))?;
    }
    let mut trainer = Trainer::new(dataset, config, options.kernel)?;
    if let Some(path) = options.checkpoint.as_deref().filter(|_| options.resume) {
        let checkpoint = Checkpoint::read(path)?;
        checkpoint.check_belongs(path, trainer.config(), (&dataset.name, trainer.fingerprint()))?;
        clock = Clock::resume(duration(checkpoint.seconds));
        let damaged = |error: TrainError| CheckpointError::Format {
            path: path.into(),
            found: format!("a damaged one ({error})"),
        };
        trainer.restore(checkpoint).map_err(damaged)?;
    }
    let started = *trainer.progressed();
    let pace = Pace::new(options.budget.seconds, options.report, trainer.config().network.grid.is_none());
    let asked = spread(&dataset.train, ASKED_VIEWS);
    let (of_asked, largest) = pixels_of(asked);
    let lattice = pace.lattice_on_the_way(of_asked, largest, f64::INFINITY);
    let pixels = [pixels_of(&dataset.val).0, of_asked / u64::from(lattice).pow(2)];
    let (taken_up, last_checkpoint) = (Instant::now(), Instant::now());
    let session = Session {
        trainer,
        dataset,
        options,
        watched,
        pictured,
        clock,
        started,
        taken_up,
        pace,
        pixels,
        last_checkpoint,
        last_step: 0.0,
        claim: options.checkpoint.is_some().then(Claim::new),
        warned: false,
    };
    session.run(stop)
}

/// A run under way.
pub(super) struct Session<'a, 'd> {
    pub(super) trainer: Trainer<'d>,
    pub(super) dataset: &'d Dataset,
    pub(super) options: &'a RunOptions,
    /// Validation views that are measured on the way.
    pub(super) watched: Vec<usize>,
    /// Validation views that pictures are taken of.
    pub(super) pictured: Vec<usize>,
    pub(super) clock: Clock,
    /// What validation and the work after the last step may take.
    pub(super) pace: Pace,
    /// Pixels of all validation views, and those that a question is asked of on training views.
    pixels: [u64; 2],
    /// Counters at the start, or when the run was taken up again.
    started: Progressed,
    taken_up: Instant,
    last_checkpoint: Instant,
    /// Seconds that the last step took.
    last_step: f64,
    /// Makes signals wait for the checkpoint.
    claim: Option<Claim>,
    /// Whether it was said that checkpoints cannot be written.
    warned: bool,
}

impl Session<'_, '_> {
    fn run(mut self, stop: &dyn Fn(u32) -> bool) -> Result<Ended, RunError> {
        let mut progress = self.progress();
        let train_seconds = loop {
            let (step, seconds) = (self.trainer.progressed().step, self.clock.seconds());
            let share = self.share(step, seconds + self.last_step);
            let ended = share >= 1.0;
            let due = self.due(share, ended);
            if due.any() {
                self.covered(|session| session.validate(due))?;
            }
            self.note(ended);
            if ended {
                break seconds;
            }
            if stop(step) {
                let checkpoint = self.save()?;
                progress.finish(format!("interrupted after step {step}"));
                return Ok(Ended::Interrupted { step, checkpoint });
            }
            let due = self.last_checkpoint.elapsed().as_secs_f64() >= self.options.checkpoint_every;
            if due && step > self.started.step {
                self.save_on_the_way(&progress);
            }
            if self.last_step > LONG_STEP {
                self.covered(|session| session.step(share, &mut progress))?;
            } else {
                self.step(share, &mut progress)?;
            }
        };
        let p = *self.trainer.progressed();
        let a_second = |now: u64, then: u64| now.saturating_sub(then) as f64 / self.seconds_here();
        let samples = a_second(p.samples, self.started.samples);
        let evaluated = a_second(p.evaluated, self.started.evaluated);
        self.save_on_the_way(&progress);
        let (of_all, of_kept) = (evaluated / 1e6, samples / 1e6);
        progress.finish(format!(
            "{} steps; {of_all:.2} million samples evaluated a second, {of_kept:.2} million trained on",
            p.step
        ));
        self.covered(|session| session.finish(train_seconds, [evaluated, samples])).map(Ended::Finished)
    }

    /// Share of the budget that is used, what is kept for the end left out.
    pub(super) fn share(&self, step: u32, seconds: f64) -> f64 {
        self.options.budget.share(step, seconds, self.pace.reserve(self.pixels[0], self.pixels[1]))
    }

    /// Does what may take long; a signal meanwhile leaves a checkpoint of the run as it stands.
    fn covered<T>(&mut self, work: impl FnOnce(&mut Self) -> T) -> T {
        let Some(claim) = self.claim.take() else { return work(self) };
        let cover = self.cover();
        let done = claim.cover(cover, || work(self));
        self.claim = Some(claim);
        done
    }

    /// What a signal writes and says while the run is busy.
    fn cover(&self) -> Cover {
        let step = self.trainer.progressed().step;
        let Some(path) = &self.options.checkpoint else { return Cover::default() };
        let bytes = self.trainer.checkpoint(self.clock.seconds()).to_bytes();
        Cover { file: Some((path.clone(), bytes)), message: interrupted(step, Some(path)) }
    }

    fn progress(&self) -> Progress {
        let budget = self.options.budget;
        let progress = Progress::new("train", budget.total(), self.options.style)
            .resume_at(u64::from(self.started.step));
        let b = self.trainer.bounds().scene_box;
        progress.println(format!(
            "scene box {} .. {}; {:.1} % of its cells may hold something; {} pixels to draw from",
            b.min,
            b.max,
            100.0 * self.trainer.occupied_share(),
            self.trainer.pixels()
        ));
        progress
    }

    /// Seconds since the start, or since the run was taken up again; above 0.
    fn seconds_here(&self) -> f64 {
        self.taken_up.elapsed().as_secs_f64().max(1e-9)
    }

    fn step(&mut self, share: f64, progress: &mut Progress) -> Result<(), RunError> {
        let begun = Instant::now();
        let before = self.trainer.progressed().reseeds;
        // On a thread of the pool, so that the parts of a step need not wake it one by one.
        rayon::scope(|_| self.trainer.step(share))?;
        self.last_step = begun.elapsed().as_secs_f64();
        let p = *self.trainer.progressed();
        if p.reseeds != before {
            self.started = p;
            progress.println(format!(
                "every density became 0 (a known failure of ReLU densities); starting anew with another seed, \
                 attempt {} of 4",
                p.reseeds + 1
            ));
        }
        let rays = p.rays.saturating_sub(self.started.rays) as f64;
        progress.update(
            u64::from(p.step),
            &Message {
                rays_per_s: Some(rays / self.seconds_here()),
                train_psnr_db: Some(self.trainer.train_psnr_db()),
                val_psnr_db: self.last_val_psnr_db(),
                note: String::new(),
            },
        );
        Ok(())
    }

    /// Writes a checkpoint if there is a place for it.
    fn save(&mut self) -> Result<Option<PathBuf>, RunError> {
        self.last_checkpoint = Instant::now();
        let Some(path) = &self.options.checkpoint else { return Ok(None) };
        self.trainer.checkpoint(self.clock.seconds()).write(path)?;
        Ok(Some(path.clone()))
    }

    /// As [`Session::save`]; where it cannot be written, the one before stays, and that is said once.
    fn save_on_the_way(&mut self, progress: &Progress) {
        if let Err(error) = self.save()
            && !std::mem::replace(&mut self.warned, true)
        {
            progress.warn(format!("warning: checkpoint: {error}; the one before stays, and the run goes on"));
        }
    }
}

/// What a run says that was interrupted.
pub fn interrupted(step: u32, checkpoint: Option<&PathBuf>) -> String {
    match checkpoint {
        Some(path) => format!(
            "interrupted after step {step}; the checkpoint is {}: go on with the same command and --resume",
            path.display()
        ),
        None => format!("interrupted after step {step}"),
    }
}
