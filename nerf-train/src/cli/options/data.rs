//! Options for reading data sets and for the extent of their scenes.

use crate::cli::common::Global;
use crate::data::refined::{self, RefinedPoses};
use crate::data::{
    self, Axes, Background, Cameras, Dataset, Downscale, Layout, ReadOptions, Report, Watch, cameras_in_name,
    origin_in_name, reads_data,
};
use crate::model::config::{Config, Surroundings};
use crate::system::input::{MAX_TOML_BYTES, read_text};
use crate::system::output::claims::Claims;
use crate::system::progress::{self, Progress, ProgressStyle, Total};
use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use nerf_core::blob::Blob;
use nerf_core::plan::{Plan, PlanError};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::Duration;

/// Options for reading a data set.
#[derive(Debug, Args)]
#[command(next_help_heading = "Data set")]
pub struct DataOptions {
    /// Camera axes: opengl (looks along −Z) or opencv (looks along +Z) [default: by the layout].
    #[arg(long, value_name = "CONVENTION")]
    pub axes: Option<Axes>,
    /// Distance along a ray at which sampling starts, world units [default: in training, estimated from the data;
    /// for a trained scene, no limit].
    #[arg(long, value_name = "T")]
    pub near: Option<f32>,
    /// Distance along a ray at which sampling ends, world units; in training of an unbounded scene, sampling ends at this
    /// distance from the scene's centre [default: as for --near].
    #[arg(long, value_name = "T")]
    pub far: Option<f32>,
    /// Layout of a folder: transforms (Blender, nerfstudio, instant-ngp), colmap or llff [default: the first that
    /// fits].
    #[arg(long, value_name = "LAYOUT")]
    pub layout: Option<Layout>,
    /// Whole factor by which photographs are downscaled, or auto (long side of about 800 pixels) [default: auto; 1 for
    /// Blender].
    #[arg(long, value_name = "N", default_value = "auto", hide_default_value = true)]
    pub downscale: Downscale,
    /// Intrinsics of a COLMAP reconstruction: shared (one set per physical camera; if COLMAP has a set per photograph,
    /// bundle adjustment is run again with shared ones) or own (COLMAP's unchanged, for a zoom lens) [default: shared;
    /// for a trained scene, as trained].
    #[arg(long, value_name = "WHICH")]
    pub cameras: Option<Cameras>,
    /// Allow transforms files to name images outside the data set's folder.
    #[arg(long)]
    pub outside_files: bool,
    /// File with the names of the photographs to leave out, one per line, as `check --cross-validate` writes.
    #[arg(long, value_name = "FILE")]
    pub leave_out: Option<PathBuf>,
}

/// Extent of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Space {
    /// A box if the background of the photographs is transparent or of one colour, or if a box is given; else
    /// unbounded. Without a hash grid, or without empty-space skipping, always a box.
    #[default]
    Auto,
    /// The scene ends at a box.
    Box,
    /// Unbounded: space is contracted outside a ball around the point that the cameras look at.
    Contracted,
}

impl Space {
    /// Returns the assumptions of training about the scene's background and extent. `boxed`: whether a box is given.
    pub fn around(self, background: Background, boxed: bool) -> Surroundings {
        match (self, background) {
            (Self::Contracted, _) => Surroundings::Unbounded,
            (Self::Auto, Background::Unknown) if !boxed => Surroundings::Unbounded,
            (_, Background::Unknown) => Surroundings::Unknown,
            _ => Surroundings::Known,
        }
    }

    /// Applies `self` to `config`: `Contracted` adds a missing contraction, `Box` removes one, `Auto` changes nothing.
    pub fn settle(self, config: &mut Config) {
        match self {
            Self::Auto => {}
            Self::Box => config.sampling.contraction = None,
            Self::Contracted => {
                config.sampling.contraction.get_or_insert(1);
            }
        }
    }

    pub fn say(self, config: &Config, background: Background, global: &Global) {
        let reason = match (self, background) {
            (Self::Auto, _) if config.sampling.scene_box.is_some() => "which is given",
            (Self::Auto, Background::Unknown) if config.sampling.contraction.is_some() => {
                "since the pictures do not say what is background (--space box ends it at a box)"
            }
            (Self::Auto, Background::Unknown) => {
                "since a contraction needs a learned grid and skips empty space"
            }
            (Self::Auto, _) if config.sampling.contraction.is_some() => "as the settings say",
            (Self::Auto, _) => "since the pictures say what is background",
            _ => "as --space says",
        };
        global.say(match config.sampling.contraction {
            Some(_) => format!("unbounded space, contracted around what the cameras look at, {reason}"),
            None => format!("space ends at a box, {reason}"),
        });
    }
}

impl DataOptions {
    /// Returns the plan with rays limited to the distances from `--near` to `--far`.
    pub fn range_of<'a>(&self, plan: Plan<'a>) -> Result<Plan<'a>, PlanError> {
        plan.with_range(self.near.unwrap_or(0.0), self.far.unwrap_or(f32::MAX))
    }

    /// Returns [`Claims`] that protect the data set `path`, if given, and the file of `--leave-out` from overwriting.
    pub fn claims<'p>(&self, path: impl Into<Option<&'p Path>>) -> Claims {
        reads_data(Claims::default(), path).reads("the file of --leave-out", self.leave_out.as_deref())
    }

    pub fn read(&self, path: &Path, global: &Global) -> Result<Dataset> {
        self.read_by(path, &self.options(), &Watch::default(), global)
    }

    /// Reads a data set without the photographs that `--leave-out` names.
    fn read_by(&self, path: &Path, options: &ReadOptions, watch: &Watch, global: &Global) -> Result<Dataset> {
        let mut dataset = read_with(path, options, watch, global)?;
        let Some(file) = &self.leave_out else { return Ok(dataset) };
        let context = || format!("--leave-out {}", file.display());
        let names = read_text(file, MAX_TOML_BYTES).with_context(context)?;
        let names: BTreeSet<&str> = names.lines().map(str::trim).filter(|name| !name.is_empty()).collect();
        dataset.leave_out(&names).with_context(context)?;
        global.say(format!("{} photographs left out, named in {}", names.len(), file.display()));
        Ok(dataset)
    }

    /// Reads a data set for training. If shared intrinsics have to be computed, writes them to a file next to the scene
    /// file `output`. Also returns the time of this computation, which does not count as training time.
    pub fn read_to_fit(&self, path: &Path, output: &Path, global: &Global) -> Result<(Dataset, Duration)> {
        let watch = Watch::default();
        let options = ReadOptions { shared_cameras: Some(cameras_beside(output)), ..self.options() };
        let dataset = self.read_by(path, &options, &watch, global)?;
        Ok((dataset, watch.set_aside()))
    }

    /// Reads a data set as [`Self::read_given_for`] does. Uses the refined poses next to the scene file `file`, if any.
    pub fn read_for(
        &self,
        path: &Path,
        (blob, file): (&Blob<'_>, &Path),
        global: &Global,
    ) -> Result<Dataset> {
        let mut dataset = self.read_given_for(path, (blob, file), global)?;
        let Some(refined) = RefinedPoses::beside(file)? else { return Ok(dataset) };
        let mut count = 0;
        for views in [&mut dataset.train, &mut dataset.val, &mut dataset.test] {
            let cameras = refined.cameras(file, &*views, dataset.origin)?;
            for (view, camera) in views.iter_mut().zip(cameras) {
                count += usize::from(camera.is_some());
                view.camera = camera.unwrap_or(view.camera);
            }
        }
        global.say(format!("{count} views with the refined poses of {}", refined::beside(file).display()));
        Ok(dataset)
    }

    /// Reads a data set with the origin of coordinates and the intrinsics with which the scene `blob` was trained;
    /// `--cameras` selects other intrinsics. `file`: path of the scene file. The data set may lack training views.
    pub fn read_given_for(
        &self,
        path: &Path,
        (blob, file): (&Blob<'_>, &Path),
        global: &Global,
    ) -> Result<Dataset> {
        let name = blob.provenance().data;
        let options = ReadOptions {
            to_measure: true,
            cameras: self.cameras.unwrap_or_else(|| cameras_in_name(name)),
            shared_cameras: Some(cameras_beside(file)),
            origin: Some(origin_in_name(name)),
            ..self.options()
        };
        self.read_by(path, &options, &Watch::default(), global)
    }

    fn options(&self) -> ReadOptions {
        ReadOptions {
            axes: self.axes,
            near: self.near,
            far: self.far,
            outside_files: self.outside_files,
            layout: self.layout,
            downscale: self.downscale,
            cameras: self.cameras.unwrap_or_default(),
            ..ReadOptions::default()
        }
    }
}

/// Reads a data set, with a progress bar if reading takes more than a second.
pub fn read_with(path: &Path, options: &ReadOptions, watch: &Watch, global: &Global) -> Result<Dataset> {
    let style = global.style();
    std::thread::scope(|scope| {
        let (reading, ended) = mpsc::channel::<()>();
        scope.spawn(|| show_reading(watch, style, ended));
        let dataset = data::read_watched(path, options, watch);
        drop(reading);
        Ok(dataset?)
    })
}

/// Returns the path of the file of shared intrinsics that belongs to the scene file `file`.
fn cameras_beside(file: &Path) -> PathBuf {
    file.with_extension("cameras.json")
}

/// Shows a progress bar of the images read, from one second after the start until the sender of `ended` is dropped.
fn show_reading(watch: &Watch, style: ProgressStyle, ended: Receiver<()>) {
    const SOON: Duration = Duration::from_secs(1);
    const EVERY: Duration = Duration::from_millis(200);
    let goes_on = |wait| ended.recv_timeout(wait) == Err(RecvTimeoutError::Timeout);
    if !goes_on(SOON) {
        return;
    }
    let total = match watch.total() {
        0 => Total::Unknown,
        total => Total::Steps(total),
    };
    let mut progress = Progress::new("read", total, style).resume_at(watch.done());
    while goes_on(EVERY) {
        progress.reach(watch.done() as usize);
    }
    progress.finish(format!("{} pictures", watch.done()));
}

pub fn print_report(dataset: &Dataset, global: &Global) -> Report {
    let report = Report::of(dataset);
    progress::say_lines(global.style(), &report.to_string());
    report
}
