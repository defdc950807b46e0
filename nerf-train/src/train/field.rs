//! Fits a 2D field to a picture.

use super::average::Average;
use super::candidate::MADE_BY;
use super::checkpoint::{Checkpoint, State, settings};
use super::schedule::learning_rate;
use super::{Progressed, TrainError};
use crate::data::pictures::photograph::Photo;
use crate::data::pictures::rgb::Picture;
use crate::model::engine::{Batch, BatchRay, Engine, EngineKind, Model, engine_for};
use crate::model::export::{Contents, Exported, Tables, export};
use crate::model::picture_config::FieldConfig;
use glam::Vec3;
use nerf_core::Kernel;
use nerf_core::blob::{Content, PictureFacts, Provenance};
use nerf_core::sampling::{Purpose, uniform_u32};
use nerf_core::space::SceneBox;
use rayon::prelude::*;
use std::borrow::Cow;

/// Description of how the PSNR was measured, stored in the exported file of a 2D field.
pub(crate) const MEASURED_ON: &str = "over the whole picture";

const DRAWN: usize = 64;

pub struct FieldTrainer<'p> {
    photo: &'p Photo,
    pub(crate) config: FieldConfig,
    pub(crate) model: Model,
    engine: Box<dyn Engine>,
    batch: Batch,
    pub(crate) state: State,
}

impl<'p> FieldTrainer<'p> {
    pub fn new(photo: &'p Photo, config: FieldConfig, kernel: Kernel) -> Result<Self, TrainError> {
        config.check_for(photo.size())?;
        let model = config.model(photo.size());
        let picture = SceneBox { min: Vec3::ZERO, max: Vec3::ONE };
        let adam = config.optimiser.adam();
        let engine = engine_for(EngineKind::Fused, &model, picture, adam, config.seed, kernel.isa)?;
        let state = State {
            average: Average::new(config.optimiser.average, 1, model.parameters()),
            progressed: Progressed { mse: f64::NAN, ..Progressed::default() },
            ..State::default()
        };
        Ok(Self { photo, config, model, engine, batch: Batch::default(), state })
    }

    /// Does one training step. Fails without a change if it diverges. `share`: used fraction of the budget.
    pub fn step(&mut self, share: f64) -> Result<(), TrainError> {
        self.draw();
        if let Some(grid) = self.config.grid.as_ref().filter(|grid| grid.is_rounded(share)) {
            self.engine.round_tables(grid.rounding());
        }
        let p = &mut self.state.progressed;
        let rate = learning_rate(&self.config.optimiser, p.step, share);
        let loss = self.engine.step(&self.batch, rate)?;
        p.mse = if p.step == 0 { loss.mse } else { 0.95 * p.mse + 0.05 * loss.mse };
        p.step += 1;
        self.state.average.update(p.step, || self.engine.parameters());
        Ok(())
    }

    /// Fills the batch with random pixels. For a learned grid, the pixels are in row order, so that successive rays
    /// read nearby entries.
    fn draw(&mut self) {
        let Self { photo, config, batch, state, .. } = self;
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
            // All pixels are chosen before the first is read, so that many loads from memory overlap.
            let index: [usize; DRAWN] = std::array::from_fn(|i| {
                let i = chunk * DRAWN + i;
                let (part, random) = (
                    part(i),
                    uniform_u32(config.seed, Purpose::Pixel, u64::from(state.progressed.step), i as u64),
                );
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

    pub fn steps(&self) -> u32 {
        self.state.progressed.step
    }

    /// Exports the present field as the bytes of a file. `psnr_db`: PSNR of the field, stored in the file if known.
    pub fn export(&self, psnr_db: Option<f64>) -> Result<Exported, TrainError> {
        let parameters = self.state.average.values().map_or_else(|| self.engine.parameters(), Cow::Borrowed);
        let [width, height] = self.photo.size();
        let (parameters, tables) = parameters.split_at(self.model.layer_parameters());
        Ok(export(&Contents {
            architecture: &self.model.architecture,
            parameters,
            tables: Tables::of(self.config.grid.as_ref(), tables, self.engine.table_scales()),
            content: Content::Picture(PictureFacts { width, height }),
            occupancy: None,
            provenance: Provenance {
                data: &self.photo.name,
                made_by: MADE_BY,
                steps: self.steps(),
                seed: self.config.seed,
                psnr_db: psnr_db.map(|db| db as f32).filter(|db| db.is_finite()),
                psnr_convention: if psnr_db.is_some() { MEASURED_ON } else { "" },
                quantisation_loss_db: None,
                trained_parameters: self.model.parameters() as u32,
            },
        })?)
    }

    pub fn checkpoint(&self, seconds: f64) -> Checkpoint {
        Checkpoint {
            config: settings(&self.config),
            data: self.photo.name.clone(),
            fingerprint: self.photo.fingerprint(),
            optimiser: self.engine.state(),
            state: self.state.clone(),
            seconds,
        }
    }

    /// Resumes from a checkpoint of the same run; on an error the run is unchanged.
    pub fn restore(&mut self, checkpoint: Checkpoint) -> Result<(), TrainError> {
        if let Some(part) = checkpoint.wrong_part(&self.state.average) {
            return Err(TrainError::Parts { part });
        }
        self.engine.restore(&checkpoint.optimiser)?;
        self.state = checkpoint.state;
        Ok(())
    }
}
