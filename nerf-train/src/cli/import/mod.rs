//! `nerf-train import`

mod options;
mod outcome;

use super::audit::check_threshold;
use super::common::{DataOptions, Global, background_name, tell};
use super::places;
use crate::data::system::output::claims::Claims;
use crate::data::system::output::write_atomic;
use crate::data::system::progress::{Message, Progress, Total};
use crate::data::{Axes, Downscale, View};
use crate::fit::run::spread;
use crate::measure::audit::{THRESHOLD_DB, Verdict, flattened};
use crate::measure::eval::measure;
use crate::measure::import::probe::{Probe, probe};
use crate::measure::import::{Check, occupancy};
use crate::measure::import::{Draft, SUSPICIOUS_DB, VIEWS, check, renderings, split, thinned};
use crate::measure::metrics::gain_db;
use crate::model::export::{Coarse, Contents, Exported, Tables, export_with};
use crate::model::import::{Imported, Settings, Tensors, network};
use crate::train::occupancy::{Ask, LiveCells};
use anyhow::bail;
use clap::Args;
use nerf_core::Kernel;
use nerf_core::blob::{Content, Provenance};
use nerf_core::network::Architecture;
use nerf_core::plan::Quality;
use options::Guesses;
use outcome::{OccupancySource, Outcome};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Make a blob of a network trained elsewhere, in nerf-pytorch's names.
///
/// CKPT is a .npz or .safetensors file with pts_linears.0.weight, … of one network, or of a coarse and a fine one
/// (then the fine one is taken).
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    nerf-train import lego_200k_fine.npz -o lego.nerf --background white --check lego_200\n  \
    nerf-train import lego_200k_fine.npz -o lego.nerf --coarse lego_200k_coarse.npz --background white\n  \
    nerf-train import lego.safetensors -o lego.nerf --angle-scale pi --samples 64 --occupancy grid96.npy")]
pub struct Import {
    /// The network: .npz or .safetensors.
    #[arg(value_name = "CKPT")]
    checkpoint: PathBuf,
    /// The blob to write.
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// What stands in front of the tensors' names, such as network_fine. [default: as the file has it].
    #[arg(long, value_name = "PREFIX")]
    prefix: Option<String>,
    /// The coarse network that goes with it: its densities say where on a ray CKPT is asked. A file of both may
    /// be named twice.
    #[arg(long, value_name = "CKPT")]
    coarse: Option<PathBuf>,
    /// What stands in front of its tensors' names [default: as the file has it].
    #[arg(long, value_name = "PREFIX", requires = "coarse")]
    coarse_prefix: Option<String>,
    /// TOML file with what the file cannot say; flags win.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Render views of a data set, print their PSNR, what f16 costs, and whether the occupancy grid is part of the
    /// model.
    #[arg(long, value_name = "DATA")]
    check: Option<PathBuf>,
    /// Which validation views, counted from 0 [default: up to ten of them].
    #[arg(long = "view", value_name = "I,J,…", value_delimiter = ',', requires = "check")]
    views: Vec<usize>,
    /// Read pictures of --check also where its `file_path` leads out of its folder.
    #[arg(long, requires = "check")]
    outside_files: bool,
    /// Leave view dependence out if it gains less than this on the views of --check, dB: its mean over directions
    /// takes its place.
    #[arg(long, value_name = "DB", default_value_t = THRESHOLD_DB, allow_hyphen_values = true, requires = "check")]
    effect_threshold: f64,
    /// Occupancy grid of the box that the network was trained with: a .npy array [x, y, z] of truths.
    #[arg(long, value_name = "FILE", conflicts_with = "no_occupancy")]
    occupancy: Option<PathBuf>,
    /// The occupancy grid of --occupancy is no part of the model: the picture is the same without it.
    #[arg(long, requires = "occupancy")]
    occupancy_optional: bool,
    /// Build no occupancy grid: every sample asks the network.
    #[arg(long)]
    no_occupancy: bool,
    #[command(flatten)]
    guesses: Guesses,
}

/// Views whose directions are averaged over.
const RAY_VIEWS: usize = 50;

/// Views to check with.
struct Data {
    name: String,
    axes: Axes,
    views: Vec<View>,
    /// Views whose directions are averaged over: those of training, if there are any.
    rays: Vec<View>,
}

impl Import {
    /// Runs the command.
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let guesses = match &self.config {
            Some(file) => self.guesses.clone().or(Guesses::read(file)?),
            None => self.guesses.clone(),
        };
        if guesses.coarse_samples.is_some() && self.coarse.is_none() {
            bail!("coarse_samples: expected only with --coarse");
        }
        let (settings, kernel) = (guesses.settings(self.coarse.is_some()), global.kernel());
        settings.check()?;
        check_threshold(self.effect_threshold)?;
        places::check_extension("-o", &self.output, places::BLOB)?;
        Claims::new()
            .reads("the network", &self.checkpoint)
            .reads_if("the coarse network", self.coarse.as_deref())
            .reads_if("the file of settings", self.config.as_deref())
            .reads_if("the occupancy grid", self.occupancy.as_deref())
            .reads_data_if(self.check.as_deref())
            .writes("-o", &self.output)
            .settle()?;
        let tensors = Tensors::read(&self.checkpoint, self.prefix.as_deref())?;
        let network = network(&tensors, &settings)?;
        let coarse = self.coarse(&settings)?;
        let given = self.occupancy.as_deref().map(|file| occupancy::read(file, &settings)).transpose()?;
        let data = self.data(&guesses, &settings, global)?;
        let mut work = Work {
            network: &network,
            architecture: network.model.architecture.clone(),
            parameters: network.folded(),
            coarse: coarse.as_ref(),
            settings: &settings,
            cells: None,
            file: &self.checkpoint,
        };
        // What the format refuses is found out before the work.
        work.export(&About::default())?;
        let source;
        (work.cells, source) = match given {
            Some(cells) => (Some(cells), OccupancySource::Given),
            None if self.no_occupancy => (None, OccupancySource::None),
            None => {
                global.say("asking the network which cells of the scene box hold something");
                let (architecture, parameters) = (&work.architecture, work.parameters.as_slice());
                let ask = Ask { isa: kernel.isa, architecture, parameters, seed: 0, contraction: None };
                (occupancy::build(&settings, &ask), OccupancySource::Built)
            }
        };
        let mut check = data.as_ref().map(|data| work.check(kernel, data, global)).transpose()?;
        let mut direction = None;
        if let (Some(data), Some(seen)) = (&data, &check)
            && !seen.is_suspicious()
        {
            direction = work.ask_direction(kernel, data, seen.psnr_db(), self.effect_threshold)?;
            if direction.is_some_and(|(_, verdict)| verdict == Verdict::Drops) {
                check = Some(work.check(kernel, data, global)?);
            }
        }
        let occupancy_required = work.cells.is_some()
            && match (source, &check) {
                (OccupancySource::Given, _) if self.occupancy_optional => false,
                (OccupancySource::Given, Some(check)) => check.occupancy_matters(),
                (OccupancySource::Given, None) => true,
                // What a network that was trained without it loses by it is no reason to require it.
                (_, check) => check.as_ref().is_some_and(|c| c.occupancy_matters() && !c.occupancy_harms()),
            };
        let about = About {
            occupancy_required,
            check: check.as_ref(),
            data: data.as_ref().map(|data| data.name.as_str()),
        };
        let exported = work.export(&about)?;
        write_atomic(&self.output, &exported.bytes)?;
        let probes = match (&check, &data) {
            (Some(check), Some(data)) if check.is_suspicious() => {
                global.say("that is no picture of the scene; trying other guesses");
                probe(&tensors, &settings, data.axes, kernel, &data.views)?
            }
            _ => Vec::new(),
        };
        let outcome = Outcome {
            tensors: &tensors,
            network: &network,
            architecture: &work.architecture,
            direction,
            coarse: coarse.as_ref().map(|coarse| &coarse.network),
            settings: &settings,
            exported: &exported,
            occupancy: source,
            cells: work.cells.as_ref(),
            occupancy_required,
            check: check.as_ref(),
            probes: &probes,
            output: &self.output,
        };
        warn(&outcome);
        global.finish(&outcome.summary(kernel), || outcome.print())?;
        Ok(ExitCode::SUCCESS)
    }

    /// The network of `--coarse`.
    fn coarse(&self, settings: &Settings) -> anyhow::Result<Option<CoarseNetwork>> {
        let Some(file) = &self.coarse else { return Ok(None) };
        let tensors = Tensors::read_coarse(file, self.coarse_prefix.as_deref())?;
        let network = network(&tensors, settings)?;
        Ok(Some(CoarseNetwork { parameters: network.folded(), network }))
    }

    /// The views of `--check`, thinned.
    fn data(&self, guesses: &Guesses, settings: &Settings, global: &Global) -> anyhow::Result<Option<Data>> {
        let Some(path) = &self.check else { return Ok(None) };
        let options = DataOptions {
            axes: guesses.axes,
            near: Some(settings.near),
            far: Some(settings.far),
            layout: None,
            downscale: Downscale::Auto,
            outside_files: self.outside_files,
        };
        // What is imported was trained in the file's own world.
        let dataset = options.read_from(path, Some([0.0; 3]), global)?;
        let all = split(&dataset);
        let views: Vec<&View> = if self.views.is_empty() {
            spread(all, VIEWS)
        } else {
            let view = |&i: &usize| all.get(i).ok_or(i);
            match self.views.iter().map(view).collect() {
                Ok(views) => views,
                Err(i) => bail!("--view: expected 0 to {}, found {i}", all.len().saturating_sub(1)),
            }
        };
        let opaque = views.iter().all(|view| !view.has_alpha());
        if opaque && settings.background != [0.0; 3] {
            global.say("note: these pictures have no alpha: their own background stays in the truth");
        }
        let views = views.into_iter().map(thinned).collect();
        let fitted = if dataset.train.is_empty() { all } else { &dataset.train };
        let rays = spread(fitted, RAY_VIEWS).into_iter().map(thinned).collect();
        Ok(Some(Data { name: dataset.name, axes: dataset.axes, views, rays }))
    }
}

/// The network of `--coarse`, and its parameters in export order.
struct CoarseNetwork {
    network: Imported,
    parameters: Vec<f32>,
}

/// Everything that goes into the blob but what is measured on it.
struct Work<'a> {
    network: &'a Imported,
    architecture: Architecture,
    parameters: Vec<f32>,
    coarse: Option<&'a CoarseNetwork>,
    settings: &'a Settings,
    cells: Option<LiveCells>,
    file: &'a Path,
}

/// What is measured.
#[derive(Default)]
struct About<'a> {
    occupancy_required: bool,
    check: Option<&'a Check>,
    data: Option<&'a str>,
}

impl Work<'_> {
    fn export(&self, about: &About<'_>) -> anyhow::Result<Exported> {
        let finite = |db: f64| Some(db as f32).filter(|db| db.is_finite());
        let name = self.file.file_name().unwrap_or_default().to_string_lossy();
        let made_by = format!("nerf-train {}, imported from {name}", env!("CARGO_PKG_VERSION"));
        let s = self.settings;
        let drawn = s.coarse_samples.map_or_else(String::new, |coarse| format!("{coarse} + "));
        let convention = about.check.map_or_else(String::new, |check| {
            format!(
                "mean over {} views, every third pixel and row, background {}, {drawn}{} samples a ray",
                check.scores.views.len(),
                background_name(self.settings.background),
                self.settings.samples
            )
        });
        let stem = self.file.file_stem().unwrap_or_default().to_string_lossy();
        let coarse = self.coarse.zip(s.coarse_samples).map(|(coarse, samples)| Coarse {
            architecture: &coarse.network.model.architecture,
            parameters: &coarse.parameters,
            samples,
        });
        let contents = Contents {
            tables: Tables::None,
            architecture: &self.architecture,
            parameters: &self.parameters,
            content: Content::Scene(self.settings.facts(about.occupancy_required)),
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
    fn ask_direction(
        &mut self,
        kernel: Kernel,
        data: &Data,
        with_db: f64,
        threshold_db: f64,
    ) -> anyhow::Result<Option<(f64, Verdict)>> {
        let rays: Vec<&View> = data.rays.iter().collect();
        let Some((architecture, parameters)) = flattened(&self.architecture, &self.parameters, &rays) else {
            return Ok(None);
        };
        let flat = Self { architecture, parameters, cells: self.cells.clone(), ..*self };
        let (draft, quality) = (flat.export(&About::default())?.bytes, Quality::default());
        let (background, views) = (self.settings.background, &data.views);
        let scores = measure(&draft, None, kernel, &quality, background, views, |_, _, _, _| {})?;
        let gain_db = gain_db(with_db, scores.psnr_db().unwrap_or(f64::NAN));
        // It takes work and spares none.
        let verdict = Verdict::of(gain_db, 1.0, threshold_db);
        if verdict == Verdict::Drops {
            *self = flat;
        }
        Ok(Some((gain_db, verdict)))
    }

    fn check(&self, kernel: Kernel, data: &Data, global: &Global) -> anyhow::Result<Check> {
        let blob = &self.export(&About::default())?.bytes;
        let has_occupancy = self.cells.is_some();
        let total = renderings(has_occupancy) * data.views.len() as u64;
        let mut progress = Progress::new("check", Total::Steps(total), global.style());
        let mut done = 0;
        let background = self.settings.background;
        let draft = Draft { blob, parameters: &self.parameters, has_occupancy, background };
        let check = check(&draft, kernel, &data.views, || {
            done += 1;
            progress.update(done, &Message::default());
        })?;
        progress.finish(format!("{} views", data.views.len()));
        Ok(check)
    }
}

/// Says on stderr, also when quiet, what must not be overlooked.
fn warn(outcome: &Outcome<'_>) {
    let Some(check) = outcome.check else {
        if outcome.occupancy == OccupancySource::Built && outcome.cells.is_none() {
            tell("warning: the network's density is nowhere above the threshold: nothing would be seen");
        }
        return;
    };
    if check.is_suspicious() {
        tell(&format!(
            "warning: {:.2} dB is no picture of the scene (expected at least {SUSPICIOUS_DB} dB). What the file \
             cannot say was guessed wrong: --angle-scale, --order, --identity, --axes, --background, --near, \
             --far, --box, --density, or the data set is another scene's",
            check.psnr_db()
        ));
        if let Some(Probe { flag, psnr_db }) = outcome.probes.first()
            && *psnr_db > check.psnr_db() + 1.0
        {
            tell(&format!("try {flag}: {psnr_db:.1} dB on a few pixels"));
        }
    }
    if outcome.occupancy == OccupancySource::Built && check.occupancy_harms() {
        tell(&format!(
            "warning: the occupancy grid costs {:.2} dB: raise --occupancy-resolution, lower --occupancy-threshold, or take \
             --no-occupancy",
            -check.occupancy_gain_db.unwrap_or(0.0)
        ));
    }
}
