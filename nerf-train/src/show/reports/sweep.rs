//! Report of a sweep: a table, plots of PSNR over each setting and over time, a sheet of pictures.

use crate::data::pictures::rgb::Picture;
use crate::lab::sweep::{Folder, Kind, Knob, Record, Status, records};
use crate::show::contact_sheet::{Cell, contact_sheet};
use crate::show::plot::{LinePlot, Marker, Series};
use crate::show::table::Table;
use crate::system::output::write_atomic;
use crate::system::printable::markdown as markdown_text;
use clap::ValueEnum;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use std::fmt::Write as _;
use std::path::Path;

/// Largest number of curves in a plot; more could not be told apart. Beyond it, one or two curves combine all runs.
const MAX_SERIES: usize = 7;
/// Longest side of a picture on the contact sheet, pixels.
const THUMBNAIL: usize = 256;

/// Writes table.csv, report.md, sheet.png and plots of the finished runs into `folder`; returns the runs' records.
pub fn write_report(folder: &Folder) -> anyhow::Result<Vec<Record>> {
    let records = records(folder)?;
    let path = &folder.path;
    let table = table(&records);
    table.write_csv(path.join("table.csv"))?;
    write_atomic(path.join("report.md"), markdown(folder, &records).as_bytes())?;
    for knob in varied(&records) {
        knob_plot(folder, &records, knob).write(path.join(format!("psnr_over_{}", knob.name())))?;
    }
    time_plot(folder, &records).write(path.join("psnr_over_time"))?;
    if let Some(sheet) = sheet(folder, &records) {
        sheet.write_png(path.join("sheet.png"))?;
    }
    Ok(records)
}

fn varied(records: &[Record]) -> Vec<Knob> {
    Knob::value_variants().iter().copied().filter(|&knob| values(records, knob).len() > 1).collect()
}

fn values(records: &[Record], knob: Knob) -> Vec<f64> {
    let mut values: Vec<f64> = records.iter().filter_map(|record| record.point.get(knob)).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}

/// Returns all runs ordered by PSNR, the best first; diverged runs last.
fn ranked(records: &[Record]) -> Vec<&Record> {
    let mut ranked: Vec<&Record> = records.iter().collect();
    let key = |record: &Record| match record.status {
        Status::Ok | Status::Flat => record.psnr_db.unwrap_or(f64::MIN),
        Status::Diverged => f64::NEG_INFINITY,
    };
    ranked.sort_by(|a, b| key(b).total_cmp(&key(a)));
    ranked
}

/// Returns the table of the runs, one per row, the best first.
pub fn table(records: &[Record]) -> Table {
    let knobs =
        records.first().map_or(Vec::new(), |r| r.point.values().map(|(knob, _)| knob.name()).collect());
    let columns = ["PSNR, dB", "status", "time, s", "steps"];
    let more = ["parameters", "MACs a sample", "blob, bytes", "note"];
    let mut table = Table::new(["rank"].into_iter().chain(knobs).chain(columns).chain(more));
    for (rank, record) in ranked(records).into_iter().enumerate() {
        let values = record.point.values().map(|(_, value)| value.to_string());
        let results = [
            record.psnr_db.map_or_else(String::new, |db| format!("{db:.2}")),
            status(record).into(),
            format!("{:.1}", record.train_seconds),
            record.steps.to_string(),
            record.parameters.to_string(),
            record.macs.to_string(),
            record.blob_bytes.to_string(),
            record.note.clone(),
        ];
        table.push(std::iter::once((rank + 1).to_string()).chain(values).chain(results));
    }
    table
}

fn status(record: &Record) -> &'static str {
    match record.status {
        Status::Ok => "ok",
        Status::Diverged => "diverged",
        Status::Flat => "flat",
    }
}

/// Returns the table of PSNR over the two settings that vary; `None` if the number of varied settings is not two.
fn matrix(records: &[Record]) -> Option<Table> {
    let [down, across] = varied(records)[..] else { return None };
    let columns = values(records, across);
    let head = std::iter::once(format!("{} \\ {}", down.name(), across.name()));
    let mut table = Table::new(head.chain(columns.iter().map(f64::to_string)));
    for value in values(records, down) {
        let cell = |column: &f64| {
            let here = |r: &&Record| r.point.get(down) == Some(value) && r.point.get(across) == Some(*column);
            match records.iter().find(here) {
                Some(Record { status: Status::Ok, psnr_db: Some(db), .. }) => format!("{db:.2}"),
                Some(record) => status(record).into(),
                None => "–".into(),
            }
        };
        table.push(std::iter::once(value.to_string()).chain(columns.iter().map(cell)));
    }
    Some(table)
}

fn measured(kind: Kind) -> &'static str {
    match kind {
        Kind::Image => "PSNR of the whole picture, dB",
        Kind::Scene => "mean PSNR of the validation views, dB",
    }
}

fn markdown(folder: &Folder, records: &[Record]) -> String {
    let header = &folder.header;
    let mut text = format!("# Sweep of {}\n\n", markdown_text(&header.data));
    // Writing into a String cannot fail.
    let _ = writeln!(text, "{} finished runs. PSNR: {}.\n", records.len(), measured(header.kind));
    if let Some(matrix) = matrix(records) {
        let _ = writeln!(text, "{}", matrix.to_markdown());
    }
    let _ = writeln!(text, "{}", table(records).to_markdown());
    let mut machines: Vec<String> =
        records.iter().map(|r| format!("{}, {} threads, kernel {}", r.cpu, r.threads, r.kernel)).collect();
    machines.sort();
    machines.dedup();
    let _ = writeln!(text, "Run on: {}.\n", markdown_text(&machines.join("; ")));
    for knob in varied(records) {
        let _ = writeln!(text, "![PSNR over {0}](psnr_over_{0}.png)\n", knob.name());
    }
    let _ = writeln!(text, "![PSNR over time](psnr_over_time.png)\n\n![Pictures](sheet.png)\n");
    let settings = serde_json::to_string_pretty(&header.settings).unwrap_or_default();
    let settings = crate::system::printable::json(&settings);
    let _ = writeln!(text, "All other settings:\n\n```json\n{settings}\n```");
    text
}

/// Returns the runs to plot, with their PSNR, dB. Left out: runs that diverged or score no better than one flat colour.
fn drawn(records: &[Record]) -> impl Iterator<Item = (&Record, f64)> + Clone {
    let fine = |record: &&Record| record.status == Status::Ok;
    records.iter().filter(fine).filter_map(|record| Some((record, record.psnr_db?)))
}

/// Points of a curve: x, and PSNR in dB.
type Points = Vec<(f64, f64)>;

/// Returns the curves of PSNR over `x`, one for each combination of the settings other than `knob`. If there are
/// several curves, curves with a single point are left out.
fn curves(records: &[Record], knob: Knob, x: impl Fn(&Record) -> f64) -> Vec<Series> {
    let others: Vec<Knob> = varied(records).into_iter().filter(|&other| other != knob).collect();
    let mut curves: Vec<(Vec<f64>, Points)> = Vec::new();
    for (record, db) in drawn(records) {
        let key: Vec<f64> = others.iter().filter_map(|&other| record.point.get(other)).collect();
        let point = (x(record), db);
        match curves.iter_mut().find(|(of, _)| *of == key) {
            Some((_, points)) => points.push(point),
            None => curves.push((key, vec![point])),
        }
    }
    if curves.len() > 1 {
        curves.retain(|(_, points)| points.len() > 1);
    }
    let name = |key: &[f64]| {
        let parts = others.iter().zip(key).map(|(&other, value)| match other.name() {
            "layers" => format!("{value} layers"),
            knob => format!("{knob} {value}"),
        });
        parts.collect::<Vec<_>>().join(", ")
    };
    let series = |(key, mut points): (Vec<f64>, Vec<(f64, f64)>)| {
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let name = if key.is_empty() { "runs".into() } else { name(&key) };
        Series { name, points, marker: Marker::LineAndPoints }
    };
    curves.into_iter().map(series).collect()
}

/// Returns two curves over `knob`, for plots with too many single curves: best and mean PSNR of the runs at each value.
fn summarised(records: &[Record], knob: Knob) -> Vec<Series> {
    let of_value =
        |value: f64| drawn(records).filter(move |(r, _)| r.point.get(knob) == Some(value)).map(|(_, db)| db);
    let (mut best, mut mean) = (Vec::new(), Vec::new());
    for value in values(records, knob) {
        let count = of_value(value).count();
        if count > 0 {
            best.push((value, of_value(value).fold(f64::MIN, f64::max)));
            mean.push((value, of_value(value).sum::<f64>() / count as f64));
        }
    }
    let series = |name: &str, points| Series { name: name.into(), points, marker: Marker::LineAndPoints };
    vec![series("best of the others", best), series("mean over the others", mean)]
}

fn knob_plot(folder: &Folder, records: &[Record], knob: Knob) -> LinePlot {
    let title = format!("{}: PSNR over {}", folder.header.data, knob.axis());
    let mut plot = LinePlot::new(title, knob.axis(), measured(folder.header.kind));
    let curves = curves(records, knob, |record| record.point.get(knob).unwrap_or(f64::NAN));
    plot.series = if (1..=MAX_SERIES).contains(&curves.len()) { curves } else { summarised(records, knob) };
    plot.log_x = knob == Knob::Rate;
    plot.notes = notes(records);
    plot
}

fn time_plot(folder: &Folder, records: &[Record]) -> LinePlot {
    let title = format!("{}: PSNR over training time", folder.header.data);
    let mut plot = LinePlot::new(title, "training time, s", measured(folder.header.kind));
    // One series per value of the setting that has fewest values.
    let group = varied(records).into_iter().min_by_key(|&knob| values(records, knob).len());
    let all = |keep: &dyn Fn(&Record) -> bool| {
        let kept = drawn(records).filter(|(record, _)| keep(record));
        let mut points: Vec<(f64, f64)> = kept.map(|(record, db)| (record.train_seconds, db)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points
    };
    plot.series = match group {
        Some(knob) if values(records, knob).len() <= MAX_SERIES => values(records, knob)
            .into_iter()
            .map(|value| Series {
                name: format!("{} {value}", knob.name()),
                points: all(&|record| record.point.get(knob) == Some(value)),
                marker: Marker::Points,
            })
            .collect(),
        _ => vec![Series { name: "runs".into(), points: all(&|_| true), marker: Marker::Points }],
    };
    plot.notes = notes(records);
    plot
}

fn notes(records: &[Record]) -> Vec<String> {
    let others: Vec<String> = records
        .iter()
        .filter(|r| r.status != Status::Ok)
        .map(|r| format!("{} ({})", r.point, status(r)))
        .collect();
    if others.is_empty() { Vec::new() } else { vec![format!("Not drawn: {}.", others.join("; "))] }
}

/// Returns a contact sheet of the runs' pictures in the order of their settings; `None` without runs.
fn sheet(folder: &Folder, records: &[Record]) -> Option<Picture> {
    let mut cells = Vec::new();
    for record in records {
        let caption = match (record.status, record.psnr_db) {
            (Status::Ok, Some(db)) => format!("{}\n{db:.2} dB, {:.1} s", record.point, record.train_seconds),
            _ => format!("{}\n{}", record.point, status(record)),
        };
        // A picture that was deleted leaves a blank cell, not a failed report.
        let picture = Picture::read(folder.picture_path(&record.point.name()));
        let picture = picture.map(|picture| picture.reduced_to(THUMBNAIL));
        cells.push(Cell::new(picture.unwrap_or_else(|| Picture::filled(1, 1, [0.9; 3])), caption));
    }
    let columns = varied(records).last().map_or(1, |&knob| values(records, knob).len());
    let columns = if columns > 1 && columns <= 10 { columns } else { 6 };
    (!cells.is_empty()).then(|| contact_sheet(&folder.header.data, &cells, columns))
}

#[derive(Debug, Serialize)]
pub struct Summary<'r> {
    pub report: String,
    pub runs: Vec<RunSummary<'r>>,
}

impl<'r> Summary<'r> {
    pub fn of(records: &'r [Record], report: &Path) -> Self {
        Self { report: report.display().to_string(), runs: records.iter().map(RunSummary).collect() }
    }
}

/// Settings and results of a run. Each setting has the name of its command-line flag.
#[derive(Debug)]
pub struct RunSummary<'r>(&'r Record);

impl Serialize for RunSummary<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let record = self.0;
        let mut map = serializer.serialize_map(None)?;
        for (knob, value) in record.point.values() {
            let name = knob.flag().replace('-', "_");
            match knob {
                Knob::Rate | Knob::Seconds => map.serialize_entry(&name, &value)?,
                _ => map.serialize_entry(&name, &(value as u64))?,
            }
        }
        map.serialize_entry("diverged", &(record.status == Status::Diverged))?;
        map.serialize_entry("flat", &(record.status == Status::Flat))?;
        map.serialize_entry("note", &record.note)?;
        map.serialize_entry("psnr_db", &record.psnr_db.unwrap_or(f64::NAN))?;
        map.serialize_entry("train_seconds", &record.train_seconds)?;
        map.end()
    }
}
