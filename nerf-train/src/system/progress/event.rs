//! Progress as JSON lines.

use serde::Serialize;
use std::time::Duration;

/// One JSON line for a program that follows the progress; numbers that are not finite are null.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub enum Event<'a> {
    Progress {
        what: &'a str,
        position: u64,
        /// Null if only time ends the work, or its end is not known.
        total: Option<u64>,
        elapsed_s: f64,
        left_s: Option<f64>,
        #[serde(skip_serializing_if = "Option::is_none")]
        rays_per_s: Option<f64>,
        #[serde(skip_serializing_if = "Option::is_none")]
        train_psnr_db: Option<f64>,
        #[serde(skip_serializing_if = "Option::is_none")]
        val_psnr_db: Option<f64>,
        #[serde(skip_serializing_if = "str::is_empty")]
        note: &'a str,
    },
    Done {
        what: &'a str,
        text: &'a str,
        elapsed_s: f64,
    },
    Note {
        text: &'a str,
    },
}

impl Event<'_> {
    pub fn line(&self) -> String {
        // Strings and numbers alone: nothing that could fail.
        let json = serde_json::to_string(self).unwrap_or_default();
        crate::system::printable::json(&json).into_owned()
    }
}

/// Seconds, rounded to the millisecond.
pub fn seconds(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e3).round() / 1e3
}
