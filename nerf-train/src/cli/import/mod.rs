//! `nerf-train import`

mod options;

use super::audit::check_threshold;
use super::common::{Global, print_lines, tell};
use super::options::data::DataOptions;
use super::places;
use crate::data::{Cameras, Downscale, View};
use crate::fit::run::spread;
use crate::measure::audit::THRESHOLD_DB;
use crate::measure::import::probe::Probe;
use crate::measure::import::work::{Occupancy, OccupancySource, Outcome, Request, Stage, Views, Work};
use crate::measure::import::{RAY_VIEWS, SUSPICIOUS_DB, VIEWS, occupancy, split, thinned};
use crate::model::import::{Settings, Tensors};
use crate::system::output::claims::Claims;
use crate::system::output::write_atomic;
use crate::system::progress::{Message, Progress, Total};
use anyhow::bail;
use clap::Args;
use options::Guesses;
use std::path::PathBuf;
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

impl Import {
    /// Runs the command.
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let guesses = match &self.config {
            Some(file) => self.guesses.clone().or(Guesses::read(file)?),
            None => self.guesses.clone(),
        };
        let settings = self.settings(&guesses)?;
        let tensors = Tensors::read(&self.checkpoint, self.prefix.as_deref())?;
        let coarse = match &self.coarse {
            Some(file) => Some(Tensors::read_coarse(file, self.coarse_prefix.as_deref())?),
            None => None,
        };
        let request = Request {
            tensors: &tensors,
            coarse: coarse.as_ref(),
            settings: &settings,
            kernel: global.kernel(),
            effect_threshold_db: self.effect_threshold,
        };
        let work = Work::new(&request)?;
        let cells = self.occupancy.as_deref().map(|file| occupancy::read(file, &settings)).transpose()?;
        let views = self.views(&guesses, &settings, global)?;
        let occupancy = match cells {
            Some(cells) => Occupancy::Given { cells, optional: self.occupancy_optional },
            None if self.no_occupancy => Occupancy::None,
            None => Occupancy::Ask,
        };
        let mut shown = Shown::new(global);
        let mut outcome = work.finish(occupancy, views.as_ref(), &mut |stage| shown.show(stage))?;
        write_atomic(&self.output, &outcome.exported.bytes)?;
        if let Some(views) = &views {
            outcome.try_guesses(views, &mut |stage| shown.show(stage))?;
        }
        warn(&outcome);
        let summary = outcome.summary(&self.output);
        global.finish(&summary, || print_lines(outcome.lines(&self.output)))?;
        Ok(ExitCode::SUCCESS)
    }

    /// The settings of flags and file; refuses what cannot be, before any network is read.
    fn settings(&self, guesses: &Guesses) -> anyhow::Result<Settings> {
        if guesses.coarse_samples.is_some() && self.coarse.is_none() {
            bail!("coarse_samples: expected only with --coarse");
        }
        let settings = guesses.settings(self.coarse.is_some());
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
        Ok(settings)
    }

    /// The views of `--check`, thinned.
    fn views(
        &self,
        guesses: &Guesses,
        settings: &Settings,
        global: &Global,
    ) -> anyhow::Result<Option<Views>> {
        let Some(path) = &self.check else { return Ok(None) };
        let options = DataOptions {
            axes: guesses.axes,
            near: Some(settings.near),
            far: Some(settings.far),
            layout: None,
            downscale: Downscale::Auto,
            cameras: Some(Cameras::Own),
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
        Ok(Some(Views { name: dataset.name, axes: dataset.axes, views, rays }))
    }
}

/// Says on stderr, also when quiet, what must not be overlooked.
fn warn(outcome: &Outcome<'_>) {
    let Some(check) = &outcome.check else {
        if outcome.source == OccupancySource::Built && outcome.cells.is_none() {
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
        if let Some(Probe { flag, psnr_db }) = outcome.guesses.first()
            && *psnr_db > check.psnr_db() + 1.0
        {
            tell(&format!("try {flag}: {psnr_db:.1} dB on a few pixels"));
        }
    }
    if outcome.source == OccupancySource::Built && check.occupancy_harms() {
        tell(&format!(
            "warning: the occupancy grid costs {:.2} dB: raise --occupancy-resolution, lower --occupancy-threshold, or take \
             --no-occupancy",
            -check.occupancy_gain_db.unwrap_or(0.0)
        ));
    }
}

/// How an import is getting on.
struct Shown<'g> {
    global: &'g Global,
    progress: Option<Progress>,
}

impl<'g> Shown<'g> {
    fn new(global: &'g Global) -> Self {
        Self { global, progress: None }
    }

    fn show(&mut self, stage: Stage) {
        match stage {
            Stage::Occupancy => {
                self.global.say("asking the network which cells of the scene box hold something");
            }
            Stage::Guesses => self.global.say("that is no picture of the scene; trying other guesses"),
            Stage::Check { done, total, views } => {
                let new = || Progress::new("check", Total::Steps(total), self.global.style());
                self.progress.get_or_insert_with(new).update(done, &Message::default());
                if done == total
                    && let Some(progress) = self.progress.take()
                {
                    progress.finish(format!("{views} views"));
                }
            }
        }
    }
}
