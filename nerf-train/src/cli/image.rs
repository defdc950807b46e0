//! `nerf-train image`

use super::common::{
    Global, check_checkpoint_every, check_max_seconds, claim_checkpoint, cpu_name, open_blob,
    parse_background, parse_math, read_file,
};
use super::grid::{self, GridSummary, TableSettings, check_memory, given, of_sinusoidal, parse_bytes};
use super::places;
use crate::data::photograph::{MAX_SIDE, Photo};
use crate::data::rgb::Picture;
use crate::data::system::memory;
use crate::data::system::output::claims::Claims;
use crate::data::system::output::ensure_folder;
use crate::data::system::progress::{Message, Progress, Total};
use crate::data::system::stop;
use crate::fit::drive::Ended;
use crate::fit::picture::{Evaluation, Outcome, RunOptions, kept, run};
use crate::fit::size;
use crate::measure::frame;
use crate::model::picture_config::{FieldConfig, FieldPreset};
use crate::show::contact_sheet::{Cell, contact_sheet};
use crate::show::plot::{LinePlot, Marker, Series};
use crate::show::summary::write;
use crate::show::table::Table;
use crate::train::CurvePoint;
use crate::train::schedule::{Budget, Clock};
use anyhow::{Context, bail};
use clap::{Args, Subcommand};
use nerf_core::blob::Blob;
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::render::Renderer;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

/// Fit a 2D neural field to a picture, and render one.
#[derive(Debug, Subcommand)]
#[command(after_help = "Examples:
  nerf-train image fit photo.jpg -o photo.nerf --report out/photo
  nerf-train image render photo.nerf -o large.png --width 2048")]
pub enum Image {
    /// Fit a 2D neural field to a picture.
    Fit(Box<Fit>),
    /// Render a 2D field at any size.
    Render(Render),
}

impl Image {
    /// Runs the command.
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        match self {
            Self::Fit(fit) => fit.run(global),
            Self::Render(render) => render.run(global),
        }
    }
}

/// How to read a photograph.
#[derive(Debug, Args)]
pub struct PhotoOptions {
    /// Fit a reduced picture: this share of its width and height.
    #[arg(long, value_name = "SHARE", default_value_t = 1.0)]
    pub scale: f64,
    /// What shows through transparent parts: black, white, red or R,G,B (0 to 255).
    #[arg(long, value_name = "COLOUR", default_value = "black", value_parser = parse_background)]
    pub background: [f32; 3],
}

impl PhotoOptions {
    /// Reads it and says what was read.
    pub fn read(&self, file: &Path, global: &Global) -> anyhow::Result<Photo> {
        let photo = Photo::read(file, self.background, self.scale)?;
        let [width, height] = photo.size();
        global.say(format!("{}: {width}x{height} pixels", photo.name));
        photo.notes.iter().for_each(|note| global.say(format!("  {note}")));
        Ok(photo)
    }
}

/// Flags for single settings; each replaces what the preset says.
#[derive(Debug, Args)]
#[command(next_help_heading = "Settings (replace the preset's)")]
pub struct Settings {
    /// Pixels a step, drawn at random over the whole picture.
    #[arg(long, value_name = "N")]
    pixels: Option<usize>,
    /// Learning rate at the end, as a share of the one at the start; 1 keeps it constant.
    #[arg(long, value_name = "SHARE")]
    final_share: Option<f64>,
    /// Steps over which the learning rate rises from 0.
    #[arg(long, value_name = "N")]
    warm_up: Option<u32>,
    /// Adam's decay of the second moment.
    #[arg(long, value_name = "DECAY")]
    beta2: Option<f64>,
    /// Adam's epsilon. Of a sinusoidal network only.
    #[arg(long, value_name = "EPSILON")]
    pub epsilon: Option<f64>,
    /// Decay of the average of the parameters that is exported; 0 exports the last step's.
    #[arg(long, value_name = "DECAY")]
    average: Option<f64>,
    /// Steps [default: the preset's].
    #[arg(long, value_name = "N")]
    steps: Option<u32>,
    /// Seed of everything random.
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
}

impl Settings {
    /// The settings with the flags' values.
    pub fn over(&self, mut config: FieldConfig) -> FieldConfig {
        let o = &mut config.optimiser;
        o.steps = self.steps.unwrap_or(o.steps);
        o.final_share = self.final_share.unwrap_or(o.final_share);
        // Of a short run no more than a fifth, unless it is asked for.
        o.warm_up = self.warm_up.unwrap_or(o.warm_up.min(o.steps / 5));
        o.beta2 = self.beta2.unwrap_or(o.beta2);
        o.epsilon = self.epsilon.unwrap_or(o.epsilon);
        o.average = self.average.unwrap_or(o.average);
        config.pixels = self.pixels.unwrap_or(config.pixels);
        config.seed = self.seed.unwrap_or(config.seed);
        config
    }
}

/// Fit a 2D neural field to a picture.
///
/// PHOTO is a PNG, JPEG, WebP, TIFF, BMP or GIF of any size, bit depth and number of channels.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train image fit fox.jpg -o fox.nerf --report out/fox --snapshots 0,200,400,800,1600
  nerf-train image fit fox.jpg -o fox.nerf --preset sharp")]
pub struct Fit {
    /// The picture.
    photo: PathBuf,
    /// The blob to write (.nerf).
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// Folder for summary.json, curve, pictures and contact sheet.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Steps at which the whole picture is kept, as a picture and on the contact sheet.
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', requires = "report")]
    snapshots: Vec<u32>,
    /// Steps between evaluations of the whole picture, for the curve [default: a tenth of the run].
    #[arg(long, value_name = "N")]
    evaluate_every: Option<u32>,
    /// Go on from the checkpoint beside the output file.
    #[arg(long)]
    resume: bool,
    /// Begin anew and replace the checkpoint beside the output file: without this or --resume a fit that finds one
    /// is refused.
    #[arg(long, conflicts_with = "resume")]
    restart: bool,
    /// Seconds between checkpoints.
    #[arg(long, value_name = "S", default_value_t = 30.0)]
    checkpoint_every: f64,
    /// Stop after so much time; with --steps, at whichever comes first.
    #[arg(long, value_name = "S")]
    max_seconds: Option<f64>,
    /// Named settings to start from.
    #[arg(long, value_enum, default_value = "grid")]
    preset: FieldPreset,
    /// Levels L of the position's encoding: 2 + 4 L inputs. Of a sinusoidal network only.
    #[arg(long, value_name = "L")]
    levels: Option<u8>,
    /// Hidden layers.
    #[arg(long, value_name = "N")]
    layers: Option<usize>,
    /// Channels of every hidden layer.
    #[arg(long, value_name = "N")]
    width: Option<usize>,
    /// Learning rate at the start.
    #[arg(long, value_name = "RATE")]
    rate: Option<f64>,
    #[command(flatten)]
    photo_options: PhotoOptions,
    #[command(flatten)]
    settings: Settings,
    #[command(flatten)]
    table: TableSettings,
    /// Choose what no flag says of table, levels and storage so that the whole file is no larger: bytes, or k = 1024 and
    /// m = 1048576 of them.
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, help_heading = grid::HEADING)]
    max_bytes: Option<u64>,
}

impl Fit {
    /// Preset and flags, for a picture of this size.
    fn config(&self, size: [u32; 2]) -> anyhow::Result<FieldConfig> {
        let mut config = self.settings.over(self.preset.config().for_picture(size));
        let sinusoidal =
            [("--levels", self.levels.is_some()), ("--epsilon", self.settings.epsilon.is_some())];
        if let Some(flag) = given(sinusoidal).filter(|_| config.grid.is_some()) {
            return Err(of_sinusoidal(flag, &self.preset, "classic"));
        }
        let more = given([("--max-bytes", self.max_bytes.is_some())]);
        self.table.apply(config.grid.as_mut(), more, &self.preset)?;
        if let Some(grid) = config.grid.as_mut().filter(|_| self.table.coarsest.is_none()) {
            grid.coarsest = grid.coarsest.min(grid.finest.max(1));
        }
        config.levels = self.levels.unwrap_or(config.levels);
        config.layers = self.layers.unwrap_or(config.layers);
        config.width = self.width.unwrap_or(config.width);
        config.optimiser.rate = self.rate.unwrap_or(config.optimiser.rate);
        config.check()?;
        Ok(config)
    }

    /// The settings with which the file is as small as was asked for; says what was chosen.
    fn within_bytes(
        &self,
        config: FieldConfig,
        photo: &Photo,
        global: &Global,
    ) -> anyhow::Result<FieldConfig> {
        let Some(max_bytes) = self.max_bytes else { return Ok(config) };
        let (size, name) = (photo.size(), &photo.name);
        let fitted = size::picture_within(&config, self.table.chosen(), size, name, max_bytes)?;
        let Some(fitted) = fitted else { return Ok(config) };
        if let Some(grid) = &fitted.grid {
            let (grid, most) = (grid::in_words(grid), size::most_picture_bytes(&fitted, size, name)?);
            global.say(format!("--max-bytes {max_bytes}: {grid}: at most {most} bytes"));
        }
        Ok(fitted)
    }

    fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let clock = Clock::resume(Duration::ZERO);
        // Wrong settings are found before the picture is read, and once more with its size.
        self.config([MAX_SIDE; 2])?;
        check_max_seconds(self.max_seconds)?;
        check_checkpoint_every(self.checkpoint_every)?;
        places::check_extension("-o", &self.output, places::BLOB)?;
        places::check_report(self.report.as_ref())?;
        let claims = Claims::new()
            .reads("the picture", &self.photo)
            .writes("-o", &self.output)
            .writes_folder_if("--report", self.report.as_deref(), &places::IMAGE_FIT);
        let checkpoint = claim_checkpoint(claims, &self.output, self.resume, self.restart)?;
        let snapshots = match &self.report {
            Some(folder) if !self.snapshots.is_empty() => {
                ensure_folder(folder.join("snapshots"))?;
                Some(folder.join("snapshots"))
            }
            _ => None,
        };
        let photo = self.photo_options.read(&self.photo, global)?;
        let config = self.config(photo.size())?;
        config.check_for(photo.size())?;
        let config = self.within_bytes(config, &photo, global)?;
        if let Some(grid) = &config.grid {
            check_memory(&grid.picture_encoding(photo.size()))?;
        }

        let steps =
            (self.settings.steps.is_some() || self.max_seconds.is_none()).then_some(config.optimiser.steps);
        let options = RunOptions {
            budget: Budget { steps, seconds: self.max_seconds },
            output: Some(self.output.clone()),
            checkpoint,
            checkpoint_every: self.checkpoint_every,
            resume: self.resume,
            snapshots: self.snapshots.clone(),
            evaluate_every: self.evaluate_every,
            kernel: global.kernel(),
            style: global.style(),
        };
        global.say_training(config.seed);
        let mut written = Ok(());
        let stop = |_| stop::requested();
        let ended = run(&photo, config.clone(), &options, clock, &stop, |at: Evaluation<'_>| {
            if let Some(folder) = &snapshots
                && self.snapshots.contains(&at.step)
            {
                written = std::mem::replace(&mut written, Ok(()))
                    .and(at.picture.write_png(step_file(folder, at.step)));
            }
        })?;
        let outcome = match ended {
            Ended::Finished(outcome) => outcome,
            Ended::Interrupted { step, checkpoint } => {
                global.interrupted(&kept(step, &self.output, checkpoint.as_deref()));
                return Ok(stop::status());
            }
        };
        let place = self.output.display();
        let _note = stop::Note::new(format!("interrupted: {place} is complete, its report is not"));
        written?;
        if let Some(folder) = &self.report {
            write_curve(folder, &photo, &outcome)?;
            write_sheet(folder, &photo, &outcome, &self.snapshots)?;
            outcome.picture.write_png(folder.join("picture.png"))?;
            let missed: Vec<String> =
                self.snapshots.iter().filter(|&&step| step > outcome.steps).map(u32::to_string).collect();
            if !missed.is_empty() {
                global.say(format!("--snapshots: the run ended before step {}", missed.join(", ")));
            }
        }
        let blob = Blob::open(&outcome.bytes)?;
        let summary = FitSummary {
            psnr_db: outcome.psnr_db,
            photo: &photo.name,
            width_px: photo.picture.width,
            height_px: photo.picture.height,
            train_seconds: outcome.train_seconds,
            total_seconds: clock.seconds(),
            steps: outcome.steps,
            parameters: outcome.parameters,
            blob_bytes: outcome.bytes.len(),
            subnormal_weights: outcome.subnormal_weights,
            pixels_per_second: outcome.pixels_per_second,
            levels: config.levels,
            layers: config.layers,
            width: config.width,
            rate: config.optimiser.rate,
            pixels_a_step: config.pixels,
            seed: config.seed,
            kernel: options.kernel.to_string(),
            threads: rayon::current_num_threads(),
            cpu: cpu_name(),
            blob: self.output.display().to_string(),
            grid: GridSummary::of(&blob),
        };
        if let Some(folder) = &self.report {
            write(&summary, folder)?;
        }
        global.finish(&summary, || {
            outln!("{:.2} dB PSNR over the whole picture", outcome.psnr_db);
            outln!("trained: {} steps in {:.1} s", outcome.steps, outcome.train_seconds);
            outln!(
                "blob: {} ({} bytes, {} parameters)",
                self.output.display(),
                outcome.bytes.len(),
                outcome.parameters
            );
            if let Some(grid) = grid::describe(&blob) {
                outln!("learned grid: {grid}");
            }
            Ok(())
        })?;
        Ok(ExitCode::SUCCESS)
    }
}

/// What a fit made, for scripts.
#[derive(Debug, Serialize)]
struct FitSummary<'p> {
    psnr_db: f64,
    photo: &'p str,
    width_px: usize,
    height_px: usize,
    train_seconds: f64,
    total_seconds: f64,
    steps: u32,
    parameters: usize,
    blob_bytes: usize,
    subnormal_weights: usize,
    pixels_per_second: f64,
    levels: u8,
    layers: usize,
    width: usize,
    rate: f64,
    pixels_a_step: usize,
    seed: u64,
    kernel: String,
    threads: usize,
    cpu: String,
    blob: String,
    #[serde(flatten)]
    grid: Option<GridSummary>,
}

/// `curve.csv`, `curve.png` and `curve.svg`.
fn write_curve(folder: &Path, photo: &Photo, outcome: &Outcome) -> anyhow::Result<()> {
    let mut table = Table::new(["step", "seconds", "batch_psnr_db", "psnr_db"]);
    let (mut batch, mut whole) = (Vec::new(), Vec::new());
    for point in &outcome.curve {
        table.push([
            point.step.to_string(),
            format!("{:.3}", point.seconds),
            if point.step == 0 { String::new() } else { format!("{:.4}", point.train_psnr_db) },
            point.val_psnr_db.map_or_else(String::new, |db| format!("{db:.4}")),
        ]);
        let step = f64::from(point.step);
        if point.step > 0 {
            batch.push((step, point.train_psnr_db));
        }
        whole.extend(point.val_psnr_db.map(|db| (step, db)));
    }
    table.write_csv(folder.join("curve.csv"))?;
    let mut plot = LinePlot::new(format!("{}: PSNR while training", photo.name), "steps", "PSNR, dB");
    plot.series = vec![
        Series { name: "pixels of the steps, smoothed".into(), points: batch, marker: Marker::Line },
        Series { name: "whole picture".into(), points: whole, marker: Marker::LineAndPoints },
    ];
    plot.notes = vec![format!("{} steps in {:.1} s of training.", outcome.steps, outcome.train_seconds)];
    plot.write(folder.join("curve"))?;
    Ok(())
}

/// Longest side of a picture on the contact sheet, pixels.
const THUMBNAIL: usize = 512;

/// The picture of a step, in the folder of snapshots.
fn step_file(snapshots: &Path, step: u32) -> PathBuf {
    snapshots.join(format!("step_{step:06}.png"))
}

/// `sheet.png`: the snapshots, read back so that those of a run that was taken up again are there, the end, and the
/// picture itself.
fn write_sheet(folder: &Path, photo: &Photo, outcome: &Outcome, snapshots: &[u32]) -> anyhow::Result<()> {
    let shown = |point: &CurvePoint| {
        let db =
            point.val_psnr_db.filter(|_| snapshots.contains(&point.step) && point.step < outcome.steps)?;
        let picture = Picture::read(step_file(&folder.join("snapshots"), point.step))?;
        Some(Cell::new(picture.reduced_to(THUMBNAIL), format!("step {}: {db:.2} dB", point.step)))
    };
    let mut cells: Vec<Cell> = outcome.curve.iter().filter_map(shown).collect();
    let caption = format!("step {}: {:.2} dB", outcome.steps, outcome.psnr_db);
    cells.push(Cell::new(outcome.picture.reduced_to(THUMBNAIL), caption));
    cells.push(Cell::new(photo.picture.reduced_to(THUMBNAIL), format!("target: {}", photo.name)));
    let columns = cells.len().min(4);
    contact_sheet(&photo.name, &cells, columns).write_png(folder.join("sheet.png"))?;
    Ok(())
}

/// Render a 2D field at any size.
///
/// A size that is not given follows from the photograph's.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train image render fox.nerf -o fox.png
  nerf-train image render fox.nerf -o large.png --width 4096")]
pub struct Render {
    /// The blob.
    file: PathBuf,
    /// The picture (.png) to write.
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// Width, pixels [default: the photograph's, or as the height asks].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65_535))]
    width: Option<u32>,
    /// Height, pixels [default: the photograph's, or as the width asks].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65_535))]
    height: Option<u32>,
    /// Elementary functions: polynomial, libm, micromath, recurrence.
    #[arg(long, value_name = "BACKEND", default_value = "polynomial", value_parser = parse_math)]
    math: MathBackend,
}

/// What a pixel takes until its picture is written: its colour as f32 and as bytes, and these encoded.
const BYTES_PER_PIXEL: u64 = 12 + 3 + 2 * 4;

impl Render {
    fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        places::check_extension("-o", &self.output, places::PICTURE)?;
        Claims::new().reads("the blob", &self.file).writes("-o", &self.output).settle()?;
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let Some(facts) = blob.picture() else {
            bail!("{}: expected a 2D field, found a scene: render it with `render`", self.file.display());
        };
        let along = |side: u32, of: u32, to: u32| {
            // Rounded, at least 1; of u16 range as the sides are.
            ((u64::from(side) * u64::from(to) + u64::from(of) / 2) / u64::from(of)).max(1) as u32
        };
        let size = match (self.width, self.height) {
            (Some(width), Some(height)) => [width, height],
            (Some(width), None) => [width, along(width, facts.width, facts.height)],
            (None, Some(height)) => [along(height, facts.height, facts.width), height],
            (None, None) => [facts.width, facts.height],
        };
        let [width, height] = size.map(u64::from);
        let what = format!("{}: a picture of {width}x{height} pixels", self.file.display());
        memory::check(what, width * height, BYTES_PER_PIXEL, "choose a smaller --width")?;
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, global.kernel())];
        let renderer = Renderer::new(blob, global.kernel(), &mut memory)?;
        let mut progress = Progress::new("render", Total::Steps(size[1].into()), global.style());
        let (picture, counters) = frame::render_picture(&renderer, self.math, size, |rows| {
            progress.update(rows, &Message { note: "rows".into(), ..Message::default() });
        })
        .with_context(|| self.file.display().to_string())?;
        progress.finish(format!("{} rows", size[1]));
        picture.write_png(&self.output)?;
        let summary = RenderSummary {
            file: self.output.display().to_string(),
            width_px: size[0],
            height_px: size[1],
            colour_evaluations: counters.colour_evaluations,
            macs: counters.macs,
            invalid_samples: counters.invalid_samples,
        };
        global.finish(&summary, || {
            outln!("{} ({}x{} pixels)", self.output.display(), size[0], size[1]);
            Ok(())
        })?;
        Ok(ExitCode::SUCCESS)
    }
}

/// What was rendered, for scripts.
#[derive(Debug, Serialize)]
struct RenderSummary {
    file: String,
    width_px: u32,
    height_px: u32,
    colour_evaluations: u64,
    macs: u64,
    invalid_samples: u64,
}
