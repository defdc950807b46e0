//! `nerf-train eval`

use super::common::{
    DataOptions, Global, QualityOptions, WhichBins, background_name, cpu_name, open_blob, parse_background,
    read_file,
};
use super::places;
use crate::data::View;
use crate::data::names::FileNames;
use crate::data::system::output::claims::Claims;
use crate::data::system::progress::{Message, Progress, Total};
use crate::measure::eval::{ViewScore, evaluate};
use crate::measure::frame;
use crate::measure::metrics::psnr_db;
use crate::show::summary::write;
use crate::show::table::Table;
use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan};
use nerf_core::render::Renderer;
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// A part of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Split {
    /// What was fitted.
    Train,
    /// What the fit was watched on.
    Val,
    /// What is left.
    Test,
}

impl Split {
    /// Its views.
    pub fn of(self, dataset: &crate::data::Dataset) -> &[View] {
        match self {
            Self::Train => &dataset.train,
            Self::Val => &dataset.val,
            Self::Test => &dataset.test,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::Test => "test",
        }
    }
}

/// Measure a blob on views of a data set: PSNR and SSIM per view and their means.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: nerf-train eval lego.nerf lego_200x200.npz --background white --report out/eval"
)]
pub struct Eval {
    /// The blob.
    file: PathBuf,
    /// The data set.
    data: PathBuf,
    /// Which views.
    #[arg(long, value_enum, default_value = "val")]
    split: Split,
    /// Take every N-th view of the split only.
    #[arg(long, value_name = "N", default_value_t = 1)]
    every: usize,
    /// Print the PSNR over every N-th pixel of every N-th row too, from the first: many a published figure is
    /// of such a lattice, and differs from that of all pixels.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    lattice: Option<u32>,
    /// What is behind the scene: black, white, red, #RRGGBB or R,G,B (0 to 255) [default: the blob's own].
    #[arg(long, value_name = "COLOUR", value_parser = parse_background)]
    background: Option<[f32; 3]>,
    /// Folder for summary.json, the table and the pictures.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    data_options: DataOptions,
}

impl Eval {
    /// Runs the command.
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        if self.every == 0 {
            bail!("--every: expected at least 1, found 0");
        }
        places::check_report(self.report.as_ref())?;
        Claims::new()
            .reads("the blob", &self.file)
            .reads_data(&self.data)
            .writes_folder_if("--report", self.report.as_deref(), &places::EVAL)
            .settle()?;
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let kernel = global.kernel();
        let quality = self.quality.quality();
        let plan = Plan::new(&blob, &quality, Outputs::ALL, Batch::FULL)
            .and_then(|plan| self.data_options.range_of(plan))
            .map(|plan| self.quality.bins_of(plan, WhichBins::Own))
            .with_context(|| self.file.display().to_string())?;
        let own = blob.scene().map_or([0.0; 3], |scene| scene.background);
        let background = self.background.unwrap_or(own);
        let plan = plan.with_background(background)?;
        let dataset = self.data_options.read_for(&self.data, &blob, global)?;
        let split = self.split.of(&dataset);
        let (views, names): (Vec<&View>, _) =
            (split.iter().step_by(self.every).collect(), FileNames::of(split));
        if views.is_empty() {
            bail!(
                "{}: the split `{}` has no views; it has {} train, {} val and {} test: choose with --split",
                self.data.display(),
                self.split.name(),
                dataset.train.len(),
                dataset.val.len(),
                dataset.test.len()
            );
        }
        let opaque = views.iter().all(|view| !view.has_alpha());
        if opaque && background != own {
            global.say(
                "note: these pictures have no alpha, so their own background stays in the truth whatever \
                 --background says",
            );
        }
        let parameters = blob.architecture().parameters();
        let steps = blob.provenance().steps;
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob, kernel, &mut memory)?;
        let start = Instant::now();
        let mut progress = Progress::new("eval", Total::Steps(views.len() as u64), global.style());
        let mut table = Table::new(["view", "psnr_db", "ssim"]);
        let (mut done, mut written) = (0, Ok(()));
        let mut lattice_db = Vec::new();
        let scores = evaluate(&renderer, &plan, background, views, |view, frame, truth, score| {
            done += 1;
            if let Some(step) = self.lattice {
                let on = |picture| lattice(picture, frame.width, step as usize);
                lattice_db.push(psnr_db(&on(&frame.rgb), &on(truth)));
            }
            progress.update(done, &Message::default());
            table.push([score.view.clone(), format!("{:.3}", score.psnr_db), format!("{:.4}", score.ssim)]);
            if let (Some(folder), Ok(())) = (&self.report, &written) {
                let name = format!("{}.png", names.stem(view));
                written = frame::picture(frame).write_png(folder.join(name));
            }
        })?;
        written?;
        let seconds = start.elapsed().as_secs_f64();
        progress.finish(format!("{done} views"));
        let (psnr, ssim) = (scores.psnr_db().unwrap_or(f64::NAN), scores.ssim().unwrap_or(f64::NAN));
        let name = background_name(background);
        let c = &scores.counters;
        let rays = c.rays.max(1) as f64;
        let (density, colour) = (c.density_evaluations as f64 / rays, c.colour_evaluations as f64 / rays);
        let proposal = c.proposal_evaluations as f64 / rays;
        let lattice_psnr_db =
            (!lattice_db.is_empty()).then(|| lattice_db.iter().sum::<f64>() / lattice_db.len() as f64);
        let summary = Summary {
            val_psnr_db: psnr,
            val_ssim: ssim,
            views: done,
            split: self.split.name(),
            background: name.clone(),
            steps,
            parameters,
            blob_bytes: bytes.len(),
            render_seconds: seconds,
            density_evaluations_per_ray: density,
            colour_evaluations_per_ray: colour,
            proposal_evaluations_per_ray: proposal,
            invalid_samples: c.invalid_samples,
            macs: c.macs,
            kernel: kernel.to_string(),
            threads: rayon::current_num_threads(),
            cpu: cpu_name(),
            view_scores: &scores.views,
            lattice_psnr_db,
        };
        if let Some(folder) = &self.report {
            table.write_csv(folder.join("views.csv"))?;
            write(&summary, folder)?;
        }
        global.finish(&summary, || {
            outlines!(table.to_text());
            outln!("mean over {done} views on {name}: {psnr:.3} dB PSNR, {ssim:.4} SSIM");
            if let (Some(step), Some(mean)) = (self.lattice, lattice_psnr_db) {
                outln!("over every pixel number 0, {step}, {}, … of such rows: {mean:.3} dB PSNR", 2 * step);
            }
            outln!("{seconds:.3} s; a ray: {density:.2} density and {colour:.2} colour evaluations");
            if c.proposal_evaluations > 0 {
                outln!("a ray: {proposal:.2} evaluations of the proposal");
            }
            if c.invalid_samples > 0 {
                outln!("{} samples were NaN and counted as empty", c.invalid_samples);
            }
            Ok(())
        })?;
        Ok(ExitCode::SUCCESS)
    }
}

/// The pixels whose column and row are multiples of `step`.
fn lattice(picture: &[[f32; 3]], width: usize, step: usize) -> Vec<[f32; 3]> {
    let rows = picture.chunks_exact(width).step_by(step);
    rows.flat_map(|row| row.iter().step_by(step)).copied().collect()
}

/// What an evaluation found, for scripts.
#[derive(Debug, Serialize)]
struct Summary<'s> {
    val_psnr_db: f64,
    val_ssim: f64,
    views: u64,
    split: &'static str,
    background: String,
    steps: u32,
    parameters: usize,
    blob_bytes: usize,
    render_seconds: f64,
    density_evaluations_per_ray: f64,
    colour_evaluations_per_ray: f64,
    proposal_evaluations_per_ray: f64,
    invalid_samples: u64,
    macs: u64,
    kernel: String,
    threads: usize,
    cpu: String,
    view_scores: &'s [ViewScore],
    #[serde(skip_serializing_if = "Option::is_none")]
    lattice_psnr_db: Option<f64>,
}
