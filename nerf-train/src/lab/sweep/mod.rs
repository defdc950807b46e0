//! Sweeps: many runs that differ in a few settings, and their records.
//!
//! lists of values → their combinations → one run each, with a record in a file → table, plots, contact sheet
//!
//! A folder holds a sweep. The file `sweep.json` holds the data and settings that all runs share, and the folder `runs`
//! holds a record and a picture of each finished run. A run that has a record is not repeated. Runs can be spread over
//! machines ([`Shard`](super::Shard)), into one folder or into several that are merged later.

mod combinations;
mod folder;
mod job;

#[cfg(test)]
mod tests;

pub use combinations::{Combinations, Knob, Mode, Point};
pub use folder::Folder;
pub use job::{Job, Runner};
use serde::{Deserialize, Serialize};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Fit of a 2D field to a photograph; PSNR is over the whole picture.
    Image,
    /// Fit of a radiance field to posed photographs; PSNR is the mean over validation views.
    Scene,
}

/// Data and settings that all runs of a folder share, stored as `sweep.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    pub kind: Kind,
    pub data: String,
    pub fingerprint: String,
    pub mode: Mode,
    /// All base settings, including the base values of varied settings, since a later command may vary other settings.
    pub settings: serde_json::Value,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    Ok,
    /// A number overflowed, or every density became 0.
    Diverged,
    /// The field scores no better than one flat colour: the learning rate is too high, or the steps are too few.
    Flat,
}

/// Result of one run, stored as `runs/NAME.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    pub point: Point,
    pub status: Status,
    /// Reason why the run diverged, or why its pictures count as one flat colour; else empty.
    pub note: String,
    /// PSNR as defined by [`Kind`], dB; `None` if there is no picture.
    pub psnr_db: Option<f64>,
    pub steps: u32,
    pub parameters: usize,
    /// Multiply-adds per pixel of a 2D field, or per sample of a scene.
    pub macs: u64,
    pub blob_bytes: usize,
    pub train_seconds: f64,
    pub threads: usize,
    pub kernel: String,
    pub cpu: String,
}

impl Record {
    /// Returns the status and figures of the run in a few words.
    pub(super) fn result(&self) -> String {
        match (self.status, self.psnr_db) {
            (Status::Ok, Some(db)) => format!("{db:.2} dB in {:.1} s", self.train_seconds),
            (Status::Flat, _) => format!("flat ({})", self.note),
            _ => format!("diverged ({})", self.note),
        }
    }
}

/// Returns the records of all finished runs in `folder`, ordered by their settings.
pub fn records(folder: &Folder) -> anyhow::Result<Vec<Record>> {
    let mut records = folder.runs()?;
    // No value is NaN: JSON has none.
    let order = |a: &Record, b: &Record| a.point.partial_cmp(&b.point);
    records.sort_by(|a, b| order(a, b).unwrap_or(std::cmp::Ordering::Equal));
    Ok(records)
}
