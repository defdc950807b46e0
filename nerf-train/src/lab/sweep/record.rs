//! What a sweep keeps: what its runs share, and what each came to.

use super::{Mode, Point};
use serde::{Deserialize, Serialize};

/// What is fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A 2D field to a photograph; PSNR is over the whole picture.
    Image,
    /// A radiance field to posed photographs; PSNR is the mean over validation views.
    Scene,
}

/// What all runs of a folder share; `sweep.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names say what they are, and in which unit")]
pub struct Header {
    pub kind: Kind,
    pub data: String,
    pub fingerprint: String,
    pub mode: Mode,
    /// All settings of the base; those that are varied too, and they may be varied further later.
    pub settings: serde_json::Value,
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// As it should.
    Ok,
    /// A number overflowed, or every density died.
    Diverged,
    /// It went through, and shows no more than one flat colour would: too fast a rate, or too few steps.
    Flat,
}

/// What one run came to; `runs/NAME.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names say what they are, and in which unit")]
pub struct Record {
    pub point: Point,
    pub status: Status,
    /// Why, where it did not end as it should.
    pub note: String,
    /// dB, as [`Kind`] says; absent where there is no picture.
    pub psnr_db: Option<f64>,
    pub steps: u32,
    pub parameters: usize,
    /// Multiply-adds of one pixel or sample.
    pub macs: u64,
    pub blob_bytes: usize,
    pub train_seconds: f64,
    pub threads: usize,
    pub kernel: String,
    pub cpu: String,
}

impl Record {
    /// What it came to, in a few words.
    pub(super) fn result(&self) -> String {
        match (self.status, self.psnr_db) {
            (Status::Ok, Some(db)) => format!("{db:.2} dB in {:.1} s", self.train_seconds),
            (Status::Flat, _) => format!("flat ({})", self.note),
            _ => format!("diverged ({})", self.note),
        }
    }
}
