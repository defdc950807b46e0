//! An import from first to last: network, occupancy grid, check, and what is left out.

pub use super::outcome::{OccupancySource, Outcome, Summary};
use super::probe::{ProbeError, probe};
use super::{Check, Draft, check, occupancy, renderings};
use crate::data::pictures::colour;
use crate::data::{Axes, View};
use crate::measure::audit::{Verdict, flattened};
use crate::measure::eval::measure;
use crate::measure::metrics::gain_db;
use crate::model::export::{Coarse, Contents, Exported, Tables, export_with};
use crate::model::import::{ImportError, Imported, Settings, Tensors, network};
use crate::train::occupancy::{Ask, LiveCells};
use nerf_core::Kernel;
use nerf_core::blob::{Content, Provenance};
use nerf_core::network::Architecture;
use nerf_core::plan::Quality;

/// What to import, and how.
#[derive(Clone, Copy)]
pub struct Request<'a> {
    /// The network.
    pub tensors: &'a Tensors,
    /// The coarse network whose densities say where on a ray it is asked.
    pub coarse: Option<&'a Tensors>,
    /// What the files cannot say.
    pub settings: &'a Settings,
    /// What renders the check.
    pub kernel: Kernel,
    /// View dependence that gains less than this on the check's views is left out, dB.
    pub effect_threshold_db: f64,
}

/// Views to check with.
pub struct Views {
    /// Of the data set.
    pub name: String,
    /// As which they were read.
    pub axes: Axes,
    /// What is measured.
    pub views: Vec<View>,
    /// Views whose directions are averaged over: those of training, if there are any.
    pub rays: Vec<View>,
}

/// The occupancy grid of an import.
pub enum Occupancy {
    /// The one that the network was trained with.
    Given {
        /// Its live cells.
        cells: LiveCells,
        /// Whether it is no part of the model whatever the check says.
        optional: bool,
    },
    /// The network is asked for one.
    Ask,
    /// There is to be none.
    None,
}

/// What an import is at.
#[derive(Clone, Copy, Debug)]
pub enum Stage {
    /// It asks the network which cells hold something.
    Occupancy,
    /// It renders views.
    Check {
        /// Renderings that are done.
        done: u64,
        /// Renderings in all.
        total: u64,
        /// Views that are rendered.
        views: usize,
    },
    /// It tries other guesses.
    Guesses,
}

/// The network of `--coarse`, and its parameters in export order.
pub(super) struct CoarseNetwork {
    pub(super) network: Imported,
    parameters: Vec<f32>,
}

/// Everything that goes into the blob but what is measured on it.
pub struct Work<'a> {
    request: Request<'a>,
    tensors: &'a Tensors,
    settings: &'a Settings,
    network: Imported,
    architecture: Architecture,
    parameters: Vec<f32>,
    coarse: Option<CoarseNetwork>,
    cells: Option<LiveCells>,
}

/// What is measured.
#[derive(Default)]
struct About<'a> {
    occupancy_required: bool,
    check: Option<&'a Check>,
    data: Option<&'a str>,
}

impl<'a> Work<'a> {
    /// Reads the networks out of the tensors.
    ///
    /// # Errors
    /// [`ImportError`] if the tensors are no network of these settings, and on what the format refuses.
    pub fn new(request: &Request<'a>) -> Result<Self, ImportError> {
        let Request { tensors, settings, .. } = *request;
        let own = network(tensors, settings)?;
        let coarse = match request.coarse {
            Some(tensors) => {
                let network = network(tensors, settings)?;
                Some(CoarseNetwork { parameters: network.folded(), network })
            }
            None => None,
        };
        let (architecture, parameters) = (own.model.architecture.clone(), own.folded());
        let request = *request;
        let work =
            Self { request, tensors, settings, network: own, architecture, parameters, coarse, cells: None };
        // What the format refuses is found out before the work.
        work.export(&About::default())?;
        Ok(work)
    }

    /// Builds the occupancy grid, checks the network on `views`, decides what is part of the model, and exports.
    ///
    /// # Errors
    /// [`ProbeError`] if the network cannot be exported or rendered.
    pub fn finish(
        mut self,
        occupancy: Occupancy,
        views: Option<&Views>,
        each: &mut dyn FnMut(Stage),
    ) -> Result<Outcome<'a>, ProbeError> {
        let (source, optional) = self.take(occupancy, each);
        let mut check = views.map(|views| self.check(views, each)).transpose()?;
        let mut direction = None;
        if let (Some(views), Some(seen)) = (views, &check)
            && !seen.is_suspicious()
        {
            direction = self.ask_direction(views, seen.psnr_db())?;
            if direction.is_some_and(|(_, verdict)| verdict == Verdict::Drops) {
                check = Some(self.check(views, each)?);
            }
        }
        let occupancy_required = self.cells.is_some()
            && match (source, &check) {
                (OccupancySource::Given, _) if optional => false,
                (OccupancySource::Given, Some(check)) => check.occupancy_matters(),
                (OccupancySource::Given, None) => true,
                // What a network that was trained without it loses by it is no reason to require it.
                (_, check) => check.as_ref().is_some_and(|c| c.occupancy_matters() && !c.occupancy_harms()),
            };
        let data = views.map(|views| views.name.as_str());
        let exported = self.export(&About { occupancy_required, check: check.as_ref(), data })?;
        Ok(Outcome {
            tensors: self.tensors,
            settings: self.settings,
            kernel: self.request.kernel,
            network: self.network,
            architecture: self.architecture,
            direction,
            coarse: self.coarse.map(|coarse| coarse.network),
            exported,
            source,
            cells: self.cells,
            occupancy_required,
            check,
            guesses: Vec::new(),
        })
    }

    /// Takes the occupancy grid in; where it comes from, and whether it is no part of the model.
    fn take(&mut self, occupancy: Occupancy, each: &mut dyn FnMut(Stage)) -> (OccupancySource, bool) {
        match occupancy {
            Occupancy::Given { cells, optional } => {
                self.cells = Some(cells);
                (OccupancySource::Given, optional)
            }
            Occupancy::None => (OccupancySource::None, false),
            Occupancy::Ask => {
                each(Stage::Occupancy);
                let (architecture, parameters) = (&self.architecture, self.parameters.as_slice());
                let isa = self.request.kernel.isa;
                let ask = Ask { isa, architecture, parameters, seed: 0, contraction: None };
                self.cells = occupancy::build(self.settings, &ask);
                (OccupancySource::Built, false)
            }
        }
    }

    /// The blob: all but what is in `about` follows from the network.
    fn export(&self, about: &About<'_>) -> Result<Exported, ImportError> {
        let finite = |db: f64| Some(db as f32).filter(|db| db.is_finite());
        let name = self.tensors.file.file_name().unwrap_or_default().to_string_lossy();
        let made_by = format!("nerf-train {}, imported from {name}", env!("CARGO_PKG_VERSION"));
        let s = self.settings;
        let drawn = s.coarse_samples.map_or_else(String::new, |coarse| format!("{coarse} + "));
        let convention = about.check.map_or_else(String::new, |check| {
            format!(
                "mean over {} views, every third pixel and row, background {}, {drawn}{} samples a ray",
                check.scores.views.len(),
                colour::name(s.background),
                s.samples
            )
        });
        let stem = self.tensors.file.file_stem().unwrap_or_default().to_string_lossy();
        let coarse = self.coarse.as_ref().zip(s.coarse_samples).map(|(coarse, samples)| Coarse {
            architecture: &coarse.network.model.architecture,
            parameters: &coarse.parameters,
            samples,
        });
        let contents = Contents {
            tables: Tables::None,
            architecture: &self.architecture,
            parameters: &self.parameters,
            content: Content::Scene(s.facts(about.occupancy_required)),
            occupancy: self.cells.as_ref().map(|cells| (cells.resolution(), cells.bits())),
            provenance: Provenance {
                data: about.data.unwrap_or(&stem),
                made_by: &made_by,
                psnr_db: about.check.and_then(|check| finite(check.psnr_db())),
                psnr_convention: &convention,
                quantisation_loss_db: about.check.and_then(|check| finite(check.quantisation_loss_db)),
                trained_parameters: self.network.parameters.len() as u32,
                ..Provenance::NONE
            },
        };
        Ok(export_with(&contents, coarse.as_ref())?)
    }

    /// What view dependence gains over its mean, dB, and whether that is enough: if not, the mean takes its
    /// place. `None` if colour does not depend on the direction.
    fn ask_direction(&mut self, views: &Views, with_db: f64) -> Result<Option<(f64, Verdict)>, ProbeError> {
        let rays: Vec<&View> = views.rays.iter().collect();
        let Some(flat) = flattened(&self.architecture, &self.parameters, &rays) else {
            return Ok(None);
        };
        let whole = (
            std::mem::replace(&mut self.architecture, flat.0),
            std::mem::replace(&mut self.parameters, flat.1),
        );
        let draft = self.export(&About::default())?.bytes;
        let (kernel, background) = (self.request.kernel, self.settings.background);
        let quality = Quality::default();
        let scores = measure(&draft, None, kernel, &quality, background, &views.views, |_, _, _, _| {})?;
        let gain_db = gain_db(with_db, scores.psnr_db().unwrap_or(f64::NAN));
        // It takes work and spares none.
        let verdict = Verdict::of(gain_db, 1.0, self.request.effect_threshold_db);
        if verdict != Verdict::Drops {
            (self.architecture, self.parameters) = whole;
        }
        Ok(Some((gain_db, verdict)))
    }

    fn check(&self, views: &Views, each: &mut dyn FnMut(Stage)) -> Result<Check, ProbeError> {
        let blob = &self.export(&About::default())?.bytes;
        let has_occupancy = self.cells.is_some();
        let (total, views) = (renderings(has_occupancy) * views.views.len() as u64, &views.views);
        let mut done = 0;
        let background = self.settings.background;
        let draft = Draft { blob, parameters: &self.parameters, has_occupancy, background };
        Ok(check(&draft, self.request.kernel, views, || {
            done += 1;
            each(Stage::Check { done, total, views: views.len() });
        })?)
    }
}

impl Outcome<'_> {
    /// Tries other guesses where the check shows no picture of the scene.
    ///
    /// # Errors
    /// As [`probe`].
    pub fn try_guesses(&mut self, views: &Views, each: &mut dyn FnMut(Stage)) -> Result<(), ProbeError> {
        if self.check.as_ref().is_some_and(Check::is_suspicious) {
            each(Stage::Guesses);
            self.guesses = probe(self.tensors, self.settings, views.axes, self.kernel, &views.views)?;
        }
        Ok(())
    }
}
