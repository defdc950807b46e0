use super::audit::check_threshold;
use super::common::{Global, parse_numbers, print, print_lines, tell_flat, tell_missed};
use super::lines::lines;
use super::options::Conduct;
use super::options::data::{DataOptions, Space, print_report};
use super::options::grid::{TableSettings, check_memory, given, parse_bytes, set};
use super::options::settings::{SetOption, read_config};
use super::places;
use crate::capture::check::Diagnosis;
use crate::data::{Background, Dataset, is_blank, refined};
use crate::fit::finish::Outcome;
use crate::fit::run::{Ended, RunOptions, interrupted, run_since};
use crate::fit::size::{self, Chosen};
use crate::fit::summary::{Capture, Summary};
use crate::fit::{detail, live};
use crate::measure::audit::THRESHOLD_DB;
use crate::model::config::{Config, Preset, Surroundings};
use crate::model::engine::EngineKind;
use crate::show::reports;
use crate::system::output::claims::{Claims, Existing, is_device};
use crate::system::output::write_atomic;
use crate::system::{memory, stop};
use crate::train::find_box;
use crate::train::schedule::Clock;
use anyhow::{Context, bail, ensure};
use clap::Args;
use glam::Vec3;
use std::path::PathBuf;
use std::process::ExitCode;

/// Train a radiance field on posed photographs.
///
/// DATA is a .npz in the layout of tiny_nerf or of the CS180 course, or a folder with Blender
/// transforms_{train,val,test}.json, a nerfstudio / instant-ngp transforms.json, a COLMAP reconstruction or LLFF
/// poses_bounds.npy.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: nerf-train fit lego_200x200.npz -o lego.nerf --report out/lego --max-seconds 60"
)]
pub struct Fit {
    /// Data set: a .npz file, or a folder in the layout of Blender, nerfstudio, instant-ngp, COLMAP or LLFF.
    data: PathBuf,
    #[command(flatten)]
    conduct: Conduct,
    /// Training steps [default: the preset's; unlimited with --max-seconds].
    #[arg(long, value_name = "N")]
    steps: Option<u32>,
    /// Preset: grid (hash grid), small (small network, sinusoidal encoding), seed (classic NeRF, 8 layers of 256).
    #[arg(long, value_enum, default_value = "grid", hide_possible_values = true)]
    preset: Preset,
    /// TOML file of settings that override the preset (see `config`).
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    set: SetOption,
    /// Steps between validations [default: an eighth of the run, or more if validations take over 5 % of its time].
    #[arg(long, value_name = "N")]
    validate_every: Option<u32>,
    /// Remove view dependence if it raises the PSNR of training views by less than this, dB.
    #[arg(long, value_name = "DB", default_value_t = THRESHOLD_DB, allow_hyphen_values = true)]
    effect_threshold: f64,
    /// Folder in which live.nerf, the newest scene, is replaced about every second; examples/web shows it.
    #[arg(long, value_name = "DIR")]
    live: Option<PathBuf>,
    /// Steps at which validation views are rendered for the report [default: every eighth of the run].
    #[arg(long, value_name = "N,N,…", value_delimiter = ',', requires = "report")]
    snapshots: Vec<u32>,
    /// Validation views that --snapshots renders, by index from 0 [default: two views].
    #[arg(long, value_name = "I,J,…", value_delimiter = ',', requires = "report")]
    snapshot_views: Vec<usize>,
    /// Train only on photographs of group N, from 1; if poses disagree, `check` lists groups with consistent poses.
    #[arg(long, value_name = "N")]
    group: Option<usize>,
    #[command(flatten)]
    data_options: DataOptions,
    #[command(flatten)]
    settings: Settings,
    #[command(flatten)]
    table: TableSettings,
    /// Ray-march steps across the longest side of the scene box; in an unbounded scene, across the inner ball, which is
    /// not contracted.
    #[arg(long, value_name = "N", help_heading = super::options::grid::HEADING)]
    steps_across: Option<u16>,
    /// Maximum file size, such as 256k or 1m; table size, levels, storage and occupancy grid are chosen to fit.
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, help_heading = super::options::grid::HEADING)]
    max_bytes: Option<u64>,
}

/// Flags for single settings; each overrides preset and TOML file.
#[derive(Debug, Args)]
#[command(next_help_heading = "Settings (replace the preset's)")]
struct Settings {
    /// Seed of the initial weights and of all random choices in training [default: the preset's].
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Gradient engine: fused (explicit backward passes) or dfdx (automatic differentiation: slow reference).
    #[arg(long, value_enum)]
    engine: Option<EngineKind>,
    /// Number of hidden layers of the density network; 0: density is read directly from the grid features.
    #[arg(long, value_name = "N")]
    depth: Option<usize>,
    /// Width of the hidden layers of the density network.
    #[arg(long, value_name = "N")]
    width: Option<usize>,
    /// Width of the colour network's one hidden layer; 0: no hidden layer.
    #[arg(long, value_name = "N")]
    colour_width: Option<usize>,
    /// Rays per batch at the start of training; rays × samples per ray at most 2^27.
    #[arg(long, value_name = "N")]
    rays: Option<usize>,
    /// Initial learning rate.
    #[arg(long, value_name = "RATE")]
    rate: Option<f64>,
    /// Start with all cells of the occupancy grid occupied. Default: start with the visual hull, which leaves out cells
    /// that a photograph shows as background.
    #[arg(long)]
    no_hull: bool,
    /// Scene extent: box (bounded), contracted (unbounded, by scene contraction) or auto (box with --box, or if the
    /// background of the photographs is transparent or of one colour; else contracted).
    #[arg(long, value_enum, default_value_t)]
    space: Space,
    /// Scene box: lowest and highest corner, in the coordinates of the data [default: found from the data].
    #[arg(
        long = "box",
        value_name = "X0,Y0,Z0,X1,Y1,Z1",
        value_parser = parse_numbers::<6, f32>,
        allow_hyphen_values = true
    )]
    scene_box: Option<[f32; 6]>,
}

impl Settings {
    fn apply(&self, config: &mut Config) {
        let Config { engine, network: n, sampling: s, occupancy: g, optimiser: o, seed, .. } = config;
        set(seed, &self.seed);
        set(engine, &self.engine);
        set(&mut n.depth, &self.depth);
        set(&mut n.width, &self.width);
        set(&mut n.colour_width, &self.colour_width);
        set(&mut s.rays, &self.rays);
        set(&mut o.rate, &self.rate);
        g.hull &= !self.no_hull;
        s.scene_box = self.scene_box.or(s.scene_box);
    }
}

/// Memory per sample of a training batch, bytes: measured with 130 million samples.
const BYTES_PER_SAMPLE: u64 = 32;

impl Fit {
    /// Returns the preset's settings adapted to `background`, overridden by the TOML file and then by the flags.
    fn config(&self, background: Background) -> anyhow::Result<Config> {
        let boxed = self.settings.scene_box.is_some();
        let around = match self.settings.space.around(background, boxed) {
            Surroundings::Known if self.settings.no_hull => Surroundings::Unknown,
            other => other,
        };
        let mut config = read_config(self.preset, self.config.as_deref(), &self.set, around)?;
        self.settings.apply(&mut config);
        let (n, s) = (&mut config.network, &mut config.sampling);
        let more =
            [("--steps-across", self.steps_across.is_some()), ("--max-bytes", self.max_bytes.is_some())];
        self.table.apply(n.grid.as_mut(), given(more), &config.preset)?;
        set(&mut s.steps_across, &self.steps_across);
        config.sampling.near = self.data_options.near.or(config.sampling.near);
        config.sampling.far = self.data_options.far.or(config.sampling.far);
        set(&mut config.optimiser.steps, &self.steps);
        self.settings.space.settle(&mut config);
        config.check()?;
        if self.settings.width.is_some() && config.network.depth == 0 {
            bail!("--width: expected --depth of at least 1 beside it, found no layer that is so wide");
        }
        let (rays, samples) = (config.sampling.rays as u64, u64::from(config.sampling.samples));
        let what = format!("a step of {rays} rays with {samples} samples");
        memory::check(what, rays * samples, BYTES_PER_SAMPLE, "lower --rays")?;
        if let Some(grid) = &config.network.grid {
            // A cubic box has the largest number of grid values of any box.
            check_memory(&grid.encoding(Vec3::ONE))?;
        }
        Ok(config)
    }

    /// Reports and returns settings adapted to the photographs' resolution, the run's length and `--max-bytes`.
    fn sized(
        &self,
        config: Config,
        dataset: &Dataset,
        options: &RunOptions,
        global: &Global,
    ) -> anyhow::Result<Config> {
        let hull =
            config.sampling.contraction.is_none() && config.occupancy.hull && config.network.grid.is_some();
        if !hull && self.max_bytes.is_none() {
            return Ok(config);
        }
        let flags = self.table.chosen();
        let of_grid = |key| self.set.names(&format!("network.grid.{key}"));
        let chosen = Chosen {
            entries: flags.entries || of_grid("log2_entries"),
            levels: flags.levels || of_grid("levels"),
            coarsest: flags.coarsest || of_grid("coarsest"),
            finest: flags.finest || of_grid("finest"),
            storage: flags.storage || of_grid("storage"),
            occupancy: self.set.names("occupancy.resolution"),
            steps: config.sampling.steps_across != config.preset.config().sampling.steps_across
                || self.steps_across.is_some()
                || self.set.names("sampling.steps_across"),
        };
        let scene_box = find_box(dataset, &config)?.scene_box;
        let pixels = detail::pixels_across(dataset, &scene_box).filter(|_| hull);
        let mut config = config;
        if let Some(pixels) = pixels {
            config = detail::for_pixels(config, chosen, pixels);
            config = self.for_length(config, chosen, options)?;
            if let Some(grid) = &config.network.grid {
                let steps = config.sampling.steps_across;
                global
                    .say(format!("{pixels:.0} pixels across the scene: {}, {steps} steps", grid.in_words()));
            }
        }
        let Some(max_bytes) = self.max_bytes else { return Ok(config) };
        let extent = scene_box.max - scene_box.min;
        let Some(fitted) = size::within(&config, chosen, extent, dataset, max_bytes)? else {
            return Ok(config);
        };
        if let Some(grid) = &fitted.network.grid {
            global.say(format!(
                "--max-bytes {max_bytes}: {}, {} cells of occupancy: at most {} bytes",
                grid.in_words(),
                fitted.occupancy.resolution,
                size::most_bytes(&fitted, extent, dataset)?,
            ));
        }
        Ok(fitted)
    }

    /// Returns `config`, adapted to a long run if this run is long. A resumed run is long if its checkpoint has a long
    /// run's settings; a new run is long if [`detail::is_long`] says so. With `--max-bytes`, the learned grid is left
    /// unchanged: its size follows from that limit. `chosen`: the user's settings, left unchanged.
    fn for_length(&self, config: Config, chosen: Chosen, options: &RunOptions) -> anyhow::Result<Config> {
        let sized = self.max_bytes.is_some();
        let chosen = Chosen { entries: chosen.entries || sized, ..chosen };
        let long = detail::for_long_run(config.clone(), chosen);
        let is_long = match options.resumed_settings()? {
            Some(resumed) => {
                resumed["sampling"]["steps_across"] == long.sampling.steps_across
                    && (sized || resumed["network"]["grid"] == serde_json::to_value(&long.network.grid)?)
            }
            None => detail::is_long(&options.budget),
        };
        Ok(if is_long { long } else { config })
    }

    fn claims(&self) -> Claims {
        let inputs = self.data_options.claims(&*self.data);
        let claims = self.conduct.claims(inputs.reads("the file of settings", self.config.as_deref()));
        match &self.live {
            Some(folder) => {
                claims.writes_folder("--live", folder).writes("--live", &folder.join("live.nerf"))
            }
            None => claims,
        }
    }

    /// Checks the options before any data is read. Returns the checkpoint's path; `None` if the output is a device.
    fn check(&self) -> anyhow::Result<Option<PathBuf>> {
        // The data's background is still unknown. The settings are checked again when it is known.
        self.config(Background::Alpha)?;
        check_threshold(self.effect_threshold)?;
        if let Some(folder) = &self.live {
            places::check_folder("--live", folder)?;
        }
        let checkpoint = self.conduct.check(self.claims())?;
        if !is_device(&self.conduct.output) {
            let poses = refined::beside(&self.conduct.output);
            self.claims().derives("the refined poses beside -o", &poses, Existing::Replace).settle()?;
        }
        Ok(checkpoint)
    }

    fn options(&self, config: &Config, checkpoint: Option<PathBuf>, global: &Global) -> RunOptions {
        RunOptions {
            snapshots: self.conduct.snapshots(&self.snapshots, &self.snapshot_views),
            report: self.conduct.report.is_some(),
            validate_every: self.validate_every,
            effect_threshold_db: Some(self.effect_threshold),
            live: self.live.clone(),
            ..self.conduct.options((config.optimiser.steps, self.steps.is_some()), checkpoint, global)
        }
    }

    /// Writes the refined poses next to the scene file. Without refined poses, removes the file of an earlier fit.
    fn write_poses(&self, outcome: &Outcome) -> anyhow::Result<()> {
        let file = refined::beside(&self.conduct.output);
        match &outcome.refined_poses {
            Some(poses) if !is_device(&self.conduct.output) => {
                write_atomic(&file, poses.to_json().as_bytes())?
            }
            _ if file.is_file() => std::fs::remove_file(&file).with_context(|| file.display().to_string())?,
            _ => {}
        }
        Ok(())
    }

    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let clock = Clock::start();
        let checkpoint = self.check()?;
        let (mut dataset, set_aside) =
            self.data_options.read_to_fit(&self.data, &self.conduct.output, global)?;
        let clock = clock.without(set_aside);
        let report = print_report(&dataset, global);
        let on_test = dataset.validate_on_test();
        if on_test {
            global.say(format!(
                "no validation views: the {} test views are measured, and nothing is chosen by them",
                dataset.val.len()
            ));
        }
        ensure!(
            !is_blank(&dataset.train),
            "{}: every pixel of every training photograph has the same colour: expected pictures of a scene",
            self.data.display()
        );
        let diagnosis = Diagnosis::of(&dataset);
        diagnosis.lines().for_each(|line| global.say(line));
        diagnosis.select(&mut dataset, self.group)?;
        let config = self.config(dataset.background)?;
        self.settings.space.say(&config, dataset.background, global);
        let options = self.options(&config, checkpoint, global);
        let config = self.sized(config, &dataset, &options, global)?;
        global.say_training(config.seed);
        let stop = |_| stop::requested();
        let outcome = match run_since(clock, &dataset, config.clone(), &options, &stop)? {
            Ended::Finished(outcome) => outcome,
            Ended::Interrupted { step, checkpoint } => {
                global.interrupted(&interrupted(step, checkpoint.as_deref()));
                return Ok(stop::status());
            }
        };
        write_atomic(&self.conduct.output, &outcome.bytes)?;
        self.write_poses(&outcome)?;
        if let Some(error) = self.live.as_ref().and_then(|folder| live::finish(folder, &outcome).err()) {
            global.say(format!("warning: --live: {error}"));
        }
        tell_missed(outcome.steps, &outcome.missed_snapshots);
        let (seconds, data) = (clock.seconds(), &dataset.name);
        let capture = Capture::of(&diagnosis, &outcome);
        let found: Vec<String> = capture.fitted.lines().map(str::to_owned).collect();
        let summary = Summary {
            capture: Some(capture),
            val_split: if on_test { "test" } else { "val" },
            ..Summary::of(&outcome, &config, options.kernel, seconds, data, &self.conduct.output)
        };
        tell_flat(&outcome);
        let printed = global.finish_with(&summary, || {
            print_lines(&found)?;
            print(lines(&summary)?.trim_end())
        });
        if let Some(folder) = &self.conduct.report {
            reports::fit::write(folder, &outcome, &dataset, &summary, &report)?;
        }
        printed
    }
}
