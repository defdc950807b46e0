use super::common::{GO_ON, Global, check_max_seconds, cpu_name};
use super::image::{PhotoOptions, Settings};
use super::options::ShardOption;
use super::options::data::{DataOptions, Space, print_report};
use super::options::settings::{SetOption, read_config};
use super::places;
use crate::lab::sweep::{Combinations, Folder, Job, Knob, Mode, Point, Runner};
use crate::model::config::Preset;
use crate::model::picture_config::FieldPreset;
use crate::show::reports::sweep::{Summary, write_report};
use crate::system::output::claims::Claims;
use crate::system::stop::Note;
use anyhow::bail;
use clap::{Args, Subcommand};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Train with every combination of the listed settings, and compare the results.
#[derive(Debug, Subcommand)]
#[command(after_help = "Examples:
  nerf-train sweep image fox.jpg -o out/sweep --levels 6,8,10,12,14 --layers 2,4,6,8,10 --scale 0.25 --steps 1000 --pixels 2500
  nerf-train sweep scene lego_200x200.npz -o out/tables --table 12,14,16 --features 2,4 --max-seconds 20
  nerf-train sweep scene lego_200x200.npz -o out/sweep --width 64,128 --layers 2,4 --max-seconds 30
  nerf-train sweep scene lego_200x200.npz -o out/times --table 12,14,16 --max-seconds 10,20,60
  nerf-train sweep merge -o out/all out/machine1 out/machine2")]
pub enum Sweep {
    /// Train a 2D field for each combination of settings, and compare them.
    Image(Box<ImageSweep>),
    /// Train a radiance field for each combination of settings, and compare them.
    Scene(Box<SceneSweep>),
    /// Merge the finished runs of several folders.
    Merge(Merge),
}

impl Sweep {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        match self {
            Self::Image(sweep) => sweep.run(global),
            Self::Scene(sweep) => sweep.run(global),
            Self::Merge(merge) => merge.run(global),
        }
    }
}

/// Lists of settings to vary, and the folder of the results.
#[derive(Debug, Args)]
struct Lists {
    /// Folder of the sweep; finished runs in it are not repeated.
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    /// Numbers of frequencies of the position encoding, a list to compare (networks without a grid).
    #[arg(long, value_name = "L,L,…", value_delimiter = ',', num_args = 1)]
    levels: Vec<u8>,
    /// Numbers of hidden layers, a list to compare.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    layers: Vec<u16>,
    /// Widths of the hidden layers, a list to compare.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    width: Vec<u16>,
    /// Exponents N of hash table sizes: at most 2^N entries per level; a list to compare (networks with a grid).
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    table: Vec<u8>,
    /// Numbers of resolution levels of the hash grid, a list to compare (networks with a grid).
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    grid_levels: Vec<u8>,
    /// Features per level: 1, 2 or 4; a list to compare (networks with a grid).
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    features: Vec<u8>,
    /// Cells along the longest side of the scene box or image, at the finest level, a list to compare (networks with a
    /// grid) [default: the preset's; for images, the image size].
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    finest: Vec<u16>,
    /// Initial learning rates, a list to compare.
    #[arg(long, value_name = "RATE,…", value_delimiter = ',', num_args = 1)]
    rate: Vec<f64>,
    /// Vary one setting at a time instead of training every combination.
    #[arg(long)]
    one_at_a_time: bool,
    #[command(flatten)]
    shard: ShardOption,
}

impl Lists {
    /// Refuses an output folder that contains an input.
    fn claim(&self, inputs: Claims) -> anyhow::Result<()> {
        places::check_folder("-o", &self.output)?;
        Ok(inputs.writes_folder("-o", &self.output).check()?)
    }

    /// Whether `--levels`, `--layers` or `--width` is given; the default preset then has a sinusoidal encoding.
    fn of_sinusoidal(&self) -> bool {
        !(self.levels.is_empty() && self.layers.is_empty() && self.width.is_empty())
    }

    fn combinations(&self, job: &Job<'_>, more: [(Knob, Vec<f64>); 3]) -> Combinations {
        let own = [
            (Knob::Levels, numbers(&self.levels)),
            (Knob::Layers, numbers(&self.layers)),
            (Knob::Width, numbers(&self.width)),
            (Knob::Table, numbers(&self.table)),
            (Knob::GridLevels, numbers(&self.grid_levels)),
            (Knob::Features, numbers(&self.features)),
            (Knob::Finest, numbers(&self.finest)),
            (Knob::Rate, self.rate.clone()),
        ];
        let mode = if self.one_at_a_time { Mode::OneAtATime } else { Mode::Full };
        Combinations { base: job.base_point(), lists: own.into_iter().chain(more).collect(), mode }
    }

    /// Trains the combinations of this process that have no result yet, then reports all results. `more`: further
    /// settings to vary, with their values.
    fn sweep(&self, job: &Job<'_>, more: [(Knob, Vec<f64>); 3], global: &Global) -> anyhow::Result<ExitCode> {
        let combinations = self.combinations(job, more);
        let points = combinations.points()?;
        points.iter().try_for_each(|point| job.check(point))?;
        let shard = self.shard.choose(global)?;
        let folder = Folder::open(&self.output, job.header(combinations.mode))?;
        let mine = points.iter().enumerate().filter(|&(i, _)| shard.takes(i));
        let mine: Vec<Point> = mine.map(|(_, &point)| point).collect();
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
        folder.conduct(&mine, say, |point| job.run(point, &runner))?;
        drop(note);
        finish(&folder, global)
    }
}

fn numbers<T: Copy + Into<f64>>(list: &[T]) -> Vec<f64> {
    list.iter().map(|&value| value.into()).collect()
}

/// Writes the report of all finished runs in a folder, and prints the summary.
fn finish(folder: &Folder, global: &Global) -> anyhow::Result<ExitCode> {
    let records = write_report(folder)?;
    let report = folder.path.join("report.md");
    global.finish(&Summary::of(&records, &report))
}

/// Train a 2D field for each combination of settings, and compare them.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: nerf-train sweep image fox.jpg -o out/sweep --levels 6,8,10 --layers 2,4 --scale 0.25"
)]
pub struct ImageSweep {
    /// Image to fit.
    photo: PathBuf,
    #[command(flatten)]
    lists: Lists,
    /// Preset: grid (hash grid), classic (sinusoidal encoding), sharp (classic with one layer more, trained
    /// longer) [default: grid; classic with --levels, --layers or --width].
    #[arg(long, value_enum, hide_possible_values = true)]
    preset: Option<FieldPreset>,
    #[command(flatten)]
    photo_options: PhotoOptions,
    #[command(flatten)]
    settings: Settings,
}

impl ImageSweep {
    fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        self.lists.claim(Claims::default().reads("the picture", &self.photo))?;
        let start = if self.lists.of_sinusoidal() { FieldPreset::Classic } else { FieldPreset::Grid };
        let preset = self.preset.unwrap_or(start);
        let photo = self.photo_options.read(&self.photo, global)?;
        let base = self.settings.over(preset.config().for_picture(photo.size()))?;
        let none = [Knob::Samples, Knob::Turns, Knob::Seconds].map(|knob| (knob, Vec::new()));
        self.lists.sweep(&Job::Image { photo: &photo, base }, none, global)
    }
}

/// Train a radiance field for each combination of settings, and compare them.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: nerf-train sweep scene lego_200x200.npz -o out/sweep --levels 6,10 --width 64,128 --max-seconds 30"
)]
pub struct SceneSweep {
    /// Data set: a .npz file or a folder, as for `fit`.
    data: PathBuf,
    #[command(flatten)]
    lists: Lists,
    /// Preset: grid (hash grid), small (small network, sinusoidal encoding), seed (classic NeRF, 8 layers of 256) [default: grid; small with --levels, --layers, --width or --samples].
    #[arg(long, value_enum, hide_possible_values = true)]
    preset: Option<Preset>,
    /// TOML file of settings that override the preset (see `config`).
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    set: SetOption,
    /// Training steps of a run [default: the preset's].
    #[arg(long, value_name = "N", conflicts_with = "max_seconds")]
    steps: Option<u32>,
    /// Wall-clock limit of a run, seconds: one value, or a list to compare.
    #[arg(long, value_name = "S,S,…", value_delimiter = ',', num_args = 1)]
    max_seconds: Vec<f64>,
    /// Samples per ray, a list to compare (networks without a grid).
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    samples: Vec<u16>,
    /// Update each hashed level only every N steps, by the sum of the gradients since its last update; a list to compare
    /// (networks with a grid).
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    turns: Vec<u32>,
    /// Seed of the initial weights and of all random choices in training [default: the preset's].
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Scene extent: box (bounded), contracted (unbounded, by scene contraction) or auto (box if the background of the
    /// photographs is transparent or of one colour; else contracted).
    #[arg(long, value_enum, default_value_t)]
    space: Space,
    #[command(flatten)]
    data_options: DataOptions,
}

impl SceneSweep {
    fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        self.max_seconds.iter().try_for_each(|&seconds| check_max_seconds(Some(seconds)))?;
        let claims = self.data_options.claims(&*self.data);
        self.lists.claim(claims.reads("the file of settings", self.config.as_deref()))?;
        let dataset = self.data_options.read(&self.data, global)?;
        print_report(&dataset, global);
        if dataset.val.is_empty() {
            bail!(
                "{}: expected validation views, which a sweep compares by; found none",
                self.data.display()
            );
        }
        let around = self.space.around(dataset.background, false);
        let of_small = self.lists.of_sinusoidal() || !self.samples.is_empty();
        let start = if of_small { Preset::Small } else { Preset::Grid };
        let mut base = read_config(self.preset.unwrap_or(start), self.config.as_deref(), &self.set, around)?;
        base.sampling.near = self.data_options.near.or(base.sampling.near);
        base.sampling.far = self.data_options.far.or(base.sampling.far);
        base.optimiser.steps = self.steps.unwrap_or(base.optimiser.steps);
        base.seed = self.seed.unwrap_or(base.seed);
        self.space.settle(&mut base);
        base.check()?;
        self.space.say(&base, dataset.background, global);
        let (seconds, listed) = match self.max_seconds[..] {
            [seconds] => (Some(seconds), Vec::new()),
            _ => (None, self.max_seconds.clone()),
        };
        let job = Job::Scene { dataset: &dataset, base: Box::new(base), seconds };
        let more = [
            (Knob::Samples, numbers(&self.samples)),
            (Knob::Turns, numbers(&self.turns)),
            (Knob::Seconds, listed),
        ];
        self.lists.sweep(&job, more, global)
    }
}

/// Merge the finished runs of several folders.
#[derive(Debug, Args)]
#[command(after_help = "Example: nerf-train sweep merge -o out/all out/machine1 out/machine2")]
pub struct Merge {
    /// Folders to merge.
    #[arg(required = true, value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Output folder; may hold finished runs of the same sweep.
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
}

impl Merge {
    fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        places::check_folder("-o", &self.output)?;
        let claims =
            self.folders.iter().fold(Claims::default(), |claims, part| claims.reads("the sweep", part));
        claims.writes_folder("-o", &self.output).check()?;
        let open = |path: &PathBuf| Folder::existing(Path::new(path));
        let parts = self.folders.iter().map(open).collect::<Result<Vec<_>, _>>()?;
        let Some(first) = parts.first() else { bail!("expected at least one folder") };
        // All folders are checked against each other before anything is written.
        parts.iter().try_for_each(|part| first.check_same(&part.header))?;
        let whole = Folder::open(&self.output, first.header.clone())?;
        for part in &parts {
            let new = whole.take_in(part)?;
            global.say(format!("{}: {new} new runs", part.path.display()));
        }
        finish(&whole, global)
    }
}
