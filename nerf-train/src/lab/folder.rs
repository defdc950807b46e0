//! An experiment on disk.

use crate::data::pictures::rgb::Picture;
use crate::data::pictures::rgb::ReportError;
use crate::system::input;
use crate::system::output::{OutputError, ensure_folder, write_atomic, write_new};
use crate::system::printable;
use crate::train::checkpoint::difference;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Display;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

/// What all runs of an experiment share, as a file in its folder.
pub trait Header: Clone + Serialize + DeserializeOwned {
    /// The file.
    const FILE: &'static str;
    /// What it is of, for messages: "sweep".
    const WHAT: &'static str;
}

/// What one run came to, as a file in the folder `runs`.
pub trait Run: Serialize + DeserializeOwned {
    /// The stem of its file, which no other run's settings have.
    fn name(&self) -> String;
    /// What it came to, in a few words.
    fn result(&self) -> String;
}

/// The folder of an experiment.
///
/// A run is one small file, and never made twice, whoever made it: runs can be spread over machines
/// ([`Shard`](super::Shard)) into one folder or into several that are merged.
#[derive(Debug)]
pub struct Folder<H, R> {
    path: PathBuf,
    header: H,
    runs: PhantomData<fn() -> R>,
}

impl<H: Clone, R> Clone for Folder<H, R> {
    fn clone(&self) -> Self {
        Self { path: self.path.clone(), header: self.header.clone(), runs: PhantomData }
    }
}

/// Why a folder cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LabError {
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
    #[error("{path}: expected a {kind}'s {what}, found: {found}")]
    Format {
        /// The file.
        path: PathBuf,
        /// Of what.
        kind: &'static str,
        /// What belongs there.
        what: &'static str,
        /// What the reader said.
        found: String,
    },
    /// A folder without an experiment, where one was expected.
    #[error("{path}: expected the folder of a {kind}, found no {file} in it")]
    Empty {
        /// The folder.
        path: PathBuf,
        /// Of what.
        kind: &'static str,
        /// The file that is missing.
        file: &'static str,
    },
    /// A folder with another experiment.
    #[error(
        "{path}: the {kind} in this folder has another {field} (in the folder: {found}; now: {expected}); \
         nothing was changed: take another folder, or the same settings"
    )]
    Other {
        /// The folder.
        path: PathBuf,
        /// Of what.
        kind: &'static str,
        /// What differs.
        field: String,
        /// What is asked for now.
        expected: String,
        /// What is there.
        found: String,
    },
}

impl<H: Header, R: Run> Folder<H, R> {
    /// Takes up the experiment in `path`, or begins one there.
    ///
    /// # Errors
    /// [`LabError::Other`] if the folder holds one with other settings; nothing is changed then.
    pub fn open(path: &Path, header: H) -> Result<Self, LabError> {
        let file = path.join(H::FILE);
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

    /// The experiment in `path`.
    ///
    /// # Errors
    /// [`LabError::Empty`] if there is none.
    pub fn existing(path: &Path) -> Result<Self, LabError> {
        let file = path.join(H::FILE);
        if !file.exists() {
            return Err(LabError::Empty { path: path.into(), kind: H::WHAT, file: H::FILE });
        }
        let header = read_json(&file, H::WHAT, "description")?;
        Ok(Self { path: path.into(), header, runs: PhantomData })
    }

    /// What its runs share.
    pub fn header(&self) -> &H {
        &self.header
    }

    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Refuses another experiment than `other` describes.
    ///
    /// # Errors
    /// [`LabError::Other`] names the first difference.
    pub fn check_same(&self, other: &H) -> Result<(), LabError> {
        let tree = |header: &H| serde_json::to_value(header).unwrap_or_default();
        match difference(&tree(other), &tree(&self.header)) {
            Some((field, expected, found)) => {
                let field = field.trim_start_matches("settings.").to_owned();
                Err(LabError::Other { path: self.path.clone(), kind: H::WHAT, field, expected, found })
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
    pub fn run(&self, name: &str) -> Result<Option<R>, LabError> {
        let path = self.run_path(name);
        if path.exists() { read_json(&path, H::WHAT, "record").map(Some) } else { Ok(None) }
    }

    /// Keeps a finished run: its picture first, so that a record never lacks one it should have.
    ///
    /// # Errors
    /// [`LabError::Output`].
    pub fn keep(&self, run: &R, picture: Option<&Picture>) -> Result<(), LabError> {
        if let Some(picture) = picture {
            picture.write_png(self.picture_path(&run.name()))?;
        }
        write_json(&self.run_path(&run.name()), run)
    }

    /// All finished runs, by name.
    ///
    /// # Errors
    /// [`LabError::Format`] names the file that holds something else.
    pub fn runs(&self) -> Result<Vec<R>, LabError> {
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
        files.iter().map(|path| read_json(path, H::WHAT, "record")).collect()
    }

    /// Makes those of `trials` that are not finished, each with its name, and says what each came to.
    ///
    /// # Errors
    /// What `make` says, and [`LabError`] on files.
    pub fn conduct<'t, T: Display + 't, E: From<LabError>>(
        &self,
        trials: &[(&'t T, String)],
        say: impl Fn(String),
        mut make: impl FnMut(&T) -> Result<(R, Option<Picture>), E>,
    ) -> Result<(), E> {
        for (i, (trial, name)) in trials.iter().enumerate() {
            let place = format!("[{}/{}] {trial}", i + 1, trials.len());
            if let Some(run) = self.run(name)? {
                say(format!("{place}: finished before, {}", run.result()));
                continue;
            }
            say(format!("{place}: begins"));
            let (run, picture) = make(trial)?;
            self.keep(&run, picture.as_ref())?;
            say(format!("{place}: {}", run.result()));
        }
        Ok(())
    }

    /// Takes in the finished runs of another folder of the same experiment; returns how many were new.
    ///
    /// # Errors
    /// [`LabError::Other`] if it is another one; [`LabError::Read`] and [`LabError::Output`] on files.
    pub fn take_in(&self, other: &Self) -> Result<usize, LabError> {
        other.check_same(&self.header)?;
        let mut new = 0;
        for run in other.runs()? {
            let name = run.name();
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

fn read_json<T: DeserializeOwned>(
    path: &Path,
    kind: &'static str,
    what: &'static str,
) -> Result<T, LabError> {
    let text = input::read_text(path, input::MAX_JSON_BYTES)
        .map_err(|source| LabError::Read { path: path.into(), source })?;
    serde_json::from_str(&text).map_err(|error| LabError::Format {
        path: path.into(),
        kind,
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
