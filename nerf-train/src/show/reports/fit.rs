//! The report of a fit: summary, curve, snapshots, validation views.

use crate::data::names::{FileNames, count};
use crate::data::pictures::colour;
use crate::data::pictures::rgb::Picture;
use crate::data::{Dataset, Report};
use crate::fit::finish::{Outcome, Shown};
use crate::fit::summary::Summary;
use crate::measure::frame;
use crate::show::contact_sheet::{Cell, contact_sheet};
use crate::show::plot::{LinePlot, Marker, Series};
use crate::show::table::Table;
use crate::show::view::{Output, picture_of};
use crate::system::output::{ensure_folder, write_atomic};
use crate::system::{printable, summary};
use crate::train::{CurvePoint, Snapshot};
use anyhow::Context;
use std::collections::BTreeSet;
use std::path::Path;

/// Longer side of a picture on the contact sheet, pixels: larger pictures are reduced.
const SHEET_SIDE: usize = 400;
/// Colour of the cell of a missing picture.
const NOTHING: [f32; 3] = [0.88; 3];

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

/// Writes `data.json`, the report about the data set.
pub fn write_data(folder: &Path, report: &Report) -> anyhow::Result<()> {
    let json = serde_json::to_string_pretty(report).context("cannot make the data.json")?;
    Ok(write_atomic(folder.join("data.json"), printable::json(&json).as_bytes())?)
}

/// Writes `curve.csv`; plots PSNR over time as `curve.png` and `.svg`, over steps as `curve_steps.png` and `.svg`.
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

/// Writes `snapshots.png`: validation views during training, ground truth last. No file if there are no snapshots.
pub fn write_snapshots(folder: &Path, outcome: &Outcome, dataset: &Dataset) -> anyhow::Result<()> {
    let (taken, background) = (&outcome.snapshots, outcome.background);
    let title = format!(
        "{}: validation views while training, PSNR of each on {}",
        dataset.name,
        colour::name(background)
    );
    if let Some(sheet) = sheet(&title, folder, dataset, taken, background) {
        sheet.write_png(folder.join("snapshots.png"))?;
    }
    Ok(())
}

/// Makes a contact sheet with a row per view, a column per step, and a last column of ground truth over `background`.
/// Returns `None` without snapshots. The snapshots' pictures are read from `folder`, including pictures saved before a
/// resume. A missing picture becomes a grey cell.
fn sheet(
    title: &str,
    folder: &Path,
    dataset: &Dataset,
    snapshots: &[Snapshot],
    background: [f32; 3],
) -> Option<Picture> {
    let steps: BTreeSet<u32> = snapshots.iter().map(|snapshot| snapshot.step).collect();
    let views: BTreeSet<usize> = snapshots.iter().map(|snapshot| snapshot.view).collect();
    let mut cells = Vec::new();
    for (index, view) in views.iter().filter_map(|&index| Some((index, dataset.val.get(index)?))) {
        let (width, height) = view.size();
        let (width, height) = (width as usize, height as usize);
        let truth = Picture { width, height, rgb: view.composite_over(background) };
        for &step in &steps {
            let taken = snapshots.iter().find(|taken| (taken.step, taken.view) == (step, index));
            let stored = taken.and_then(|taken| {
                let picture = Picture::read(taken.path(folder, dataset))?;
                // A snapshot may have only every N-th pixel of the view: it is enlarged to ground truth's size.
                let fits = picture.width <= width && picture.height <= height;
                fits.then(|| (picture.enlarged(width / picture.width.max(1)), taken.psnr_db))
            });
            let (picture, said) = match stored {
                Some((picture, psnr_db)) => (picture, format!("{psnr_db:.2} dB")),
                None => (Picture::filled(width, height, NOTHING), "no picture".to_owned()),
            };
            let caption = format!("{}\nstep {step}\n{said}", view.name);
            cells.push(Cell::new(picture.reduced_to(SHEET_SIDE), caption));
        }
        cells.push(Cell::new(truth.reduced_to(SHEET_SIDE), format!("{}\nground truth", view.name)));
    }
    (!cells.is_empty()).then(|| contact_sheet(title, &cells, steps.len() + 1))
}

/// Writes a picture and a z_depth picture of a few validation views, and a contact sheet of pictures and ground truth.
fn write_views(folder: &Path, outcome: &Outcome, dataset: &Dataset) -> anyhow::Result<()> {
    let names = FileNames::of(&dataset.val);
    let mut cells = Vec::new();
    for Shown { view, frame, truth, psnr_db } in &outcome.shown {
        let view = &dataset.val[*view];
        let (file, name) = (names.stem(view), &view.name);
        frame::picture(frame).write_png(folder.join(format!("{file}.png")))?;
        picture_of(frame, Output::ZDepth, None)?.write_png(folder.join(format!("{file}_z_depth.png")))?;
        let truth = Picture::new(frame.width, frame.height, truth.clone())?;
        cells.push(Cell::new(frame::picture(frame), format!("{name}: {psnr_db:.2} dB")));
        cells.push(Cell::new(truth, format!("{name}: truth")));
    }
    if !cells.is_empty() {
        contact_sheet("Validation views", &cells, 4).write_png(folder.join("views.png"))?;
    }
    Ok(())
}

/// Writes `moved/NAME.png`: training photographs, red where moving objects are left out of the loss.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::demo;

    #[test]
    fn a_sheet_has_a_row_a_view_and_the_truth_last() {
        let (dataset, folder) = (demo::small(1, 3, 24), tempfile::tempdir().expect("a folder"));
        std::fs::create_dir(folder.path().join("snapshots")).expect("a folder");
        assert!(sheet("a title", folder.path(), &dataset, &[], [0.0; 3]).is_none());
        let red = Picture::filled(24, 24, [1.0, 0.0, 0.0]);
        let taken = |step, view| Snapshot { step, seconds: 0.0, view, psnr_db: 10.0 };
        let snapshots = [taken(10, 0), taken(10, 2), taken(30, 2)];
        for snapshot in &snapshots[..2] {
            red.write_png(snapshot.path(folder.path(), &dataset)).expect("written");
        }
        let sheet = sheet("a title", folder.path(), &dataset, &snapshots, [0.0; 3]).expect("a sheet");
        let count = |colour: [f32; 3]| sheet.rgb.iter().filter(|rgb| **rgb == colour).count();
        // Of six pictures, each enlarged eight times, two exist, two are missing, and two are ground truth.
        assert_eq!((count([1.0, 0.0, 0.0]), count(NOTHING)), (2 * 192 * 192, 2 * 192 * 192));
        assert!(sheet.width >= 3 * 192 && sheet.height >= 2 * 192);
    }
}
