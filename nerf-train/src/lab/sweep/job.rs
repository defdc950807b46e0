//! Runs one point of a sweep: trains the field, measures its PSNR, and returns a record and a picture.

use super::{Header, Kind, Knob, Mode, Point, Record, Status};
use crate::data::pictures::photograph::Photo;
use crate::data::pictures::rgb::Picture;
use crate::data::{Dataset, View};
use crate::fit::picture;
use crate::fit::run::{Ended, RunOptions, run_since, spread};
use crate::fit::validation::FINAL_VIEWS;
use crate::measure::eval::measure;
use crate::measure::frame::{self, Frame};
use crate::measure::metrics::{flat_psnr_db, is_flat};
use crate::model::config::{Config, ConfigError, TableConfig, rule};
use crate::model::engine::EngineError;
use crate::model::picture_config::FieldConfig;
use crate::system::progress::ProgressStyle;
use crate::train::TrainError;
use crate::train::checkpoint::fingerprint;
use crate::train::schedule::{Budget, Clock};
use nerf_core::Kernel;
use nerf_core::network::Architecture;
use nerf_core::plan::Quality;
use serde_json::json;

/// Data and base settings of all runs of a sweep.
#[derive(Debug)]
pub enum Job<'a> {
    Image {
        photo: &'a Photo,
        base: FieldConfig,
    },
    Scene {
        dataset: &'a Dataset,
        base: Box<Config>,
        /// Time limit, seconds, of each run whose point does not set [`Knob::Seconds`]; replaces the limit in steps.
        seconds: Option<f64>,
    },
}

#[derive(Clone, Copy, Debug)]
pub struct Runner<'a> {
    pub kernel: Kernel,
    pub style: ProgressStyle,
    pub cpu: &'a str,
}

pub type Run = (Record, Option<Picture>);

impl Job<'_> {
    /// Returns the base settings as a point: learning rate, and sizes of the grid or of the sinusoidal network.
    pub fn base_point(&self) -> Point {
        match self {
            Self::Image { base, .. } => {
                base_point(base.grid.as_ref(), (base.levels, base.layers, base.width), base.optimiser.rate)
            }
            Self::Scene { base, .. } => {
                let n = &base.network;
                base_point(n.grid.as_ref(), (n.position_levels, n.depth, n.width), base.optimiser.rate)
            }
        }
    }

    pub fn header(&self, mode: Mode) -> Header {
        match self {
            Self::Image { photo, base } => Header {
                kind: Kind::Image,
                data: photo.name.clone(),
                fingerprint: format!("{:016x}", photo.fingerprint()),
                mode,
                settings: json!(base),
            },
            Self::Scene { dataset, base, seconds } => Header {
                kind: Kind::Scene,
                data: dataset.name.clone(),
                fingerprint: format!("{:016x}", fingerprint(dataset)),
                mode,
                settings: json!({ "max_seconds": seconds, "config": base }),
            },
        }
    }

    pub fn check(&self, point: &Point) -> Result<(), ConfigError> {
        match self {
            Self::Image { photo, base } => field_config(base, point).check_for(photo.size()),
            Self::Scene { base, .. } => {
                let config = scene_config(base, point);
                let wide = point.get(Knob::Width).filter(|_| config.network.depth == 0);
                wide.map_or(Ok(()), |width| {
                    rule("network.width", false, "none without trunk layers", width)
                })?;
                config.check()
            }
        }
    }

    /// Runs one point to its end; an interrupted run leaves no record. The picture is the fitted photograph, or the
    /// rendered first validation view. A run that diverges has a record without a picture.
    pub fn run(&self, point: &Point, runner: &Runner<'_>) -> anyhow::Result<Run> {
        let clock = Clock::start();
        let (blank, ran) = match self {
            Self::Image { photo, base } => {
                let config = field_config(base, point);
                let blank = blank(point, runner, &config.model(photo.size()).architecture);
                (blank.clone(), run_image(photo, config, blank, runner, clock))
            }
            Self::Scene { dataset, base, seconds } => {
                let config = scene_config(base, point);
                let blank = blank(point, runner, &config.model().architecture);
                let seconds = point.get(Knob::Seconds).or(*seconds);
                let steps = seconds.is_none().then_some(config.optimiser.steps);
                let budget = Budget { steps, seconds };
                (blank.clone(), run_scene(dataset, config, budget, blank, runner, clock))
            }
        };
        ran.or_else(|error| match error.downcast_ref() {
            Some(
                TrainError::Engine(EngineError::Diverged { .. })
                | TrainError::Dead { .. }
                | TrainError::Export(_),
            ) => {
                let (status, note) = (Status::Diverged, error.to_string());
                Ok((Record { status, note, train_seconds: clock.seconds(), ..blank }, None))
            }
            _ => Err(error),
        })
    }
}

/// Returns a point with learning rate `rate` and the sizes of `grid` or, without a grid, the sizes of the network.
fn base_point(grid: Option<&TableConfig>, (levels, layers, width): (u8, usize, usize), rate: f64) -> Point {
    let point = match grid {
        Some(grid) => Point::of(&[
            (Knob::Table, grid.log2_entries.into()),
            (Knob::GridLevels, grid.levels as f64),
            (Knob::Features, grid.features.into()),
            (Knob::Finest, grid.finest.into()),
        ]),
        None => Point::of(&[
            (Knob::Levels, levels.into()),
            (Knob::Layers, layers as f64),
            (Knob::Width, width as f64),
        ]),
    };
    point.with(Knob::Rate, rate)
}

fn set_grid(grid: Option<&mut TableConfig>, point: &Point) {
    if let Some(grid) = grid {
        set(&mut grid.log2_entries, point.get(Knob::Table));
        set(&mut grid.levels, point.get(Knob::GridLevels));
        set(&mut grid.features, point.get(Knob::Features));
        set(&mut grid.finest, point.get(Knob::Finest));
    }
}

fn field_config(base: &FieldConfig, point: &Point) -> FieldConfig {
    let mut config = base.clone();
    set(&mut config.levels, point.get(Knob::Levels));
    set(&mut config.layers, point.get(Knob::Layers));
    set(&mut config.width, point.get(Knob::Width));
    set_grid(config.grid.as_mut(), point);
    config.optimiser.rate = point.get(Knob::Rate).unwrap_or(config.optimiser.rate);
    config
}

fn scene_config(base: &Config, point: &Point) -> Config {
    let mut config = base.clone();
    let n = &mut config.network;
    set(&mut n.position_levels, point.get(Knob::Levels));
    set(&mut n.depth, point.get(Knob::Layers));
    set(&mut n.width, point.get(Knob::Width));
    set_grid(n.grid.as_mut(), point);
    set(&mut config.sampling.samples, point.get(Knob::Samples));
    set(&mut config.optimiser.hashed_every, point.get(Knob::Turns));
    // The skip connection stays, unless the trunk ends before it.
    if n.skip_after >= n.depth {
        n.skip_after = 0;
    }
    config.optimiser.rate = point.get(Knob::Rate).unwrap_or(config.optimiser.rate);
    config
}

/// Sets `to` to `value`, a whole number. Changes nothing if `value` is `None` or outside of the type's range.
fn set<T: TryFrom<u64>>(to: &mut T, value: Option<f64>) {
    if let Some(value) = value.and_then(|value| T::try_from(value as u64).ok()) {
        *to = value;
    }
}

fn blank(point: &Point, runner: &Runner<'_>, architecture: &Architecture) -> Record {
    Record {
        point: *point,
        status: Status::Ok,
        note: String::new(),
        psnr_db: None,
        steps: 0,
        parameters: architecture.parameters(),
        macs: (architecture.density_macs() + architecture.colour_macs()) as u64,
        blob_bytes: 0,
        train_seconds: 0.0,
        threads: rayon::current_num_threads(),
        kernel: runner.kernel.to_string(),
        cpu: runner.cpu.into(),
    }
}

/// Returns a run's status and note. `flat`: whether its PSNR is no better than `flat_psnr_db`, that of one flat colour.
fn judged(flat: bool, flat_psnr_db: f64) -> (Status, String) {
    match flat {
        true => (Status::Flat, format!("no better than one flat colour, which has {flat_psnr_db:.2} dB")),
        false => (Status::Ok, String::new()),
    }
}

fn run_image(
    photo: &Photo,
    config: FieldConfig,
    blank: Record,
    runner: &Runner<'_>,
    clock: Clock,
) -> anyhow::Result<Run> {
    let budget = Budget { steps: Some(config.optimiser.steps), seconds: None };
    let options = RunOptions {
        validate_every: Some(u32::MAX),
        ..RunOptions::unattended(budget, runner.kernel, runner.style)
    };
    let ended = picture::run(photo, config, &options, None, clock, &|_| false, |_| {})?;
    let Ended::Finished(outcome) = ended else { unreachable!("nobody stops it") };
    let flat = flat_psnr_db(&photo.picture.rgb);
    let (status, note) = judged(is_flat([(outcome.psnr_db, flat)]), flat);
    let record = Record {
        status,
        note,
        psnr_db: Some(outcome.psnr_db),
        steps: outcome.steps,
        blob_bytes: outcome.bytes.len(),
        train_seconds: outcome.train_seconds,
        ..blank
    };
    Ok((record, Some(outcome.picture)))
}

fn run_scene(
    dataset: &Dataset,
    config: Config,
    budget: Budget,
    blank: Record,
    runner: &Runner<'_>,
    clock: Clock,
) -> anyhow::Result<Run> {
    let options = RunOptions::unattended(budget, runner.kernel, runner.style);
    let ended = run_since(clock, dataset, config, &options, &|_| false)?;
    let Ended::Finished(outcome) = ended else { unreachable!("nobody stops it") };
    let (status, note) = judged(outcome.flat, outcome.flat_psnr_db);
    let record = Record {
        status,
        note,
        psnr_db: outcome.scores.psnr_db(),
        steps: outcome.steps,
        blob_bytes: outcome.bytes.len(),
        train_seconds: outcome.train_seconds,
        ..blank
    };
    let mut picture = None;
    let each = |_: &View, frame: &Frame, _: &[[f32; 3]], _: &_| picture = Some(frame::picture(frame));
    let first = spread(&dataset.val, FINAL_VIEWS).first().copied();
    measure(&outcome.bytes, None, runner.kernel, &Quality::default(), outcome.background, first, each)?;
    Ok((record, picture))
}
