//! Candidate for export: the field and occupancy grid of a run at one step.

use crate::data::cameras::viewpoint::viewpoint;
use crate::model::export::{Contents, Exported, Tables, export};
use crate::train::occupancy::{DensityQuery, Occupancy, OccupiedCells};
use crate::train::{TrainError, Trainer};
use nerf_core::blob::{Content, Provenance, SceneFacts, SceneSampling};
use nerf_core::network::Architecture;
use std::borrow::Cow;

pub(crate) const MADE_BY: &str = concat!("nerf-train ", env!("CARGO_PKG_VERSION"));

/// Least optical thickness of an occupied cell in the exported grid, over one march step. Training in bounded scenes
/// uses lower values. The exported grid thus leaves out thin fog: rendering takes a fifth less time at the same PSNR.
const EXPORTED: f32 = 0.1;
/// Value in place of [`EXPORTED`] if the photographs contradict each other. Without the thin fog in such fields, PSNR
/// falls by 0.2 dB.
const EXPORTED_FOG: f32 = 0.03;

/// The field and occupancy grid of a run at one step, as they would be exported.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    pub step: u32,
    /// Network parameters in the order of export, not yet rounded; the average over steps if the run keeps one.
    pub parameters: Vec<f32>,
    /// Occupancy grid. At the end of a run, the cells have been evaluated a last time.
    pub live: OccupiedCells,
    /// Architecture to export if the direction input was removed; `None`: the trained architecture is exported.
    pub architecture: Option<Architecture>,
}

/// Facts that are written into an exported blob and that the trainer does not know.
#[derive(Clone, Copy, Debug, Default)]
pub struct About<'a> {
    pub occupancy_required: bool,
    pub psnr_db: Option<f64>,
    pub convention: &'a str,
    pub quantisation_loss_db: Option<f64>,
}

impl Candidate {
    /// Copies the present state of the run. `settle`: whether to evaluate the cells of the occupancy grid a last time
    /// and, in an unbounded scene, to empty cells in which no sample had enough compositing weight; true at the end of
    /// a run. Without a learned feature grid, the cells are evaluated even if `settle` is false.
    pub fn of(trainer: &Trainer<'_>, settle: bool) -> Self {
        let averaged = trainer.state.average.values().map(Cow::Borrowed);
        let parameters = averaged.unwrap_or_else(|| trainer.engine.parameters());
        let parameters = trainer.model.fold(parameters).into_owned();
        let scene_box = trainer.bounds.scene_box;
        let resolution = trainer.config.occupancy_resolution(scene_box.max - scene_box.min);
        let full = || Occupancy::full(scene_box, resolution);
        let mut occupancy = trainer.state.occupancy.clone().unwrap_or_else(full);
        let ask = DensityQuery {
            isa: trainer.kernel.isa,
            architecture: &trainer.model.architecture,
            parameters: &parameters,
            seed: trainer.config.seed,
            contraction: trainer.bounds.contraction,
        };
        if settle || trainer.config.network.grid.is_none() {
            let threshold = trainer.threshold();
            let contradict = trainer.state.photographs.withheld_found.is_some_and(|found| found.contradict());
            let exported = if contradict { EXPORTED_FOG } else { EXPORTED };
            let threshold = trainer.step_width.map_or(threshold, |step| threshold.max(exported / step));
            occupancy.settle(&ask, threshold);
        }
        if settle {
            occupancy.drop_unweighted();
        }
        Self {
            step: trainer.state.progressed.step,
            live: occupancy.into_live(),
            parameters,
            architecture: None,
        }
    }

    pub fn export(&self, trainer: &Trainer<'_>, about: &About<'_>) -> Result<Exported, TrainError> {
        let finite = |db: Option<f64>| db.map(|db| db as f32).filter(|db| db.is_finite());
        let b = &trainer.bounds;
        let architecture = self.architecture.as_ref().unwrap_or(&trainer.model.architecture);
        let (parameters, tables) = self.parameters.split_at(architecture.parameters());
        let exported = export(&Contents {
            architecture,
            parameters,
            tables: Tables::of(trainer.config.network.grid.as_ref(), tables, trainer.engine.table_scales()),
            content: Content::Scene(SceneFacts {
                min: b.scene_box.min.into(),
                max: b.scene_box.max.into(),
                near: b.near,
                far: b.far,
                sampling: match trainer.step_width {
                    Some(_) => b.sampling(trainer.config.sampling.steps_across),
                    None => SceneSampling::Bins(trainer.config.sampling.samples),
                },
                background: trainer.background,
                occupancy_required: about.occupancy_required,
                viewpoint: viewpoint(trainer.dataset, (b.near, b.far)),
            }),
            occupancy: Some((self.live.resolution(), self.live.bits())),
            provenance: Provenance {
                data: &trainer.dataset.name,
                made_by: MADE_BY,
                steps: self.step,
                seed: trainer.config.seed,
                psnr_db: finite(about.psnr_db),
                psnr_convention: about.convention,
                quantisation_loss_db: finite(about.quantisation_loss_db),
                trained_parameters: trainer.model.parameters() as u32,
            },
        })?;
        Ok(exported)
    }
}
