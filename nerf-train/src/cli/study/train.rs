//! `nerf-train study train`

use crate::cli::common::{GO_ON, Global, cpu_name};
use crate::cli::options::data::{DataOptions, Space, print_report};
use crate::cli::options::settings::read_config;
use crate::cli::options::shard::ShardOption;
use crate::cli::places;
use crate::data::Dataset;
use crate::lab::Run;
use crate::lab::study::training::{Fitted, Folder, Header, Lists, Trial, fit};
use crate::model::config::{Config, Preset, Surroundings};
use crate::show::reports::training::{Summary, table, write};
use crate::system::output::claims::Claims;
use crate::system::stop::Note;
use crate::train::checkpoint::fingerprint;
use anyhow::bail;
use clap::{Args, ValueEnum};
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;

/// Fit for the same time with other settings, and show PSNR over time: how long is worth waiting for.
///
/// Without any list: the presets `grid` and `seed`, three table sizes of the learned grid and updates of its hashed levels
/// at every step, and three widths, three depths and three numbers of samples of the base, a sinusoidal network.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: nerf-train study train lego_200x200.npz --report out/training --seconds 60 --width 64,128,256"
)]
pub struct StudyTrain {
    /// The data set.
    data: PathBuf,
    /// Folder for one file a finished fit, table.csv, curves.csv, report.md, plots and summary.json. Fits that are
    /// finished in it are not repeated; lists may be extended later.
    #[arg(long, value_name = "DIR")]
    report: PathBuf,
    /// Seconds of a fit, everything included; of several, each fit is made for each.
    #[arg(long, value_name = "S,S,…", value_delimiter = ',', num_args = 1, default_value = "30")]
    seconds: Vec<f64>,
    /// Minutes of all fits together: each gets its share, instead of --seconds.
    #[arg(long, value_name = "M", conflicts_with = "seconds")]
    minutes: Option<f64>,
    /// Presets to compare.
    #[arg(long, value_enum, value_name = "PRESET,…", value_delimiter = ',', num_args = 1)]
    preset: Vec<Preset>,
    /// Of the base, or of the preset `grid` where that has no learned grid: binary logarithms of the most entries a level
    /// has. The report then shows what a file of each size holds after each time.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    table: Vec<u8>,
    /// Of the same: steps between updates of a hashed level, whose gradients are summed in between.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    turns: Vec<u32>,
    /// Channels of the trunk.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    width: Vec<usize>,
    /// Trunk layers.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    depth: Vec<usize>,
    /// Samples a ray.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', num_args = 1)]
    samples: Vec<u16>,
    /// The preset whose table, turns, width, depth and samples are varied.
    #[arg(long, value_enum, value_name = "PRESET", default_value = "small")]
    base: Preset,
    /// TOML file with settings that replace the base's.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Where the scene ends, in every fit whose preset can do so.
    #[arg(long, value_enum, default_value_t)]
    space: Space,
    #[command(flatten)]
    shard: ShardOption,
    #[command(flatten)]
    data_options: DataOptions,
}

impl StudyTrain {
    fn lists(&self) -> Lists {
        let lists = Lists {
            presets: self.preset.clone(),
            tables: self.table.clone(),
            turns: self.turns.clone(),
            widths: self.width.clone(),
            depths: self.depth.clone(),
            samples: self.samples.clone(),
        };
        let sinusoidal = [lists.widths.is_empty(), lists.depths.is_empty(), lists.samples.is_empty()];
        let learned = [lists.tables.is_empty(), lists.turns.is_empty()];
        if !(lists.presets.is_empty() && learned == [true; 2] && sinusoidal == [true; 3]) {
            return lists;
        }
        Lists {
            presets: vec![Preset::Grid, Preset::Seed],
            tables: vec![12, 14, 16],
            turns: vec![1],
            widths: vec![64, 128, 256],
            depths: vec![2, 4, 8],
            samples: vec![64, 128, 192],
        }
    }

    /// Runs the command.
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        self.check()?;
        let dataset = self.data_options.read(&self.data, global)?;
        print_report(&dataset, global);
        if dataset.val.is_empty() {
            bail!("{}: expected validation views, which fits compare by; found none", self.data.display());
        }
        let around = self.space.around(dataset.background, false);
        let base = self.base(&dataset, around, global)?;
        let of = |preset: Preset| self.within_range(preset.config().around(around));
        let mut trials = self.lists().trials(&base, &self.seconds, of)?;
        if let Some(minutes) = self.minutes {
            let share = 60.0 * minutes / trials.len() as f64;
            trials.iter_mut().for_each(|trial| trial.budget_seconds = share);
        }
        let presets: Vec<_> = Preset::value_variants().iter().copied().map(of).collect();
        let header = Header {
            data: dataset.name.clone(),
            fingerprint: format!("{:016x}", fingerprint(&dataset)),
            settings: json!({ "base": &base, "presets": presets }),
        };
        let folder = Folder::open(&self.report, header)?;
        self.fit(&dataset, &folder, &trials, global)?;
        let fits = report(&folder, &trials)?;
        global.finish(&Summary::of(&fits), || {
            outlines!(table(&fits).to_text().trim_end());
            outln!("report: {}", self.report.join("report.md").display());
            Ok(())
        })?;
        Ok(ExitCode::SUCCESS)
    }

    /// Refuses what cannot be, before anything is read.
    fn check(&self) -> anyhow::Result<()> {
        let given = self.seconds.iter().map(|&seconds| ("--seconds", seconds));
        for (flag, value) in given.chain(self.minutes.map(|minutes| ("--minutes", minutes))) {
            if !(value.is_finite() && value > 0.0) {
                bail!("{flag}: expected a number above 0, found {value}");
            }
        }
        places::check_report(Some(&self.report))?;
        Ok(Claims::new()
            .reads_data(&self.data)
            .reads_if("the file of settings", self.config.as_deref())
            .writes_folder("--report", &self.report)
            .settle()?)
    }

    /// The settings with rays from --near to --far.
    fn within_range(&self, mut config: Config) -> Config {
        config.sampling.near = self.data_options.near.or(config.sampling.near);
        config.sampling.far = self.data_options.far.or(config.sampling.far);
        config
    }

    /// The settings that lists are varied around.
    fn base(&self, dataset: &Dataset, around: Surroundings, global: &Global) -> anyhow::Result<Config> {
        let mut base = self.within_range(read_config(self.base, self.config.as_deref(), around)?);
        if base.network.grid.is_some() {
            self.space.settle(&mut base);
        }
        self.space.say(&base, dataset.background, global);
        if base.network.grid.is_some() && !self.samples.is_empty() {
            bail!(
                "--samples: a setting of sinusoidal networks, and the base has a learned grid: take --base small or seed"
            );
        }
        Ok(base)
    }

    /// Fits what is not finished of this part.
    fn fit(
        &self,
        dataset: &Dataset,
        folder: &Folder,
        trials: &[Trial],
        global: &Global,
    ) -> anyhow::Result<()> {
        let machine =
            format!("{}, {} threads, kernel {}", cpu_name(), rayon::current_num_threads(), global.kernel());
        let mine = self.shard.choose(global)?.of(trials, Trial::file_name);
        let total: f64 = mine.iter().map(|(trial, _)| trial.budget_seconds).sum();
        let (all, own) = (trials.len(), mine.len());
        global.say(format!("{all} fits, {own} of them this part's, in {total:.0} s, on {machine}"));
        let note = Note::new(GO_ON);
        let (finished, listed) = (folder.clone(), trials.to_vec());
        note.before("the report", move || {
            report(&finished, &listed).map(drop).map_err(|error| error.to_string())
        });
        let one = |trial: &Trial| -> anyhow::Result<_> {
            Ok((fit(dataset, trial, global.kernel(), global.style(), &machine)?, None))
        };
        folder.conduct(&mine, |text| global.say(text), one)
    }
}

/// Writes the report of all finished fits, those of `trials` in their order and in front; returns them.
fn report(folder: &Folder, trials: &[Trial]) -> anyhow::Result<Vec<Fitted>> {
    let mut fits = folder.runs()?;
    let place = |fit: &Fitted| {
        trials.iter().position(|trial| trial.file_name() == fit.name()).unwrap_or(trials.len())
    };
    fits.sort_by_key(place);
    write(&fits, &folder.header().data, folder.path())?;
    Ok(fits)
}
