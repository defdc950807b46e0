//! One run from first step to blob: progress, validation, snapshots, checkpoints, Ctrl-C.

use crate::data::pictures::rgb::ReportError;
use crate::data::{Dataset, View};
pub use crate::fit::drive::{Ended, interrupted};
use crate::fit::drive::{File, Task, drive, nothing_done};
use crate::fit::finish::Outcome;
use crate::fit::live::{Live, State};
use crate::fit::pace::Pace;
use crate::fit::snapshot::{SnapshotError, SnapshotOptions};
use crate::fit::validation::{ASKED_VIEWS, Due, pixels_of, spread_indices, watched};
use crate::measure::eval::EvalError;
use crate::model::config::Config;
use crate::system::output::{OutputError, ensure_folder};
use crate::system::progress::{Message, Progress, ProgressStyle};
use crate::train::candidate::About;
use crate::train::checkpoint::{Checkpoint, CheckpointError};
use crate::train::moving::in_words;
use crate::train::schedule::{Budget, Clock, Done, TooShort, duration};
use crate::train::{Progressed, RESEEDS, TrainError, Trainer};
use nerf_core::Kernel;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// How a run is conducted.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Limits; one in seconds is of this command, also where it goes on from a checkpoint.
    pub budget: Budget,
    /// Fewest steps of a run that a limit in seconds ends.
    pub min_steps: u32,
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
    /// Folder that always has the newest blob, for a page to show.
    pub live: Option<PathBuf>,
    pub kernel: Kernel,
    /// Display.
    pub style: ProgressStyle,
}

impl RunOptions {
    /// A run that writes nothing on the way and asks nothing of what is exported.
    pub fn unattended(budget: Budget, kernel: Kernel, style: ProgressStyle) -> Self {
        Self {
            budget,
            min_steps: 0,
            checkpoint: None,
            checkpoint_every: f64::INFINITY,
            resume: false,
            snapshots: None,
            report: false,
            validate_every: None,
            effect_threshold_db: None,
            live: None,
            kernel,
            style,
        }
    }
}

/// Why a run failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    #[error("{0}")]
    Train(#[from] TrainError),
    #[error("{0}")]
    TooShort(#[from] TooShort),
    #[error("own blob: {0}")]
    Eval(#[from] EvalError),
    #[error("{0}")]
    Snapshot(#[from] SnapshotError),
    #[error("{0}")]
    Checkpoint(#[from] CheckpointError),
    #[error("{0}")]
    Output(#[from] OutputError),
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
) -> Result<Ended<Outcome>, RunError> {
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
) -> Result<Ended<Outcome>, RunError> {
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
        clock = clock.after(duration(checkpoint.seconds));
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
    let mut session = Session {
        trainer,
        dataset,
        options,
        budget: options.budget.after(clock.seconds() - clock.own_seconds()),
        watched,
        pictured,
        clock,
        started,
        taken_up: Instant::now(),
        pace,
        pixels,
        train_seconds: 0.0,
        samples_per_second: [0.0; 2],
        live: None,
    };
    if let Some(folder) = &options.live {
        session.live = Some(Live::begin(folder.clone(), dataset, session.trainer.background())?);
    }
    let progress = session.progress();
    drive(&mut session, options.checkpoint_every, progress, stop)
}

/// A run under way.
pub(super) struct Session<'a, 'd> {
    pub(super) trainer: Trainer<'d>,
    pub(super) dataset: &'d Dataset,
    pub(super) options: &'a RunOptions,
    /// Limits, what earlier commands took counted in.
    budget: Budget,
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
    /// Seconds from the start until the last step.
    pub(super) train_seconds: f64,
    /// Samples evaluated and samples trained on, a second of training.
    pub(super) samples_per_second: [f64; 2],
    live: Option<Live>,
}

impl Task for Session<'_, '_> {
    type Outcome = Outcome;
    type Error = RunError;
    type Due = Due;

    fn steps(&self) -> u32 {
        self.trainer.progressed().step
    }

    fn share(&mut self, last_step: f64) -> Result<f64, RunError> {
        Ok(self.share_at(self.steps(), self.clock.seconds() + last_step))
    }

    fn check_steps(&self) -> Result<(), RunError> {
        let seconds = self.clock.own_seconds();
        let done = Done {
            before: self.started.step,
            steps: self.steps(),
            prepared: seconds - self.seconds_here(),
            seconds,
            reserve: self.reserve(),
        };
        Ok(self.options.budget.check_steps(done, self.options.min_steps)?)
    }

    fn due(&self, share: f64, ended: bool) -> Option<Due> {
        Some(self.due_at(share, ended)).filter(|due| due.any())
    }

    fn validate(&mut self, due: Due, _: f64) -> Result<(), RunError> {
        self.measure_views(due)
    }

    fn note(&mut self, ended: bool) {
        self.note_point(ended);
    }

    fn step(&mut self, share: f64, progress: &Progress) -> Result<(), RunError> {
        let before = self.trainer.progressed().reseeds;
        let (exposure, poses) = (self.trainer.exposure(), self.trainer.poses());
        let moved = self.trainer.has_moved();
        // On a thread of the pool, so that the parts of a step need not wake it one by one.
        rayon::scope(|_| self.trainer.step(share))?;
        if let Some(found) = self.trainer.exposure().filter(|found| Some(*found) != exposure) {
            progress.println(found.in_words(&self.dataset.train));
        }
        if let Some(found) = self.trainer.poses().filter(|found| Some(*found) != poses) {
            progress.println(found.to_string());
        }
        if self.trainer.has_moved() && !moved {
            in_words(&self.trainer.moved()).into_iter().for_each(|words| progress.println(words));
        }
        let p = *self.trainer.progressed();
        if p.reseeds != before {
            self.started = p;
            progress.println(format!(
                "every density became 0; starting anew with another seed, attempt {} of {}",
                p.reseeds + 1,
                RESEEDS + 1
            ));
        }
        self.show_live(progress)
    }

    fn message(&self) -> Message {
        let rays = self.trainer.progressed().rays.saturating_sub(self.started.rays) as f64;
        Message {
            rays_per_s: Some(rays / self.seconds_here()),
            train_psnr_db: Some(self.trainer.train_psnr_db()),
            val_psnr_db: self.last_val_psnr_db(),
            note: String::new(),
        }
    }

    fn is_worth_keeping(&self) -> bool {
        self.options.checkpoint.is_some()
    }

    fn checkpoint(&self) -> Option<File> {
        let path = self.options.checkpoint.clone()?;
        Some((path, self.trainer.checkpoint(self.clock.seconds()).to_bytes()))
    }

    fn as_it_stands(&self) -> Result<Option<File>, RunError> {
        Ok(None)
    }

    fn interrupted(&self) -> String {
        interrupted(self.steps(), self.options.checkpoint.as_deref())
    }

    fn ended(&mut self) -> String {
        let p = *self.trainer.progressed();
        let a_second = |now: u64, then: u64| now.saturating_sub(then) as f64 / self.seconds_here();
        let samples = a_second(p.samples, self.started.samples);
        let evaluated = a_second(p.evaluated, self.started.evaluated);
        (self.train_seconds, self.samples_per_second) = (self.clock.seconds(), [evaluated, samples]);
        if self.options.resume && p.step == self.started.step {
            return nothing_done(p.step);
        }
        format!(
            "{} steps; {:.2} million samples evaluated a second, {:.2} million trained on",
            p.step,
            evaluated / 1e6,
            samples / 1e6
        )
    }

    fn finish(&mut self) -> Result<Outcome, RunError> {
        self.export()
    }
}

impl Session<'_, '_> {
    /// Share of the budget that is used, what is kept for the end left out.
    pub(super) fn share_at(&self, step: u32, seconds: f64) -> f64 {
        self.budget.share(step, seconds, self.reserve())
    }

    /// Seconds kept for the end.
    fn reserve(&self) -> f64 {
        let rays = self.trainer.progressed().rays.saturating_sub(self.started.rays).max(1);
        let refining = self.trainer.held_out_rays() as f64 * self.seconds_here() / rays as f64;
        let refining = if self.budget.seconds.is_some() { refining } else { 0.0 };
        self.pace.reserve(self.times() * self.pixels[0], self.pixels[1]) + refining
    }

    /// How many times validation views are measured in the end: from the refined poses, too, where there are such.
    pub(super) fn times(&self) -> u64 {
        if self.trainer.held_out_rays() > 0 { 2 } else { 1 }
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
        if let Some(sights) = self.trainer.sights() {
            progress.println(sights.to_string());
        }
        if let Some(found) = self.trainer.exposure() {
            progress.println(found.in_words(&self.dataset.train));
        }
        if let Some(found) = self.trainer.poses() {
            progress.println(found.to_string());
        }
        progress
    }

    /// Writes the run's present state to the live page, if the next update is due.
    fn show_live(&mut self, progress: &Progress) -> Result<(), RunError> {
        if !self.live.as_ref().is_some_and(Live::is_due) {
            return Ok(());
        }
        let (begun, state) = (Instant::now(), self.state());
        let candidate = self.trainer.candidate(false);
        let about = About { occupancy_required: true, psnr_db: state.val_psnr_db, ..About::default() };
        let blob = self.trainer.export(&candidate, &about)?.bytes;
        let warning = self.live.as_mut().and_then(|live| live.write(&blob, &state, begun));
        warning.into_iter().for_each(|warning| progress.warn(warning));
        Ok(())
    }

    fn state(&self) -> State {
        State {
            step: self.steps(),
            seconds: self.clock.seconds(),
            train_psnr_db: self.trainer.train_psnr_db(),
            val_psnr_db: self.last_val_psnr_db(),
            done: false,
        }
    }

    /// Seconds since the start, or since the run was taken up again; above 0.
    fn seconds_here(&self) -> f64 {
        self.taken_up.elapsed().as_secs_f64().max(1e-9)
    }
}
