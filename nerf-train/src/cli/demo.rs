use super::common::{Global, open_blob, print, print_lines};
use super::lines::lines;
use super::options::data::print_report;
use super::options::settings::{SetOption, read_config};
use super::places;
use crate::data::Dataset;
use crate::data::cameras::bundle::median;
use crate::data::demo::{self, DemoSpec, Truth};
use crate::data::pictures::rgb::Picture;
use crate::fit::run::{Ended, RunOptions, run_since};
use crate::fit::snapshot::SnapshotOptions;
use crate::fit::summary::Summary;
use crate::measure::eval::{Scores, evaluate};
use crate::measure::frame::{self, Frame};
use crate::model::config::{Config, Preset, Surroundings};
use crate::show::animation::GifWriter;
use crate::show::contact_sheet::{Cell, contact_sheet};
use crate::show::orbit::Orbit;
use crate::show::reports;
use crate::show::view::{Output, picture_of};
use crate::system::output::claims::Claims;
use crate::system::output::write_atomic;
use crate::system::progress::Progress;
use crate::system::summary::write;
use crate::train::schedule::{Budget, Clock};
use clap::Args;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::Renderer;
use std::path::PathBuf;
use std::process::ExitCode;

/// Default number of training steps: the demo takes less than a minute on two cores.
const STEPS: u32 = 5000;
const ORBIT_FRAMES: usize = 36;

/// Train, render and evaluate a built-in scene.
///
/// The scene is ray-traced in code, so its true colours and distances are known.
#[derive(Debug, Args)]
#[command(after_help = "Example: nerf-train demo --out out/demo")]
pub struct Demo {
    /// Output folder.
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    out: PathBuf,
    /// TOML file of settings that override the grid preset (see `config`).
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Number of training steps; 5000 take less than a minute on two cores.
    #[arg(long, value_name = "N", default_value_t = STEPS)]
    steps: u32,
    /// Seed of the initial weights and of all random choices in training.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
}

impl Demo {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let clock = Clock::start();
        let config = self.check()?;
        let spec = DemoSpec::default();
        let dataset = demo::dataset(&spec)?;
        let report = print_report(&dataset, global);
        let options = self.options(&config, global);
        let Ended::Finished(outcome) = run_since(clock, &dataset, config.clone(), &options, &|_| false)?
        else {
            unreachable!("nobody stops it");
        };
        let blob_path = self.out.join("demo.nerf");
        write_atomic(&blob_path, &outcome.bytes)?;
        reports::fit::write_curve(&self.out, &outcome)?;
        reports::fit::write_snapshots(&self.out, &outcome, &dataset)?;
        reports::fit::write_data(&self.out, &report)?;

        let blob = open_blob(&blob_path, &outcome.bytes)?;
        let plan = Plan::new(&blob, &Quality::default(), Outputs::ALL, Batch::FULL)?;
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, options.kernel)];
        let renderer = Renderer::new(blob, options.kernel, &mut memory)?;
        let (scores, z_depth_error) = self.views(&renderer, &plan, outcome.background, &dataset, global)?;
        self.orbit(&renderer, &plan, &spec, global)?;

        let (seconds, data) = (clock.seconds(), &dataset.name);
        let summary = Summary {
            val_psnr_db: scores.psnr_db().unwrap_or(f64::NAN),
            val_ssim: scores.ssim().unwrap_or(f64::NAN),
            z_depth_median_relative_error: Some(z_depth_error),
            ..Summary::of(&outcome, &config, options.kernel, seconds, data, &blob_path)
        };
        write(&summary, &self.out)?;
        global.finish_with(&summary, || self.print(&summary))
    }

    fn check(&self) -> anyhow::Result<Config> {
        let mut config =
            read_config(Preset::Grid, self.config.as_deref(), &SetOption::default(), Surroundings::Known)?;
        config.check()?;
        places::check_folder("--out", &self.out)?;
        Claims::default()
            .reads("the file of settings", self.config.as_deref())
            .writes_folder("--out", &self.out)
            .writes("--out", &self.out.join("demo.nerf"))
            .settle()?;
        config.seed = self.seed;
        config.optimiser.steps = self.steps.max(1);
        Ok(config)
    }

    fn options(&self, config: &Config, global: &Global) -> RunOptions {
        let budget = Budget { steps: Some(config.optimiser.steps), seconds: None };
        let folder = self.out.clone();
        RunOptions {
            snapshots: Some(SnapshotOptions { folder, steps: Vec::new(), views: Vec::new() }),
            ..RunOptions::unattended(budget, global.kernel(), global.style())
        }
    }

    /// Evaluates the held-out views, and writes a contact sheet. Returns scores, and the median relative z-depth error.
    fn views(
        &self,
        renderer: &Renderer<'_>,
        plan: &Plan<'_>,
        background: [f32; 3],
        dataset: &Dataset,
        global: &Global,
    ) -> anyhow::Result<(Scores, f64)> {
        let mut errors = Vec::new();
        let (mut cells, mut done, mut drawn) = (Vec::new(), 0, Ok(()));
        let mut progress = Progress::steps("eval", dataset.val.len(), global.style());
        let scores = evaluate(renderer, plan, background, &dataset.val, |view, frame, truth, _| {
            errors.extend(z_depth_errors(frame, &demo::render_truth(&view.camera)));
            if cells.len() < 12 && drawn.is_ok() {
                drawn = sheet_row(&mut cells, view.name.as_str(), frame, truth);
            }
            done += 1;
            progress.reach(done);
        })?;
        drawn?;
        progress.finish(format!("{} views", scores.views.len()));
        contact_sheet("Held-out views: rendered, truth, z_depth", &cells, 3)
            .write_png(self.out.join("views.png"))?;
        Ok((scores, median(errors)))
    }

    fn orbit(
        &self,
        renderer: &Renderer<'_>,
        plan: &Plan<'_>,
        spec: &DemoSpec,
        global: &Global,
    ) -> anyhow::Result<()> {
        const SIDE: u32 = 192;
        let blob = renderer.blob();
        let Some(scene) = blob.scene() else { return Ok(()) };
        let orbit = Orbit::of(scene, None);
        let fov = 2.0 * (0.5 / spec.focal).atan().to_degrees();
        let mut gif = GifWriter::create(self.out.join("orbit.gif"), SIDE as usize, SIDE as usize, 18.0)?;
        let mut progress = Progress::steps("orbit", ORBIT_FRAMES, global.style());
        for i in 0..ORBIT_FRAMES {
            let camera = orbit.camera(i as f32 / ORBIT_FRAMES as f32, SIDE, SIDE, fov)?;
            gif.push(frame::picture(&frame::render(renderer, plan, &camera)?))?;
            progress.reach(i + 1);
        }
        gif.finish()?;
        progress.finish(format!("{ORBIT_FRAMES} views"));
        Ok(())
    }

    fn print(&self, summary: &Summary) -> anyhow::Result<()> {
        print(lines(summary)?.trim_end())?;
        let files = [
            ("demo.nerf", "the scene: open it with nerf-core or the C ABI"),
            ("views.png", "held-out views, their truth, and z_depth"),
            ("orbit.gif", "a flight around the scene"),
            ("snapshots.png", "two held-out views while training"),
            ("curve.png", "PSNR while training (also .svg and .csv)"),
            ("summary.json", "every figure, with its unit in its name"),
        ];
        let line = |(name, what)| format!("  {:<28} {what}", self.out.join(name).display().to_string());
        print_lines(files.map(line))
    }
}

/// Returns the relative error |z_depth − truth| / truth of each pixel that is opaque in the ray-traced image.
fn z_depth_errors(frame: &Frame, truth: &Truth) -> Vec<f64> {
    let pixels = frame.z_depth.iter().zip(&truth.z_depth).zip(&truth.opaque);
    let opaque = pixels.filter(|&(_, &opaque)| opaque);
    opaque
        .filter_map(|((&found, exact), _)| exact.map(|exact| f64::from((found - exact).abs() / exact)))
        .collect()
}

fn sheet_row(cells: &mut Vec<Cell>, name: &str, frame: &Frame, truth: &[[f32; 3]]) -> anyhow::Result<()> {
    let truth = Picture::new(frame.width, frame.height, truth.to_vec())?;
    cells.push(Cell::new(frame::picture(frame), format!("{name}: rendered")));
    cells.push(Cell::new(truth, format!("{name}: truth")));
    cells.push(Cell::new(picture_of(frame, Output::ZDepth, None)?, format!("{name}: z_depth")));
    Ok(())
}
