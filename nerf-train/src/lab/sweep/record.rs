//! What a sweep keeps: what its runs share, and what each came to.

use super::{Mode, Point};
use crate::lab::{self, Run};
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
pub struct Header {
    /// What is fitted.
    pub kind: Kind,
    /// Name of the data.
    pub data: String,
    /// Checksum of the data.
    pub fingerprint: String,
    /// How values are combined.
    pub mode: Mode,
    /// All settings of the base; those that are varied too, and they may be varied further later.
    pub settings: serde_json::Value,
}

impl lab::Header for Header {
    const FILE: &'static str = "sweep.json";
    const WHAT: &'static str = "sweep";
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
pub struct Record {
    /// Its settings.
    pub point: Point,
    /// How it ended.
    pub status: Status,
    /// Why, where it did not end as it should.
    pub note: String,
    /// dB, as [`Kind`] says; absent where there is no picture.
    pub psnr_db: Option<f64>,
    /// Steps done.
    pub steps: u32,
    /// Trained parameters.
    pub parameters: usize,
    /// Multiply-adds of one pixel or sample.
    pub macs: u64,
    /// Bytes of the blob.
    pub blob_bytes: usize,
    /// Seconds of training.
    pub train_seconds: f64,
    /// Threads it ran on.
    pub threads: usize,
    /// What it ran with.
    pub kernel: String,
    /// CPU it ran on.
    pub cpu: String,
}

impl Run for Record {
    fn name(&self) -> String {
        self.point.name()
    }

    fn result(&self) -> String {
        match (self.status, self.psnr_db) {
            (Status::Ok, Some(db)) => format!("{db:.2} dB in {:.1} s", self.train_seconds),
            (Status::Flat, _) => format!("flat ({})", self.note),
            _ => format!("diverged ({})", self.note),
        }
    }
}
