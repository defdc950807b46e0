//! Training loop shared by fits of scenes and of 2D fields: budget, validation, checkpoints, Ctrl-C, progress.

use crate::system::output::write_atomic;
use crate::system::progress::{Message, Progress};
use crate::system::stop::{Claim, Cover};
use anyhow::Result;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Number of steps between two points of the training curve, apart from the points at validations.
pub(super) const POINT_EVERY: u32 = 20;
/// Time that a step or a validation takes, seconds, above which the state is serialised before the next one, to be
/// saved on a signal. A signal during shorter work is answered after it.
const LONG: f64 = 0.3;

pub(super) type File = (PathBuf, Vec<u8>);

pub(super) trait Task {
    type Outcome;
    type Due;

    fn steps(&self) -> u32;
    /// Returns the used fraction of the budget. The used time includes the next step, which is assumed to take
    /// `last_step` seconds, as the last step did.
    fn share(&mut self, last_step: f64) -> Result<f64>;
    /// Returns an error if the limit in seconds ended the run after too few steps.
    fn check_steps(&self) -> Result<()>;
    /// Returns the due validation. `share`: used fraction of the budget. `ended`: whether the last step is done.
    fn due(&self, share: f64, ended: bool) -> Option<Self::Due>;
    fn validate(&mut self, due: Self::Due) -> Result<()>;
    /// Adds a point without validation to the training curve, if a point is due at this step and the curve has no point
    /// at this step yet. `ended`: whether the last step is done.
    fn note(&mut self, ended: bool);
    fn step(&mut self, share: f64, progress: &Progress) -> Result<()>;
    fn message(&self) -> Message;

    /// Whether the run has results that must be saved before a signal ends the process.
    fn is_worth_keeping(&self) -> bool;
    /// Returns the path and bytes of a checkpoint of the present state; `None` if the run writes no checkpoints.
    fn checkpoint(&self) -> Option<File>;
    /// Returns path and bytes of the present 2D field's file. If the run is interrupted, this file is written in
    /// addition to the checkpoint. `None` for a scene, or without an output path.
    fn as_it_stands(&self) -> Result<Option<File>>;
    fn interrupted(&self) -> String;

    /// Records the totals of the run after its last step, and returns a closing message for the user.
    fn ended(&mut self) -> String;
    fn finish(&mut self) -> Result<Self::Outcome>;
}

#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "made once a run")]
pub enum Ended<O> {
    Finished(O),
    /// The run was ended by Ctrl-C after step `step`. `checkpoint`: path of the checkpoint, if one was written.
    Interrupted {
        step: u32,
        checkpoint: Option<PathBuf>,
    },
}

/// Does training steps until the budget is used or `stop`, called with the number of steps done, returns true.
///
/// A checkpoint is written every `checkpoint_every` seconds. If a signal arrives during a long step, a validation or
/// the final export, the state before this work is saved.
pub(super) fn drive<T: Task>(
    task: &mut T,
    checkpoint_every: f64,
    mut progress: Progress,
    stop: &dyn Fn(u32) -> bool,
) -> Result<Ended<T::Outcome>> {
    let started = task.steps();
    let mut keeper = Keeper { claim: None, last: Instant::now(), warned: false };
    // The first validation may take long.
    let (mut last_step, mut last_validation) = (0.0, f64::INFINITY);
    loop {
        keeper.begin(task);
        let step = task.steps();
        let share = task.share(last_step)?;
        let ended = share >= 1.0;
        if ended {
            task.check_steps()?;
        }
        if let Some(due) = task.due(share, ended) {
            last_validation = keeper.run(task, last_validation, |task| task.validate(due))?;
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
        last_step = keeper.run(task, last_step, |task| task.step(share, &progress))?;
        progress.update(u64::from(task.steps()), &task.message());
    }
    let said = task.ended();
    keeper.save(task, &progress);
    progress.finish(said);
    keeper.covered(task, T::finish).map(Ended::Finished)
}

/// Saves a run's state at intervals, and when a signal interrupts work that takes long.
struct Keeper {
    /// Claim that makes a signal wait until the state is saved; `None` while there are no results to save.
    claim: Option<Claim>,
    last: Instant,
    /// Whether the user was warned that checkpoints cannot be written.
    warned: bool,
}

impl Keeper {
    fn begin(&mut self, task: &impl Task) {
        if self.claim.is_none() && task.is_worth_keeping() {
            self.claim = Some(Claim::new());
        }
    }

    /// Runs `work` and returns its time, seconds. Saves the state as [`Self::covered`] does only if `last`, the time of
    /// the last work of this kind, is above [`LONG`].
    fn run<T: Task>(&self, task: &mut T, last: f64, work: impl FnOnce(&mut T) -> Result<()>) -> Result<f64> {
        let begun = Instant::now();
        if last > LONG { self.covered(task, work) } else { work(task) }?;
        Ok(begun.elapsed().as_secs_f64())
    }

    /// Runs `work`, which may take long. If a signal arrives during `work`, the state before `work` is saved.
    fn covered<T: Task, R>(&self, task: &mut T, work: impl FnOnce(&mut T) -> Result<R>) -> Result<R> {
        let Some(claim) = &self.claim else { return work(task) };
        let files = task.checkpoint().into_iter().chain(task.as_it_stands()?).collect();
        claim.cover(Cover { files, message: task.interrupted() }, || work(task))
    }

    /// Writes a checkpoint, if the run keeps one. If writing fails, the previous checkpoint is kept; only the first
    /// failure is reported.
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

pub fn interrupted(step: u32, checkpoint: Option<&Path>) -> String {
    format!("interrupted after step {step}{}", how_to_go_on(checkpoint))
}

pub(super) fn how_to_go_on(checkpoint: Option<&Path>) -> String {
    checkpoint.map_or_else(String::new, |path| {
        format!("; the checkpoint is {}: go on with the same command and --resume", path.display())
    })
}

/// Returns the message for a resumed run whose checkpoint already has all steps.
pub(super) fn nothing_done(steps: u32) -> String {
    format!("nothing was done: the checkpoint has all {steps} steps; --steps asks for more")
}
