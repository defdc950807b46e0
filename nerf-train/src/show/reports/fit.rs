//! The report of a fit: summary, curve, snapshots, validation views.

use crate::data::names::{FileNames, count};
use crate::data::pictures::colour;
use crate::data::pictures::rgb::Picture;
use crate::data::{Dataset, Report};
use crate::fit::finish::{Outcome, Shown};
use crate::fit::summary::Summary;
use crate::measure::frame;
use crate::show::colour_map::z_depth_picture;
use crate::show::contact_sheet::{Cell, contact_sheet};
use crate::show::plot::{LinePlot, Marker, Series};
use crate::show::snapshots;
use crate::show::table::Table;
use crate::system::output::{ensure_folder, write_atomic};
use crate::system::{printable, summary};
use crate::train::CurvePoint;
use anyhow::Context;
use std::path::Path;

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
    write_moved(folder, outcome, dataset)?;
    write_data(folder, report)?;
    summary::write(summary, folder)?;
    Ok(())
}

/// `data.json`: report about the data set.
pub fn write_data(folder: &Path, report: &Report) -> anyhow::Result<()> {
    let json = serde_json::to_string_pretty(report).context("cannot make the data.json")?;
    Ok(write_atomic(folder.join("data.json"), printable::json(&json).as_bytes())?)
}

/// `curve.csv`; and PSNR over time as `curve.png` and `.svg`, over steps as `curve_steps.png` and `.svg`.
pub fn write_curve(folder: &Path, outcome: &Outcome) -> anyhow::Result<()> {
    let mut table =
        Table::new(["step", "seconds", "train_psnr_db", "val_psnr_db", "val_views", "val_lattice"]);
    for point in &outcome.curve {
        // Cells are empty at points without a validation.
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
        colour::name(outcome.background)
    ));
    if !outcome.watched.is_empty() {
        let views = count(outcome.watched.len(), "validation view");
        plot.series.push(series(views, Marker::LineAndPoints, &|point| point.val_psnr_db));
        plot.notes.extend(outcome.overfitting.map(|stop| format!("Trend: {stop}.")));
    }
    plot
}

/// `snapshots.png`: views while training, ground truth last; nothing if no pictures were taken.
pub fn write_snapshots(folder: &Path, outcome: &Outcome, dataset: &Dataset) -> anyhow::Result<()> {
    let (taken, background) = (&outcome.snapshots, outcome.background);
    let title = format!(
        "{}: validation views while training, PSNR of each on {}",
        dataset.name,
        colour::name(background)
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

/// `moved/NAME.png`: training photographs, red where something that moved was left out of the loss.
fn write_moved(folder: &Path, outcome: &Outcome, dataset: &Dataset) -> anyhow::Result<()> {
    let (names, moved_folder) = (FileNames::of(&dataset.train), folder.join("moved"));
    if !outcome.moved.is_empty() {
        ensure_folder(&moved_folder)?;
    }
    for moved in &outcome.moved {
        let view = &dataset.train[moved.view];
        let (width, height) = view.size();
        let mut rgb = view.composite_over(outcome.background);
        for ([r, g, b], _) in rgb.iter_mut().zip(&moved.mask).filter(|(_, masked)| **masked) {
            (*r, *g, *b) = (0.5 + 0.5 * *r, 0.5 * *g, 0.5 * *b);
        }
        let picture = Picture::new(width as usize, height as usize, rgb)?;
        picture.write_png(moved_folder.join(format!("{}.png", names.at(moved.view))))?;
    }
    Ok(())
}
