//! Loop of every fit, of a scene or a picture: budget, validation, checkpoints, Ctrl-C, progress.

use crate::system::output::write_atomic;
use crate::system::progress::{Message, Progress};
use crate::system::stop::{Claim, Cover};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Number of steps between two points of the training curve that have no validation.
pub(super) const POINT_EVERY: u32 = 20;
/// Seconds of a step above which the bytes of files are made before each step, to be written if a signal interrupts it.
const LONG_STEP: f64 = 0.3;

pub(super) type File = (PathBuf, Vec<u8>);

pub(super) trait Task {
    type Outcome;
    type Due;

    fn steps(&self) -> u32;
    /// Used fraction of the budget, with `last_step`, the seconds of the last step, added to the elapsed time.
    fn share(&mut self, last_step: f64) -> anyhow::Result<f64>;
    /// Returns an error if the limit in seconds ended the run after too few steps.
    fn check_steps(&self) -> anyhow::Result<()>;
    /// Returns the validation that is due at the used fraction `share` of the budget, if any.
    fn due(&self, share: f64, ended: bool) -> Option<Self::Due>;
    fn validate(&mut self, due: Self::Due) -> anyhow::Result<()>;
    /// Adds a point to the training curve, if one is due and the step's validation has added none.
    fn note(&mut self, ended: bool);
    fn step(&mut self, share: f64, progress: &Progress) -> anyhow::Result<()>;
    fn message(&self) -> Message;

    /// Whether the run has results that a signal must not discard.
    fn is_worth_keeping(&self) -> bool;
    /// Checkpoint of the present state, if the run has a path for one.
    fn checkpoint(&self) -> Option<File>;
    /// File to write in addition to the checkpoint when the run is interrupted: a picture's blob.
    fn as_it_stands(&self) -> anyhow::Result<Option<File>>;
    /// Message of an interrupted run.
    fn interrupted(&self) -> String;

    /// Records the totals after the last step; returns a message about the steps.
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

/// Runs until the budget is used or `stop` returns true. `stop` is called between steps with the number of steps done.
///
/// A checkpoint is written every `checkpoint_every` seconds. A signal during a long step, a validation or the final
/// export saves the state from before that work.
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

/// Saves a run's state: at intervals, and when a signal interrupts long work.
struct Keeper {
    /// Claim that makes a signal wait until the run saves its state; absent while there are no results to save.
    claim: Option<Claim>,
    last: Instant,
    /// Whether the warning that checkpoints cannot be written has been shown.
    warned: bool,
}

impl Keeper {
    fn begin(&mut self, task: &impl Task) {
        if self.claim.is_none() && task.is_worth_keeping() {
            self.claim = Some(Claim::new());
        }
    }

    /// Does `work`, which may take long; a signal meanwhile writes the files of the state before the work.
    fn covered<T: Task, R>(
        &self,
        task: &mut T,
        work: impl FnOnce(&mut T) -> anyhow::Result<R>,
    ) -> anyhow::Result<R> {
        let Some(claim) = &self.claim else { return work(task) };
        let files = task.checkpoint().into_iter().chain(task.as_it_stands()?).collect();
        claim.cover(Cover { files, message: task.interrupted() }, || work(task))
    }

    /// Writes the checkpoint. On failure the previous checkpoint stays; only the first failure is reported.
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
