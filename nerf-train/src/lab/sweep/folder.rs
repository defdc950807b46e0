//! A sweep on disk.

use super::{Header, Point, Record};
use crate::data::pictures::rgb::Picture;
use crate::data::pictures::rgb::ReportError;
use crate::system::input;
use crate::system::output::{OutputError, ensure_folder, write_atomic, write_new};
use crate::system::printable;
use crate::train::checkpoint::difference;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// What the runs share, as a file in the folder.
const FILE: &str = "sweep.json";

/// The folder of a sweep.
///
/// A run is one small file, and never made twice, whoever made it: runs can be spread over machines
/// ([`Shard`](crate::lab::Shard)) into one folder or into several that are merged.
#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
    header: Header,
}

/// Why a folder cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names say what they are")]
pub enum LabError {
    /// A file cannot be written.
    #[error("{0}")]
    Output(#[from] OutputError),
    /// A picture, plot or table cannot be made.
    #[error("{0}")]
    Report(#[from] ReportError),
    /// A file cannot be read.
    #[error("cannot read {path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    /// A file holds something else.
    #[error("{path}: expected a sweep's {what}, found: {found}")]
    Format { path: PathBuf, what: &'static str, found: String },
    /// A folder without a sweep, where one was expected.
    #[error("{path}: expected the folder of a sweep, found no sweep.json in it")]
    Empty { path: PathBuf },
    /// A folder with another sweep.
    #[error(
        "{path}: the sweep in this folder has another {field} (in the folder: {found}; now: {expected}); \
         nothing was changed: take another folder, or the same settings"
    )]
    Other { path: PathBuf, field: String, expected: String, found: String },
}

impl Folder {
    /// Takes up the sweep in `path`, or begins one there.
    ///
    /// # Errors
    /// [`LabError::Other`] if the folder holds one with other settings; nothing is changed then.
    pub fn open(path: &Path, header: Header) -> Result<Self, LabError> {
        let file = path.join(FILE);
        if !file.exists() {
            ensure_folder(path.join("runs"))?;
            // Another process may begin one here at this very moment: then it is that one's.
            write_new(file, json(&header)?.as_bytes())?;
        }
        let folder = Self::existing(path)?;
        folder.check_same(&header)?;
        ensure_folder(path.join("runs"))?;
        Ok(folder)
    }

    /// The sweep in `path`.
    ///
    /// # Errors
    /// [`LabError::Empty`] if there is none.
    pub fn existing(path: &Path) -> Result<Self, LabError> {
        let file = path.join(FILE);
        if !file.exists() {
            return Err(LabError::Empty { path: path.into() });
        }
        let header = read_json(&file, "description")?;
        Ok(Self { path: path.into(), header })
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
    /// [`LabError::Other`] names the first difference.
    pub fn check_same(&self, other: &Header) -> Result<(), LabError> {
        let tree = |header: &Header| serde_json::to_value(header).unwrap_or_default();
        match difference(&tree(other), &tree(&self.header)) {
            Some((field, expected, found)) => {
                let field = field.trim_start_matches("settings.").to_owned();
                Err(LabError::Other { path: self.path.clone(), field, expected, found })
            }
            None => Ok(()),
        }
    }

    fn run_path(&self, name: &str) -> PathBuf {
        self.path.join("runs").join(format!("{name}.json"))
    }

    /// Where the picture of a run lies.
    pub fn picture_path(&self, name: &str) -> PathBuf {
        self.path.join("runs").join(format!("{name}.png"))
    }

    /// The run of this name, if it is finished.
    ///
    /// # Errors
    /// [`LabError::Format`] if its file holds something else.
    pub fn run(&self, name: &str) -> Result<Option<Record>, LabError> {
        let path = self.run_path(name);
        if path.exists() { read_json(&path, "record").map(Some) } else { Ok(None) }
    }

    /// Keeps a finished run: its picture first, so that a record never lacks one it should have.
    ///
    /// # Errors
    /// [`LabError::Output`].
    pub fn keep(&self, run: &Record, picture: Option<&Picture>) -> Result<(), LabError> {
        if let Some(picture) = picture {
            picture.write_png(self.picture_path(&run.point.name()))?;
        }
        write_json(&self.run_path(&run.point.name()), run)
    }

    /// All finished runs, by name.
    ///
    /// # Errors
    /// [`LabError::Format`] names the file that holds something else.
    pub fn runs(&self) -> Result<Vec<Record>, LabError> {
        let runs = self.path.join("runs");
        let read = |source| LabError::Read { path: runs.clone(), source };
        let mut files: Vec<PathBuf> = Vec::new();
        for entry in std::fs::read_dir(&runs).map_err(read)? {
            let path = entry.map_err(read)?.path();
            if path.extension().is_some_and(|extension| extension == "json") {
                files.push(path);
            }
        }
        files.sort();
        files.iter().map(|path| read_json(path, "record")).collect()
    }

    /// Makes those runs of `points` that are not finished, and says what each came to.
    ///
    /// # Errors
    /// What `make` says, and [`LabError`] on files.
    pub fn conduct<E: From<LabError>>(
        &self,
        points: &[Point],
        say: impl Fn(String),
        mut make: impl FnMut(&Point) -> Result<(Record, Option<Picture>), E>,
    ) -> Result<(), E> {
        for (i, point) in points.iter().enumerate() {
            let place = format!("[{}/{}] {point}", i + 1, points.len());
            if let Some(run) = self.run(&point.name())? {
                say(format!("{place}: finished before, {}", run.result()));
                continue;
            }
            say(format!("{place}: begins"));
            let (run, picture) = make(point)?;
            self.keep(&run, picture.as_ref())?;
            say(format!("{place}: {}", run.result()));
        }
        Ok(())
    }

    /// Takes in the finished runs of another folder of the same sweep; returns how many were new.
    ///
    /// # Errors
    /// [`LabError::Other`] if it is another one; [`LabError::Read`] and [`LabError::Output`] on files.
    pub fn take_in(&self, other: &Self) -> Result<usize, LabError> {
        other.check_same(&self.header)?;
        let mut new = 0;
        for run in other.runs()? {
            let name = run.point.name();
            if self.run(&name)?.is_some() {
                continue;
            }
            let path = other.picture_path(&name);
            if path.exists() {
                let bytes = input::read_limited(&path, input::MAX_PICTURE_BYTES)
                    .map_err(|source| LabError::Read { path, source })?;
                write_atomic(self.picture_path(&name), &bytes)?;
            }
            write_json(&self.run_path(&name), &run)?;
            new += 1;
        }
        Ok(new)
    }
}

fn read_json<T: DeserializeOwned>(path: &Path, what: &'static str) -> Result<T, LabError> {
    let text = input::read_text(path, input::MAX_JSON_BYTES)
        .map_err(|source| LabError::Read { path: path.into(), source })?;
    serde_json::from_str(&text).map_err(|error| LabError::Format {
        path: path.into(),
        what,
        found: error.to_string(),
    })
}

fn json(value: &impl Serialize) -> Result<String, LabError> {
    let text = serde_json::to_string_pretty(value).map_err(ReportError::encode("record"))?;
    Ok(printable::json(&text).into_owned() + "\n")
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<(), LabError> {
    Ok(write_atomic(path, json(value)?.as_bytes())?)
}
