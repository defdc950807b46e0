//! Protection of inputs: all paths that a command will read or write are compared before it reads or writes.
//!
//! Files are compared by their identity in the file system (device and inode on Unix, the canonical path elsewhere).
//! Two paths to one file are thus recognised despite links, relative paths and differences of case. If a data set is a
//! folder, no output may lie in it. If a data set is a file, the inputs are that file, the transforms files next to it,
//! and the images that transforms files name. A folder of results must not hold an input that has the extension of a
//! result file, such as `.png` or `.json`. Devices and pipes such as `/dev/null` may be input and output.

use super::mark::was_made_here;
use super::{Attempt, OutputError, ensure_folder, folder_of};
use std::collections::{BTreeSet, HashMap};
use std::ffi::OsStr;
use std::path::{Component, Path, PathBuf};
use std::{fs, io};

/// Maximum length of a file name, bytes: the limit of common file systems.
const MAX_NAME_BYTES: usize = 255;
/// Extensions of the files that commands write into a folder of results.
const RESULTS: [&str; 8] = ["csv", "gif", "html", "json", "md", "mp4", "png", "svg"];
/// Folders into which commands write, relative to a folder of results; `""`: the folder itself.
const RESULT_FOLDERS: [&str; 4] = ["", "snapshots", "moved", "runs"];

/// Error about a refused output, in one sentence: which output, why, and what to do.
#[derive(Debug, thiserror::Error)]
#[error("{output}: {found}")]
pub struct ClaimError {
    output: String,
    found: String,
}

/// Treatment of an output file that exists already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    Replace,
    /// The output replaces the file if this program made the file; otherwise the output is refused.
    ReplaceOwn,
    /// The output is refused. The text completes the error message, with reason and advice.
    Refuse(&'static str),
}

#[derive(Debug, Default)]
pub struct Claims {
    inputs: HashMap<Identity, Input>,
    outputs: Vec<Output>,
}

#[derive(Debug)]
struct Input {
    shown: String,
    is_folder: bool,
}

#[derive(Debug)]
struct Output {
    flag: String,
    path: PathBuf,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    File(Existing),
    Results,
    Frames,
}

#[derive(Debug, PartialEq, Eq, Hash)]
enum Identity {
    #[cfg(unix)]
    Inode(u64, u64),
    /// Canonical path; used if the file does not exist yet, or if the system has no inodes.
    Path(PathBuf),
}

impl Identity {
    /// Returns the identity of a file or folder; `None` for a device or pipe, or if nothing exists at `path`.
    fn of(path: &Path) -> Option<Self> {
        let metadata = fs::metadata(path).ok().filter(|found| found.is_file() || found.is_dir())?;
        #[cfg(unix)]
        {
            use std::os::unix::fs::MetadataExt;
            Some(Self::Inode(metadata.dev(), metadata.ino()))
        }
        #[cfg(not(unix))]
        {
            let _ = metadata;
            fs::canonicalize(path).ok().map(Self::Path)
        }
    }
}

/// Whether `path` is a device or pipe, which is written to and not replaced.
pub fn is_device(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir())
}

impl Claims {
    /// Adds the input `path`, if given: a file, or a folder with all its contents. `what`: description of the input
    /// for errors. A missing file is ignored here; the command fails when it reads the file.
    pub fn reads<'p, P: AsRef<Path> + ?Sized + 'p>(
        mut self,
        what: &str,
        path: impl Into<Option<&'p P>>,
    ) -> Self {
        let path = path.into().map(P::as_ref);
        if let Some((path, identity)) = path.and_then(|path| Some((path, Identity::of(path)?))) {
            let shown = format!("{what} {}", path.display());
            self.inputs.entry(identity).or_insert(Input { shown, is_folder: path.is_dir() });
        }
        self
    }

    pub fn writes(self, flag: &str, path: &Path) -> Self {
        self.derives(flag, path, Existing::Replace)
    }

    /// Adds `path` as an output file. `what`: name of the output in errors; `existing`: treatment of an existing file.
    pub fn derives(self, what: &str, path: &Path, existing: Existing) -> Self {
        self.output(what, path, Kind::File(existing))
    }

    /// Adds `folder`, given by the flag `flag`, as a folder of results to write; `None` adds nothing.
    pub fn writes_folder<'p, P: AsRef<Path> + ?Sized + 'p>(
        self,
        flag: &str,
        folder: impl Into<Option<&'p P>>,
    ) -> Self {
        match folder.into() {
            Some(folder) => self.output(flag, folder.as_ref(), Kind::Results),
            None => self,
        }
    }

    /// Adds `frame_0000.png`, `frame_0001.png`, …, in `folder`, given by the flag `flag`, as outputs.
    pub fn writes_frames(self, flag: &str, folder: &Path) -> Self {
        self.output(flag, folder, Kind::Frames)
    }

    fn output(mut self, flag: &str, path: &Path, kind: Kind) -> Self {
        self.outputs.push(Output { flag: flag.to_owned(), path: path.to_owned(), kind });
        self
    }

    /// Fails if an output is also an input or another output, lies in an input folder, has an invalid file
    /// name, or must not replace an existing file. Creates nothing.
    pub fn check(&self) -> Result<(), ClaimError> {
        let mut taken: HashMap<Identity, &str> = HashMap::new();
        for output in &self.outputs {
            let fault = |found| ClaimError { output: output.flag.clone(), found };
            self.check_output(output).map_err(fault)?;
            if matches!(output.kind, Kind::File(_)) && !is_device(&output.path) {
                let place = resolved(&output.path);
                let identity = Identity::of(&place).unwrap_or(Identity::Path(place));
                if let Some(other) = taken.insert(identity, &output.flag) {
                    let path = output.path.display();
                    return Err(fault(format!("{path} is also what {other} writes; choose another name")));
                }
            }
        }
        Ok(())
    }

    /// Calls [`check`](Self::check), then creates the folders of all outputs and tests that files can be written there.
    pub fn settle(&self) -> Result<(), ClaimError> {
        self.check()?;
        let mut tried = BTreeSet::new();
        for Output { flag, path, kind } in &self.outputs {
            let folder = match kind {
                // A link is followed: the file is written into the folder of its target.
                Kind::File(_) if path.is_file() => folder_of(&resolved(path)).to_owned(),
                Kind::File(_) => folder_of(path).to_owned(),
                Kind::Results | Kind::Frames => path.clone(),
            };
            if !is_device(path) && tried.insert(folder.clone()) {
                ensure_folder(folder)
                    .map_err(|error| ClaimError { output: flag.clone(), found: error.to_string() })?;
            }
        }
        Ok(())
    }

    fn check_output(&self, Output { path, kind, .. }: &Output) -> Result<(), String> {
        if let Kind::File(existing) = kind {
            check_name(path)?;
            self.check_place(path)?;
            return check_existing(path, *existing);
        }
        self.check_place(path)?;
        let (folders, extensions): (&[&str], &[&str]) = match kind {
            Kind::Frames => (&[""], &["png"]),
            _ => (&RESULT_FOLDERS, &RESULTS),
        };
        for folder in folders.iter().map(|below| path.join(below)) {
            self.check_place(&folder)?;
            // A missing folder holds no files. A folder that cannot be read is reported when a trial file is written.
            for file in fs::read_dir(&folder).into_iter().flatten().flatten().map(|entry| entry.path()) {
                let is_like = |found: &OsStr| extensions.iter().any(|e| found.eq_ignore_ascii_case(e));
                if !file.extension().is_some_and(is_like) {
                    continue;
                }
                if let Some(Input { shown, is_folder: false }) = self.input(&file) {
                    let file = file.display();
                    return Err(format!("{file} is {shown}, which is being read; choose another folder"));
                }
                let name = file.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
                if *kind == Kind::Frames && name.starts_with("frame_") {
                    check_existing(&file, Existing::ReplaceOwn)?;
                }
            }
        }
        Ok(())
    }

    fn input(&self, path: &Path) -> Option<&Input> {
        self.inputs.get(&Identity::of(path)?)
    }

    /// Refuses a path that is an input or lies in an input folder; for a link, checks the link and its target.
    fn check_place(&self, path: &Path) -> Result<(), String> {
        let (place, shown_path) = (resolved(path), path.display());
        let above = resolved(folder_of(path));
        let folders = place.ancestors().chain(above.ancestors());
        match self.input(&place) {
            Some(Input { shown, is_folder: false }) => {
                Err(format!("{shown_path} is {shown} and would be destroyed; choose another name"))
            }
            _ => match folders.filter_map(|folder| self.input(folder)).find(|input| input.is_folder) {
                Some(Input { shown, .. }) => Err(format!(
                    "{shown_path} lies in {shown}, which is being read; choose a place outside of it"
                )),
                None => Ok(()),
            },
        }
    }
}

/// Refuses a path that names a folder, and file names that are too long.
fn check_name(path: &Path) -> Result<(), String> {
    let shown = path.display();
    let ends_in_slash =
        path.as_os_str().as_encoded_bytes().last().is_some_and(|&last| std::path::is_separator(last.into()));
    if ends_in_slash || path.file_name().is_none() || resolved(path).is_dir() {
        return Err(format!("expected the name of a file, found the folder {shown}"));
    }
    let found = path.file_name().map_or(0, |name| name.as_encoded_bytes().len());
    if found > MAX_NAME_BYTES {
        return Err(format!(
            "expected a name of at most {MAX_NAME_BYTES} bytes, found {found} in {shown}; choose a shorter one"
        ));
    }
    match fs::symlink_metadata(path) {
        // `NotFound` and `NotADirectory` are reported when the folder is created.
        Err(error) if !matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            Err(OutputError::new(Attempt::Create, path, error).to_string())
        }
        _ => Ok(()),
    }
}

fn check_existing(path: &Path, existing: Existing) -> Result<(), String> {
    let why = match existing {
        Existing::Replace => return Ok(()),
        _ if !path.is_file() => return Ok(()),
        Existing::ReplaceOwn if was_made_here(path) => return Ok(()),
        Existing::ReplaceOwn => {
            " and nerf-train did not make it; move it away, or choose another name for -o"
        }
        Existing::Refuse(why) => why,
    };
    Err(format!("{} is there already{why}", path.display()))
}

/// Returns `path` with links, `.` and `..` resolved; components that do not exist are kept literally.
fn resolved(path: &Path) -> PathBuf {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let mut real = PathBuf::new();
    for component in absolute.components() {
        match component {
            Component::ParentDir => {
                real.pop();
            }
            Component::CurDir => {}
            other => {
                real.push(other);
                real = fs::canonicalize(&real).unwrap_or(real);
            }
        }
    }
    real
}
