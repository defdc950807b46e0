//! What a training run says in the end: text, summary, curves, pictures.

use super::common::{background_name, cpu_name};
use crate::config::Config;
use crate::dataset::{Dataset, Report};
use crate::eval::measure;
use crate::report::contact_sheet::{Cell, contact_sheet};
use crate::report::plot::{LinePlot, Marker, Series};
use crate::report::summary::Summary;
use crate::report::table::Table;
use crate::train::run::{Outcome, file_name, spread};
use nerf_core::kernels::Tier;
use nerf_core::plan::Quality;
use std::path::Path;

/// Prints the result.
pub fn print(outcome: &Outcome, output: &Path) -> anyhow::Result<()> {
    let background = background_name(outcome.background);
    match (outcome.scores.psnr_db(), outcome.scores.ssim()) {
        (Some(psnr), Some(ssim)) => outln!(
            "validation: {psnr:.2} dB PSNR, {ssim:.4} SSIM over {} views on {background}",
            outcome.scores.views.len()
        ),
        _ => outln!("validation: no views"),
    }
    outln!("trained: {} steps in {:.1} s", outcome.steps, outcome.train_seconds);
    if let Some(loss) = outcome.quantisation_loss_db {
        outln!("f16 rounding cost {loss:.3} dB ({} subnormal weights)", outcome.subnormal_weights);
    }
    if outcome.grid_required {
        outln!(
            "without its skip grid the picture changes by {:.2} dB: the grid is part of the model",
            outcome.grid_loss_db
        );
    } else {
        outln!("without its skip grid the picture changes by {:.3} dB", outcome.grid_loss_db);
    }
    outln!("blob: {} ({} bytes)", output.display(), outcome.bytes.len());
    Ok(())
}

/// The fields of `summary.json`.
pub fn summary(outcome: &Outcome, config: &Config, tier: Tier, total_seconds: f64) -> Summary {
    let mut summary = Summary::new();
    // Without validation views null, with a note: scripts rely on the names.
    summary
        .number("val_psnr_db", outcome.scores.psnr_db().unwrap_or(f64::NAN))
        .number("val_ssim", outcome.scores.ssim().unwrap_or(f64::NAN))
        .integer("views", outcome.scores.views.len() as u64)
        .text("background", background_name(outcome.background))
        .number("train_seconds", outcome.train_seconds)
        .number("total_seconds", total_seconds)
        .integer("steps", u64::from(outcome.steps))
        .integer("parameters", outcome.parameters as u64)
        .integer("blob_bytes", outcome.bytes.len() as u64)
        .number("grid_loss_db", outcome.grid_loss_db)
        .flag("grid_required", outcome.grid_required)
        .number_f32("grid_occupancy_share", outcome.occupancy)
        .integer("subnormal_weights", outcome.subnormal_weights as u64)
        .number("live_samples_per_second", outcome.samples_per_second)
        .integer("seed", config.seed)
        .text("kernel", tier.name())
        .integer("threads", rayon::current_num_threads() as u64)
        .text("cpu", cpu_name());
    if let Some(loss) = outcome.quantisation_loss_db {
        summary.number("quantisation_loss_db", loss);
    }
    summary
}

/// Writes summary, settings, curve, plot and validation pictures.
pub fn write(
    folder: &Path,
    outcome: &Outcome,
    dataset: &Dataset,
    summary: &mut Summary,
    report: &Report,
    tier: Tier,
) -> anyhow::Result<()> {
    write_curve(folder, outcome)?;
    write_views(folder, outcome, dataset, tier)?;
    let json = serde_json::to_string_pretty(report)?;
    crate::output::write_atomic(folder.join("data.json"), json.as_bytes())?;
    summary.write(folder)?;
    Ok(())
}

/// `curve.csv`, `curve.png` and `curve.svg`.
pub fn write_curve(folder: &Path, outcome: &Outcome) -> anyhow::Result<()> {
    let mut table = Table::new(["step", "seconds", "train_psnr_db", "val_psnr_db"]);
    let (mut train, mut val) = (Vec::new(), Vec::new());
    for point in &outcome.curve {
        let shown = point.val_psnr_db.map_or_else(String::new, |db| format!("{db:.4}"));
        let cells = [
            point.step.to_string(),
            format!("{:.3}", point.seconds),
            format!("{:.4}", point.train_psnr_db),
            shown,
        ];
        table.push(cells);
        train.push((point.seconds, point.train_psnr_db));
        val.extend(point.val_psnr_db.map(|db| (point.seconds, db)));
    }
    table.write_csv(folder.join("curve.csv"))?;
    let mut plot = LinePlot::new("PSNR while training", "time since the start, s", "PSNR, dB");
    plot.series = vec![
        Series { name: "training rays".into(), points: train, marker: Marker::Line },
        Series { name: "two validation views".into(), points: val, marker: Marker::LineAndPoints },
    ];
    plot.notes = vec![format!(
        "Training rays are drawn near the foreground, so their PSNR is lower than that of whole views. \
         Background: {}.",
        background_name(outcome.background)
    )];
    plot.write(folder.join("curve"))?;
    Ok(())
}

/// Pictures of a few validation views with their truth and their z_depth, and a sheet of them.
fn write_views(folder: &Path, outcome: &Outcome, dataset: &Dataset, tier: Tier) -> anyhow::Result<()> {
    let views = spread(&dataset.val, 4);
    let mut cells = Vec::new();
    let mut written = Ok(());
    let each = |view: &crate::dataset::View,
                frame: &crate::frame::Frame,
                truth: &[[f32; 3]],
                score: &crate::eval::ViewScore| {
        let name = file_name(&view.name);
        let mut write = || -> anyhow::Result<()> {
            frame.picture().write_png(folder.join(format!("{name}.png")))?;
            frame.z_depth_picture()?.write_png(folder.join(format!("{name}_z_depth.png")))?;
            let truth = crate::report::picture::Picture::new(frame.width, frame.height, truth.to_vec())?;
            cells.push(Cell::new(frame.picture(), format!("{}: {:.2} dB", view.name, score.psnr_db)));
            cells.push(Cell::new(truth, format!("{}: truth", view.name)));
            Ok(())
        };
        if written.is_ok() {
            written = write();
        }
    };
    measure(&outcome.bytes, None, tier, &Quality::default(), outcome.background, views, each)?;
    written?;
    if !cells.is_empty() {
        contact_sheet("Validation views", &cells, 4).write_png(folder.join("views.png"))?;
    }
    Ok(())
}
