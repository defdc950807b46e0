//! Fits of lego with the settings of the course's write-ups, except that empty space is skipped. Prints one row per
//! recipe.
//!
//! `NERF_BENCH_DATA=lego_200x200.npz cargo bench -p nerf-train --bench seeds [-- MINUTES [RECIPE…]]` fits the named
//! recipes (default: all) for at most MINUTES each (default: 60). `-- dense` compares the first 50 steps of the first
//! recipe with and without skipping.
//!
//! All recipes fit the classic network (8×256, skip connection after 4 layers, L = 10 and 4) with Adam at a constant
//! rate. Validation PSNR is the mean over all validation views. Training PSNR is the mean over an equal number of
//! training views. Both are of the exported file over its background, with every pixel. Published results: the course
//! requires 23 dB; the best write-up has 26 dB on training views and 25 dB on validation views.

use nerf_core::Kernel;
use nerf_core::plan::Quality;
use nerf_train::data::{Dataset, ReadOptions, read};
use nerf_train::fit::run::{Ended, RunOptions, run, spread};
use nerf_train::measure::eval::measure;
use nerf_train::model::config::{Config, Jitter, Preset};
use nerf_train::system::progress::ProgressStyle;
use nerf_train::train::schedule::Budget;
use nerf_train::train::{Trainer, psnr_db_of_mse};
use std::path::Path;
use std::time::Instant;

/// Settings of a write-up that differ from those of the preset seed.
struct Recipe {
    name: &'static str,
    rays: usize,
    /// Number of random images per step, with equally many rays each, drawn from all pixels; lego has 100 training
    /// images. Not 0: with a visual hull, rays from all images at once would be drawn only near the foreground.
    images: usize,
    samples: u16,
    jitter: Jitter,
    rate: f64,
    steps: u32,
}

const RECIPES: [Recipe; 4] = [
    Recipe {
        name: "1500",
        rays: 10_000,
        images: 100,
        samples: 64,
        jitter: Jitter::Bin,
        rate: 5e-4,
        steps: 1_500,
    },
    Recipe {
        name: "3000",
        rays: 10_000,
        images: 100,
        samples: 32,
        jitter: Jitter::Width(0.02),
        rate: 5e-4,
        steps: 3_000,
    },
    Recipe {
        name: "4000",
        rays: 10_000,
        images: 100,
        samples: 64,
        jitter: Jitter::Bin,
        rate: 1e-3,
        steps: 4_000,
    },
    Recipe {
        name: "10000",
        rays: 10_000,
        images: 50,
        samples: 64,
        jitter: Jitter::Bin,
        rate: 5e-4,
        steps: 10_000,
    },
];

impl Recipe {
    fn config(&self, dense: bool) -> Config {
        let mut config = Preset::Seed.config();
        (config.sampling.rays, config.sampling.images) = (self.rays, self.images);
        (config.sampling.samples, config.sampling.jitter) = (self.samples, self.jitter);
        (config.optimiser.rate, config.optimiser.steps) = (self.rate, self.steps);
        (config.occupancy.skip, config.occupancy.hull) = (!dense, !dense);
        config
    }
}

fn main() {
    let data = std::env::var_os("NERF_BENCH_DATA").expect("NERF_BENCH_DATA: the file lego_200x200.npz");
    let data = read(Path::new(&data), &ReadOptions::default()).expect("NERF_BENCH_DATA: a data set");
    let mut arguments = std::env::args().skip(1).filter(|argument| !argument.starts_with("--"));
    let first = arguments.next();
    if first.as_deref() == Some("dense") {
        return beside_dense(&data);
    }
    let minutes: f64 = first.map_or(60.0, |minutes| minutes.parse().expect("minutes"));
    let named: Vec<String> = arguments.collect();
    println!("| recipe | steps | minutes | training dB | validation dB |");
    println!("| --- | ---: | ---: | ---: | ---: |");
    for recipe in &RECIPES {
        if named.is_empty() || named.iter().any(|name| name == recipe.name) {
            row(&data, recipe, minutes);
        }
    }
}

fn row(data: &Dataset, recipe: &Recipe, minutes: f64) {
    let begun = Instant::now();
    let budget = Budget { steps: Some(recipe.steps), seconds: Some(60.0 * minutes) };
    let options = RunOptions::unattended(budget, Kernel::detect(), ProgressStyle::Auto);
    let ended = run(data, recipe.config(false), &options, &|_| false).expect("a run");
    let Ended::Finished(outcome) = ended else { unreachable!("nobody stops it") };
    let views = spread(&data.train, data.val.len().max(1));
    let quality = Quality::default();
    let training =
        measure(&outcome.bytes, None, options.kernel, &quality, outcome.background, views, |_, _, _, _| {})
            .expect("the training views");
    println!(
        "| {} rays × {} samples, {:?} jitter, rate {}{} | {} of {} | {:.1} | {:.2} | {:.2} |",
        recipe.rays,
        recipe.samples,
        recipe.jitter,
        recipe.rate,
        format_args!(", {} images a step", recipe.images),
        outcome.steps,
        recipe.steps,
        begun.elapsed().as_secs_f64() / 60.0,
        training.psnr_db().unwrap_or(f64::NAN),
        outcome.scores.psnr_db().unwrap_or(f64::NAN),
    );
}

/// Compares the first recipe's first 50 steps with and without the skipping of empty space. Prints time, and smoothed
/// PSNR of the training rays.
fn beside_dense(data: &Dataset) {
    println!("| step | dense dB | dense s | skipping dB | skipping s |");
    println!("| ---: | ---: | ---: | ---: | ---: |");
    let trainer = |dense| Trainer::new(data, RECIPES[0].config(dense), Kernel::detect()).expect("a trainer");
    let mut trainers = [trainer(true), trainer(false)];
    let mut seconds = [0.0; 2];
    for step in 1..=50 {
        for (trainer, seconds) in trainers.iter_mut().zip(&mut seconds) {
            let begun = Instant::now();
            trainer.step(f64::from(step - 1) / f64::from(RECIPES[0].steps)).expect("a step");
            *seconds += begun.elapsed().as_secs_f64();
        }
        if step == 1 || step % 10 == 0 {
            let db = [0, 1].map(|i| psnr_db_of_mse(trainers[i].progressed().mse));
            println!("| {step} | {:.2} | {:.1} | {:.2} | {:.1} |", db[0], seconds[0], db[1], seconds[1]);
        }
    }
}
