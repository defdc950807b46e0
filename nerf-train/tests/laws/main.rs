//! Laws of training and export that need no command line, on scenes of 24×24 pixels.

mod checkpoints;
mod choice;
mod data;
#[path = "../../src/data/pictures/testing.rs"]
mod encoders;
mod engines;
mod golden;
mod import;
mod pages;
mod parity_dfdx;
#[path = "../program.rs"]
mod program;
mod quality;
mod rooms;
#[allow(dead_code, reason = "shared with the tests that span the crates")]
#[path = "../../../tests/src/tools.rs"]
mod tools;
mod training;

use nerf_core::Kernel;
use nerf_train::data::Dataset;
use nerf_train::data::demo;
use nerf_train::data::demo::DemoSpec;
use nerf_train::fit::finish::Outcome;
use nerf_train::fit::run::Ended;
use nerf_train::fit::run::RunOptions;
use nerf_train::fit::run::run;
use nerf_train::model::config::Config;
use nerf_train::model::config::PoseRefinement;
use nerf_train::model::config::Preset;
use nerf_train::model::engine::EngineKind;
use nerf_train::system::progress::ProgressStyle;
use nerf_train::train::schedule::Budget;
use std::path::PathBuf;

/// Six training and two validation views of the built-in scene.
fn scene() -> Dataset {
    demo::dataset(&DemoSpec { train: 6, val: 2, size: 24, ..DemoSpec::default() }).expect("a scene")
}

/// The small preset, 2×16.
fn tiny(steps: u32) -> Config {
    let mut config = Preset::Small.config();
    let (n, s, g, o) =
        (&mut config.network, &mut config.sampling, &mut config.occupancy, &mut config.optimiser);
    (n.depth, n.width, n.position_levels, n.direction_levels, n.colour_width) = (2, 16, 4, 1, 8);
    (s.samples, s.rays, s.live_samples) = (16, 64, 512);
    (g.resolution, g.every, g.from) = (12, 4, 8);
    (o.steps, o.warm_up) = (steps, 5);
    config
}

/// The grid preset with tables of 2^10 entries, three of its five levels hashed.
fn tiny_grid(steps: u32) -> Config {
    let mut config = Preset::Grid.config();
    let grid = config.network.grid.as_mut().expect("the preset has one");
    (grid.levels, grid.log2_entries, grid.coarsest, grid.finest) = (5, 10, 6, 64);
    (config.sampling.rays, config.sampling.live_samples, config.sampling.steps_across) = (64, 512, 48);
    (config.occupancy.resolution, config.occupancy.cells, config.occupancy.every) = (24, 2048, 4);
    config.optimiser.steps = steps;
    config
}

/// The same, unbounded.
fn tiny_unbounded(steps: u32) -> Config {
    let mut config = tiny_grid(steps);
    (config.sampling.contraction, config.occupancy.hull) = (Some(2), false);
    // As a preset's own: opaque from the start, each photograph would be painted before its camera.
    let own = Preset::Grid.config().unbounded();
    (config.network.density_bias, config.occupancy.threshold) =
        (own.network.density_bias, own.occupancy.threshold);
    config.optimiser.hashed_every = own.optimiser.hashed_every;
    config
}

/// The same, poses refined or not; with a layer, which tells places apart that share an entry of so small tables.
fn tiny_posed(steps: u32, poses: PoseRefinement) -> Config {
    let mut config = tiny_unbounded(steps);
    config.network.depth = 1;
    config.capture.poses = poses;
    config
}

/// The seed preset, 8×16 with its skip and feature layers.
fn tiny_seed(steps: u32) -> Config {
    let mut config = Preset::Seed.config();
    (config.network.width, config.network.colour_width) = (16, 8);
    (config.sampling.rays, config.sampling.samples, config.optimiser.steps) = (64, 16, steps);
    config.occupancy.resolution = 12;
    // So narrow and deep, most seeds start without any density, and would learn nothing in a few steps.
    config.network.density_bias = 0.5;
    config
}

/// The same, by dfdx's tape.
fn by_tape(config: Config) -> Config {
    Config { engine: EngineKind::Dfdx, ..config }
}

fn options(config: &Config, checkpoint: Option<PathBuf>, resume: bool) -> RunOptions {
    RunOptions {
        budget: Budget { steps: Some(config.optimiser.steps), seconds: None },
        min_steps: 0,
        checkpoint,
        checkpoint_every: f64::INFINITY,
        resume,
        snapshots: None,
        report: false,
        validate_every: None,
        live: None,
        effect_threshold_db: None,
        kernel: Kernel::detect(),
        style: ProgressStyle::Quiet,
    }
}

fn fit(dataset: &Dataset, config: &Config) -> anyhow::Result<Outcome> {
    match run(dataset, config.clone(), &options(config, None, false), &|_| false)? {
        Ended::Finished(outcome) => Ok(outcome),
        Ended::Interrupted { .. } => unreachable!("nobody interrupts"),
    }
}
