//! Import of networks that were trained elsewhere, from files whose tensors are named as in nerf-pytorch.
//!
//! ```text
//! .npz, .safetensors
//!   ─► Tensors                   tensors by name
//!   ─► layers, columns permuted  with Settings, which say what the file does not
//!   ─► engine::Model, parameters
//!   ─► folded parameters         the feature layer is merged into the layer after it
//!   ─► blob                      checked on views
//! ```
//!
//! `W`, `V`: widths of layers; PE: sinusoidal encoding; `x`: position; `d`: direction; `h`: output of the layer before.
//!
//! | tensor | shape | becomes |
//! | --- | --- | --- |
//! | `pts_linears.0.weight` | `[W, E]` | first trunk layer; the width `E` of PE(x) gives the number of levels |
//! | `pts_linears.i.weight` | `[W, W]`, or `[W, E + W]` | trunk layer with input `h`, or with input `[PE(x), h]` |
//! | `alpha_linear.weight` | `[1, W]` | density head |
//! | `feature_linear.weight` | `[W, W]` | no activation: folded into the layer after it |
//! | `views_linears.0.weight` | `[V, W + D]` | first colour layer; the width `D` of PE(d) gives the number of levels |
//! | `rgb_linear.weight` | `[3, V]` | rgb |
//! | `output_linear.weight` | `[4, W]` | without view directions: rgb, then sigma; replaces the four tensors above |
//!
//! A coarse network (`--coarse`) is read in the same way; its layers up to the densities become the proposal network.
//!
//! Each weight comes with a `.bias`, one value per row. A prefix of the names, such as `module.`, is ignored.
//!
//! # Source
//! The names and the order of columns are those of github.com/yenchenlin/nerf-pytorch (`run_nerf_helpers.py`),
//! which copies the original authors' TensorFlow code.

mod network;
pub mod occupancy;
mod order;
mod settings;
mod summary;
mod tensors;

pub use network::{Imported, network};
pub use order::{Identity, Order};
pub use settings::{AngleFactor, RawDensity, Settings};
pub use summary::Summary;
pub use tensors::{Tensor, Tensors};

use crate::data::View;
use crate::data::pictures::colour;
use crate::measure::audit::{Verdict, flattened};
use crate::measure::eval::{OCCUPANCY_LOSS_DB, Scores, measure};
use crate::measure::metrics::gain_db;
use crate::model::export::{Coarse, Contents, Exported, Tables, export_with};
use crate::system::progress::{Progress, ProgressStyle, say};
use crate::train::occupancy::{DensityQuery, OccupiedCells};
use nerf_core::Kernel;
use nerf_core::blob::{Content, Provenance};
use nerf_core::network::Architecture;
use nerf_core::plan::Quality;
use std::fmt::Display;

/// Distance between measured pixels in rows and columns, pixels; odd, so that a square of this side has a middle pixel.
pub const STRIDE: u32 = 3;
/// PSNR below which some setting of the import is probably wrong, dB.
pub const SUSPICIOUS_DB: f64 = 15.0;

/// Returns an error about `place`, a file or setting that an import cannot use.
fn refused(place: impl Display, expected: impl Display, found: impl Display) -> anyhow::Error {
    anyhow::anyhow!("{place}: expected {expected}, found {found}")
}

#[derive(Clone, Copy)]
pub struct Request<'a> {
    pub tensors: &'a Tensors,
    /// The coarse network, whose densities guide the importance sampling.
    pub coarse: Option<&'a Tensors>,
    pub settings: &'a Settings,
    pub kernel: Kernel,
    pub style: ProgressStyle,
    /// Smallest gain of PSNR, dB, at which view dependence is kept. The gain is measured on the views of the check.
    pub effect_threshold_db: f64,
}

/// Views on which an imported network is checked, reduced to every [`STRIDE`]-th column and row.
pub struct Views {
    pub name: String,
    pub views: Vec<View>,
    /// Training views, else validation views, over whose rays the encoded direction is averaged.
    pub rays: Vec<View>,
}

pub enum Occupancy {
    /// The occupancy grid that the network was trained with.
    Given {
        cells: OccupiedCells,
        /// Whether the user states that the grid is not part of the model, and thus never required for rendering.
        optional: bool,
    },
    Build,
    None,
}

#[derive(Clone, Debug)]
pub struct Check {
    /// Scores with the scene file's rounded weights.
    pub scores: Scores,
    pub quantisation_loss_db: f64,
    /// PSNR with the occupancy grid minus PSNR without it, dB. `None` without an occupancy grid.
    pub occupancy_gain_db: Option<f64>,
}

impl Check {
    pub fn psnr_db(&self) -> f64 {
        self.scores.psnr_db().unwrap_or(f64::NAN)
    }

    /// Whether leaving out the occupancy grid changes PSNR by more than `OCCUPANCY_LOSS_DB`; true for a change of NaN.
    fn occupancy_matters(&self) -> bool {
        self.occupancy_gain_db.is_some_and(|gain| gain.is_nan() || gain.abs() > OCCUPANCY_LOSS_DB)
    }

    /// Whether PSNR is lower with the occupancy grid than without it, by more than `OCCUPANCY_LOSS_DB`.
    pub fn occupancy_harms(&self) -> bool {
        self.occupancy_gain_db.is_some_and(|gain| gain < -OCCUPANCY_LOSS_DB)
    }

    /// Whether PSNR is below [`SUSPICIOUS_DB`] or NaN: some setting of the import is then probably wrong.
    pub fn is_suspicious(&self) -> bool {
        let psnr_db = self.psnr_db();
        psnr_db.is_nan() || psnr_db < SUSPICIOUS_DB
    }
}

/// Import of a checkpoint: its networks, the occupancy grid, and results of the check on views.
pub struct Import<'a> {
    request: Request<'a>,
    network: Imported,
    architecture: Architecture,
    parameters: Vec<f32>,
    /// The coarse network, and its parameters in the order of a blob's weights.
    coarse: Option<(Imported, Vec<f32>)>,
    pub cells: Option<OccupiedCells>,
    occupancy_required: bool,
    /// PSNR gained by view dependence, dB, and whether view dependence is kept; `None` if not measured.
    direction: Option<(f64, Verdict)>,
    pub check: Option<Check>,
}

impl<'a> Import<'a> {
    /// Reads the network and the coarse network from their tensors.
    pub fn new(request: &Request<'a>) -> anyhow::Result<Self> {
        let own = network(request.tensors, request.settings)?;
        let coarse = request.coarse.map(|tensors| network(tensors, request.settings)).transpose()?;
        let import = Self {
            request: *request,
            architecture: own.model.architecture.clone(),
            parameters: own.folded(),
            network: own,
            coarse: coarse.map(|coarse| {
                let parameters = coarse.folded();
                (coarse, parameters)
            }),
            cells: None,
            occupancy_required: false,
            direction: None,
            check: None,
        };
        // This export is a trial: what the format refuses fails here, before any long work.
        import.export(None)?;
        Ok(import)
    }

    /// Sets or builds the occupancy grid, checks the network on `views`, and exports the blob. The check decides
    /// whether view dependence is kept and whether the grid is required.
    pub fn finish(&mut self, occupancy: Occupancy, views: Option<&Views>) -> anyhow::Result<Exported> {
        let (given, optional) = match occupancy {
            Occupancy::Given { cells, optional } => {
                self.cells = Some(cells);
                (true, optional)
            }
            Occupancy::Build => {
                self.cells = self.built();
                (false, false)
            }
            Occupancy::None => (false, false),
        };
        if let Some(views) = views {
            self.check = Some(self.measured(views)?);
            self.direction = self.ask_direction(views)?;
            if self.direction.is_some_and(|(_, verdict)| verdict == Verdict::Drops) {
                self.check = Some(self.measured(views)?);
            }
        }
        self.occupancy_required = self.cells.is_some()
            && !optional
            && match &self.check {
                // A built grid that harms the picture must not be required: the network was trained without it.
                Some(check) => check.occupancy_matters() && (given || !check.occupancy_harms()),
                None => given,
            };
        self.export(views.map(|views| &*views.name))
    }

    /// Returns the occupancy grid built from the network's densities; `None` if no cell is occupied.
    fn built(&self) -> Option<OccupiedCells> {
        let Request { settings, kernel, style, .. } = self.request;
        say(style, "building the occupancy grid from the network's densities");
        let (architecture, parameters) = (&self.architecture, self.parameters.as_slice());
        let ask = DensityQuery { isa: kernel.isa, architecture, parameters, seed: 0, contraction: None };
        let coarse = self.coarse.as_ref().map_or(0, |_| settings.coarse_samples);
        let samples = f32::from(settings.samples(self.coarse.is_some())) + f32::from(coarse);
        let threshold = settings.occupancy_threshold * samples / (settings.far - settings.near);
        occupancy::build(settings, &ask, threshold)
    }

    /// Exports the scene file; `data`: name of the data set on which the network was checked.
    fn export(&self, data: Option<&str>) -> anyhow::Result<Exported> {
        let finite = |db: f64| Some(db as f32).filter(|db| db.is_finite());
        let Request { tensors, settings, .. } = self.request;
        let name = tensors.file.file_name().unwrap_or_default().to_string_lossy();
        let stem = tensors.file.file_stem().unwrap_or_default().to_string_lossy();
        let made_by = format!("nerf-train {}, imported from {name}", env!("CARGO_PKG_VERSION"));
        let coarse = self.coarse.as_ref().map(|(coarse, parameters)| Coarse {
            architecture: &coarse.model.architecture,
            parameters,
            samples: settings.coarse_samples,
        });
        let facts = settings.facts(coarse.is_some(), self.occupancy_required);
        let check = self.check.as_ref().filter(|_| data.is_some());
        let convention = check.map_or_else(String::new, |check| {
            let drawn = coarse.as_ref().map_or_else(String::new, |coarse| format!("{} + ", coarse.samples));
            format!(
                "mean over {} views, every third pixel and row, background {}, {drawn}{} samples a ray",
                check.scores.views.len(),
                colour::name(settings.background),
                settings.samples(coarse.is_some())
            )
        });
        let contents = Contents {
            tables: Tables::None,
            architecture: &self.architecture,
            parameters: &self.parameters,
            content: Content::Scene(facts),
            occupancy: self.cells.as_ref().map(|cells| (cells.resolution(), cells.bits())),
            provenance: Provenance {
                data: data.unwrap_or(&stem),
                made_by: &made_by,
                psnr_db: check.and_then(|check| finite(check.psnr_db())),
                psnr_convention: &convention,
                quantisation_loss_db: check.and_then(|check| finite(check.quantisation_loss_db)),
                trained_parameters: self.network.parameters.len() as u32,
                ..Provenance::NONE
            },
        };
        Ok(export_with(&contents, coarse.as_ref())?)
    }

    /// Scores `views` with rounded weights, with f32 weights and, if there is an occupancy grid, without the grid.
    fn measured(&self, views: &Views) -> anyhow::Result<Check> {
        let blob = self.export(None)?.bytes;
        let Request { settings, kernel, style, .. } = self.request;
        let renderings = if self.cells.is_some() { 3 } else { 2 };
        let mut progress = Progress::steps("check", renderings * views.views.len(), style);
        let mut done = 0;
        let mut score = |parameters: Option<&[f32]>, occupancy| -> anyhow::Result<Scores> {
            let quality = Quality { occupancy, ..Quality::default() };
            measure(&blob, parameters, kernel, &quality, settings.background, &views.views, |_, _, _, _| {
                done += 1;
                progress.reach(done);
            })
        };
        let db = |scores: &Scores| scores.psnr_db().unwrap_or(f64::NAN);
        let scores = score(None, true)?;
        let quantisation_loss_db = gain_db(db(&score(Some(&self.parameters), true)?), db(&scores));
        let occupancy_gain_db = match self.cells {
            Some(_) => Some(gain_db(db(&scores), db(&score(None, false)?))),
            None => None,
        };
        progress.finish(format!("{} views", views.views.len()));
        Ok(Check { scores, quantisation_loss_db, occupancy_gain_db })
    }

    /// Measures how many dB of PSNR view dependence adds: by how much the PSNR falls if the encoded direction is replaced
    /// by its mean. Removes view dependence if it adds too little. If colour does not depend on the direction, or if
    /// [`Check::is_suspicious`] is true, measures nothing and returns `None`.
    fn ask_direction(&mut self, views: &Views) -> anyhow::Result<Option<(f64, Verdict)>> {
        let rays: Vec<&View> = views.rays.iter().collect();
        let check = self.check.as_ref().filter(|check| !check.is_suspicious());
        let flat = check.and_then(|_| flattened(&self.architecture, &self.parameters, &rays));
        let (Some(check), Some(flat)) = (check, flat) else { return Ok(None) };
        let with_db = check.psnr_db();
        let whole = (
            std::mem::replace(&mut self.architecture, flat.0),
            std::mem::replace(&mut self.parameters, flat.1),
        );
        let draft = self.export(None)?.bytes;
        let Request { settings, kernel, .. } = self.request;
        let quality = Quality::default();
        let scores =
            measure(&draft, None, kernel, &quality, settings.background, &views.views, |_, _, _, _| {})?;
        let gain_db = gain_db(with_db, scores.psnr_db().unwrap_or(f64::NAN));
        // The ratio of multiply-adds is set to 1, as view dependence saves no work.
        let verdict = Verdict::of(gain_db, 1.0, self.request.effect_threshold_db);
        if verdict != Verdict::Drops {
            (self.architecture, self.parameters) = whole;
        }
        Ok(Some((gain_db, verdict)))
    }
}
