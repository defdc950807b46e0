//! The state of a run as it would be exported.

use crate::data::cameras::viewpoint::viewpoint;
use crate::model::export::{Contents, Exported, Tables, export};
use crate::train::occupancy::{DensityQuery, LiveCells, Occupancy};
use crate::train::{TrainError, Trainer};
use nerf_core::blob::{Content, Provenance, SceneFacts, SceneSampling};
use nerf_core::network::Architecture;
use std::borrow::Cow;

pub(crate) const MADE_BY: &str = concat!("nerf-train ", env!("CARGO_PKG_VERSION"));

/// Optical thickness of a marched step that keeps a cell in the file, where training keeps more.
const EXPORTED: f32 = 0.03;

/// A state of the run as it would be exported: what is measured of it is what its blob shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    pub step: u32,
    /// Averaged over steps where the run averages; in export order, not yet rounded.
    pub parameters: Vec<f32>,
    /// The occupancy grid, asked once more everywhere.
    pub live: LiveCells,
    /// The shape of its network where that is not the trained one's: without its direction.
    pub architecture: Option<Architecture>,
}

/// What a blob says besides what the run knows.
#[derive(Clone, Copy, Debug, Default)]
pub struct About<'a> {
    /// Whether the occupancy grid is part of the model.
    pub occupancy_required: bool,
    pub psnr_db: Option<f64>,
    pub convention: &'a str,
    pub quantisation_loss_db: Option<f64>,
}

impl Trainer<'_> {
    /// The run as it stands. Training is not changed by asking for it.
    ///
    /// `settle`: ask all cells of the occupancy grid once more. A grid field's are asked all the time, so that on the
    /// way its occupancy does as it is.
    pub fn candidate(&self, settle: bool) -> Candidate {
        let parameters = self.averaged_parameters();
        let scene_box = self.bounds.scene_box;
        let resolution = self.config.occupancy_resolution(scene_box.max - scene_box.min);
        let full = || Occupancy::full(scene_box, resolution);
        let mut occupancy = self.occupancy.clone().unwrap_or_else(full);
        let ask = DensityQuery {
            isa: self.kernel.isa,
            architecture: &self.model.architecture,
            parameters: &parameters,
            seed: self.config.seed,
            contraction: self.bounds.contraction,
        };
        if settle || self.config.network.grid.is_none() {
            let threshold = self.threshold();
            let threshold = self.step_width.map_or(threshold, |step| threshold.max(EXPORTED / step));
            occupancy.settle(&ask, threshold);
        }
        if settle {
            occupancy.drop_unweighted();
        }
        Candidate { step: self.progressed.step, live: occupancy.into_live(), parameters, architecture: None }
    }

    /// In export order: the average, or the last where the run does not average.
    fn averaged_parameters(&self) -> Vec<f32> {
        let parameters = self.average.values().map_or_else(|| self.engine.parameters(), Cow::Borrowed);
        self.model.fold(parameters).into_owned()
    }

    pub fn export(&self, candidate: &Candidate, about: &About<'_>) -> Result<Exported, TrainError> {
        let finite = |db: Option<f64>| db.map(|db| db as f32).filter(|db| db.is_finite());
        let b = &self.bounds;
        let architecture = candidate.architecture.as_ref().unwrap_or(&self.model.architecture);
        let (parameters, tables) = candidate.parameters.split_at(architecture.parameters());
        let exported = export(&Contents {
            architecture,
            parameters,
            tables: Tables::of(self.config.network.grid.as_ref(), tables, self.engine.table_scales()),
            content: Content::Scene(SceneFacts {
                min: b.scene_box.min.into(),
                max: b.scene_box.max.into(),
                near: b.near,
                far: b.far,
                sampling: match self.step_width {
                    Some(_) => b.sampling(self.config.sampling.steps_across),
                    None => SceneSampling::Bins(self.config.sampling.samples),
                },
                background: self.background(),
                occupancy_required: about.occupancy_required,
                viewpoint: viewpoint(self.dataset, (b.near, b.far)),
            }),
            occupancy: Some((candidate.live.resolution(), candidate.live.bits())),
            provenance: Provenance {
                data: &self.dataset.name,
                made_by: MADE_BY,
                steps: candidate.step,
                seed: self.config.seed,
                psnr_db: finite(about.psnr_db),
                psnr_convention: about.convention,
                quantisation_loss_db: finite(about.quantisation_loss_db),
                trained_parameters: self.parameters() as u32,
            },
        })?;
        Ok(exported)
    }

    /// What is behind the scene, display-encoded: the data's own colour; of an unbounded scene, where it shows through
    /// what no photograph saw, their mean colour; or else black.
    pub fn background(&self) -> [f32; 3] {
        self.background
    }
}
