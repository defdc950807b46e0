//! One run from first step to blob: progress, validation, snapshots, checkpoints, Ctrl-C.

use crate::data::Dataset;
pub use crate::fit::drive::{Ended, interrupted};
use crate::fit::drive::{File, POINT_EVERY, Task, drive, nothing_done};
use crate::fit::finish::{self, Outcome};
use crate::fit::live::{Live, State};
use crate::fit::pace::Pace;
use crate::fit::snapshot::SnapshotOptions;
pub use crate::fit::validation::spread;
use crate::fit::validation::{self, ASKED_VIEWS, Due, pixels_of, watched};
use crate::model::config::Config;
use crate::system::output::ensure_folder;
use crate::system::progress::{Message, Progress, ProgressStyle};
use crate::train::candidate::{About, Candidate};
use crate::train::checkpoint::{Checkpoint, damaged, settings};
use crate::train::moving::in_words;
use crate::train::schedule::{Budget, Clock, Done, duration};
use crate::train::{Progressed, RESEEDS, TrainError, Trainer};
use nerf_core::Kernel;
use serde_json::Value;
use std::path::PathBuf;
use std::time::Instant;

#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Limits in steps and seconds. The limit in seconds applies to this command alone, even if it resumes a run.
    pub budget: Budget,
    /// Least number of steps. The run fails if its limit in seconds is reached before this number of steps.
    pub min_steps: u32,
    /// Path of the checkpoint file; `None`: no checkpoints are written.
    pub checkpoint: Option<PathBuf>,
    pub checkpoint_every: f64,
    pub resume: bool,
    pub snapshots: Option<SnapshotOptions>,
    /// Whether a report will be written. If so, the run keeps renderings for the report, and reserves time to write it.
    pub report: bool,
    /// Steps between validations during training; `None` validates after each eighth of the budget.
    pub validate_every: Option<u32>,
    /// Least PSNR, dB, that view-dependent colour must gain to be exported. `None`: exported in any case.
    pub effect_threshold_db: Option<f64>,
    /// Folder in which the newest blob is kept for a web page; `None` writes no blob during the run.
    pub live: Option<PathBuf>,
    pub kernel: Kernel,
    pub style: ProgressStyle,
}

impl RunOptions {
    /// Returns the options of a run that writes nothing during training, and always exports view-dependent colour.
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

    /// Returns the settings in the checkpoint from which this run resumes; `None` if the run does not resume.
    pub fn resumed_settings(&self) -> anyhow::Result<Option<Value>> {
        let Some(path) = self.checkpoint.as_deref().filter(|_| self.resume) else { return Ok(None) };
        // Text that is not JSON is refused later, as settings of another run.
        Ok(Some(serde_json::from_str(&Checkpoint::read(path)?.config).unwrap_or_default()))
    }

    /// Reads the checkpoint and passes it to `restore`, if the run resumes. Returns `clock` plus the checkpoint's
    /// seconds. Fails if it belongs to a run with other settings (`config`, as JSON) or `data` (name and fingerprint).
    pub(super) fn resumed(
        &self,
        clock: Clock,
        config: &str,
        data: (&str, u64),
        restore: impl FnOnce(Checkpoint) -> Result<(), TrainError>,
    ) -> anyhow::Result<Clock> {
        let Some(path) = self.checkpoint.as_deref().filter(|_| self.resume) else { return Ok(clock) };
        let checkpoint = Checkpoint::read(path)?;
        checkpoint.check_belongs(path, config, data)?;
        let seconds = checkpoint.seconds;
        restore(checkpoint).map_err(|error| damaged(path, format_args!("a damaged one ({error})")))?;
        Ok(clock.after(duration(seconds)))
    }
}

pub(super) struct Session<'a, 'd> {
    pub(super) trainer: Trainer<'d>,
    pub(super) dataset: &'d Dataset,
    pub(super) options: &'a RunOptions,
    /// Limits of the run. The limit in seconds is that of this command plus the time of earlier commands of the run.
    pub(super) budget: Budget,
    /// Indices of the validation views that are measured during training.
    pub(super) watched: Vec<usize>,
    pub(super) pictured: Vec<usize>,
    pub(super) clock: Clock,
    pub(super) pace: Pace,
    /// Number of pixels of all validation views, and number of training pixels on which export candidates are compared.
    pub(super) pixels: [u64; 2],
    /// Counts of steps, rays and samples when this command's first step began; above 0 if the run was resumed.
    pub(super) started: Progressed,
    pub(super) taken_up: Instant,
    pub(super) train_seconds: f64,
    pub(super) samples_per_second: [f64; 2],
    pub(super) live: Option<Live>,
}

impl Session<'_, '_> {
    /// Returns the used fraction of the budget after `step` steps and `seconds`, with time reserved for the end.
    pub(super) fn share_at(&self, step: u32, seconds: f64) -> f64 {
        self.budget.share(step, seconds, self.reserve())
    }

    pub(super) fn reserve(&self) -> f64 {
        let rays = self.trainer.progressed().rays.saturating_sub(self.started.rays).max(1);
        let refining = self.trainer.held_out_rays() as f64 * self.seconds_here() / rays as f64;
        let refining = if self.budget.seconds.is_some() { refining } else { 0.0 };
        self.pace.reserve(self.times() * self.pixels[0], self.pixels[1]) + refining
    }

    /// Returns the number of times that each validation view is measured at the end. If poses are refined, the number
    /// is 2: once with the given pose and once with the refined pose. Otherwise, the number is 1.
    pub(super) fn times(&self) -> u64 {
        if self.trainer.held_out_rays() > 0 { 2 } else { 1 }
    }

    /// Returns the seconds since this command's first step began; above 0.
    pub(super) fn seconds_here(&self) -> f64 {
        self.taken_up.elapsed().as_secs_f64().max(1e-9)
    }
}

/// Fits a scene until the budget is used or `stop` returns true. `stop` is called between steps with the number of
/// steps done. On failure, a checkpoint written earlier stays unchanged.
pub fn run(
    dataset: &Dataset,
    config: Config,
    options: &RunOptions,
    stop: &dyn Fn(u32) -> bool,
) -> anyhow::Result<Ended<Outcome>> {
    run_since(Clock::start(), dataset, config, options, stop)
}

/// Fits a scene as [`run`] does, but with the run's time counted from the start of `clock`.
pub fn run_since(
    clock: Clock,
    dataset: &Dataset,
    config: Config,
    options: &RunOptions,
    stop: &dyn Fn(u32) -> bool,
) -> anyhow::Result<Ended<Outcome>> {
    let watched = watched(dataset.val.len());
    let mut pictured = Vec::new();
    if let Some(snapshots) = &options.snapshots {
        pictured = snapshots.views_of(dataset, &watched)?;
        ensure_folder(snapshots.folder.join("snapshots"))?;
    }
    let mut trainer = Trainer::new(dataset, config, options.kernel)?;
    let (config, data) = (settings(&trainer.config), (&*dataset.name, trainer.fingerprint));
    let clock = options.resumed(clock, &config, data, |checkpoint| trainer.restore(checkpoint))?;
    let started = *trainer.progressed();
    let pace = Pace::new(options.budget.seconds, options.report, trainer.config.network.grid.is_none());
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
        session.live = Some(Live::begin(folder.clone(), dataset, session.trainer.background)?);
    }
    let progress = progress(&session);
    drive(&mut session, options.checkpoint_every, progress, stop)
}

impl Task for Session<'_, '_> {
    type Outcome = Outcome;
    type Due = Due;

    fn steps(&self) -> u32 {
        self.trainer.progressed().step
    }

    fn share(&mut self, last_step: f64) -> anyhow::Result<f64> {
        Ok(self.share_at(self.steps(), self.clock.seconds() + last_step))
    }

    fn check_steps(&self) -> anyhow::Result<()> {
        let seconds = self.clock.own_seconds();
        let done = Done {
            before: self.started.step,
            steps: self.steps(),
            prepared: seconds - self.seconds_here(),
            seconds,
            reserve: self.reserve(),
        };
        self.options.budget.check_steps(done, self.options.min_steps)
    }

    fn due(&self, share: f64, ended: bool) -> Option<Due> {
        validation::due_at(self, share, ended)
    }

    fn validate(&mut self, due: Due) -> anyhow::Result<()> {
        validation::validate(self, due)
    }

    fn note(&mut self, ended: bool) {
        if ended || self.steps().is_multiple_of(POINT_EVERY) {
            self.trainer.state.note(self.clock.seconds());
        }
    }

    fn step(&mut self, share: f64, progress: &Progress) -> anyhow::Result<()> {
        let before = self.trainer.progressed().reseeds;
        let train = &self.dataset.train;
        let found = &self.trainer.state.photographs;
        let (exposure, poses, withheld) = (found.exposure, found.poses_found, found.withheld_found);
        let moved = found.has_moved();
        // Runs the step on a thread of the pool. Otherwise each parallel part of the step would have to wake the pool.
        rayon::scope(|_| self.trainer.step(share))?;
        let found = &self.trainer.state.photographs;
        let new = [
            found.exposure.filter(|found| Some(*found) != exposure).map(|found| found.in_words(train)),
            found.poses_found.filter(|found| Some(*found) != poses).map(|found| found.to_string()),
            found.withheld_found.filter(|_| withheld.is_none()).map(|found| found.to_string()),
        ];
        new.into_iter().flatten().for_each(|words| progress.println(words));
        if found.has_moved() && !moved {
            in_words(&found.moved(train)).into_iter().for_each(|words| progress.println(words));
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
        show_live(self, progress)
    }

    fn message(&self) -> Message {
        let rays = self.trainer.progressed().rays.saturating_sub(self.started.rays) as f64;
        Message {
            rays_per_s: Some(rays / self.seconds_here()),
            train_psnr_db: Some(self.trainer.state.train_psnr_db()),
            val_psnr_db: self.trainer.state.last_validation().map(|(_, db)| db),
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

    fn as_it_stands(&self) -> anyhow::Result<Option<File>> {
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

    fn finish(&mut self) -> anyhow::Result<Outcome> {
        finish::finish(self)
    }
}

fn progress(session: &Session<'_, '_>) -> Progress {
    let budget = session.options.budget;
    let progress = Progress::new("train", budget.total(), session.options.style)
        .resume_at(u64::from(session.started.step));
    let b = session.trainer.bounds.scene_box;
    let occupancy = session.trainer.state.occupancy.as_ref();
    progress.println(format!(
        "scene box {} .. {}; {:.1} % of its cells may hold something; {} pixels to draw from",
        b.min,
        b.max,
        100.0 * occupancy.map_or(1.0, |occupancy| occupancy.lookup().occupied_share()),
        session.trainer.pixels()
    ));
    let found = &session.trainer.state.photographs;
    let known = [
        session.trainer.sights.as_ref().map(ToString::to_string),
        found.exposure.map(|found| found.in_words(&session.dataset.train)),
        found.poses_found.map(|found| found.to_string()),
    ];
    known.into_iter().flatten().for_each(|words| progress.println(words));
    progress
}

/// Writes the present field into the live folder, if the next update of the web page is due.
fn show_live(session: &mut Session<'_, '_>, progress: &Progress) -> anyhow::Result<()> {
    if !session.live.as_ref().is_some_and(Live::is_due) {
        return Ok(());
    }
    let begun = Instant::now();
    let state = State {
        step: session.steps(),
        seconds: session.clock.seconds(),
        train_psnr_db: session.trainer.state.train_psnr_db(),
        val_psnr_db: session.trainer.state.last_validation().map(|(_, db)| db),
        done: false,
    };
    let candidate = Candidate::of(&session.trainer, false);
    let about = About { occupancy_required: true, psnr_db: state.val_psnr_db, ..About::default() };
    let blob = candidate.export(&session.trainer, &about)?.bytes;
    let warning = session.live.as_mut().and_then(|live| live.write(&blob, &state, begun));
    warning.into_iter().for_each(|warning| progress.warn(warning));
    Ok(())
}
