//! What fits of the same time say: PSNR over time, and over the size of the file.

use crate::data::pictures::rgb::ReportError;
use crate::lab::study::training::{Fitted, Group};
use crate::show::plot::{LinePlot, Marker, Series};
use crate::show::table::Table;
use crate::system::output::write_atomic;
use crate::system::printable::markdown;
use crate::system::summary;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;

/// Curves of a plot that can be told apart.
const MAX_SERIES: usize = 7;

/// One row a fit, in their order.
pub fn table(fits: &[Fitted]) -> Table {
    let columns = ["group", "fit", "PSNR, dB", "time, s", "steps", "parameters", "file, bytes", "note"];
    let mut table = Table::new(columns);
    for fit in fits {
        let db = fit.psnr_db.map_or_else(String::new, |db| format!("{db:.2}"));
        table.push([
            fit.trial.group.name().to_owned(),
            fit.trial.name.clone(),
            db,
            format!("{:.1}", fit.seconds),
            fit.steps.to_string(),
            fit.parameters.to_string(),
            fit.bytes.to_string(),
            fit.note.clone(),
        ]);
    }
    table
}

/// Writes table.csv, curves.csv, report.md, a plot a group, and summary.json into `folder`.
///
/// # Errors
/// [`ReportError`] on files that cannot be written.
pub fn write(fits: &[Fitted], data: &str, folder: &Path) -> Result<(), ReportError> {
    table(fits).write_csv(folder.join("table.csv"))?;
    let mut curves = Table::new(["fit", "seconds", "val_psnr_db"]);
    for fit in fits {
        for (seconds, db) in &fit.curve {
            curves.push([fit.trial.name.clone(), seconds.to_string(), db.to_string()]);
        }
    }
    curves.write_csv(folder.join("curves.csv"))?;
    let mut text = format!("# PSNR over the time of a fit: {}\n\n", markdown(data));
    // Writing into a String cannot fail.
    let mut machines: Vec<&str> = fits.iter().map(|fit| fit.machine.as_str()).collect();
    machines.sort_unstable();
    machines.dedup();
    let _ = writeln!(text, "On {}.\n\n{}", machines.join("; "), table(fits).to_markdown());
    for group in groups(fits) {
        let name = group.name();
        plot(fits, data, group).write(folder.join(format!("psnr_over_time_{name}")))?;
        let _ = writeln!(text, "![{name}](psnr_over_time_{name}.png)\n");
    }
    if let Some(plot) = size_plot(fits, data) {
        plot.write(folder.join("psnr_over_bytes"))?;
        let _ = writeln!(text, "![what a file holds](psnr_over_bytes.png)\n");
    }
    let _ = writeln!(
        text,
        "Curves are means over the few validation views that a fit watches; the table's PSNR is the exported blob's, \
         over all of them. A fit follows its schedule to the end of its time: a curve is not what a longer fit \
         shows on its way."
    );
    write_atomic(folder.join("report.md"), text.as_bytes())?;
    summary::write(&Summary::of(fits), folder)?;
    Ok(())
}

/// What the fits came to; summary.json.
#[derive(Debug, Serialize)]
pub struct Summary<'f> {
    fits: Vec<FitSummary<'f>>,
}

#[derive(Debug, Serialize)]
struct FitSummary<'f> {
    fit: &'f str,
    group: &'static str,
    val_psnr_db: f64,
    train_seconds: f64,
    steps: u32,
    parameters: usize,
    bytes: usize,
    note: &'f str,
    curve_seconds: Vec<f64>,
    curve_val_psnr_db: Vec<f64>,
}

impl<'f> Summary<'f> {
    /// Of these fits, in their order.
    pub fn of(fits: &'f [Fitted]) -> Self {
        let fit = |fit: &'f Fitted| {
            let (curve_seconds, curve_val_psnr_db) = fit.curve.iter().copied().unzip();
            FitSummary {
                fit: &fit.trial.name,
                group: fit.trial.group.name(),
                val_psnr_db: fit.psnr_db.unwrap_or(f64::NAN),
                train_seconds: fit.seconds,
                steps: fit.steps,
                parameters: fit.parameters,
                bytes: fit.bytes,
                note: &fit.note,
                curve_seconds,
                curve_val_psnr_db,
            }
        };
        Self { fits: fits.iter().map(fit).collect() }
    }
}

fn groups(fits: &[Fitted]) -> Vec<Group> {
    let mut groups: Vec<Group> = fits.iter().map(|fit| fit.trial.group).collect();
    groups.dedup();
    groups
}

fn plot(fits: &[Fitted], data: &str, group: Group) -> LinePlot {
    let name = group.name();
    let title = format!("{data}: PSNR over the time of a fit, by {name}");
    let mut plot = LinePlot::new(title, "seconds, everything included", "mean PSNR of watched views, dB");
    let of_group = fits.iter().filter(|fit| fit.trial.group == group).take(MAX_SERIES);
    let series = |fit: &Fitted| Series {
        name: fit.trial.name.clone(),
        points: fit.curve.clone(),
        marker: Marker::LineAndPoints,
    };
    plot.series = of_group.map(series).collect();
    plot
}

/// What files of different sizes hold after each time: the table sizes, or all fits where none are compared; `None` of
/// fewer than two.
fn size_plot(fits: &[Fitted], data: &str) -> Option<LinePlot> {
    let tables = fits.iter().any(|fit| fit.trial.group == Group::Table);
    let shown =
        || fits.iter().filter(|fit| fit.psnr_db.is_some() && (fit.trial.group == Group::Table || !tables));
    let mut seconds: Vec<f64> = shown().map(|fit| fit.trial.budget_seconds).collect();
    seconds.sort_by(f64::total_cmp);
    seconds.dedup();
    let series = |&seconds: &f64| {
        let fits = shown().filter(|fit| fit.trial.budget_seconds == seconds);
        let mut points: Vec<(f64, f64)> =
            fits.filter_map(|fit| Some((fit.bytes as f64 / 1024.0, fit.psnr_db?))).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let marker = if tables { Marker::LineAndPoints } else { Marker::Points };
        Series { name: format!("{seconds} s"), points, marker }
    };
    if shown().count() < 2 {
        return None;
    }
    let title = format!("{data}: what a file of each size holds");
    let mut plot = LinePlot::new(title, "whole file, KiB", "mean PSNR of validation views, dB");
    plot.series = seconds.iter().take(MAX_SERIES).map(series).collect();
    plot.log_x = true;
    Some(plot)
}
