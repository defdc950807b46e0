//! Poses of photographs that have none, found by an installed COLMAP.
//!
//! COLMAP works in a hidden folder next to the output folder, on copies of the photographs, so that later edits of the
//! photographs never change the result. If a reconstruction is torn (photographs are missing) or folded (wrong poses),
//! COLMAP runs again with another strategy. At the end, the hidden folder is renamed to the output folder.

mod fault;
mod run;

pub use fault::Fault;

use crate::data::layouts::bare::Bare;
use crate::data::layouts::colmap::commands::{self, Place, Way};
use crate::data::layouts::colmap::{Facts, facts};
use crate::data::names::file_name;
use crate::data::{Dataset, DatasetError, ReadOptions, read};
use crate::system::output::{self, AtomicFolder, OutputError};
use crate::system::progress::{ProgressStyle, say_lines};
use run::{Runner, none_registered};
use serde::Serialize;
use std::path::Path;
use std::time::Duration;
use std::{fs, io};

/// Minimum number of photographs: a fit needs training views and a held-out view.
const MIN_PHOTOGRAPHS: usize = 3;

#[derive(Clone, Copy)]
pub struct Request<'a> {
    pub photographs: &'a Path,
    pub output: &'a Path,
    /// Whether photographs are matched only with their neighbours in the order of names, not all with all.
    pub sequential: bool,
    /// Maximum number of threads; `None`: no limit.
    pub threads: Option<usize>,
    /// Time without output after which COLMAP is killed.
    pub patience: Duration,
    /// Function that returns the groups of photographs if a reconstruction is folded ([`Fault::Folded`]), else `None`.
    pub folded: &'a dyn Fn(&Dataset) -> Option<Vec<Vec<String>>>,
    pub style: ProgressStyle,
}

/// Result of the command `poses`.
#[derive(Clone, Debug, Serialize)]
pub struct Found {
    pub photographs: usize,
    pub registered: usize,
    pub unregistered: Vec<String>,
    /// Names of picture files that were left out because they cannot be read.
    pub damaged: Vec<String>,
    /// Number of reconstructions that COLMAP made; the largest is kept.
    pub models: usize,
    pub points: usize,
    pub mean_reprojection_error_px: f64,
    /// Number of cameras: one for each device and each of its picture sizes.
    pub cameras: usize,
    pub way: &'static str,
    pub fault: Option<Fault>,
}

struct Attempt {
    model: Facts,
    way: Way,
    fault: Option<Fault>,
}

/// Finds the poses of photographs, and writes `sparse/0` and `images` into a new folder, which is removed on an error.
pub fn find(request: &Request<'_>) -> anyhow::Result<Found> {
    let few = |found: usize, damaged: &[String]| {
        let skipped = match damaged.len() {
            0 => String::new(),
            count => format!(", and {count} files that are no whole pictures"),
        };
        let fault = format!("expected at least {MIN_PHOTOGRAPHS} photographs, found {found}{skipped}");
        DatasetError::fault(request.photographs, fault)
    };
    let bare = Bare::of(request.photographs)?.ok_or_else(|| few(0, &[]))?;
    let count = bare.photographs.len();
    if count < MIN_PHOTOGRAPHS {
        return Err(few(count, &bare.damaged).into());
    }
    let runner = Runner { request, photographs: count };
    let result = AtomicFolder::create(request.output)?;
    let work = result.place().join("work");
    let place = Place { images: result.place().join("images"), work: work.clone() };
    // Called first, so that nothing is copied if COLMAP is not installed.
    runner.help(&commands::features(&place, None))?;
    let cannot_write_output = |source| cannot_write(request.output, source);
    [&place.images, &work].into_iter().try_for_each(fs::create_dir).map_err(cannot_write_output)?;
    copy(&bare, &place.images).map_err(cannot_write_output)?;
    extract(&bare, &place, &runner)?;
    let best = best(&place, &runner)?;
    let sparse = result.place().join("sparse");
    let kept = fs::create_dir(&sparse).and_then(|()| keep(&best.model, &sparse.join("0"), &work));
    kept.map_err(cannot_write_output)?;
    result.commit()?;
    Ok(found(bare, best))
}

/// Extracts the features of all photographs into one database, with one run of COLMAP for each camera.
fn extract(bare: &Bare, place: &Place, runner: &Runner<'_>) -> anyhow::Result<()> {
    for (index, names) in bare.cameras.iter().enumerate() {
        let list = place.work.join(format!("camera{index}.txt"));
        let list = (bare.cameras.len() > 1).then_some(list);
        if let Some(list) = &list {
            fs::write(list, names.join("\n") + "\n").map_err(|source| cannot_write(list, source))?;
        }
        runner.run(commands::features(place, list.as_deref()))?;
    }
    Ok(())
}

/// Tries COLMAP's strategies ([`Way`]) in order; returns the first reconstruction without a fault, else the largest.
fn best(place: &Place, runner: &Runner<'_>) -> anyhow::Result<Attempt> {
    let Runner { request, photographs: count } = *runner;
    let mut best: Option<Attempt> = None;
    for way in Way::all(request.sequential) {
        let attempt = match (attempt(way, place, runner), &best) {
            (Err(error), None) => return Err(error),
            (Err(error), Some(_)) => {
                say_lines(request.style, &format!("{}: {error}", way.in_words()));
                continue;
            }
            (Ok(model), _) => {
                let data =
                    with_photographs(place, way).map_err(|source| cannot_write(&place.images, source))?;
                let folded = data.and_then(|data| (request.folded)(&data));
                let fault = Fault::of(&model, count, folded);
                Attempt { model, way, fault }
            }
        };
        let Some(fault) = &attempt.fault else { return Ok(attempt) };
        let registered = attempt.model.names.len();
        say_lines(
            request.style,
            &format!("{}: {registered} of {count} photographs: {fault}", way.in_words()),
        );
        let rank = |attempt: &Attempt| (attempt.fault.is_none(), attempt.model.names.len());
        if best.as_ref().is_none_or(|best| rank(best) < rank(&attempt)) {
            best = Some(attempt);
        }
    }
    best.ok_or_else(|| none_registered(count, "no model was made"))
}

/// Reads the largest reconstruction of `way` as a data set; `None` if it is unreadable. The photographs are moved next
/// to the reconstruction while it is read. Fails if the photographs cannot be moved.
fn with_photographs(place: &Place, way: Way) -> io::Result<Option<Dataset>> {
    let models = place.models(way);
    let beside = models.join("images");
    fs::rename(&place.images, &beside)?;
    let data = read(&models, &ReadOptions::default()).ok();
    fs::rename(&beside, &place.images)?;
    Ok(data)
}

/// Matches and reconstructs with the strategy `way`, and summarises the largest reconstruction; fails if none is made.
fn attempt(way: Way, place: &Place, runner: &Runner<'_>) -> anyhow::Result<Facts> {
    if let Some(matching) = commands::matching(place, way) {
        let database = place.database(way);
        fs::copy(place.features(), &database).map_err(|source| cannot_write(&database, source))?;
        runner.run(matching)?;
    }
    let models = place.models(way);
    fs::create_dir_all(models.join("sparse")).map_err(|source| cannot_write(&models, source))?;
    runner.run(commands::mapping(place, way, runner.photographs))?;
    facts(&models)?.ok_or_else(|| none_registered(runner.photographs, "no model was made"))
}

fn found(bare: Bare, Attempt { model, way, fault }: Attempt) -> Found {
    let names = bare.photographs.iter().map(|path| file_name(path));
    Found {
        photographs: bare.photographs.len(),
        registered: model.names.len(),
        unregistered: names.filter(|name| !model.names.contains(name)).collect(),
        cameras: bare.cameras.len(),
        damaged: bare.damaged,
        models: 1 + model.others.len(),
        points: model.points,
        mean_reprojection_error_px: model.mean_error,
        way: way.in_words(),
        fault,
    }
}

fn cannot_write(path: &Path, source: io::Error) -> anyhow::Error {
    OutputError::new(output::Attempt::Write, path, source).into()
}

fn copy(bare: &Bare, images: &Path) -> io::Result<()> {
    for photograph in &bare.photographs {
        fs::copy(photograph, images.join(photograph.file_name().unwrap_or_default()))?;
    }
    Ok(())
}

/// Moves the reconstruction to `place` and removes the folder `work`.
fn keep(model: &Facts, place: &Path, work: &Path) -> io::Result<()> {
    fs::rename(&model.folder, place)?;
    // `project.ini` contains paths in the hidden folder, which is renamed at the end.
    let _ = fs::remove_file(place.join("project.ini"));
    fs::remove_dir_all(work)
}
