//! The report of an `image fit`: curve, contact sheet, pictures.

use crate::data::pictures::photograph::Photo;
use crate::data::pictures::rgb::Picture;
use crate::fit::picture::{Outcome, Summary};
use crate::show::contact_sheet::{Cell, contact_sheet};
use crate::show::plot::{LinePlot, Marker, Series};
use crate::show::table::Table;
use crate::system::summary;
use crate::train::CurvePoint;
use std::path::{Path, PathBuf};

/// Writes all files of the report into `folder`. `snapshots`: steps whose pictures are read from `folder/snapshots`.
pub fn write(
    folder: &Path,
    photo: &Photo,
    outcome: &Outcome,
    snapshots: &[u32],
    summary: &Summary<'_>,
) -> anyhow::Result<()> {
    write_curve(folder, photo, outcome)?;
    write_sheet(folder, photo, outcome, snapshots)?;
    outcome.picture.write_png(folder.join("picture.png"))?;
    summary::write(summary, folder)?;
    Ok(())
}

/// Writes `curve.csv`, and plots PSNR over steps as `curve.png` and `curve.svg`.
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

pub fn step_file(snapshots: &Path, step: u32) -> PathBuf {
    snapshots.join(format!("step_{step:06}.png"))
}

/// Writes `sheet.png`: the snapshots, including those saved before a resume, then the final picture and the target.
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
