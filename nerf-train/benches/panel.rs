//! Fits of ordinary captures. Prints one row of figures per capture, measured on its held-out photographs.
//!
//! `NERF_PANEL=shared/data/real cargo bench -p nerf-train --bench panel [-- OPTIONS] [CAPTURE…]` fits the named
//! captures; default: all of [`CAPTURES`] that the folder `NERF_PANEL` holds. Options:
//!
//! - `--steps N` or `--seconds S`: length of each fit; default: 9,000 steps. A limit in seconds needs an otherwise idle
//!   machine.
//! - `--seed N`: seed of each fit.
//! - `--config TOML`: settings, as in `fit`.
//! - `--report DIR`: folder for pictures of held-out views beside their photographs.
//! - `--choose`: for the choice of settings. Photographs 0, 8, … are left out, and 4, 12, … are measured.
//! - `--cameras own`: cameras as in the reconstruction, instead of one camera per device.

use nerf_core::Kernel;
use nerf_train::cli::{SetOption, read_config};
use nerf_train::data::pictures::rgb::Picture;
use nerf_train::data::{Background, Cameras, Dataset, Downscale, ReadOptions, View, read};
use nerf_train::fit::finish::{Outcome, Shown};
use nerf_train::fit::run::{Ended, RunOptions, run};
use nerf_train::measure::frame;
use nerf_train::model::config::{Config, Preset, Surroundings};
use nerf_train::show::contact_sheet::{Cell, contact_sheet};
use nerf_train::system::progress::ProgressStyle;
use nerf_train::train::schedule::Budget;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Captures: name in the folder, and factor by which the photographs are reduced.
const CAPTURES: [(&str, u32); 9] = [
    ("lego_200x200.npz", 1),
    ("fox_ngp", 4),
    ("stitch", 1),
    ("cup_colmap", 2),
    ("mouse", 4),
    ("can", 2),
    ("can_unfolded", 2),
    ("milk", 3),
    ("fern_llff", 8),
];

/// Options of the command line.
#[derive(Default)]
struct Asked {
    steps: Option<u32>,
    seconds: Option<f64>,
    seed: u64,
    choose: bool,
    cameras: Cameras,
    config: Option<PathBuf>,
    report: Option<PathBuf>,
    captures: Vec<String>,
}

impl Asked {
    fn of_arguments() -> Self {
        let mut asked = Self::default();
        let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
        while let Some(argument) = arguments.next() {
            let mut value = || arguments.next().unwrap_or_else(|| panic!("{argument}: expected a value"));
            match argument.as_str() {
                "--steps" => asked.steps = Some(value().parse().expect("--steps: a number")),
                "--seconds" => asked.seconds = Some(value().parse().expect("--seconds: a number")),
                "--seed" => asked.seed = value().parse().expect("--seed: a number"),
                "--report" => asked.report = Some(value().into()),
                "--cameras" => asked.cameras = value().parse().expect("--cameras: shared or own"),
                "--config" => asked.config = Some(value().into()),
                "--choose" => asked.choose = true,
                name => asked.captures.push(name.into()),
            }
        }
        asked
    }

    fn budget(&self) -> Budget {
        let steps = if self.seconds.is_none() { self.steps.or(Some(9_000)) } else { self.steps };
        Budget { steps, seconds: self.seconds }
    }
}

fn main() {
    let folder = PathBuf::from(std::env::var_os("NERF_PANEL").expect("NERF_PANEL: a folder of captures"));
    let asked = Asked::of_arguments();
    println!(
        "| capture | PSNR, mean / worst | aligned | SSIM | depth error | near share | exposure | steps | seconds |"
    );
    println!("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    for (name, downscale) in CAPTURES {
        let wanted = asked.captures.is_empty() || asked.captures.iter().any(|capture| capture == name);
        if wanted && folder.join(name).exists() {
            row(&folder.join(name), name, downscale, &asked);
        }
    }
}

fn row(path: &Path, name: &str, downscale: u32, asked: &Asked) {
    let begun = Instant::now();
    let dataset = held_out(path, downscale, asked);
    let mut options = RunOptions::unattended(asked.budget(), Kernel::detect(), ProgressStyle::Quiet);
    options.report = asked.report.is_some();
    options.effect_threshold_db = Some(0.05);
    // Validation on the way tells a limit in seconds what its end takes; steps go without.
    options.validate_every = asked.seconds.is_none().then_some(u32::MAX);
    let config = Config { seed: asked.seed, ..config(&dataset, asked) };
    let Ended::Finished(outcome) = run(&dataset, config, &options, &|_| false).expect("a run") else {
        unreachable!("nobody stops it")
    };
    let percent = |share: Option<f64>| share.map_or("–".into(), |share| format!("{:.1} %", 100.0 * share));
    let db = |db: Option<f64>| db.unwrap_or(f64::NAN);
    println!(
        "| {name}, 1/{downscale} | {:.2} / {:.2} | {:.2} | {:.3} | {} | {} | {} | {} | {:.0} |",
        db(outcome.scores.psnr_db()),
        db(outcome.scores.worst_psnr_db()),
        db(outcome.scores.aligned_psnr_db()),
        db(outcome.scores.ssim()),
        percent(outcome.surfaces.depth_error),
        percent(outcome.surfaces.near_share),
        outcome.exposure.map_or("–".into(), |found| {
            format!("{:.3}{}", found.spread, if found.fitted { ", fitted" } else { "" })
        }),
        outcome.steps,
        begun.elapsed().as_secs_f64(),
    );
    if let Some(report) = &asked.report {
        std::fs::create_dir_all(report).expect("--report: a folder");
        write_views(&report.join(format!("{name}.png")), name, &outcome, &dataset);
    }
}

/// Returns the settings of `fit` with the preset grid: for an unbounded scene if the data set's background is unknown,
/// else for a known background.
fn config(dataset: &Dataset, asked: &Asked) -> Config {
    let surroundings = match dataset.background {
        Background::Unknown => Surroundings::Unbounded,
        _ => Surroundings::Known,
    };
    let read = read_config(Preset::Grid, asked.config.as_deref(), &SetOption::default(), surroundings);
    let mut config = read.unwrap_or_else(|error| panic!("{error:#}"));
    if let Some(steps) = asked.budget().steps {
        config.optimiser.steps = steps;
    }
    config
}

/// Reads a capture, with every eighth photograph held out unless the capture has a split. With `--choose`, removes
/// these held-out photographs, and holds out another eighth of the photographs instead.
fn held_out(path: &Path, downscale: u32, asked: &Asked) -> Dataset {
    let read = |hold_offset| {
        let (downscale, cameras) = (Downscale::By(downscale), asked.cameras);
        let options = ReadOptions { downscale, hold_offset, cameras, ..Default::default() };
        read(path, &options).unwrap_or_else(|error| panic!("{error}"))
    };
    let mut dataset = read(0);
    if asked.choose {
        let reported: Vec<String> = dataset.val.iter().map(|view| view.name.clone()).collect();
        let second = read(4);
        let is_reported = |view: &View| reported.contains(&view.name);
        if second.val.iter().any(is_reported) {
            // Its own split: every eighth of what is left is measured.
            let names = dataset.train.iter().map(|view| view.name.clone()).skip(4).step_by(8);
            let chosen: Vec<String> = names.collect();
            let (val, train) = dataset.train.into_iter().partition(|view| chosen.contains(&view.name));
            (dataset.train, dataset.val) = (train, val);
        } else {
            dataset = second;
            dataset.train.retain(|view| !is_reported(view));
        }
    }
    dataset
}

/// Writes a contact sheet of some held-out views, each rendered from the blob and beside its photograph.
fn write_views(file: &Path, name: &str, outcome: &Outcome, dataset: &Dataset) {
    let mut cells = Vec::new();
    for Shown { view, frame, truth, psnr_db } in &outcome.shown {
        let photograph = Picture::new(frame.width, frame.height, truth.clone()).expect("a picture");
        let view = &dataset.val[*view].name;
        cells.push(Cell::new(frame::picture(frame), format!("{view}: {psnr_db:.2} dB")));
        cells.push(Cell::new(photograph, format!("{view}: photograph")));
    }
    contact_sheet(name, &cells, 4).write_png(file).expect("--report: written");
}
