//! Folder of a sweep, with its records and pictures.

use super::{Header, Point, Record};
use crate::data::pictures::rgb::Picture;
use crate::system::input;
use crate::system::output::{ensure_folder, write_atomic, write_new};
use crate::system::summary::to_json;
use crate::train::checkpoint::difference;
use anyhow::{Context, anyhow, bail};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

const FILE: &str = "sweep.json";

/// Folder of a sweep; several processes may add runs ([`Shard`](crate::lab::Shard)), and folders can be merged.
#[derive(Clone, Debug)]
pub struct Folder {
    pub path: PathBuf,
    pub header: Header,
}

impl Folder {
    /// Resumes or begins the sweep in the folder `path`. Fails if the folder holds a sweep with other settings.
    pub fn open(path: &Path, header: Header) -> anyhow::Result<Self> {
        let file = path.join(FILE);
        if !file.exists() {
            ensure_folder(path.join("runs"))?;
            // Another process may begin the sweep at the same time: the file of the first one is used.
            write_new(file, to_json(&header)?.as_bytes())?;
        }
        let folder = Self::existing(path)?;
        folder.check_same(&header)?;
        ensure_folder(path.join("runs"))?;
        Ok(folder)
    }

    pub fn existing(path: &Path) -> anyhow::Result<Self> {
        let file = path.join(FILE);
        if !file.exists() {
            bail!("{}: expected the folder of a sweep, found no sweep.json in it", path.display());
        }
        let header = read_json(&file, "description")?;
        Ok(Self { path: path.into(), header })
    }

    pub fn check_same(&self, other: &Header) -> anyhow::Result<()> {
        let tree = |header: &Header| serde_json::to_value(header).unwrap_or_default();
        match difference(&tree(other), &tree(&self.header)) {
            Some((field, expected, found)) => {
                bail!(
                    "{}: the sweep in this folder has another {} (in the folder: {found}; now: {expected}); nothing was changed: \
                     take another folder, or the same settings",
                    self.path.display(),
                    field.trim_start_matches("settings.")
                )
            }
            None => Ok(()),
        }
    }

    fn run_path(&self, name: &str) -> PathBuf {
        self.path.join("runs").join(format!("{name}.json"))
    }

    pub fn picture_path(&self, name: &str) -> PathBuf {
        self.path.join("runs").join(format!("{name}.png"))
    }

    pub fn run(&self, name: &str) -> anyhow::Result<Option<Record>> {
        let path = self.run_path(name);
        if path.exists() { read_json(&path, "record").map(Some) } else { Ok(None) }
    }

    /// Saves the record `run` of a finished run. Saves `picture` first, so that no saved record lacks its picture.
    pub fn keep(&self, run: &Record, picture: Option<&Picture>) -> anyhow::Result<()> {
        if let Some(picture) = picture {
            picture.write_png(self.picture_path(&run.point.name()))?;
        }
        write_json(&self.run_path(&run.point.name()), run)
    }

    pub fn runs(&self) -> anyhow::Result<Vec<Record>> {
        let runs = self.path.join("runs");
        let mut files: Vec<PathBuf> = Vec::new();
        let unread = || unread(&runs);
        for entry in std::fs::read_dir(&runs).with_context(unread)? {
            let path = entry.with_context(unread)?.path();
            if path.extension().is_some_and(|extension| extension == "json") {
                files.push(path);
            }
        }
        files.sort();
        files.iter().map(|path| read_json(path, "record")).collect()
    }

    /// Runs the `points` that have no record, and saves each result. `make`: runs one point; `say`: shows a message.
    pub fn conduct(
        &self,
        points: &[Point],
        say: impl Fn(String),
        mut make: impl FnMut(&Point) -> anyhow::Result<(Record, Option<Picture>)>,
    ) -> anyhow::Result<()> {
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

    /// Copies finished runs from `other`, and returns the number of new runs. Fails if `other` holds another sweep.
    pub fn take_in(&self, other: &Self) -> anyhow::Result<usize> {
        other.check_same(&self.header)?;
        let mut new = 0;
        for run in other.runs()? {
            let name = run.point.name();
            if self.run(&name)?.is_some() {
                continue;
            }
            let path = other.picture_path(&name);
            if path.exists() {
                let bytes =
                    input::read_limited(&path, input::MAX_PICTURE_BYTES).with_context(|| unread(&path))?;
                write_atomic(self.picture_path(&name), &bytes)?;
            }
            write_json(&self.run_path(&name), &run)?;
            new += 1;
        }
        Ok(new)
    }
}

fn unread(path: &Path) -> String {
    format!("cannot read {}", path.display())
}

fn read_json<T: DeserializeOwned>(path: &Path, what: &'static str) -> anyhow::Result<T> {
    let text = input::read_text(path, input::MAX_JSON_BYTES).with_context(|| unread(path))?;
    serde_json::from_str(&text)
        .map_err(|error| anyhow!("{}: expected a sweep's {what}, found: {error}", path.display()))
}

fn write_json(path: &Path, value: &impl Serialize) -> anyhow::Result<()> {
    Ok(write_atomic(path, to_json(value)?.as_bytes())?)
}
