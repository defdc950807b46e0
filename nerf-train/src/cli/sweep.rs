//! `nerf-train sweep`

use super::common::{GO_ON, Global, check_max_seconds, cpu_name};
use super::image::{PhotoOptions, Settings};
use super::options::data::{DataOptions, Space, print_report};
use super::options::grid::of_sinusoidal;
use super::options::settings::read_config;
use super::options::shard::ShardOption;
use super::places;
use crate::lab::sweep::{Combinations, Folder, Job, Mode, Point, Runner};
use crate::model::config::Preset;
use crate::model::picture_config::FieldPreset;
use crate::show::reports::sweep::{Summary, table, write_report};
use crate::system::output::claims::Claims;
use crate::system::stop::Note;
use anyhow::bail;
use clap::{Args, Subcommand};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Fit many times with other settings, and compare.
#[derive(Debug, Subcommand)]
#[command(after_help = "Examples:
  nerf-train sweep image fox.jpg -o out/sweep --levels 6,8,10,12,14 --layers 2,4,6,8,10 --scale 0.25 --steps 1000 --pixels 2500
  nerf-train sweep scene lego_200x200.npz -o out/tables --table 12,14,16 --features 2,4 --max-seconds 20
  nerf-train sweep scene lego_200x200.npz -o out/sweep --width 64,128 --layers 2,4 --max-seconds 30
  nerf-train sweep merge -o out/all out/machine1 out/machine2")]
pub enum Sweep {
    /// Fit 2D fields to one picture.
    Image(Box<ImageSweep>),
    /// Fit radiance fields to one data set.
    Scene(Box<SceneSweep>),
    /// Put the finished runs of several folders together.
    Merge(Merge),
}

impl Sweep {
    /// Runs the command.
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        match self {
            Self::Image(sweep) => sweep.run(global),
            Self::Scene(sweep) => sweep.run(global),
            Self::Merge(merge) => merge.run(global),
        }
    }
}

/// What is varied, and where it is kept.
#[derive(Debug, Args)]
struct Lists {
    /// Folder of the sweep: one file a finished run, table, plots, contact sheet. Runs that are finished in it
    /// are not repeated; lists may be extended later.
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    /// Levels L of the sinusoidal encoding. Of each of these: a list to compare, or one value to keep to.
    #[arg(long, value_name = "L,L,…", value_delimiter = ',', num_args = 1)]
    levels: Vec<u8>,
    /// Hidden layers.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    layers: Vec<u16>,
    /// Channels of every hidden layer.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    width: Vec<u16>,
    /// Of a learned grid: binary logarithm of the most entries a level has.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    table: Vec<u8>,
    /// Levels of the grid.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    grid_levels: Vec<u8>,
    /// Features of an entry: 1, 2 or 4.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    features: Vec<u8>,
    /// Cells of the finest level along the longest side [default: the preset's; a picture's pixels].
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    finest: Vec<u16>,
    /// Learning rates at the start.
    #[arg(long, value_name = "RATE,…", value_delimiter = ',', num_args = 1)]
    rate: Vec<f64>,
    /// Vary one list at a time around the preset, instead of every combination.
    #[arg(long)]
    one_at_a_time: bool,
    #[command(flatten)]
    shard: ShardOption,
}

impl Lists {
    /// Refuses a folder that holds what is read.
    fn claim(&self, inputs: Claims) -> anyhow::Result<()> {
        places::check_folder("-o", &self.output)?;
        Ok(inputs.writes_folder("-o", &self.output).check()?)
    }

    /// Whether settings of a sinusoidal network are listed.
    fn of_sinusoidal(&self) -> bool {
        !(self.levels.is_empty() && self.layers.is_empty() && self.width.is_empty())
    }

    fn combinations(&self, job: &Job<'_>) -> Combinations {
        fn numbers<T: Copy + Into<f64>>(list: &[T]) -> Vec<f64> {
            list.iter().map(|&value| value.into()).collect()
        }
        let lists = [
            numbers(&self.levels),
            numbers(&self.layers),
            numbers(&self.width),
            numbers(&self.table),
            numbers(&self.grid_levels),
            numbers(&self.features),
            numbers(&self.finest),
            self.rate.clone(),
        ];
        let mode = if self.one_at_a_time { Mode::OneAtATime } else { Mode::Full };
        Combinations { base: job.base_point(), lists, mode }
    }

    /// Runs what is not finished, and reports on what is.
    fn sweep(&self, job: &Job<'_>, global: &Global) -> anyhow::Result<ExitCode> {
        let combinations = self.combinations(job);
        let points = combinations.points()?;
        points.iter().try_for_each(|point| job.check(point))?;
        let shard = self.shard.choose(global)?;
        let folder = Folder::open(&self.output, job.header(combinations.mode))?;
        let mine = shard.of(&points, Point::name);
        let cpu = cpu_name();
        let runner = Runner { kernel: global.kernel(), style: global.style(), cpu: &cpu };
        global.say(format!(
            "{} points, {} of them this part's; on {cpu} ({}, {} threads)",
            points.len(),
            mine.len(),
            runner.kernel,
            rayon::current_num_threads()
        ));
        let note = Note::new(GO_ON);
        let finished = folder.clone();
        note.before("the report", move || {
            write_report(&finished).map(drop).map_err(|error| error.to_string())
        });
        let say = |text| global.say(text);
        folder.conduct(&mine, say, |point| job.run(point, &runner).map_err(anyhow::Error::from))?;
        drop(note);
        finish(&folder, global)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Writes the report of all that is finished in a folder, and prints its table.
fn finish(folder: &Folder, global: &Global) -> anyhow::Result<()> {
    let records = write_report(folder)?;
    let report = folder.path().join("report.md");
    let summary = Summary::of(&records, &report);
    global.finish(&summary, || {
        outlines!(table(&records).to_text().trim_end());
        outln!("report: {}", report.display());
        Ok(())
    })
}

/// Fit 2D fields to one picture.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: nerf-train sweep image fox.jpg -o out/sweep --levels 6,8,10 --layers 2,4 --scale 0.25"
)]
pub struct ImageSweep {
    /// The picture.
    photo: PathBuf,
    #[command(flatten)]
    lists: Lists,
    /// Named settings to start from [default: grid; classic where --levels, --layers or --width is listed].
    #[arg(long, value_enum)]
    preset: Option<FieldPreset>,
    #[command(flatten)]
    photo_options: PhotoOptions,
    #[command(flatten)]
    settings: Settings,
}

impl ImageSweep {
    fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        self.lists.claim(Claims::new().reads("the picture", &self.photo))?;
        let start = if self.lists.of_sinusoidal() { FieldPreset::Classic } else { FieldPreset::Grid };
        let preset = self.preset.unwrap_or(start);
        let photo = self.photo_options.read(&self.photo, global)?;
        let base = self.settings.over(preset.config().for_picture(photo.size()));
        if base.grid.is_some() && self.settings.epsilon.is_some() {
            return Err(of_sinusoidal("--epsilon", &preset, "classic"));
        }
        self.lists.sweep(&Job::Image { photo: &photo, base }, global)
    }
}

/// Fit radiance fields to one data set.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: nerf-train sweep scene lego_200x200.npz -o out/sweep --levels 6,10 --width 64,128 --max-seconds 30"
)]
pub struct SceneSweep {
    /// The data set.
    data: PathBuf,
    #[command(flatten)]
    lists: Lists,
    /// Named settings to start from [default: grid; small where --levels, --layers or --width is listed].
    #[arg(long, value_enum)]
    preset: Option<Preset>,
    /// TOML file with settings that replace the preset's.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Steps of a run [default: the preset's].
    #[arg(long, value_name = "N", conflicts_with = "max_seconds")]
    steps: Option<u32>,
    /// Seconds a run may take, instead of a number of steps.
    #[arg(long, value_name = "S")]
    max_seconds: Option<f64>,
    /// Seed of everything random.
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Where the scene ends.
    #[arg(long, value_enum, default_value_t)]
    space: Space,
    #[command(flatten)]
    data_options: DataOptions,
}

impl SceneSweep {
    fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        check_max_seconds(self.max_seconds)?;
        let claims = Claims::new().reads_data(&self.data);
        self.lists.claim(claims.reads_if("the file of settings", self.config.as_deref()))?;
        let dataset = self.data_options.read(&self.data, global)?;
        print_report(&dataset, global);
        if dataset.val.is_empty() {
            bail!(
                "{}: expected validation views, which a sweep compares by; found none",
                self.data.display()
            );
        }
        let around = self.space.around(dataset.background, false);
        let start = if self.lists.of_sinusoidal() { Preset::Small } else { Preset::Grid };
        let mut base = read_config(self.preset.unwrap_or(start), self.config.as_deref(), around)?;
        base.sampling.near = self.data_options.near.or(base.sampling.near);
        base.sampling.far = self.data_options.far.or(base.sampling.far);
        base.optimiser.steps = self.steps.unwrap_or(base.optimiser.steps);
        base.seed = self.seed.unwrap_or(base.seed);
        self.space.settle(&mut base);
        base.check()?;
        self.space.say(&base, dataset.background, global);
        let job = Job::Scene { dataset: &dataset, base: Box::new(base), seconds: self.max_seconds };
        self.lists.sweep(&job, global)
    }
}

/// Put the finished runs of several folders together.
#[derive(Debug, Args)]
#[command(after_help = "Example: nerf-train sweep merge -o out/all out/machine1 out/machine2")]
pub struct Merge {
    /// Folders of one sweep's parts.
    #[arg(required = true, value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Folder to put them into; may hold finished runs of the same sweep.
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
}

impl Merge {
    fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        places::check_folder("-o", &self.output)?;
        let claims = self.folders.iter().fold(Claims::new(), |claims, part| claims.reads("the sweep", part));
        claims.writes_folder("-o", &self.output).check()?;
        let open = |path: &PathBuf| Folder::existing(Path::new(path));
        let parts = self.folders.iter().map(open).collect::<Result<Vec<_>, _>>()?;
        let Some(first) = parts.first() else { bail!("expected at least one folder") };
        // All are checked against each other before anything is written.
        parts.iter().try_for_each(|part| first.check_same(part.header()))?;
        let whole = Folder::open(&self.output, first.header().clone())?;
        for part in &parts {
            let new = whole.take_in(part)?;
            global.say(format!("{}: {new} new runs", part.path().display()));
        }
        finish(&whole, global)?;
        Ok(ExitCode::SUCCESS)
    }
}
