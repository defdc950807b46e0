//! The loop of every fit, of scenes and of pictures: budget, validation, checkpoints, Ctrl-C, progress.

use crate::system::output::write_atomic;
use crate::system::progress::{Message, Progress};
use crate::system::stop::{Claim, Cover};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Seconds that a step may take without anything at hand for a signal that comes meanwhile.
const LONG_STEP: f64 = 0.3;

pub(super) type File = (PathBuf, Vec<u8>);

pub(super) trait Task {
    type Outcome;
    type Due;

    fn steps(&self) -> u32;
    /// Share of the budget that is used, if the next step takes as long as the last one did.
    fn share(&mut self, last_step: f64) -> anyhow::Result<f64>;
    /// Refuses a run that its limit in seconds ended after too few steps.
    fn check_steps(&self) -> anyhow::Result<()>;
    /// What is to be validated now, if anything is.
    fn due(&self, share: f64, ended: bool) -> Option<Self::Due>;
    fn validate(&mut self, due: Self::Due, share: f64) -> anyhow::Result<()>;
    /// Puts a point into the curve, if one is due and validation has put none there.
    fn note(&mut self, ended: bool);
    fn step(&mut self, share: f64, progress: &Progress) -> anyhow::Result<()>;
    fn message(&self) -> Message;

    /// Whether a signal finds something that must not be lost.
    fn is_worth_keeping(&self) -> bool;
    /// The checkpoint of the run as it stands, if there is a place for one.
    fn checkpoint(&self) -> Option<File>;
    /// What else is written when the run is interrupted: a picture's blob.
    fn as_it_stands(&self) -> anyhow::Result<Option<File>>;
    /// What is said of a run that was interrupted.
    fn interrupted(&self) -> String;

    /// The last step is done; what is said of the steps.
    fn ended(&mut self) -> String;
    fn finish(&mut self) -> anyhow::Result<Self::Outcome>;
}

#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "made once a run")]
pub enum Ended<O> {
    Finished(O),
    /// By Ctrl-C, with a checkpoint if there is a place for one.
    Interrupted {
        step: u32,
        checkpoint: Option<PathBuf>,
    },
}

/// Runs until the budget is used or `stop` says so, which is asked between steps with the steps done.
///
/// A checkpoint is written every so many seconds; whatever else takes long, a signal meanwhile leaves the run as it
/// stood before.
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
            keeper.covered(task, |task| task.validate(due, share))?;
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

/// Keeps a run from being lost.
struct Keeper {
    /// Makes signals wait for the run's owner, while there is something to keep.
    claim: Option<Claim>,
    last: Instant,
    /// Whether it was said that checkpoints cannot be written.
    warned: bool,
}

impl Keeper {
    fn begin(&mut self, task: &impl Task) {
        if self.claim.is_none() && task.is_worth_keeping() {
            self.claim = Some(Claim::new());
        }
    }

    /// Does what may take long; a signal meanwhile leaves the run as it stands.
    fn covered<T: Task, R>(
        &self,
        task: &mut T,
        work: impl FnOnce(&mut T) -> anyhow::Result<R>,
    ) -> anyhow::Result<R> {
        let Some(claim) = &self.claim else { return work(task) };
        let files = task.checkpoint().into_iter().chain(task.as_it_stands()?).collect();
        claim.cover(Cover { files, message: task.interrupted() }, || work(task))
    }

    /// Writes the checkpoint; where it cannot be written, the one before stays, and that is said once.
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

/// What a run says that was interrupted, and has a checkpoint or none.
pub fn interrupted(step: u32, checkpoint: Option<&Path>) -> String {
    match checkpoint {
        Some(path) => format!(
            "interrupted after step {step}; the checkpoint is {}: go on with the same command and --resume",
            path.display()
        ),
        None => format!("interrupted after step {step}"),
    }
}

/// Message of a resumed run that has no steps left to do.
pub(super) fn nothing_done(steps: u32) -> String {
    format!("nothing was done: the checkpoint has all {steps} steps; --steps asks for more")
}
