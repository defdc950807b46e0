//! What the fit of a picture made, for scripts.

use super::Outcome;
use crate::data::pictures::photograph::Photo;
use crate::measure::inspect::GridSummary;
use crate::model::picture_config::FieldConfig;
use crate::system::cpu;
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use serde::Serialize;
use std::path::Path;

/// `summary.json` of an `image fit`.
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
    /// Of a fit to `photo`, written to `output`.
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
