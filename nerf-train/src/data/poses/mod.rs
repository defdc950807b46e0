//! Poses of bare photographs, found by an installed COLMAP.
//!
//! COLMAP works in a hidden folder beside the result, on hard links to the photographs (copies where the file system
//! cannot link), which appears under its name, whole, when a model was found. The photographs themselves are only read.

mod error;

pub use error::PosesError;

use crate::data::layouts::bare::Bare;
use crate::data::layouts::colmap::commands::{Stage, stages};
use crate::data::layouts::colmap::{Facts, facts};
use crate::data::system::child::{Heard, Helper, last_lines};
use crate::data::system::output::AtomicFolder;
use crate::data::system::progress::{Message, Progress, ProgressStyle, Total};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::time::Duration;

/// Fewer photographs tell nothing: a fit trains on some and is measured on another.
const MIN_PHOTOGRAPHS: usize = 3;
/// What is kept of COLMAP's messages, bytes: the last ones say how far it is and why it failed.
const KEPT_BYTES: usize = 32 << 10;
/// How often it is asked how far it is.
const LOOK_EVERY: Duration = Duration::from_millis(200);
/// How long it may take to list its options.
const HELP_PATIENCE: Duration = Duration::from_secs(30);

/// What is asked of COLMAP.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// The folder of photographs.
    pub photographs: &'a Path,
    /// The folder that is made.
    pub output: &'a Path,
    /// Whether only neighbours in the order of names are compared, not all with all.
    pub sequential: bool,
    /// Most threads; `None`: all there are.
    pub threads: Option<usize>,
    /// Where progress is shown.
    pub style: ProgressStyle,
}

/// What COLMAP found.
#[derive(Clone, Debug)]
pub struct Found {
    /// Photographs that were tried.
    pub photographs: usize,
    /// How many have a pose now.
    pub registered: usize,
    /// Names of those that have none.
    pub unregistered: Vec<String>,
    /// Names of files that are no whole pictures, and were not tried.
    pub damaged: Vec<String>,
    /// Whether all were taken for pictures of one camera, as they have one size.
    pub one_camera: bool,
    /// How many models there were, of which the largest is kept.
    pub models: usize,
    /// Sparse points.
    pub points: usize,
    /// Mean over the points, pixels.
    pub mean_reprojection_error: f64,
    /// Whether the result has copies of the photographs: the file system cannot link them.
    pub copied: bool,
}

/// Finds the poses of photographs and writes `sparse/0` and `images` into a new folder.
///
/// # Errors
/// [`PosesError`]; then nothing is left of the folder.
pub fn find(request: &Request<'_>) -> Result<Found, PosesError> {
    let few = |found, damaged: &[String]| PosesError::Few {
        folder: request.photographs.into(),
        found,
        skipped: match damaged.len() {
            0 => String::new(),
            count => format!(", and {count} files that are no whole pictures"),
        },
    };
    let bare = Bare::of(request.photographs)?.ok_or_else(|| few(0, &[]))?;
    let count = bare.photographs.len();
    if count < MIN_PHOTOGRAPHS {
        return Err(few(count, &bare.damaged));
    }
    let result = AtomicFolder::create(request.output)?;
    let [images, models, sparse] = ["images", "models", "sparse"].map(|name| result.place().join(name));
    let database = result.place().join("database.db");
    let made = |folder: &Path| fs::create_dir(folder).map_err(|source| cannot_write(request, source));
    // As readers look for models: numbered ones in `sparse`.
    let numbered = models.join("sparse");
    [&images, &models, &numbered, &sparse].into_iter().try_for_each(|folder| made(folder))?;
    // Asked first: nothing is linked or copied for a program that is not there.
    let stages = stages(&images, &database, &numbered, bare.one_size, request.sequential);
    let stages = stages.map(|stage| match request.threads {
        Some(threads) => stage.with_threads(threads),
        None => stage,
    });
    let commands = [arguments(&stages[0])?, arguments(&stages[1])?, arguments(&stages[2])?];
    let copied = link(&bare, &images).map_err(|source| cannot_write(request, source))?;
    for (stage, arguments) in stages.iter().zip(commands) {
        run(stage, arguments, count, request.style)?;
    }
    let none = || PosesError::NoneRegistered { photographs: count, said: "no model was made".into() };
    let model = facts(&models)?.ok_or_else(none)?;
    keep(&model, &sparse.join("0"), &[&models, &database]).map_err(|source| cannot_write(request, source))?;
    result.commit()?;
    Ok(found(bare, model, copied))
}

fn found(bare: Bare, model: Facts, copied: bool) -> Found {
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let names = bare.photographs.iter().map(name);
    Found {
        photographs: bare.photographs.len(),
        registered: model.names.len(),
        unregistered: names.filter(|name| !model.names.contains(name)).collect(),
        damaged: bare.damaged,
        one_camera: bare.one_size,
        models: model.models,
        points: model.points,
        mean_reprojection_error: model.mean_error,
        copied,
    }
}

fn cannot_write(request: &Request<'_>, source: io::Error) -> PosesError {
    let attempt = crate::data::system::output::Attempt::Write;
    crate::data::system::output::OutputError { path: request.output.into(), attempt, source }.into()
}

/// Puts all photographs into `images`; whether they had to be copied.
fn link(bare: &Bare, images: &Path) -> io::Result<bool> {
    let mut copied = false;
    for photograph in &bare.photographs {
        let place = images.join(photograph.file_name().unwrap_or_default());
        // A link to a link would break where that is relative.
        let photograph = fs::canonicalize(photograph)?;
        if fs::hard_link(&photograph, &place).is_err() {
            fs::copy(&photograph, &place)?;
            copied = true;
        }
    }
    Ok(copied)
}

/// Moves the model to its place, and removes what is of no use to anybody any more.
fn keep(model: &Facts, place: &Path, rest: &[&Path]) -> io::Result<()> {
    fs::rename(&model.folder, place)?;
    // Names the hidden folder.
    let _ = fs::remove_file(place.join("project.ini"));
    for path in rest {
        if path.is_dir() { fs::remove_dir_all(path)? } else { fs::remove_file(path)? }
    }
    Ok(())
}

/// `colmap`, without a window and without input.
fn colmap() -> Command {
    let mut command = Command::new("colmap");
    command.env("QT_QPA_PLATFORM", "offscreen");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn start(command: &mut Command) -> Result<(Helper, Heard, Heard), PosesError> {
    let helper = Helper::spawn(command).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => PosesError::Missing,
        _ => PosesError::Start(error),
    })?;
    let (_, stdout, stderr) = helper.pipes();
    Ok((helper, Heard::of(stdout, KEPT_BYTES), Heard::of(stderr, KEPT_BYTES)))
}

/// A command's arguments, with the names that the installed version has for its options.
fn arguments(stage: &Stage) -> Result<Vec<std::ffi::OsString>, PosesError> {
    let (helper, out, err) = start(colmap().arg(stage.name).arg("--help"))?;
    // One that does not answer fails at its work, and says why.
    helper.wait(HELP_PATIENCE).or_else(|| helper.kill());
    let help = [out.text(), err.text()].concat();
    Ok(stage.arguments(&String::from_utf8_lossy(&help)))
}

/// Runs a command to its end and shows how far it is.
fn run(
    stage: &Stage,
    arguments: Vec<std::ffi::OsString>,
    photographs: usize,
    style: ProgressStyle,
) -> Result<(), PosesError> {
    let (helper, out, err) = start(colmap().args(arguments))?;
    let (what, whole) = match stage.name {
        "feature_extractor" => ("features", "photographs"),
        "mapper" => ("poses", "photographs"),
        _ => ("matches", "blocks of photographs"),
    };
    // Into how many parts matching goes is known when it begins.
    let mut progress: Option<(u64, Progress)> = None;
    let status = loop {
        let status = helper.wait(LOOK_EVERY);
        let said = [out.so_far(), err.so_far()];
        let at = said.iter().find_map(|said| position(&String::from_utf8_lossy(said), photographs as u64));
        if let Some((done, total)) = at {
            let fresh = || (total, Progress::new(what, Total::Steps(total), style));
            let (_, shown) = match &mut progress {
                Some(shown) if shown.0 == total => shown,
                other => other.insert(fresh()),
            };
            shown.update(done, &Message::default());
        }
        if let Some(status) = status {
            break status;
        }
    };
    if !status.success() {
        return Err(failure(stage, status, photographs, [out.text(), err.text()]));
    }
    if let Some((total, progress)) = progress {
        let total = if what == "poses" { photographs as u64 } else { total };
        progress.finish(format!("{total} {whole}"));
    }
    Ok(())
}

/// Why it failed: that no pair of photographs fits is an error to COLMAP, too.
fn failure(stage: &Stage, status: ExitStatus, photographs: usize, said: [Vec<u8>; 2]) -> PosesError {
    let [out, err] = said;
    let all = [out.as_slice(), b"\n", err.as_slice()].concat();
    // Messages are on one of the two, by version.
    let last = last_lines(if err.trim_ascii().is_empty() { &out } else { &err });
    let text = String::from_utf8_lossy(&all);
    if stage.name == "mapper" && status.code().is_some() && text.contains("failed to create") {
        return PosesError::NoneRegistered { photographs, said: last_lines(&all) };
    }
    PosesError::Failed { stage: stage.name, status: status.to_string(), said: last }
}

/// How far COLMAP is, of how much, by the last that it has said: `[3/77]`, of blocks `[1/2, 2/2]`, and of the mapper
/// `Registering image #65 (3)`, or `(num_reg_frames=3)`, of all `photographs`.
fn position(said: &str, photographs: u64) -> Option<(u64, u64)> {
    let number = |text: &str| {
        let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
        text[..digits].parse::<u64>().ok()
    };
    let pair = |text: &str| {
        let (a, b) = text.split_once('/')?;
        Some((a.trim().parse::<u64>().ok()?, b.trim().parse::<u64>().ok()?))
    };
    said.lines().rev().find_map(|line| {
        if let Some((_, rest)) = line.split_once("Registering image #") {
            let (_, rest) = rest.split_once('(')?;
            return Some((number(rest.trim_start_matches("num_reg_frames="))?, photographs));
        }
        let (_, rest) = line.split_once('[')?;
        let (inner, _) = rest.split_once(']')?;
        match inner.split_once(',') {
            Some((row, column)) => {
                let ((i, rows), (j, columns)) = (pair(row)?, pair(column)?);
                Some((i.checked_sub(1)?.checked_mul(columns)?.checked_add(j)?, rows.checked_mul(columns)?))
            }
            None => pair(inner),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::position;

    #[test]
    fn the_last_of_what_it_said_tells_how_far_it_is() {
        let position = |said| position(said, 77);
        assert_eq!(position("Processed file [1/12]\n  Name: a\nProcessed file [2/12]\n  Dim"), Some((2, 12)));
        assert_eq!(position("I2025 12:00 feature_matching.cc:4] Processing block [2/3, 1/3]"), Some((4, 9)));
        assert_eq!(position("Matching block [2/2, 1/2] in 0.4s\nMatching bl"), Some((3, 4)));
        assert_eq!(position("Registering image #5 (8)\n  => Image sees 3 / 4 points"), Some((8, 77)));
        assert_eq!(position("Registering image #5 (num_reg_frames=9)"), Some((9, 77)));
        assert_eq!(position("Elapsed time: 0.041 [minutes]"), None);
        assert_eq!(position("[18446744073709551615/3, 9/18446744073709551615]"), None);
    }
}
