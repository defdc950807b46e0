//! A sweep on disk.

use super::{Header, Point, Record};
use crate::data::rgb::Picture;
use crate::data::rgb_error::ReportError;
use crate::data::system::input;
use crate::data::system::output::{OutputError, ensure_folder, write_atomic, write_new};
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// The folder of a sweep.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
    header: Header,
}

/// Why a folder cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SweepError {
    /// A file cannot be written.
    #[error("{0}")]
    Output(#[from] OutputError),
    /// A picture, plot or table cannot be made.
    #[error("{0}")]
    Report(#[from] ReportError),
    /// A file cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file holds something else.
    #[error("{path}: expected a sweep's {what}, found: {found}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What belongs there.
        what: &'static str,
        /// What the reader said.
        found: String,
    },
    /// A folder without a sweep, where one was expected.
    #[error("{path}: expected the folder of a sweep, found no sweep.json in it")]
    NoSweep {
        /// The folder.
        path: PathBuf,
    },
    /// A folder with a sweep of something else.
    #[error(
        "{path}: the sweep in this folder has another {field} (in the folder: {found}; now: {expected}); \
         nothing was changed: take another folder, or the same settings"
    )]
    Other {
        /// The folder.
        path: PathBuf,
        /// What differs.
        field: String,
        /// What is asked for now.
        expected: String,
        /// What is there.
        found: String,
    },
}

impl Folder {
    /// Takes up the sweep in `path`, or begins one there.
    ///
    /// # Errors
    /// [`SweepError::Other`] if the folder holds a sweep with other settings; nothing is changed then.
    pub fn open(path: &Path, header: Header) -> Result<Self, SweepError> {
        let folder = Self { path: path.into(), header };
        let file = path.join("sweep.json");
        if !file.exists() {
            ensure_folder(folder.path.join("runs"))?;
            // Another process may begin one here at this very moment: then it is that one's.
            write_new(file, json(&folder.header)?.as_bytes())?;
        }
        Self::existing(path)?.check_same(&folder.header)?;
        ensure_folder(folder.path.join("runs"))?;
        Ok(folder)
    }

    /// The sweep in `path`.
    ///
    /// # Errors
    /// [`SweepError::NoSweep`] if there is none.
    pub fn existing(path: &Path) -> Result<Self, SweepError> {
        let file = path.join("sweep.json");
        if !file.exists() {
            return Err(SweepError::NoSweep { path: path.into() });
        }
        Ok(Self { path: path.into(), header: read_json(&file, "description")? })
    }

    /// What its runs share.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Refuses another sweep than `other` describes.
    ///
    /// # Errors
    /// [`SweepError::Other`] names the first difference.
    pub fn check_same(&self, other: &Header) -> Result<(), SweepError> {
        let tree = |header: &Header| serde_json::to_value(header).unwrap_or_default();
        match crate::train::checkpoint::difference(&tree(other), &tree(&self.header)) {
            Some((field, expected, found)) => {
                let field = field.trim_start_matches("settings.").to_owned();
                Err(SweepError::Other { path: self.path.clone(), field, expected, found })
            }
            None => Ok(()),
        }
    }

    fn record_path(&self, point: &Point) -> PathBuf {
        self.path.join("runs").join(format!("{}.json", point.name()))
    }

    /// Where the picture of a run lies.
    pub fn picture_path(&self, point: &Point) -> PathBuf {
        self.path.join("runs").join(format!("{}.png", point.name()))
    }

    /// The record of a run, if it is finished.
    ///
    /// # Errors
    /// [`SweepError::Format`] if its file holds something else.
    pub fn record(&self, point: &Point) -> Result<Option<Record>, SweepError> {
        let path = self.record_path(point);
        if path.exists() { read_json(&path, "record").map(Some) } else { Ok(None) }
    }

    /// Keeps a finished run: its picture first, so that a record never lacks one it should have.
    ///
    /// # Errors
    /// [`SweepError::Output`].
    pub fn keep(&self, record: &Record, picture: Option<&Picture>) -> Result<(), SweepError> {
        if let Some(picture) = picture {
            picture.write_png(self.picture_path(&record.point))?;
        }
        write_json(&self.record_path(&record.point), record)
    }

    /// All finished runs, ordered by their settings.
    ///
    /// # Errors
    /// [`SweepError::Format`] names the file that holds something else.
    pub fn records(&self) -> Result<Vec<Record>, SweepError> {
        let runs = self.path.join("runs");
        let read = |source| SweepError::Read { path: runs.clone(), source };
        let mut records: Vec<Record> = Vec::new();
        for entry in std::fs::read_dir(&runs).map_err(read)? {
            let path = entry.map_err(read)?.path();
            if path.extension().is_some_and(|extension| extension == "json") {
                records.push(read_json(&path, "record")?);
            }
        }
        // No value is NaN: JSON has none.
        let order = |a: &Record, b: &Record| a.point.partial_cmp(&b.point);
        records.sort_by(|a, b| order(a, b).unwrap_or(std::cmp::Ordering::Equal));
        Ok(records)
    }

    /// Takes in the finished runs of another folder of the same sweep; returns how many were new.
    ///
    /// # Errors
    /// [`SweepError::Other`] if it is another sweep; [`SweepError::Read`] and [`SweepError::Output`] on files.
    pub fn take_in(&self, other: &Self) -> Result<usize, SweepError> {
        other.check_same(&self.header)?;
        let mut new = 0;
        for record in other.records()? {
            if self.record(&record.point)?.is_some() {
                continue;
            }
            let path = other.picture_path(&record.point);
            if path.exists() {
                let bytes = input::read_limited(&path, input::MAX_PICTURE_BYTES)
                    .map_err(|source| SweepError::Read { path, source })?;
                write_atomic(self.picture_path(&record.point), &bytes)?;
            }
            write_json(&self.record_path(&record.point), &record)?;
            new += 1;
        }
        Ok(new)
    }
}

fn read_json<T: DeserializeOwned>(path: &Path, what: &'static str) -> Result<T, SweepError> {
    let text = input::read_text(path, input::MAX_JSON_BYTES)
        .map_err(|source| SweepError::Read { path: path.into(), source })?;
    serde_json::from_str(&text).map_err(|error| SweepError::Format {
        path: path.into(),
        what,
        found: error.to_string(),
    })
}

fn json(value: &impl serde::Serialize) -> Result<String, SweepError> {
    let text = serde_json::to_string_pretty(value).map_err(ReportError::encode("sweep record"))?;
    Ok(crate::data::system::printable::json(&text).into_owned() + "\n")
}

fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), SweepError> {
    Ok(write_atomic(path, json(value)?.as_bytes())?)
}
