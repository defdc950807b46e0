//! What a training run says in the end: text, summary, curves, pictures.

use super::common::{background_name, cpu_name, tell};
use super::grid::{self, GridSummary};
use crate::data::names::FileNames;
use crate::data::rgb::Picture;
use crate::data::{Dataset, Report};
use crate::fit::direction::ViewDependence;
use crate::fit::finish::{Outcome, Shown};
use crate::measure::frame;
use crate::model::config::Config;
use crate::show::colour_map::z_depth_picture;
use crate::show::contact_sheet::{Cell, contact_sheet};
use crate::show::plot::{LinePlot, Marker, Series};
use crate::show::snapshots;
use crate::show::summary::{self, Short};
use crate::show::table::Table;
use crate::train::CurvePoint;
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use serde::Serialize;
use std::path::Path;

/// Prints the result.
pub fn print(outcome: &Outcome, output: &Path) -> anyhow::Result<()> {
    let background = background_name(outcome.background);
    match (outcome.scores.psnr_db(), outcome.scores.ssim()) {
        (Some(psnr), Some(ssim)) => outln!(
            "validation: {psnr:.2} dB PSNR, {ssim:.4} SSIM over {}{} on {background}; worst view {:.2} dB",
            count(outcome.scores.views.len(), "view"),
            on_lattice(outcome.lattice),
            outcome.scores.worst_psnr_db().unwrap_or(f64::NAN)
        ),
        _ => outln!("validation: no views"),
    }
    if outcome.flat {
        let views = if outcome.scores.views.is_empty() { "training" } else { "validation" };
        outln!(
            "nothing was learned: a flat colour has {:.2} dB on {views} views; lower --rate, or give it more \
             --steps",
            outcome.flat_psnr_db
        );
    }
    outln!("trained: {} steps in {:.1} s", outcome.steps, outcome.train_seconds);
    if outcome.reseeds > 0 {
        let times = count(outcome.reseeds as usize, "time");
        outln!("started anew {times} with another seed: every density had become 0");
    }
    if !outcome.watched.is_empty() {
        outln!("trend: {}", outcome.trend);
    }
    if let Some(loss) = outcome.quantisation_loss_db {
        outln!("rounding cost {loss:.3} dB ({} subnormal weights)", outcome.subnormal_weights);
    }
    if let Some(ViewDependence { gain_db, left_out }) = outcome.view_dependence {
        let what = if left_out { ": left out, its mean is in its place" } else { "" };
        outln!("view dependence gains {gain_db:.3} dB{what}");
    }
    match outcome.occupancy_loss_db {
        Some(loss) if outcome.occupancy_required => {
            outln!("without its occupancy grid the picture changes by {loss:.2} dB: it is part of the model")
        }
        Some(loss) => outln!("without its occupancy grid the picture changes by {loss:.3} dB"),
        None => {}
    }
    if let Some(grid) = Blob::open(&outcome.bytes).ok().and_then(|blob| grid::describe(&blob)) {
        outln!("learned grid: {grid}");
    }
    outln!("blob: {} ({} bytes)", output.display(), outcome.bytes.len());
    Ok(())
}

/// `1 view`, `2 views`.
fn count(n: usize, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

/// ` (one pixel of 3x3)` where not every pixel was measured.
fn on_lattice(lattice: u32) -> String {
    if lattice == 1 { String::new() } else { format!(" (one pixel of {lattice}x{lattice})") }
}

/// Says of which steps there is no picture though one was asked for.
pub fn tell_missed(outcome: &Outcome) {
    let (last, missed) = (outcome.steps, &outcome.missed_snapshots);
    let (beyond, passed): (Vec<u32>, Vec<u32>) = missed.iter().partition(|&&step| step > last);
    let say = |steps: &[u32], why: String| {
        if !steps.is_empty() {
            let steps: Vec<String> = steps.iter().map(u32::to_string).collect();
            tell(&format!("--snapshots: no picture of step {}: {why}", steps.join(", ")));
        }
    };
    say(&beyond, format!("the run ended at step {last}"));
    say(&passed, "the run had passed it when it was taken up again".into());
}

/// What a fit made, for scripts; what there is none of is null, with a note, or left out.
#[derive(Debug, Serialize)]
#[allow(missing_docs, reason = "the names say what they are, and in which unit")]
pub struct Summary {
    // Without validation views null, with a note: scripts rely on the names.
    pub val_psnr_db: f64,
    pub val_worst_psnr_db: f64,
    pub val_lattice: u32,
    pub val_ssim: f64,
    pub views: usize,
    pub flat: bool,
    pub flat_psnr_db: f64,
    pub background: String,
    pub train_seconds: f64,
    pub total_seconds: f64,
    pub steps: u32,
    pub reseeds: u32,
    pub parameters: usize,
    pub blob_bytes: usize,
    pub occupancy_required: bool,
    pub occupied_share: Short,
    pub subnormal_weights: usize,
    pub evaluated_samples_per_second: f64,
    pub trained_samples_per_second: f64,
    pub seed: u64,
    pub kernel: String,
    pub threads: usize,
    pub cpu: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view_dependence_gain_db: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view_dependence_left_out: Option<bool>,
    pub occupancy_loss_db: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub occupancy_loss_db_note: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quantisation_loss_db: Option<f64>,
    #[serde(flatten)]
    pub grid: Option<GridSummary>,
    #[serde(flatten)]
    pub trend: TrendSummary,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub z_depth_median_relative_error: Option<f64>,
    pub data: String,
    pub blob: String,
}

impl Summary {
    /// Of a fit to the data of this name, written to `blob`.
    pub fn of(
        outcome: &Outcome,
        config: &Config,
        kernel: Kernel,
        total_seconds: f64,
        data: &str,
        blob: &Path,
    ) -> Self {
        let [evaluated_samples_per_second, trained_samples_per_second] = outcome.samples_per_second;
        let asked = outcome.occupancy_loss_db.is_some();
        Self {
            val_psnr_db: outcome.scores.psnr_db().unwrap_or(f64::NAN),
            val_worst_psnr_db: outcome.scores.worst_psnr_db().unwrap_or(f64::NAN),
            val_lattice: outcome.lattice,
            val_ssim: outcome.scores.ssim().unwrap_or(f64::NAN),
            views: outcome.scores.views.len(),
            flat: outcome.flat,
            flat_psnr_db: outcome.flat_psnr_db,
            background: background_name(outcome.background),
            train_seconds: outcome.train_seconds,
            total_seconds,
            steps: outcome.steps,
            reseeds: outcome.reseeds,
            parameters: outcome.parameters,
            blob_bytes: outcome.bytes.len(),
            occupancy_required: outcome.occupancy_required,
            occupied_share: Short(outcome.occupied_share),
            subnormal_weights: outcome.subnormal_weights,
            evaluated_samples_per_second,
            trained_samples_per_second,
            seed: config.seed,
            kernel: kernel.to_string(),
            threads: rayon::current_num_threads(),
            cpu: cpu_name(),
            view_dependence_gain_db: outcome.view_dependence.map(|found| found.gain_db),
            view_dependence_left_out: outcome.view_dependence.map(|found| found.left_out),
            occupancy_loss_db: outcome.occupancy_loss_db,
            occupancy_loss_db_note: (!asked).then_some("a grid field is not asked outside of its occupancy"),
            quantisation_loss_db: outcome.quantisation_loss_db,
            grid: Blob::open(&outcome.bytes).ok().and_then(|blob| GridSummary::of(&blob)),
            trend: TrendSummary::of(outcome),
            z_depth_median_relative_error: None,
            data: data.into(),
            blob: blob.display().to_string(),
        }
    }
}

/// Validation on the way, and when it stopped rising.
#[derive(Debug, Serialize)]
#[allow(missing_docs, reason = "the names say what they are, and in which unit")]
pub struct TrendSummary {
    pub watched_views: usize,
    pub validations: usize,
    pub last_watched_psnr_db: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub last_watched_psnr_db_note: Option<String>,
    pub val_stopped_rising_step: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub val_stopped_rising_step_note: Option<String>,
    pub val_stopped_rising_seconds: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub val_stopped_rising_seconds_note: Option<String>,
}

impl TrendSummary {
    fn of(outcome: &Outcome) -> Self {
        let none = "there are no validation views";
        let validations: Vec<f64> = outcome.curve.iter().filter_map(|point| point.val_psnr_db).collect();
        let last = validations.last().copied();
        let stop = if outcome.watched.is_empty() { Err(none.into()) } else { outcome.trend.overfitting() };
        let why = stop.as_ref().err().cloned();
        let stop = stop.ok();
        Self {
            watched_views: outcome.watched.len(),
            validations: validations.len(),
            last_watched_psnr_db: last,
            last_watched_psnr_db_note: last.is_none().then(|| none.to_owned()),
            val_stopped_rising_step: stop.as_ref().map(|stop| stop.step),
            val_stopped_rising_step_note: why.clone(),
            val_stopped_rising_seconds: stop.as_ref().map(|stop| stop.seconds),
            val_stopped_rising_seconds_note: why,
        }
    }
}

/// Writes summary, settings, curve, plot and validation pictures.
pub fn write(
    folder: &Path,
    outcome: &Outcome,
    dataset: &Dataset,
    summary: &Summary,
    report: &Report,
) -> anyhow::Result<()> {
    write_curve(folder, outcome)?;
    write_snapshots(folder, outcome, dataset)?;
    write_views(folder, outcome, dataset)?;
    let json = serde_json::to_string_pretty(report)?;
    crate::data::system::output::write_atomic(
        folder.join("data.json"),
        crate::data::system::printable::json(&json).as_bytes(),
    )?;
    summary::write(summary, folder)?;
    Ok(())
}

/// `curve.csv`; and PSNR over time as `curve.png` and `.svg`, over steps as `curve_steps.png` and `.svg`.
pub fn write_curve(folder: &Path, outcome: &Outcome) -> anyhow::Result<()> {
    let mut table =
        Table::new(["step", "seconds", "train_psnr_db", "val_psnr_db", "val_views", "val_lattice"]);
    for point in &outcome.curve {
        // Empty cells where the run was not validated.
        let measured = |text: String| if point.val_psnr_db.is_some() { text } else { String::new() };
        table.push([
            point.step.to_string(),
            format!("{:.3}", point.seconds),
            format!("{:.4}", point.train_psnr_db),
            point.val_psnr_db.map_or_else(String::new, |db| format!("{db:.4}")),
            measured(point.val_views.to_string()),
            measured(point.val_lattice.to_string()),
        ]);
    }
    table.write_csv(folder.join("curve.csv"))?;
    plot(outcome, "time since the start, s", |point| point.seconds).write(folder.join("curve"))?;
    plot(outcome, "steps", |point| f64::from(point.step)).write(folder.join("curve_steps"))?;
    Ok(())
}

/// Training and validation PSNR over `x`.
fn plot(outcome: &Outcome, x_label: &str, x: impl Fn(&CurvePoint) -> f64) -> LinePlot {
    let series = |name: String, marker, y: &dyn Fn(&CurvePoint) -> Option<f64>| {
        let points = outcome.curve.iter().filter_map(|point| Some((x(point), y(point)?))).collect();
        Series { name, points, marker }
    };
    let mut plot = LinePlot::new("PSNR while training", x_label, "PSNR, dB");
    plot.series.push(series("training rays".into(), Marker::Line, &|point| Some(point.train_psnr_db)));
    plot.notes.push(format!(
        "Training rays are drawn near the foreground, where errors are larger than over whole views. \
         Background: {}.",
        background_name(outcome.background)
    ));
    if !outcome.watched.is_empty() {
        let views = count(outcome.watched.len(), "validation view");
        plot.series.push(series(views, Marker::LineAndPoints, &|point| point.val_psnr_db));
        plot.notes.push(format!("Trend: {}.", outcome.trend));
    }
    plot
}

/// `snapshots.png`: views while training, ground truth last; nothing where no pictures were taken.
pub fn write_snapshots(folder: &Path, outcome: &Outcome, dataset: &Dataset) -> anyhow::Result<()> {
    let (taken, background) = (&outcome.snapshots, outcome.background);
    let title = format!(
        "{}: validation views while training, PSNR of each on {}",
        dataset.name,
        background_name(background)
    );
    if let Some(sheet) = snapshots::sheet(&title, folder, dataset, taken, background) {
        sheet.write_png(folder.join("snapshots.png"))?;
    }
    Ok(())
}

/// Pictures of a few validation views with their truth and their z_depth, and a sheet of them.
fn write_views(folder: &Path, outcome: &Outcome, dataset: &Dataset) -> anyhow::Result<()> {
    let names = FileNames::of(&dataset.val);
    let mut cells = Vec::new();
    for Shown { view, frame, truth, psnr_db } in &outcome.shown {
        let view = &dataset.val[*view];
        let (file, name) = (names.stem(view), &view.name);
        frame::picture(frame).write_png(folder.join(format!("{file}.png")))?;
        z_depth_picture(frame)?.write_png(folder.join(format!("{file}_z_depth.png")))?;
        let truth = Picture::new(frame.width, frame.height, truth.clone())?;
        cells.push(Cell::new(frame::picture(frame), format!("{name}: {psnr_db:.2} dB")));
        cells.push(Cell::new(truth, format!("{name}: truth")));
    }
    if !cells.is_empty() {
        contact_sheet("Validation views", &cells, 4).write_png(folder.join("views.png"))?;
    }
    Ok(())
}
