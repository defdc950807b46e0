//! Fits a radiance field to posed photographs.

pub mod average;
mod bounds;
pub mod checkpoint;
pub mod exposure;
pub mod field;
pub mod moving;
pub mod occupancy;
pub mod photographs;
pub mod poses;
pub mod rays;
pub mod schedule;
mod trainer;
pub mod withheld;

use crate::data::Dataset;
use crate::data::names::FileNames;
use crate::model::config::ConfigError;
use crate::model::engine::EngineError;
use crate::model::export::ExportError;
pub use bounds::Bounds;
pub(crate) use bounds::{find_bounds, find_box};
use nerf_core::space::BoundsError;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
pub(crate) use trainer::{RESEEDS, lengthened};
pub use trainer::{Trainer, candidate};

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progressed {
    pub step: u32,
    pub rays: u64,
    /// Number of samples whose density was evaluated. `samples` counts only samples whose gradients were computed;
    /// without a learned grid, both numbers are equal.
    pub evaluated: u64,
    pub samples: u64,
    /// Smoothed number of samples per ray. With a learned grid, only samples with a backward pass are counted.
    live_per_ray: f64,
    /// Smoothed mean squared error of the training rays; before the first step 0 (scene) or NaN (2D field).
    pub mse: f64,
    /// Number of consecutive steps in which no sample got a gradient, usually because every density was 0.
    dead_steps: u32,
    pub reseeds: u32,
}

/// Returns the PSNR, dB, of a mean squared error; +inf for 0, NaN for NaN.
pub fn psnr_db_of_mse(mse: f64) -> f64 {
    // log10(0) is −inf without a special case, and + 0.0 keeps "-0" out of the reports.
    -10.0 * mse.log10() + 0.0
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    pub step: u32,
    /// Seconds since the run's start, including reading and validation.
    pub seconds: f64,
    /// Smoothed PSNR of the training rays, dB.
    pub train_psnr_db: f64,
    /// Mean PSNR, dB, of the validation views measured after this step; `None` if no view was measured.
    pub val_psnr_db: Option<f64>,
    pub val_views: u32,
    /// Spacing of the measured pixels along the rows and columns of a validation view; 1 measures every pixel.
    pub val_lattice: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    pub step: u32,
    pub seconds: f64,
    /// Index of the view in the validation split.
    pub view: usize,
    pub psnr_db: f64,
}

impl Snapshot {
    /// Returns the path of the snapshot's image. `folder`: folder of the report; `dataset`: data set with the view.
    pub fn path(&self, folder: &Path, dataset: &Dataset) -> PathBuf {
        let names = FileNames::of(&dataset.val);
        folder.join("snapshots").join(format!("step_{:06}_{}.png", self.step, names.at(self.view)))
    }
}

#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    #[error("{0}")]
    Config(#[from] ConfigError),
    #[error(
        "scene bounds: the cameras of {data} do not look at a common place; say where rays begin and end \
         with --near and --far, or where the scene is with --space box and --box"
    )]
    NoBounds { data: String },
    #[error("{0}")]
    Bounds(#[from] BoundsError),
    #[error("{0}")]
    Engine(#[from] EngineError),
    #[error(
        "training died {restarts} times: every density became 0. Try {}a lower --rate, or check the cameras' \
         convention with --axes",
        if *relu { "--set network.density=softplus, " } else { "" }
    )]
    Dead { restarts: u32, relu: bool },
    #[error("{part} that do not fit the rest")]
    Parts { part: &'static str },
    #[error("export: {0}")]
    Export(#[from] ExportError),
}
