//! Time of a training step by phase, for grids of 2^14 to 2^19 entries per level, and comparison of the engines fused
//! and dfdx.
//!
//! `cargo bench -p nerf-train --bench steps` prints both tables; with `-- engines`, only the comparison of the engines.
//! Needs an otherwise idle machine. Environment variables:
//!
//! - `NERF_BENCH_DATA=FILE`: training data, instead of the built-in scene.
//! - `NERF_BENCH_UNBOUNDED=1`: settings for photographs of an unbounded scene.
//! - `NERF_BENCH_STEPS=N`: number of timed steps (default: 600). As many steps before these are not timed.
//! - `NERF_BENCH_CONFIG=TOML`: settings, as in `fit`.

use nerf_core::Kernel;
use nerf_train::cli::{SetOption, read_config};
use nerf_train::data;
use nerf_train::data::ReadOptions;
use nerf_train::data::demo;
use nerf_train::data::demo::DemoSpec;
use nerf_train::model::config::Config;
use nerf_train::model::config::Preset;
use nerf_train::model::config::Surroundings;
use nerf_train::model::engine::EngineKind;
use nerf_train::model::engine::Phase;
use nerf_train::train::Trainer;
use std::path::Path;
use std::time::Instant;

fn main() {
    let data = match std::env::var_os("NERF_BENCH_DATA") {
        Some(path) => {
            data::read(Path::new(&path), &ReadOptions::default()).expect("NERF_BENCH_DATA: a data set")
        }
        None => demo::dataset(&DemoSpec::default()).expect("the built-in scene"),
    };
    let steps =
        std::env::var("NERF_BENCH_STEPS").map_or(600, |steps| steps.parse().expect("a number of steps"));
    if !std::env::args().any(|argument| argument == "engines") {
        phases_of_steps(&data, steps);
    }
    engines(&data);
}

/// Compares the engines fused and dfdx on the first steps of each preset. The engines take turns, step by step; their
/// steps are about equal. Prints milliseconds per step.
fn engines(data: &data::Dataset) {
    const STEPS: u32 = 20;
    println!("{}, {STEPS} steps after 5, all threads; seed with a hundredth of its rays", data.name);
    println!("| preset | fused, ms a step | dfdx, ms a step | times as long |");
    println!("| --- | ---: | ---: | ---: |");
    for preset in [Preset::Grid, Preset::Small, Preset::Seed] {
        let mut config = preset.config();
        if preset == Preset::Seed {
            config.sampling.rays /= 100;
        }
        let mut trainers = [EngineKind::Fused, EngineKind::Dfdx].map(|engine| {
            let config = Config { engine, ..config.clone() };
            (Trainer::new(data, config, Kernel::detect()).expect("a trainer"), 0.0)
        });
        for step in 0..5 + STEPS {
            for (trainer, seconds) in &mut trainers {
                let begun = Instant::now();
                trainer.step(f64::from(step) / 1000.0).expect("a step");
                *seconds += if step < 5 { 0.0 } else { begun.elapsed().as_secs_f64() };
            }
        }
        let [fused, dfdx] = trainers.map(|(_, seconds)| 1e3 * seconds / f64::from(STEPS));
        println!("| {preset:?} | {fused:.1} | {dfdx:.0} | {:.1} |", dfdx / fused);
    }
}

/// Prints the table of the phases' shares of a step's time: one row per table size and number of threads.
fn phases_of_steps(data: &data::Dataset, steps: u32) {
    println!("{}, steps {steps} to {}", data.name, 2 * steps);
    let phases: Vec<&str> = Phase::ALL.iter().map(|phase| phase.name()).collect();
    println!("| table | threads | ms a step | evaluated/s | kept/s | {} | rest |", phases.join(" | "));
    println!("| --- |{}", " ---: |".repeat(phases.len() + 5));
    for log2_entries in [14, 15, 16, 17, 18, 19] {
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| row(data, log2_entries, threads, steps));
        }
    }
}

/// Trains for twice `steps` steps, and prints the row of the second half.
fn row(data: &data::Dataset, log2_entries: u8, threads: usize, steps: u32) {
    let around = match std::env::var_os("NERF_BENCH_UNBOUNDED") {
        Some(_) => Surroundings::Unbounded,
        None => Surroundings::Known,
    };
    let settings = std::env::var_os("NERF_BENCH_CONFIG");
    let config = read_config(Preset::Grid, settings.as_deref().map(Path::new), &SetOption::default(), around);
    let mut config = config.unwrap_or_else(|error| panic!("NERF_BENCH_CONFIG: {error:#}"));
    if let Some(grid) = &mut config.network.grid {
        grid.log2_entries = log2_entries;
    }
    let mut trainer = Trainer::new(data, config, Kernel::detect()).expect("a trainer");
    let run = |trainer: &mut Trainer<'_>, from: u32| {
        for step in from..from + steps {
            trainer.step(f64::from(step) / f64::from(2 * steps)).expect("a step");
        }
    };
    run(&mut trainer, 0);
    let (before, phases, begun) = (*trainer.progressed(), trainer.phases(), Instant::now());
    run(&mut trainer, steps);
    let (after, seconds) = (*trainer.progressed(), begun.elapsed().as_secs_f64());
    let evaluated = after.evaluated - before.evaluated;
    let parts = Phase::ALL.map(|phase| (trainer.phases().of(phase) - phases.of(phase)).as_secs_f64());
    // What waits or is done by one thread alone.
    let of_all = |phase: usize| if matches!(Phase::ALL[phase], Phase::Occupancy) { threads } else { 1 };
    let parts: Vec<f64> = parts.iter().enumerate().map(|(i, s)| s * of_all(i) as f64).collect();
    let whole = seconds * threads as f64;
    let shares: Vec<String> = parts.iter().map(|s| format!("{:.1} %", 100.0 * s / whole)).collect();
    println!(
        "| 2^{log2_entries} | {threads} | {:.2} | {:.2} M | {:.2} M | {} | {:.1} % |",
        1e3 * seconds / f64::from(steps),
        evaluated as f64 / seconds / 1e6,
        (after.samples - before.samples) as f64 / seconds / 1e6,
        shares.join(" | "),
        100.0 * (whole - parts.iter().sum::<f64>()) / whole,
    );
}
