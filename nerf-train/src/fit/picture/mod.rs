//! One fit of a 2D field to a picture, from first step to blob.

use super::drive::{Ended, File, POINT_EVERY, Task, drive, how_to_go_on, nothing_done};
use super::pace::VALIDATION_SHARE;
use super::run::RunOptions;
use crate::data::pictures::photograph::Photo;
use crate::data::pictures::rgb::Picture;
use crate::measure::frame;
use crate::measure::inspect::GridSummary;
use crate::measure::metrics::psnr_db;
use crate::model::picture_config::FieldConfig;
use crate::system::cpu;
use crate::system::output::write_atomic;
use crate::system::progress::{Message, Progress};
use crate::train::CurvePoint;
use crate::train::checkpoint::settings;
use crate::train::field::FieldTrainer;
use crate::train::schedule::{Budget, Clock, Done};
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::render::Renderer;
use serde::Serialize;
use std::path::Path;
use std::time::Instant;

/// Number of evaluations on the whole picture during training, if no interval is given.
const EVALUATIONS: f64 = 10.0;

#[derive(Clone, Copy, Debug)]
pub struct Evaluation<'a> {
    pub step: u32,
    pub picture: &'a Picture,
    pub psnr_db: f64,
}

#[derive(Clone, Debug)]
pub struct Outcome {
    pub bytes: Vec<u8>,
    /// Rendering of the exported field, at the size of the fitted picture.
    pub picture: Picture,
    pub psnr_db: f64,
    pub subnormal_weights: usize,
    /// Training curve; its `val_psnr_db` is measured over the whole picture.
    pub curve: Vec<CurvePoint>,
    pub steps: u32,
    pub parameters: usize,
    /// Seconds from the start until the last step, evaluations included.
    pub train_seconds: f64,
    pub pixels_per_second: f64,
}

/// Times of the evaluations on the whole picture, seconds: of one evaluation, and of all together.
#[derive(Clone, Copy, Debug, Default)]
struct EvaluationTime {
    /// Seconds of one evaluation; `None` until measured.
    one: Option<f64>,
    all: f64,
}

impl EvaluationTime {
    fn took(&mut self, seconds: f64) {
        self.one = Some(seconds);
        self.all += seconds;
    }

    /// Whether one more evaluation is affordable: all evaluations together then take at most the fraction
    /// [`VALIDATION_SHARE`] of `now`, the seconds of the run so far.
    fn affords(&self, now: f64) -> bool {
        self.one.is_some_and(|one| self.all + one <= VALIDATION_SHARE * now)
    }

    /// Returns the seconds to reserve for the evaluation after the last step, and for writing files.
    fn reserve(&self, budget: &Budget) -> f64 {
        budget.seconds.map_or(0.0, |seconds| (1.2 * self.one.unwrap_or(0.0) + 0.5).min(0.5 * seconds))
    }
}

/// Returns the message for a run that a signal ended after `steps` steps. `output`: path of the file with the field.
pub fn kept(steps: u32, output: &Path, checkpoint: Option<&Path>) -> String {
    format!(
        "interrupted: {} holds the field after step {steps}; its PSNR over the whole picture was not measured{}",
        output.display(),
        how_to_go_on(checkpoint)
    )
}

pub(super) fn render_blob(bytes: &[u8], kernel: Kernel, size: [u32; 2]) -> anyhow::Result<Picture> {
    let blob = Blob::open(bytes)?;
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob, kernel, &mut memory)?;
    Ok(frame::render_picture(&renderer, MathBackend::Polynomial, size, |_| {})?.0)
}

/// Fits a 2D field until the budget is used or `stop` returns true. Calls `stop` between steps with the number of steps
/// done. Calls the function `each` with every evaluation, including an evaluation at step 0 if requested.
///
/// If `stop` ends the run, the blob of the present field and a checkpoint are written, each if its path is given.
pub fn run(
    photo: &Photo,
    config: FieldConfig,
    options: &RunOptions,
    output: Option<&Path>,
    clock: Clock,
    stop: &dyn Fn(u32) -> bool,
    mut each: impl FnMut(Evaluation<'_>),
) -> anyhow::Result<Ended<Outcome>> {
    let mut trainer = FieldTrainer::new(photo, config, options.kernel)?;
    let (config, data) = (settings(&trainer.config), (&*photo.name, photo.fingerprint()));
    let mut before = 0.0;
    let clock = options.resumed(clock, &config, data, |checkpoint| {
        before = checkpoint.seconds;
        trainer.restore(checkpoint)
    })?;
    let mut session = Session {
        started: (trainer.steps(), clock.seconds()),
        prepared: clock.own_seconds(),
        budget: options.budget.after(clock.seconds() - clock.own_seconds()),
        trainer,
        photo,
        options,
        output,
        clock,
        // The evaluations of earlier commands count as if they had used all their allotted time.
        time: EvaluationTime { one: None, all: VALIDATION_SHARE * before },
        train_seconds: 0.0,
        each: &mut each,
    };
    let progress =
        Progress::new("fit", options.budget.total(), options.style).resume_at(u64::from(session.started.0));
    drive(&mut session, options.checkpoint_every, progress, stop)
}

struct Session<'a, 'p> {
    trainer: FieldTrainer<'p>,
    photo: &'p Photo,
    options: &'a RunOptions,
    /// Path of the exported file, written at the end or when a signal stops the run. `None` writes no file.
    output: Option<&'a Path>,
    clock: Clock,
    time: EvaluationTime,
    /// Steps done and seconds used when this command's first step began. The steps are above 0 if the run was resumed.
    started: (u32, f64),
    prepared: f64,
    budget: Budget,
    train_seconds: f64,
    each: &'a mut dyn FnMut(Evaluation<'_>),
}

impl Session<'_, '_> {
    /// Returns the used fraction of the budget after `step` steps and `seconds`, with time reserved for the end.
    fn share_at(&self, step: u32, seconds: f64) -> f64 {
        self.budget.share(step, seconds, self.time.reserve(&self.options.budget))
    }

    /// Renders the whole picture from the present field; returns the rendering and its PSNR, dB.
    fn evaluate(&mut self) -> anyhow::Result<(Picture, f64)> {
        let (step, bytes) = (self.trainer.steps(), self.trainer.export(None)?.bytes);
        let picture = render_blob(&bytes, self.options.kernel, self.photo.size())?;
        let psnr_db = psnr_db(&picture.rgb, &self.photo.picture.rgb);
        (self.each)(Evaluation { step, picture: &picture, psnr_db });
        Ok((picture, psnr_db))
    }

    /// Estimates the seconds to render the whole picture, by a rendering at an eighth of its width and height.
    fn evaluation_seconds(&self) -> anyhow::Result<f64> {
        const SMALLER: u32 = 8;
        let size = self.photo.size();
        let small = size.map(|side| side.div_ceil(SMALLER));
        let bytes = self.trainer.export(None)?.bytes;
        let begun = Instant::now();
        render_blob(&bytes, self.options.kernel, small)?;
        let pixels = |size: [u32; 2]| f64::from(size[0]) * f64::from(size[1]);
        Ok(begun.elapsed().as_secs_f64() * pixels(size) / pixels(small))
    }

    /// Returns the number of training pixels per second since this command's first step began.
    fn pixels_per_second(&self) -> f64 {
        let (steps, seconds) = self.started;
        let pixels = f64::from(self.steps() - steps) * self.trainer.config.pixels as f64;
        pixels / (self.train_seconds - seconds).max(1e-9)
    }
}

impl Task for Session<'_, '_> {
    type Outcome = Outcome;
    type Due = ();

    fn steps(&self) -> u32 {
        self.trainer.steps()
    }

    fn share(&mut self, last_step: f64) -> anyhow::Result<f64> {
        if self.budget.seconds.is_some() && self.time.one.is_none() && self.steps() > self.started.0 {
            self.time.one = Some(self.evaluation_seconds()?);
        }
        Ok(self.share_at(self.steps(), self.clock.seconds() + last_step))
    }

    fn check_steps(&self) -> anyhow::Result<()> {
        let done = Done {
            before: self.started.0,
            steps: self.steps(),
            prepared: self.prepared,
            seconds: self.clock.own_seconds(),
            reserve: self.time.reserve(&self.options.budget),
        };
        self.options.budget.check_steps(done, self.options.min_steps)
    }

    fn due(&self, share: f64, ended: bool) -> Option<()> {
        let step = self.steps();
        let last = self.trainer.state.last_validation().map(|(point, _)| (point.step, point.seconds));
        if ended || last.is_some_and(|(at, _)| at == step) {
            return None;
        }
        let then = last.map_or(0.0, |(step, seconds)| self.share_at(step, seconds));
        let due = match self.options.validate_every {
            Some(every) => step > 0 && step.is_multiple_of(every.max(1)),
            None => share - then >= 1.0 / EVALUATIONS,
        };
        let affordable = self.budget.seconds.is_none() || self.time.affords(self.clock.seconds());
        let shown = self.options.snapshots.as_ref().is_some_and(|options| options.steps.contains(&step));
        (due && affordable || shown).then_some(())
    }

    fn validate(&mut self, (): ()) -> anyhow::Result<()> {
        let begun = Instant::now();
        let (_, psnr_db) = self.evaluate()?;
        self.time.took(begun.elapsed().as_secs_f64());
        let state = &mut self.trainer.state;
        state.curve.push(state.point(self.clock.seconds(), Some(psnr_db)));
        Ok(())
    }

    fn note(&mut self, ended: bool) {
        if !ended && self.steps().is_multiple_of(POINT_EVERY) {
            self.trainer.state.note(self.clock.seconds());
        }
    }

    fn step(&mut self, share: f64, _: &Progress) -> anyhow::Result<()> {
        Ok(self.trainer.step(share)?)
    }

    fn message(&self) -> Message {
        let state = &self.trainer.state;
        let whole = state.last_validation().map(|(_, db)| format!("whole picture {db:.2} dB"));
        Message {
            train_psnr_db: Some(state.train_psnr_db()),
            note: whole.unwrap_or_default(),
            ..Message::default()
        }
    }

    fn is_worth_keeping(&self) -> bool {
        self.output.is_some() && self.steps() > 0
    }

    fn checkpoint(&self) -> Option<File> {
        let path = self.options.checkpoint.clone()?;
        Some((path, self.trainer.checkpoint(self.clock.seconds()).to_bytes()))
    }

    fn as_it_stands(&self) -> anyhow::Result<Option<File>> {
        let Some(path) = self.output else { return Ok(None) };
        Ok(Some((path.into(), self.trainer.export(None)?.bytes)))
    }

    fn interrupted(&self) -> String {
        let checkpoint = self.options.checkpoint.as_deref();
        self.output.map_or_else(String::new, |output| kept(self.steps(), output, checkpoint))
    }

    fn ended(&mut self) -> String {
        self.train_seconds = self.clock.seconds();
        if self.options.resume && self.steps() == self.started.0 {
            return nothing_done(self.steps());
        }
        format!("{} steps, {:.0} thousand pixels/s", self.steps(), self.pixels_per_second() / 1e3)
    }

    fn finish(&mut self) -> anyhow::Result<Outcome> {
        let (picture, psnr_db) = self.evaluate()?;
        let state = &mut self.trainer.state;
        state.curve.push(state.point(self.train_seconds, Some(psnr_db)));
        let exported = self.trainer.export(Some(psnr_db))?;
        if let Some(output) = self.output {
            write_atomic(output, &exported.bytes)?;
        }
        Ok(Outcome {
            bytes: exported.bytes,
            picture,
            psnr_db,
            subnormal_weights: exported.subnormal_weights,
            curve: self.trainer.state.curve.clone(),
            steps: self.steps(),
            parameters: self.trainer.model.parameters(),
            train_seconds: self.train_seconds,
            pixels_per_second: self.pixels_per_second(),
        })
    }
}

#[derive(Debug, Serialize)]
pub struct Summary<'p> {
    pub psnr_db: f64,
    pub photo: &'p str,
    pub width_px: usize,
    pub height_px: usize,
    pub train_seconds: f64,
    pub total_seconds: f64,
    pub steps: u32,
    pub parameters: usize,
    pub blob_bytes: usize,
    pub subnormal_weights: usize,
    pub pixels_per_second: f64,
    pub levels: u8,
    pub layers: usize,
    pub width: usize,
    pub rate: f64,
    pub pixels_a_step: usize,
    pub seed: u64,
    pub kernel: String,
    pub threads: usize,
    pub cpu: String,
    pub blob: String,
    #[serde(flatten)]
    pub grid: Option<GridSummary>,
}

impl<'p> Summary<'p> {
    /// Returns the summary of a fit to `photo`, whose blob was written to `output`.
    pub fn of(
        outcome: &Outcome,
        photo: &'p Photo,
        config: &FieldConfig,
        kernel: Kernel,
        total_seconds: f64,
        output: &Path,
    ) -> Self {
        Self {
            psnr_db: outcome.psnr_db,
            photo: &photo.name,
            width_px: photo.picture.width,
            height_px: photo.picture.height,
            train_seconds: outcome.train_seconds,
            total_seconds,
            steps: outcome.steps,
            parameters: outcome.parameters,
            blob_bytes: outcome.bytes.len(),
            subnormal_weights: outcome.subnormal_weights,
            pixels_per_second: outcome.pixels_per_second,
            levels: config.levels,
            layers: config.layers,
            width: config.width,
            rate: config.optimiser.rate,
            pixels_a_step: config.pixels,
            seed: config.seed,
            kernel: kernel.to_string(),
            threads: rayon::current_num_threads(),
            cpu: cpu::name(),
            blob: output.display().to_string(),
            grid: Blob::open(&outcome.bytes).ok().and_then(|blob| GridSummary::of(&blob)),
        }
    }
}

#[cfg(test)]
mod tests;
