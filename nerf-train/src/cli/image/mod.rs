mod render;

use crate::cli::common::{Global, parse_background, tell_missed};
use crate::cli::options::Conduct;
use crate::cli::options::grid::{self, TableSettings, check_memory, given, parse_bytes};
use crate::cli::options::settings::SetOption;
use crate::data::pictures::photograph::{MAX_SIDE, Photo};
use crate::fit::drive::Ended;
use crate::fit::picture::{Evaluation, Summary, kept, run};
use crate::fit::run::RunOptions;
use crate::fit::size;
use crate::model::picture_config::{FieldConfig, FieldPreset};
use crate::show::reports::picture::{step_file, write as report};
use crate::system::output::claims::Claims;
use crate::system::output::ensure_folder;
use crate::system::stop;
use crate::train::schedule::Clock;
use anyhow::Result;
use clap::{Args, Subcommand};
use render::Render;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Train and render 2D neural fields of images.
#[derive(Debug, Subcommand)]
#[command(after_help = "Examples:
  nerf-train image fit photo.jpg -o photo.nerf --report out/photo
  nerf-train image render photo.nerf -o large.png --width 2048")]
pub enum Image {
    /// Train a 2D neural field on an image.
    Fit(Box<Fit>),
    /// Render a 2D field at any size.
    Render(Render),
}

impl Image {
    pub fn run(&self, global: &Global) -> Result<ExitCode> {
        match self {
            Self::Fit(fit) => fit.run(global),
            Self::Render(render) => render.run(global),
        }
    }
}

/// Options for reading a photograph: its scale, and the background of transparent pixels.
#[derive(Debug, Args)]
pub struct PhotoOptions {
    /// Factor by which the image is scaled before training, at most 1.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub scale: f64,
    /// Background of transparent pixels: a name (black, white, red), #RRGGBB or R,G,B (0 to 255).
    #[arg(long, value_name = "COLOUR", default_value = "black", value_parser = parse_background)]
    pub background: [f32; 3],
}

impl PhotoOptions {
    pub fn read(&self, file: &Path, global: &Global) -> Result<Photo> {
        let photo = Photo::read(file, self.background, self.scale)?;
        let [width, height] = photo.size();
        global.say(format!("{}: {width}x{height} pixels", photo.name));
        photo.notes.iter().for_each(|note| global.say(format!("  {note}")));
        Ok(photo)
    }
}

/// Flags for single settings; each overrides the preset.
#[derive(Debug, Args)]
#[command(next_help_heading = "Settings (replace the preset's)")]
pub struct Settings {
    /// Number of random pixels per batch; with a grid, they are spread evenly over the image (stratified).
    #[arg(long, value_name = "N")]
    pixels: Option<usize>,
    /// Training steps [default: the preset's].
    #[arg(long, value_name = "N")]
    steps: Option<u32>,
    /// Seed of the initial weights and of all random choices in training [default: the preset's].
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    #[command(flatten)]
    set: SetOption,
}

impl Settings {
    /// Returns `config` overridden by `--steps` and `--pixels`, then by `--set`, then by `--seed`.
    pub fn over(&self, mut config: FieldConfig) -> Result<FieldConfig> {
        let o = &mut config.optimiser;
        o.steps = self.steps.unwrap_or(o.steps);
        // The warm-up of the learning rate takes at most a fifth of the run, unless `--set` gives its length.
        o.warm_up = o.warm_up.min(o.steps / 5);
        config.pixels = self.pixels.unwrap_or(config.pixels);
        // The seed is set last, as TOML has no u64.
        Ok(FieldConfig { seed: self.seed.unwrap_or(config.seed), ..self.set.over(config)? })
    }
}

/// Train a 2D neural field on an image.
///
/// PHOTO is a PNG, JPEG, WebP, TIFF, BMP or GIF of any size, bit depth and number of channels.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train image fit fox.jpg -o fox.nerf --report out/fox --snapshots 0,200,400,800,1600
  nerf-train image fit fox.jpg -o fox.nerf --preset sharp")]
pub struct Fit {
    /// Image to fit.
    photo: PathBuf,
    #[command(flatten)]
    conduct: Conduct,
    /// Steps at which the image is rendered for the report [default: none].
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', requires = "report")]
    snapshots: Vec<u32>,
    /// Steps between evaluations [default: a tenth of the run].
    #[arg(long, value_name = "N")]
    evaluate_every: Option<u32>,
    /// Preset: grid (hash grid), classic (sinusoidal encoding), sharp (classic with one layer more, trained
    /// longer).
    #[arg(long, value_enum, default_value = "grid", hide_possible_values = true)]
    preset: FieldPreset,
    /// Number of hidden layers [default: the preset's].
    #[arg(long, value_name = "N")]
    layers: Option<usize>,
    /// Width of the hidden layers [default: the preset's].
    #[arg(long, value_name = "N")]
    width: Option<usize>,
    /// Initial learning rate [default: the preset's].
    #[arg(long, value_name = "RATE")]
    rate: Option<f64>,
    #[command(flatten)]
    photo_options: PhotoOptions,
    #[command(flatten)]
    settings: Settings,
    #[command(flatten)]
    table: TableSettings,
    /// Maximum file size, such as 256k or 1m; table size, levels and storage are chosen to fit.
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, help_heading = grid::HEADING)]
    max_bytes: Option<u64>,
}

impl Fit {
    /// Returns the preset's settings, overridden by the flags. `size`: width and height of the image, pixels.
    fn config(&self, size: [u32; 2]) -> Result<FieldConfig> {
        let mut config = self.settings.over(self.preset.config().for_picture(size))?;
        let more = given([("--max-bytes", self.max_bytes.is_some())]);
        self.table.apply(config.grid.as_mut(), more, &self.preset)?;
        if let Some(grid) = config.grid.as_mut().filter(|_| self.table.coarsest.is_none()) {
            grid.coarsest = grid.coarsest.min(grid.finest.max(1));
        }
        config.layers = self.layers.unwrap_or(config.layers);
        config.width = self.width.unwrap_or(config.width);
        config.optimiser.rate = self.rate.unwrap_or(config.optimiser.rate);
        config.check()?;
        Ok(config)
    }

    /// Returns `config`. With `--max-bytes`, changes the grid so that the file is small enough, and reports the change.
    fn within_bytes(&self, config: FieldConfig, photo: &Photo, global: &Global) -> Result<FieldConfig> {
        let Some(max_bytes) = self.max_bytes else { return Ok(config) };
        let (size, name) = (photo.size(), &photo.name);
        let fitted = size::picture_within(&config, self.table.chosen(), size, name, max_bytes)?;
        let Some(fitted) = fitted else { return Ok(config) };
        if let Some(grid) = &fitted.grid {
            let (grid, most) = (grid.in_words(), size::most_picture_bytes(&fitted, size, name)?);
            global.say(format!("--max-bytes {max_bytes}: {grid}: at most {most} bytes"));
        }
        Ok(fitted)
    }

    fn run(&self, global: &Global) -> Result<ExitCode> {
        let clock = Clock::start();
        let (checkpoint, snapshots) = self.check()?;
        let photo = self.photo_options.read(&self.photo, global)?;
        let config = self.config(photo.size())?;
        config.check_for(photo.size())?;
        let config = self.within_bytes(config, &photo, global)?;
        if let Some(grid) = &config.grid {
            check_memory(&grid.picture_encoding(photo.size()))?;
        }
        let options = self.options(&config, checkpoint, global);
        global.say_training(config.seed);
        let mut written = Ok(());
        let stop = |_| stop::requested();
        let output = Some(self.conduct.output.as_path());
        let ended = run(&photo, config.clone(), &options, output, clock, &stop, |at: Evaluation<'_>| {
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
                global.interrupted(&kept(step, &self.conduct.output, checkpoint.as_deref()));
                return Ok(stop::status());
            }
        };
        let place = self.conduct.output.display();
        let _note = stop::Note::new(format!("interrupted: {place} is complete, its report is not"));
        written?;
        let kernel = options.kernel;
        let summary = Summary::of(&outcome, &photo, &config, kernel, clock.seconds(), &self.conduct.output);
        if let Some(folder) = &self.conduct.report {
            report(folder, &photo, &outcome, &self.snapshots, &summary)?;
            let beyond = self.snapshots.iter().copied().filter(|&step| step > outcome.steps);
            tell_missed(outcome.steps, &beyond.collect::<Vec<_>>());
        }
        global.finish(&summary)
    }

    /// Checks the options before the image is read. Returns the paths of checkpoint and snapshots; `None`: not written.
    fn check(&self) -> Result<(Option<PathBuf>, Option<PathBuf>)> {
        // The picture's size is still unknown. The settings are checked again when it is known.
        self.config([MAX_SIDE; 2])?;
        let checkpoint =
            self.conduct.check(self.conduct.claims(Claims::default().reads("the picture", &self.photo)))?;
        let snapshots = match &self.conduct.report {
            Some(folder) if !self.snapshots.is_empty() => Some(folder.join("snapshots")),
            _ => None,
        };
        snapshots.as_deref().map_or(Ok(()), ensure_folder)?;
        Ok((checkpoint, snapshots))
    }

    fn options(&self, config: &FieldConfig, checkpoint: Option<PathBuf>, global: &Global) -> RunOptions {
        let steps = (config.optimiser.steps, self.settings.steps.is_some());
        RunOptions {
            snapshots: self.conduct.snapshots(&self.snapshots, &[]),
            validate_every: self.evaluate_every,
            ..self.conduct.options(steps, checkpoint, global)
        }
    }
}
