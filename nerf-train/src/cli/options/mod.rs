//! Flags that several commands share.

pub mod data;
pub mod effects;
pub mod grid;
pub mod quality;
pub mod settings;

use crate::cli::common::{Global, check_max_seconds};
use crate::cli::places;
use crate::fit::run::RunOptions;
use crate::fit::snapshot::SnapshotOptions;
use crate::lab::Shard;
use crate::system::output::claims::{Claims, Existing, is_device};
use crate::train::schedule::{Budget, MIN_STEPS};
use anyhow::bail;
use clap::{Args, ValueEnum};
use glam::Vec3;
use std::path::PathBuf;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum UpAxis {
    X,
    Y,
    Z,
    #[value(name = "-x")]
    NegX,
    #[value(name = "-y")]
    NegY,
    #[value(name = "-z")]
    NegZ,
}

impl UpAxis {
    pub fn direction(self) -> Vec3 {
        match self {
            Self::X => Vec3::X,
            Self::Y => Vec3::Y,
            Self::Z => Vec3::Z,
            Self::NegX => Vec3::NEG_X,
            Self::NegY => Vec3::NEG_Y,
            Self::NegZ => Vec3::NEG_Z,
        }
    }
}

/// Option that selects the part of the work that this process does.
#[derive(Debug, Args)]
pub struct ShardOption {
    /// Do part I of N of the work, 1/N to N/N [default: by the index of a Slurm or Kubernetes array job, else all].
    #[arg(long, value_name = "I/N")]
    pub shard: Option<Shard>,
}

impl ShardOption {
    /// Returns the part of the work that `--shard` selects. Without `--shard`, the index of an array job selects the
    /// part, and a message says so. Without an array job, returns the whole work.
    pub fn choose(&self, global: &Global) -> anyhow::Result<Shard> {
        if let Some(part) = self.shard {
            return Ok(part);
        }
        let found = Shard::of_array(|name| std::env::var(name).ok()).map_err(anyhow::Error::msg)?;
        let Some((variable, part)) = found else { return Ok(Shard::WHOLE) };
        global.say(format!("part {part} of the work, by {variable}"));
        Ok(part)
    }
}

/// Options for the outputs, the time limit and the checkpoints of `fit` and `image fit`.
#[derive(Debug, Args)]
pub struct Conduct {
    /// Output file (.nerf); FILE.checkpoint is written next to it.
    #[arg(long, short, value_name = "FILE")]
    pub output: PathBuf,
    /// Report folder: summary.json, curves, plots, images.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// Wall-clock limit of this command, seconds; a run with a limit is not reproducible.
    #[arg(long, value_name = "S")]
    max_seconds: Option<f64>,
    /// Resume from the checkpoint next to the output file.
    #[arg(long)]
    resume: bool,
    /// Start over; replaces the existing checkpoint.
    #[arg(long, conflicts_with = "resume")]
    restart: bool,
    /// Seconds between checkpoints.
    #[arg(long, value_name = "S", default_value_t = 30.0)]
    checkpoint_every: f64,
}

impl Conduct {
    /// Returns `inputs` with the output file and the report folder added as outputs.
    pub fn claims(&self, inputs: Claims) -> Claims {
        inputs.writes("-o", &self.output).writes_folder("--report", self.report.as_deref())
    }

    /// Checks the options. Checks that no output in `claims`, and no checkpoint, overwrites another file. Then creates
    /// the folders of the outputs. Returns the path of the checkpoint; `None` if the output file is a device.
    pub fn check(&self, claims: Claims) -> anyhow::Result<Option<PathBuf>> {
        check_max_seconds(self.max_seconds)?;
        // An infinite interval is valid: no checkpoint is written during training.
        if self.checkpoint_every.is_nan() || self.checkpoint_every < 0.0 {
            bail!("--checkpoint-every: expected seconds of at least 0, found {}", self.checkpoint_every);
        }
        places::check_extension("-o", &self.output, places::BLOB)?;
        places::check_report(self.report.as_ref())?;
        let existing = match self.resume || self.restart {
            true => Existing::Replace,
            false => Existing::Refuse(": --resume goes on from it, --restart replaces it"),
        };
        let mut checkpoint = self.output.as_os_str().to_owned();
        checkpoint.push(".checkpoint");
        let checkpoint = (!is_device(&self.output)).then_some(PathBuf::from(checkpoint));
        match &checkpoint {
            Some(checkpoint) => claims.derives("the checkpoint beside -o", checkpoint, existing).settle()?,
            None => claims.settle()?,
        }
        if self.resume && checkpoint.is_none() {
            bail!("--resume: {} is a device, which has no checkpoint beside it", self.output.display());
        }
        Ok(checkpoint)
    }

    /// Returns options to render the validation views `views` at the training steps `steps`; `None` without `--report`.
    pub fn snapshots(&self, steps: &[u32], views: &[usize]) -> Option<SnapshotOptions> {
        let folder = self.report.clone()?;
        Some(SnapshotOptions { folder, steps: steps.into(), views: views.into() })
    }

    /// Returns a run's options. `steps`: limit of steps; if no flag `asked` for it, `--max-seconds` replaces the limit.
    pub fn options(
        &self,
        (steps, asked): (u32, bool),
        checkpoint: Option<PathBuf>,
        global: &Global,
    ) -> RunOptions {
        let steps = (asked || self.max_seconds.is_none()).then_some(steps);
        RunOptions {
            min_steps: MIN_STEPS,
            checkpoint,
            checkpoint_every: self.checkpoint_every,
            resume: self.resume,
            ..RunOptions::unattended(
                Budget { steps, seconds: self.max_seconds },
                global.kernel(),
                global.style(),
            )
        }
    }
}
