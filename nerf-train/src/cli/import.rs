use super::audit::check_threshold;
use super::common::{Global, tell};
use super::options::data::read_with;
use super::places;
use crate::data::{Axes, Cameras, ReadOptions, View, Watch, reads_data};
use crate::fit::run::spread;
use crate::measure::audit::THRESHOLD_DB;
use crate::measure::import::{
    self, Occupancy, Request, STRIDE, SUSPICIOUS_DB, Settings, Summary, Tensors, Views, occupancy,
};
use crate::system::output::claims::Claims;
use crate::system::output::write_atomic;
use anyhow::bail;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;

/// Number of views to evaluate without `--view`.
const VIEWS: usize = 10;
/// Maximum number of views over whose rays the encoded direction is averaged, to remove the view dependence.
const RAY_VIEWS: usize = 50;

/// Convert a nerf-pytorch checkpoint to a scene file.
///
/// CKPT is a .npz or .safetensors file with the tensors pts_linears.0.weight, …. If it holds a coarse and a fine
/// network, the fine one is read.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    nerf-train import lego_200k_fine.npz -o lego.nerf --background white --check lego_200\n  \
    nerf-train import lego_200k_fine.npz -o lego.nerf --coarse lego_200k_coarse.npz --background white\n  \
    nerf-train import lego.safetensors -o lego.nerf --angle-scale pi --samples 64 --occupancy grid96.npy")]
pub struct Import {
    /// Checkpoint: its tensors as .npz or .safetensors.
    #[arg(value_name = "CKPT")]
    checkpoint: PathBuf,
    /// Output scene file (.nerf).
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// Prefix of the tensors' names, such as 'network_fine.' [default: detected].
    #[arg(long, value_name = "PREFIX")]
    prefix: Option<String>,
    /// Checkpoint of the coarse network, for importance sampling; the same file as CKPT if that holds both networks.
    #[arg(long, value_name = "CKPT")]
    coarse: Option<PathBuf>,
    /// Prefix of the coarse network's tensors [default: detected].
    #[arg(long, value_name = "PREFIX", requires = "coarse")]
    coarse_prefix: Option<String>,
    /// Data set on which to measure PSNR, the PSNR lost by f16 weights, and whether rendering needs the occupancy grid.
    #[arg(long, value_name = "DATA")]
    check: Option<PathBuf>,
    /// Validation views of --check to evaluate, by index from 0 [default: up to ten views].
    #[arg(long = "view", value_name = "I,J,…", value_delimiter = ',', requires = "check")]
    views: Vec<usize>,
    /// Allow transforms files to name images outside the folder of --check.
    #[arg(long, requires = "check")]
    outside_files: bool,
    /// Remove view dependence if it raises the PSNR of the views of --check by less than this, dB.
    #[arg(long, value_name = "DB", default_value_t = THRESHOLD_DB, allow_hyphen_values = true, requires = "check")]
    effect_threshold: f64,
    /// Occupancy grid with which the network was trained: .npy, booleans [x, y, z] over the scene box.
    #[arg(long, value_name = "FILE", conflicts_with = "no_occupancy")]
    occupancy: Option<PathBuf>,
    /// Allow renderers to ignore the grid of --occupancy. Default: they must treat its false cells as empty.
    #[arg(long, requires = "occupancy")]
    occupancy_optional: bool,
    /// Build no occupancy grid; rendering then skips no empty space.
    #[arg(long)]
    no_occupancy: bool,
    /// Camera axes in --check: opengl (looks along −Z) or opencv (looks along +Z) [default: by the data set's layout].
    #[arg(long, value_name = "CONVENTION")]
    axes: Option<Axes>,
    #[command(flatten)]
    settings: Settings,
}

impl Import {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        self.check()?;
        let tensors = Tensors::read(&self.checkpoint, self.prefix.as_deref())?;
        let coarse = self.coarse.as_ref();
        let coarse =
            coarse.map(|file| Tensors::read_coarse(file, self.coarse_prefix.as_deref())).transpose()?;
        let request = Request {
            tensors: &tensors,
            coarse: coarse.as_ref(),
            settings: &self.settings,
            kernel: global.kernel(),
            style: global.style(),
            effect_threshold_db: self.effect_threshold,
        };
        let mut import = import::Import::new(&request)?;
        let occupancy = match &self.occupancy {
            Some(file) => Occupancy::Given {
                cells: occupancy::read(file, &self.settings)?,
                optional: self.occupancy_optional,
            },
            None if self.no_occupancy => Occupancy::None,
            None => Occupancy::Build,
        };
        let views = self.views(global)?;
        let exported = import.finish(occupancy, views.as_ref())?;
        write_atomic(&self.output, &exported.bytes)?;
        self.warn(&import);
        let summary = Summary::of(&import, &exported, &self.output);
        global.finish(&summary)
    }

    fn check(&self) -> anyhow::Result<()> {
        self.settings.check()?;
        check_threshold(self.effect_threshold)?;
        places::check_extension("-o", &self.output, places::BLOB)?;
        Ok(reads_data(Claims::default(), self.check.as_deref())
            .reads("the network", &self.checkpoint)
            .reads("the coarse network", self.coarse.as_deref())
            .reads("the occupancy grid", self.occupancy.as_deref())
            .writes("-o", &self.output)
            .settle()?)
    }

    fn views(&self, global: &Global) -> anyhow::Result<Option<Views>> {
        let Some(path) = &self.check else { return Ok(None) };
        let options = ReadOptions {
            axes: self.axes,
            near: Some(self.settings.near),
            far: Some(self.settings.far),
            cameras: Cameras::Own,
            outside_files: self.outside_files,
            // The origin is not moved: the network was trained in the coordinates of the data set's files.
            origin: Some([0.0; 3]),
            ..ReadOptions::default()
        };
        let dataset = read_with(path, &options, &Watch::default(), global)?;
        let all = if dataset.val.is_empty() { &dataset.train } else { &dataset.val };
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
        if opaque && self.settings.background != [0.0; 3] {
            global.say("note: these pictures have no alpha: their own background stays in the truth");
        }
        let thinned = |view: &View| view.thinned(STRIDE).into_owned();
        let views = views.into_iter().map(thinned).collect();
        let fitted = if dataset.train.is_empty() { all } else { &dataset.train };
        let rays = spread(fitted, RAY_VIEWS).into_iter().map(thinned).collect();
        Ok(Some(Views { name: dataset.name, views, rays }))
    }

    /// Warns on stderr of an empty scene, a low PSNR or a harmful occupancy grid, even with `--quiet`.
    fn warn(&self, import: &import::Import<'_>) {
        let is_built = self.occupancy.is_none() && !self.no_occupancy;
        if is_built && import.cells.is_none() {
            tell("warning: the network's density is nowhere above the threshold: the scene is empty");
        }
        let Some(check) = &import.check else { return };
        if check.is_suspicious() {
            tell(&format!(
                "warning: {:.2} dB is no picture of the scene (expected at least {SUSPICIOUS_DB} dB). What the file \
                 cannot say was guessed wrong: --angle-scale, --order, --identity, --axes, --background, --near, \
                 --far, --box, --density, or the data set is another scene's",
                check.psnr_db()
            ));
        }
        if is_built && check.occupancy_harms() {
            tell(&format!(
                "warning: the occupancy grid costs {:.2} dB: raise --occupancy-resolution, lower \
                 --occupancy-threshold, or take --no-occupancy",
                -check.occupancy_gain_db.unwrap_or(0.0)
            ));
        }
    }
}
