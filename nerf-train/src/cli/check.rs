use super::common::{Global, print_lines};
use super::options::data::{DataOptions, Space, print_report};
use super::options::settings::{SetOption, read_config};
use super::places;
use crate::capture::check::Diagnosis;
use crate::data::pictures::file::is_picture_name;
use crate::data::{self, Dataset, Downscale};
use crate::fit::run::RunOptions;
use crate::lab::cross_validation::CrossValidation;
use crate::model::config::Preset;
use crate::show::cameras::{checked, page};
use crate::system::output::write_atomic;
use crate::system::summary::write;
use crate::system::{memory, stop};
use crate::train::schedule::Budget;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;

/// Smallest number of photographs for which the expected time and memory are reported before the check.
const MANY: usize = 300;
/// Memory per photograph with a long side of about 800 pixels, bytes.
const BYTES_EACH: u64 = 2_400_000;
/// Estimated number of photographs that one core compares with all other photographs per second.
const COMPARED_PER_SECOND: u64 = 30;
/// Estimated number of bytes of image files that one core decodes per second.
const DECODED_PER_SECOND: u64 = 15_000_000;

/// Check a capture before training: coverage, blur, exposure, overlap, poses.
///
/// `fit` runs the same check before training. One possible fault is a folded reconstruction: because of repeated
/// structures, two sides of an orbit were reconstructed on top of each other. Photographs of different objects then
/// share points. Detecting a fold needs poses with point tracks, as in a COLMAP reconstruction.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train check holiday_poses
  nerf-train check holiday_poses -o out/check --cross-validate
  nerf-train fit holiday_poses -o holiday.nerf --leave-out out/check/unpredicted.txt")]
pub struct Check {
    /// Data set: a .npz file or a folder, as for `fit`.
    data: PathBuf,
    /// Output folder: check.html (cameras in 3D, coloured by findings), summary.json; with --cross-validate,
    /// unpredicted.txt.
    #[arg(long, short, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Cross-validate in 8 folds: each fit holds out another eighth of the photographs. Lists the held-out photographs
    /// that are predicted worst (unpredicted.txt). STEPS: training steps of a fit, 4000 if not given.
    #[arg(
        long,
        value_name = "STEPS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "4000",
        requires = "output"
    )]
    cross_validate: Option<u32>,
    #[command(flatten)]
    data_options: DataOptions,
}

#[derive(Serialize)]
struct Summary<'d> {
    #[serde(flatten)]
    diagnosis: &'d Diagnosis,
    #[serde(skip_serializing_if = "Option::is_none")]
    cross_validation: Option<CrossValidation>,
}

impl Check {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        if let Some(folder) = &self.output {
            places::check_folder("-o", folder)?;
        }
        let claims = self.data_options.claims(&*self.data);
        claims.writes_folder("-o", self.output.as_deref()).settle()?;
        self.say_size(global)?;
        let mut dataset = self.data_options.read(&self.data, global)?;
        print_report(&dataset, global);
        let diagnosis = Diagnosis::of(&dataset);
        let mut lines: Vec<String> = diagnosis.lines().map(str::to_owned).collect();
        let mut cross_validation = None;
        if let (Some(steps), Some(folder)) = (self.cross_validate, &self.output) {
            let Some(found) = self.cross_validated(&dataset, steps, global)? else {
                global.interrupted("interrupted; nothing is written");
                return Ok(stop::status());
            };
            let file = folder.join("unpredicted.txt");
            write_atomic(&file, (found.unpredicted.join("\n") + "\n").as_bytes())?;
            lines.push(found.finding(&file));
            cross_validation = Some(found);
        }
        let summary = Summary { diagnosis: &diagnosis, cross_validation };
        if let Some(folder) = &self.output {
            let html = folder.join("check.html");
            let range = (self.data_options.near, self.data_options.far);
            let scene = checked(&mut dataset, &diagnosis, range)?;
            write_atomic(&html, page::page(&scene)?.as_bytes())?;
            write(&summary, folder)?;
            lines.push(html.display().to_string());
        }
        global.finish_with(&summary, || print_lines(lines))
    }

    /// Cross-validates the photographs of `dataset` in fits of `steps` steps. `--near` and `--far`, if given, set the
    /// near and far planes. All other settings are the preset's.
    fn cross_validated(
        &self,
        dataset: &Dataset,
        steps: u32,
        global: &Global,
    ) -> anyhow::Result<Option<CrossValidation>> {
        let around = Space::Auto.around(dataset.background, false);
        let mut config = read_config(Preset::Grid, None, &SetOption::default(), around)?;
        config.sampling.near = self.data_options.near.or(config.sampling.near);
        config.sampling.far = self.data_options.far.or(config.sampling.far);
        config.optimiser.steps = steps;
        config.check()?;
        let budget = Budget { steps: Some(steps), seconds: None };
        let options = RunOptions::unattended(budget, global.kernel(), global.style());
        CrossValidation::of(dataset, &config, &options, &|_| stop::requested())
    }

    /// Reports the expected time and memory of a check, and fails if the photographs do not fit into memory. Does
    /// nothing for fewer than [`MANY`] photographs, or if `--downscale` is given.
    fn say_size(&self, global: &Global) -> anyhow::Result<()> {
        let files = data::files(&self.data);
        let pictures: Vec<_> = files.iter().filter(|file| is_picture_name(file)).collect();
        let count = pictures.len();
        if count < MANY || self.data_options.downscale != Downscale::Auto {
            return Ok(());
        }
        let bytes: u64 = pictures.iter().filter_map(|file| Some(file.metadata().ok()?.len())).sum();
        let seconds = count as u64 / COMPARED_PER_SECOND + bytes / DECODED_PER_SECOND;
        let seconds = seconds / rayon::current_num_threads().max(1) as u64;
        let giga = count as f64 * BYTES_EACH as f64 / 1e9;
        global.say(format!(
            "{count} pictures: about {seconds} s to read and compare them and {giga:.1} GB of memory; --downscale N takes less of it"
        ));
        let what = format!("{count} pictures at about 800 pixels");
        memory::check(what, count as u64, BYTES_EACH, "give --downscale N to read them smaller")
    }
}
