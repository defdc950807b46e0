//! Fits a 2D field to a picture.

use super::average::Average;
use super::candidate::MADE_BY;
use super::checkpoint::{CheckpointError, check_data, check_settings, pack, unpack};
use super::schedule::learning_rate;
use super::{CurvePoint, psnr_db_of_mse};
use crate::data::pictures::photograph::Photo;
use crate::data::pictures::rgb::Picture;
use crate::model::config::ConfigError;
use crate::model::engine::{
    Batch, BatchRay, Engine, EngineError, EngineKind, Model, OptimiserState, engine_for,
};
use crate::model::export::{Contents, ExportError, Exported, Tables, export};
use crate::model::picture_config::FieldConfig;
use glam::Vec3;
use nerf_core::Kernel;
use nerf_core::blob::{Content, PictureFacts, Provenance};
use nerf_core::sampling::{Purpose, uniform_u32};
use nerf_core::space::SceneBox;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::path::Path;

/// What a blob says its PSNR is of.
pub(crate) const MEASURED_ON: &str = "over the whole picture";

/// Pixels that are drawn together.
const DRAWN: usize = 64;
/// First bytes of a checkpoint; the last is the version.
const MAGIC: [u8; 8] = *b"NERFPIC\x02";

/// Why training could not start or go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FieldTrainError {
    #[error("{0}")]
    Config(#[from] ConfigError),
    #[error("{0}")]
    Engine(#[from] EngineError),
    #[error("export: {0}")]
    Export(#[from] ExportError),
    #[error("{part} that do not fit the rest")]
    Parts { part: &'static str },
}

/// A fit of a picture, stopped between two steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldCheckpoint {
    /// Its settings, as JSON.
    pub config: String,
    pub photo: String,
    pub fingerprint: u64,
    /// Parameters and Adam's memory.
    pub optimiser: OptimiserState,
    pub average: Average,
    pub step: u32,
    /// Smoothed mean squared error.
    pub mse: f64,
    pub curve: Vec<CurvePoint>,
    /// Seconds used so far.
    pub seconds: f64,
}

/// A field that is being fitted.
pub struct FieldTrainer<'p> {
    photo: &'p Photo,
    config: FieldConfig,
    model: Model,
    engine: Box<dyn Engine>,
    average: Average,
    batch: Batch,
    step: u32,
    mse: f64,
    pub curve: Vec<CurvePoint>,
}

impl<'p> FieldTrainer<'p> {
    /// Everything ready for the first step.
    ///
    /// # Errors
    /// [`FieldTrainError::Config`] on settings out of range.
    pub fn new(photo: &'p Photo, config: FieldConfig, kernel: Kernel) -> Result<Self, FieldTrainError> {
        config.check_for(photo.size())?;
        let model = config.model(photo.size());
        let picture = SceneBox { min: Vec3::ZERO, max: Vec3::ONE };
        let engine = engine_for(EngineKind::Fused, &model, picture, config.adam(), config.seed, kernel.isa)?;
        let average = Average::new(config.optimiser.average, 1, model.parameters());
        let batch = Batch::default();
        Ok(Self { photo, config, model, engine, average, batch, step: 0, mse: f64::NAN, curve: Vec::new() })
    }

    /// One step at the learning rate that `share` of the budget used calls for.
    ///
    /// # Errors
    /// [`FieldTrainError::Engine`] if it diverged; the run is then as before the step.
    pub fn step(&mut self, share: f64) -> Result<(), FieldTrainError> {
        self.draw();
        if let Some(grid) = self.config.grid.as_ref().filter(|grid| grid.is_rounded(share)) {
            self.engine.round_tables(grid.rounding());
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

    /// Its settings.
    pub fn config(&self) -> &FieldConfig {
        &self.config
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
    /// [`FieldTrainError::Export`] on parameters that do not fit f16.
    pub fn export(&self, psnr_db: Option<f64>) -> Result<Exported, FieldTrainError> {
        let parameters = self.average.values().map_or_else(|| self.engine.parameters(), Cow::Borrowed);
        let [width, height] = self.photo.size();
        let (parameters, tables) = parameters.split_at(self.model.layer_parameters());
        Ok(export(&Contents {
            architecture: &self.model.architecture,
            parameters,
            tables: match &self.config.grid {
                Some(grid) => Tables::Values {
                    values: tables,
                    rounding: grid.rounding(),
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

    /// Everything needed to go on after `seconds`.
    pub fn checkpoint(&self, seconds: f64) -> FieldCheckpoint {
        FieldCheckpoint {
            config: settings(&self.config).to_string(),
            photo: self.photo.name.clone(),
            fingerprint: self.photo.fingerprint(),
            optimiser: self.engine.state(),
            average: self.average.clone(),
            step: self.step,
            mse: self.mse,
            curve: self.curve.clone(),
            seconds,
        }
    }

    /// Takes up a checkpoint of the same run.
    ///
    /// # Errors
    /// [`FieldTrainError::Engine`] if its parameters do not fit, [`FieldTrainError::Parts`] if anything else does not;
    /// the run is then as before.
    pub fn restore(&mut self, checkpoint: FieldCheckpoint) -> Result<(), FieldTrainError> {
        let FieldCheckpoint { optimiser, average, step, mse, curve, .. } = checkpoint;
        let ascending = curve.is_sorted_by_key(|point| point.step);
        let parts = [
            ("counters", u64::from(step) == optimiser.steps),
            ("averaged parameters", average.is_like(&self.average, step)),
            ("points of the curve", ascending && curve.last().is_none_or(|point| point.step <= step)),
        ];
        if let Some((part, _)) = parts.into_iter().find(|&(_, fits)| !fits) {
            return Err(FieldTrainError::Parts { part });
        }
        self.engine.restore(&optimiser)?;
        (self.average, self.step, self.mse, self.curve) = (average, step, mse, curve);
        Ok(())
    }
}

impl FieldCheckpoint {
    /// The file's bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        pack(MAGIC, self)
    }

    /// Reads one back.
    ///
    /// # Errors
    /// [`CheckpointError`] names the file.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        unpack(MAGIC, path)
    }

    /// Refuses a checkpoint of another picture or other settings; the number of steps may differ.
    ///
    /// # Errors
    /// [`CheckpointError::Other`] names the first difference.
    pub fn check_belongs(
        &self,
        path: &Path,
        photo: &Photo,
        config: &FieldConfig,
    ) -> Result<(), CheckpointError> {
        check_data(path, (&photo.name, photo.fingerprint()), (&self.photo, self.fingerprint))?;
        // What is no JSON differs as a whole.
        check_settings(path, &settings(config), &serde_json::from_str(&self.config).unwrap_or_default())
    }
}

/// What a run is continued with: the settings, whose number of steps may differ.
fn settings(config: &FieldConfig) -> serde_json::Value {
    let mut config = config.clone();
    config.optimiser.steps = 1;
    serde_json::to_value(config).expect("plain data")
}
