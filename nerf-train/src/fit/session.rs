//! The options of a run, and its state.

use crate::data::Dataset;
use crate::fit::live::Live;
use crate::fit::pace::Pace;
use crate::fit::snapshot::SnapshotOptions;
use crate::system::progress::ProgressStyle;
use crate::train::checkpoint::{Checkpoint, damaged};
use crate::train::schedule::{Budget, Clock, duration};
use crate::train::{Progressed, TrainError, Trainer};
use nerf_core::Kernel;
use std::path::PathBuf;
use std::time::Instant;

#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Limits; one in seconds is for this command only, even if it resumes a checkpoint.
    pub budget: Budget,
    /// Fewest steps of a run that a limit in seconds ends.
    pub min_steps: u32,
    /// Path of checkpoints; without it none are written.
    pub checkpoint: Option<PathBuf>,
    pub checkpoint_every: f64,
    pub resume: bool,
    /// Pictures to take of validation views during training; none are taken without.
    pub snapshots: Option<SnapshotOptions>,
    /// Whether a report is written afterwards, which takes pictures and time.
    pub report: bool,
    /// Steps between validations during training; an eighth of the budget if absent.
    pub validate_every: Option<u32>,
    /// PSNR that view dependence must gain to be exported, dB; not measured if absent.
    pub effect_threshold_db: Option<f64>,
    /// Folder that always has the newest blob, for a page to show.
    pub live: Option<PathBuf>,
    pub kernel: Kernel,
    pub style: ProgressStyle,
}

impl RunOptions {
    /// Options of a run that writes nothing during training and asks no questions about its export.
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

    /// Calls `restore` with the checkpoint if the run resumes, and returns the clock with the earlier seconds.
    /// `config`, `data`: as in [`Checkpoint::check_belongs`].
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
    /// Limits, including what earlier commands used.
    pub(super) budget: Budget,
    /// Validation views that are measured during training.
    pub(super) watched: Vec<usize>,
    /// Validation views that pictures are taken of.
    pub(super) pictured: Vec<usize>,
    pub(super) clock: Clock,
    /// Time that validation and the work after the last step may take.
    pub(super) pace: Pace,
    /// Pixels of all validation views, and pixels of the training views for one question about the export.
    pub(super) pixels: [u64; 2],
    /// Counters at the start, or when the run was resumed.
    pub(super) started: Progressed,
    pub(super) taken_up: Instant,
    /// Seconds from the start until the last step.
    pub(super) train_seconds: f64,
    /// Samples evaluated and samples trained on, per second of training.
    pub(super) samples_per_second: [f64; 2],
    pub(super) live: Option<Live>,
}

impl Session<'_, '_> {
    /// Used fraction of the budget without the reserve for the end.
    pub(super) fn share_at(&self, step: u32, seconds: f64) -> f64 {
        self.budget.share(step, seconds, self.reserve())
    }

    pub(super) fn reserve(&self) -> f64 {
        let rays = self.trainer.progressed().rays.saturating_sub(self.started.rays).max(1);
        let refining = self.trainer.held_out_rays() as f64 * self.seconds_here() / rays as f64;
        let refining = if self.budget.seconds.is_some() { refining } else { 0.0 };
        self.pace.reserve(self.times() * self.pixels[0], self.pixels[1]) + refining
    }

    /// Number of times that validation views are measured at the end: twice if there are refined poses.
    pub(super) fn times(&self) -> u64 {
        if self.trainer.held_out_rays() > 0 { 2 } else { 1 }
    }

    /// Seconds since the start, or since the run was resumed; above 0.
    pub(super) fn seconds_here(&self) -> f64 {
        self.taken_up.elapsed().as_secs_f64().max(1e-9)
    }
}
