//! The loop of every fit, of scenes and of pictures: budget, validation, checkpoints, Ctrl-C, progress.

use crate::system::output::write_atomic;
use crate::system::progress::{Message, Progress};
use crate::system::stop::{Claim, Cover};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Steps between the points of the curve without validation.
pub(super) const POINT_EVERY: u32 = 20;
/// Longest step, seconds, for which no files are prepared for a signal that comes meanwhile.
const LONG_STEP: f64 = 0.3;

pub(super) type File = (PathBuf, Vec<u8>);

pub(super) trait Task {
    type Outcome;
    type Due;

    fn steps(&self) -> u32;
    /// Used fraction of the budget, if the next step takes as long as the last one did.
    fn share(&mut self, last_step: f64) -> anyhow::Result<f64>;
    /// Refuses a run that its limit in seconds ended after too few steps.
    fn check_steps(&self) -> anyhow::Result<()>;
    /// The validation that is due now, if any is.
    fn due(&self, share: f64, ended: bool) -> Option<Self::Due>;
    fn validate(&mut self, due: Self::Due) -> anyhow::Result<()>;
    /// Adds a point to the curve, if one is due and validation has added none.
    fn note(&mut self, ended: bool);
    fn step(&mut self, share: f64, progress: &Progress) -> anyhow::Result<()>;
    fn message(&self) -> Message;

    /// Whether the run has something that a signal must not lose.
    fn is_worth_keeping(&self) -> bool;
    /// Checkpoint of the present state, if the run has a path for one.
    fn checkpoint(&self) -> Option<File>;
    /// File that is also written when the run is interrupted: a picture's blob.
    fn as_it_stands(&self) -> anyhow::Result<Option<File>>;
    /// Message of an interrupted run.
    fn interrupted(&self) -> String;

    /// Ends the steps; returns a message about them.
    fn ended(&mut self) -> String;
    fn finish(&mut self) -> anyhow::Result<Self::Outcome>;
}

#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "made once a run")]
pub enum Ended<O> {
    Finished(O),
    /// Ended by Ctrl-C, with a checkpoint if the run has a path for one.
    Interrupted {
        step: u32,
        checkpoint: Option<PathBuf>,
    },
}

/// Runs until the budget is used or `stop`, which is called between steps with the steps done, returns true.
///
/// A checkpoint is written every `checkpoint_every` seconds. A signal during any other long work leaves the run as it
/// was before that work.
pub(super) fn drive<T: Task>(
    task: &mut T,
    checkpoint_every: f64,
    mut progress: Progress,
    stop: &dyn Fn(u32) -> bool,
) -> anyhow::Result<Ended<T::Outcome>> {
    let started = task.steps();
    let mut keeper = Keeper { claim: None, last: Instant::now(), warned: false };
    let mut last_step = 0.0;
    loop {
        keeper.begin(task);
        let step = task.steps();
        let share = task.share(last_step)?;
        let ended = share >= 1.0;
        if ended {
            task.check_steps()?;
        }
        if let Some(due) = task.due(share, ended) {
            keeper.covered(task, |task| task.validate(due))?;
        }
        task.note(ended);
        if ended {
            break;
        }
        if stop(step) {
            let checkpoint = task.checkpoint();
            let mut files = checkpoint.clone().into_iter().chain(task.as_it_stands()?);
            files.try_for_each(|(path, bytes)| write_atomic(path, &bytes))?;
            progress.finish(format!("interrupted after step {step}"));
            return Ok(Ended::Interrupted { step, checkpoint: checkpoint.map(|(path, _)| path) });
        }
        if keeper.last.elapsed().as_secs_f64() >= checkpoint_every && step > started {
            keeper.save(task, &progress);
        }
        let begun = Instant::now();
        if last_step > LONG_STEP {
            keeper.covered(task, |task| task.step(share, &progress))?;
        } else {
            task.step(share, &progress)?;
        }
        last_step = begun.elapsed().as_secs_f64();
        progress.update(u64::from(task.steps()), &task.message());
    }
    let said = task.ended();
    keeper.save(task, &progress);
    progress.finish(said);
    keeper.covered(task, T::finish).map(Ended::Finished)
}

/// Protects a run from being lost.
struct Keeper {
    /// Makes signals wait for the run's owner, while there is something to keep.
    claim: Option<Claim>,
    last: Instant,
    /// Whether a warning said that checkpoints cannot be written.
    warned: bool,
}

impl Keeper {
    fn begin(&mut self, task: &impl Task) {
        if self.claim.is_none() && task.is_worth_keeping() {
            self.claim = Some(Claim::new());
        }
    }

    /// Does work that may take long; a signal meanwhile leaves the run as it stands.
    fn covered<T: Task, R>(
        &self,
        task: &mut T,
        work: impl FnOnce(&mut T) -> anyhow::Result<R>,
    ) -> anyhow::Result<R> {
        let Some(claim) = &self.claim else { return work(task) };
        let files = task.checkpoint().into_iter().chain(task.as_it_stands()?).collect();
        claim.cover(Cover { files, message: task.interrupted() }, || work(task))
    }

    /// Writes the checkpoint. If that fails, the one before stays, and the first failure is reported.
    fn save(&mut self, task: &impl Task, progress: &Progress) {
        self.last = Instant::now();
        let Some((path, bytes)) = task.checkpoint() else { return };
        if let Err(error) = write_atomic(&path, &bytes)
            && !std::mem::replace(&mut self.warned, true)
        {
            progress.warn(format!("warning: checkpoint: {error}; the one before stays, and the run goes on"));
        }
    }
}

/// Message of an interrupted run, with or without a checkpoint.
pub fn interrupted(step: u32, checkpoint: Option<&Path>) -> String {
    format!("interrupted after step {step}{}", how_to_go_on(checkpoint))
}

pub(super) fn how_to_go_on(checkpoint: Option<&Path>) -> String {
    checkpoint.map_or_else(String::new, |path| {
        format!("; the checkpoint is {}: go on with the same command and --resume", path.display())
    })
}

/// Message of a resumed run that has no steps left to do.
pub(super) fn nothing_done(steps: u32) -> String {
    format!("nothing was done: the checkpoint has all {steps} steps; --steps asks for more")
}
