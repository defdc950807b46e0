//! One run from first step to blob.

use crate::data::photograph::Photo;
use crate::data::rgb::Picture;
use crate::data::system::output::{OutputError, write_atomic};
use crate::data::system::progress::{Message, Progress, ProgressStyle};
use crate::data::system::stop::{Claim, Cover};
use crate::fit::pace::VALIDATION_SHARE;
use crate::measure::frame;
use crate::measure::metrics::psnr_db;
use crate::model::config::ConfigError;
use crate::model::engine::{Batch, BatchRay, Engine, EngineError, Model, engine_for};
use crate::model::export::{Contents, ExportError, Exported, Tables, export};
use crate::model::picture_config::FieldConfig;
use crate::train::CurvePoint;
use crate::train::average::Average;
use crate::train::candidate::MADE_BY;
use crate::train::psnr_db_of_mse;
use crate::train::schedule::{Budget, Clock, learning_rate};
use glam::Vec3;
use nerf_core::Kernel;
use nerf_core::blob::{Blob, BlobError, Content, PictureFacts, Provenance};
use nerf_core::camera::SceneBox;
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::render::{RenderError, Renderer};
use nerf_core::sampling::{Purpose, uniform_u32};
use rayon::prelude::*;
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Evaluations of the whole picture on the way, where no interval is given.
const EVALUATIONS: f64 = 10.0;

/// What a blob says its PSNR is of.
pub(crate) const MEASURED_ON: &str = "over the whole picture";

/// Pixels that are drawn together.
const DRAWN: usize = 64;

/// Why a field could not be fitted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FieldError {
    /// A setting out of range.
    #[error("{0}")]
    Config(#[from] ConfigError),
    /// The optimiser stopped.
    #[error("{0}")]
    Engine(#[from] EngineError),
    /// The parameters make no blob.
    #[error("export: {0}")]
    Export(#[from] ExportError),
    /// The own blob cannot be opened.
    #[error("own blob: {0}")]
    Blob(#[from] BlobError),
    /// The own blob cannot be rendered.
    #[error("own blob: {0}")]
    Render(#[from] RenderError),
    /// The own blob cannot be written.
    #[error("{0}")]
    Output(#[from] OutputError),
}

/// A field that is being fitted.
pub struct FieldTrainer<'p> {
    photo: &'p Photo,
    config: FieldConfig,
    model: Model,
    kernel: Kernel,
    engine: Box<dyn Engine>,
    average: Average,
    batch: Batch,
    step: u32,
    mse: f64,
}

impl<'p> FieldTrainer<'p> {
    /// Everything ready for the first step.
    ///
    /// # Errors
    /// [`FieldError::Config`] on settings out of range.
    pub fn new(photo: &'p Photo, config: FieldConfig, kernel: Kernel) -> Result<Self, FieldError> {
        config.check_for(photo.size())?;
        let model = config.model(photo.size());
        let picture = SceneBox { min: Vec3::ZERO, max: Vec3::ONE };
        let engine = engine_for(&model, picture, config.adam(), config.seed, kernel.isa)?;
        let average = Average::new(config.optimiser.average, 1, model.parameters());
        let batch = Batch::default();
        Ok(Self { photo, config, model, kernel, engine, average, batch, step: 0, mse: f64::NAN })
    }

    /// One step at the learning rate that `share` of the budget used calls for.
    ///
    /// # Errors
    /// [`FieldError::Engine`] if it diverged; the run is then as before the step.
    pub fn step(&mut self, share: f64) -> Result<(), FieldError> {
        self.draw();
        if self.config.grid.as_ref().is_some_and(|grid| grid.is_rounded(share)) {
            self.engine.round_tables();
        }
        let rate = learning_rate(&self.config.optimiser, self.step, share);
        let loss = self.engine.step(&self.batch, rate)?;
        self.mse = if self.step == 0 { loss.mse } else { 0.95 * self.mse + 0.05 * loss.mse };
        self.step += 1;
        self.average.update(self.step, || self.engine.parameters());
        Ok(())
    }

    /// Pixels at random over the whole picture, each at its centre; beside a grid in the picture's order, so that
    /// neighbours read table entries that lie near each other.
    fn draw(&mut self) {
        let Self { photo, config, batch, step, .. } = self;
        let Picture { width, height, rgb } = &photo.picture;
        let (across, down) = (1.0 / *width as f32, 1.0 / *height as f32);
        let pixels = config.pixels;
        batch.rays.resize(pixels, BatchRay { samples: 1, ..BatchRay::default() });
        batch.positions.resize(pixels, [0.0; 3]);
        batch.deltas.resize(pixels, 0.0);
        let part = |i: usize| match config.grid {
            Some(_) => i * rgb.len() / pixels..(i + 1) * rgb.len() / pixels,
            None => 0..rgb.len(),
        };
        let chunks = batch.rays.par_chunks_mut(DRAWN).zip(batch.positions.par_chunks_mut(DRAWN)).enumerate();
        chunks.with_min_len(16).for_each(|(chunk, (rays, positions))| {
            // All are chosen before one is read: many are then on their way from memory at once.
            let index: [usize; DRAWN] = std::array::from_fn(|i| {
                let i = chunk * DRAWN + i;
                let (part, random) =
                    (part(i), uniform_u32(config.seed, Purpose::Pixel, u64::from(*step), i as u64));
                part.start + ((u64::from(random) * part.len() as u64) >> 32) as usize
            });
            for (ray, &index) in rays.iter_mut().zip(&index) {
                ray.rgb = rgb[index];
            }
            for (position, index) in positions.iter_mut().zip(index) {
                let (x, y) = ((index % width) as f32 + 0.5, (index / width) as f32 + 0.5);
                *position = [x * across, y * down, 0.0];
            }
        });
    }

    /// Steps done.
    pub fn steps(&self) -> u32 {
        self.step
    }

    /// Smoothed PSNR of the pixels trained on, dB.
    pub fn train_psnr_db(&self) -> f64 {
        psnr_db_of_mse(self.mse)
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.model.parameters()
    }

    /// A blob of the run as it stands; `psnr_db` is noted in it, if it is known.
    ///
    /// # Errors
    /// [`FieldError::Export`] on parameters that do not fit f16.
    pub fn export(&self, psnr_db: Option<f64>) -> Result<Exported, FieldError> {
        let parameters = self.average.values().map_or_else(|| self.engine.parameters(), Cow::Borrowed);
        let [width, height] = self.photo.size();
        let (parameters, tables) = parameters.split_at(self.model.layer_parameters());
        Ok(export(&Contents {
            architecture: &self.model.architecture,
            parameters,
            tables: match &self.config.grid {
                Some(grid) => Tables::Values {
                    values: tables,
                    storage: grid.storage,
                    scales: self.engine.table_scales(),
                },
                None => Tables::None,
            },
            content: Content::Picture(PictureFacts { width, height }),
            occupancy: None,
            provenance: Provenance {
                data: &self.photo.name,
                made_by: MADE_BY,
                steps: self.step,
                seed: self.config.seed,
                psnr_db: psnr_db.map(|db| db as f32).filter(|db| db.is_finite()),
                psnr_convention: if psnr_db.is_some() { MEASURED_ON } else { "" },
                quantisation_loss_db: None,
                trained_parameters: self.model.parameters() as u32,
            },
        })?)
    }

    /// Seconds that rendering the whole picture is expected to take, asked of a smaller one.
    fn evaluation_seconds(&self) -> Result<f64, FieldError> {
        const SMALLER: u32 = 8;
        let size = self.photo.size();
        let small = size.map(|side| side.div_ceil(SMALLER));
        let bytes = self.export(None)?.bytes;
        let begun = Instant::now();
        render_blob(&bytes, self.kernel, small)?;
        let pixels = |size: [u32; 2]| f64::from(size[0]) * f64::from(size[1]);
        Ok(begun.elapsed().as_secs_f64() * pixels(size) / pixels(small))
    }
}

/// Renders a blob's picture at a size.
pub(super) fn render_blob(bytes: &[u8], kernel: Kernel, size: [u32; 2]) -> Result<Picture, FieldError> {
    let blob = Blob::open(bytes)?;
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob, kernel, &mut memory)?;
    Ok(frame::render_picture(&renderer, MathBackend::Polynomial, size, |_| {})?.0)
}

/// The whole picture at some step.
#[derive(Clone, Copy, Debug)]
pub struct Evaluation<'a> {
    /// Steps done.
    pub step: u32,
    /// What the blob of that step shows.
    pub picture: &'a Picture,
    /// dB over the whole picture.
    pub psnr_db: f64,
}

/// When to stop and when to evaluate.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// When to stop.
    pub budget: Budget,
    /// Where the blob goes, at the end or when a signal ends the run; without it a signal leaves nothing of the run.
    pub output: Option<PathBuf>,
    /// Steps at which [`run`] shows the picture, besides its own evaluations.
    pub snapshots: Vec<u32>,
    /// Steps between evaluations; a tenth of the budget if absent. With a limit in seconds they take at most a tenth
    /// of it.
    pub evaluate_every: Option<u32>,
    /// What to run with.
    pub kernel: Kernel,
    /// Display.
    pub style: ProgressStyle,
}

/// What a run made.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The blob.
    pub bytes: Vec<u8>,
    /// What that very blob shows, at the photograph's size.
    pub picture: Picture,
    /// dB over the whole picture.
    pub psnr_db: f64,
    /// Weights that became f16 subnormals.
    pub subnormal_weights: usize,
    /// The curve; its `val_psnr_db` is of the whole picture.
    pub curve: Vec<CurvePoint>,
    /// Steps.
    pub steps: u32,
    /// Number of parameters.
    pub parameters: usize,
    /// Seconds from the start until the last step, evaluations included.
    pub train_seconds: f64,
    /// Pixels trained on, a second of training.
    pub pixels_per_second: f64,
}

/// How a run ended.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "made once a run")]
pub enum Ended {
    /// Its budget is used.
    Finished(Outcome),
    /// It was told to stop; the blob as it stood is written if there is a place for it.
    Stopped {
        /// Steps done.
        steps: u32,
    },
}

/// A step that takes longer than this is not waited for: a signal writes the blob from before it.
const LONG_STEP: Duration = Duration::from_millis(300);

/// What evaluations of the whole picture take, and may take of a limit in seconds.
#[derive(Clone, Copy, Debug, Default)]
struct EvaluationTime {
    /// Seconds of one, once that is known.
    one: Option<f64>,
    /// Seconds of all so far.
    all: f64,
}

impl EvaluationTime {
    fn took(&mut self, seconds: f64) {
        self.one = Some(seconds);
        self.all += seconds;
    }

    /// Whether an evaluation at `now` keeps all of them within their share.
    fn affords(&self, now: f64) -> bool {
        self.one.is_some_and(|one| self.all + one <= VALIDATION_SHARE * now)
    }

    /// Seconds to keep for the last evaluation, and for files.
    fn reserve(&self, budget: &Budget) -> f64 {
        budget.seconds.map_or(0.0, |seconds| (1.2 * self.one.unwrap_or(0.0) + 0.5).min(0.5 * seconds))
    }
}

/// What keeps a run's blob from being lost to a signal.
struct Keeper<'o> {
    output: Option<&'o Path>,
    /// There is nothing to keep before the first step.
    claim: Option<Claim>,
}

impl Keeper<'_> {
    /// From now on there is something to keep.
    fn begin(&mut self) {
        if self.output.is_some() && self.claim.is_none() {
            self.claim = Some(Claim::new());
        }
    }

    /// Runs `work`, which may take long; a signal on the way writes `blob`, that of `steps` steps.
    fn during<T>(&self, steps: u32, blob: &[u8], work: impl FnOnce() -> T) -> T {
        match (&self.claim, self.output) {
            (Some(claim), Some(path)) => {
                let cover = Cover { file: Some((path.into(), blob.into())), message: kept(steps, path) };
                claim.cover(cover, work)
            }
            _ => work(),
        }
    }

    /// Writes the blob, if there is a place for it.
    fn write(&self, blob: &[u8]) -> Result<(), FieldError> {
        Ok(self.output.map_or(Ok(()), |path| write_atomic(path, blob))?)
    }
}

/// What there is to say when a signal ended a run after so many steps.
pub fn kept(steps: u32, output: &Path) -> String {
    format!(
        "interrupted: {} holds the field after step {steps}; its PSNR over the whole picture was not measured",
        output.display()
    )
}

/// Fits a field until the budget is used or `stop` says so, which is asked between steps with the steps done; `each`
/// sees every evaluation, step 0 included if asked for.
///
/// # Errors
/// [`FieldError`]; [`EngineError::Diverged`] if a number overflowed.
pub fn run(
    photo: &Photo,
    config: FieldConfig,
    options: &RunOptions,
    clock: Clock,
    stop: &dyn Fn(u32) -> bool,
    mut each: impl FnMut(Evaluation<'_>),
) -> Result<Ended, FieldError> {
    let mut trainer = FieldTrainer::new(photo, config, options.kernel)?;
    let mut keeper = Keeper { output: options.output.as_deref(), claim: None };
    let budget = options.budget;
    let mut progress = Progress::new("fit", budget.total(), options.style);
    let mut curve: Vec<CurvePoint> = Vec::new();
    let (mut last_evaluation, mut whole) = (0.0, None);
    let mut time = EvaluationTime::default();
    let mut last_step = Duration::ZERO;
    let started = clock.seconds();
    // Evaluates the whole picture as the run stands; its PSNR, dB.
    let mut score = |trainer: &FieldTrainer<'_>, keeper: &Keeper<'_>| -> Result<(Picture, f64), FieldError> {
        let (step, bytes) = (trainer.steps(), trainer.export(None)?.bytes);
        keeper.during(step, &bytes, || {
            let picture = render_blob(&bytes, trainer.kernel, photo.size())?;
            let psnr_db = psnr_db(&picture.rgb, &photo.picture.rgb);
            each(Evaluation { step, picture: &picture, psnr_db });
            Ok((picture, psnr_db))
        })
    };
    loop {
        let step = trainer.steps();
        if budget.seconds.is_some() && time.one.is_none() && step > 0 {
            time.one = Some(trainer.evaluation_seconds()?);
        }
        let share = budget.share(step, clock.seconds() + last_step.as_secs_f64(), time.reserve(&budget));
        let due = match options.evaluate_every {
            Some(every) => step > 0 && step.is_multiple_of(every.max(1)),
            None => share - last_evaluation >= 1.0 / EVALUATIONS,
        } && (budget.seconds.is_none() || time.affords(clock.seconds()));
        let done = share >= 1.0;
        if !done && (due || options.snapshots.contains(&step)) {
            last_evaluation = share;
            let before = clock.seconds();
            whole = Some(score(&trainer, &keeper)?.1);
            time.took(clock.seconds() - before);
            curve.push(point(&trainer, clock, whole));
        } else if step > 0 && step.is_multiple_of(20) {
            curve.push(point(&trainer, clock, None));
        }
        if done {
            break;
        }
        if stop(step) {
            keeper.write(&trainer.export(None)?.bytes)?;
            progress.finish(format!("interrupted after step {step}"));
            return Ok(Ended::Stopped { steps: step });
        }
        let begun = Instant::now();
        if last_step > LONG_STEP {
            let bytes = trainer.export(None)?.bytes;
            keeper.during(step, &bytes, || trainer.step(share))?;
        } else {
            trainer.step(share)?;
        }
        last_step = begun.elapsed();
        keeper.begin();
        progress.update(
            u64::from(trainer.steps()),
            &Message {
                train_psnr_db: Some(trainer.train_psnr_db()),
                note: whole.map_or_else(String::new, |db| format!("whole picture {db:.2} dB")),
                ..Message::default()
            },
        );
    }
    let train_seconds = clock.seconds();
    let pixels = f64::from(trainer.steps()) * trainer.config.pixels as f64;
    let pixels_per_second = pixels / (train_seconds - started).max(1e-9);
    progress.finish(format!("{} steps, {:.0} thousand pixels/s", trainer.steps(), pixels_per_second / 1e3));

    let (picture, psnr_db) = score(&trainer, &keeper)?;
    curve.push(CurvePoint { seconds: train_seconds, ..point(&trainer, clock, Some(psnr_db)) });
    let exported = trainer.export(Some(psnr_db))?;
    keeper.write(&exported.bytes)?;
    Ok(Ended::Finished(Outcome {
        bytes: exported.bytes,
        picture,
        psnr_db,
        subnormal_weights: exported.subnormal_weights,
        curve,
        steps: trainer.steps(),
        parameters: trainer.parameters(),
        train_seconds,
        pixels_per_second,
    }))
}

fn point(trainer: &FieldTrainer<'_>, clock: Clock, whole: Option<f64>) -> CurvePoint {
    CurvePoint {
        step: trainer.steps(),
        seconds: clock.seconds(),
        train_psnr_db: trainer.train_psnr_db(),
        val_psnr_db: whole,
        ..CurvePoint::default()
    }
}
