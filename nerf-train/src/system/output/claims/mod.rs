//! An input is never an output: what a command reads and what it writes, compared before it does either.
//!
//! Files are compared by what the file system knows them by (device and inode on Unix, the canonical path elsewhere),
//! so that links, relative paths and names that differ in case only are seen through. A data set that is named as a
//! folder is read as a whole: nothing is written into it. Of one that is named as a file, that file, the lists beside
//! it and the pictures they name are protected. Devices and pipes such as `/dev/null` may be both.

mod error;

use super::mark::was_made_here;
use super::{OutputError, ensure_folder, folder_of};
pub use error::ClaimError;
use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::io;
use std::path::{Component, Path, PathBuf};

/// Bytes a file's name may have on all file systems in use.
const MAX_NAME_BYTES: usize = 255;

/// What becomes of a file that is there already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// It was named, and is replaced.
    Replace,
    /// It was not named: replaced where this program made it, else refused.
    ReplaceOwn,
    /// Refused, for this reason and with this advice.
    Refuse(&'static str),
}

/// What a folder of results may hold.
#[derive(Clone, Copy, Debug)]
pub struct Contents {
    /// Files with names known beforehand.
    pub files: &'static [&'static str],
    /// Files whose names depend on what is read.
    pub patterns: &'static [Pattern],
}

/// Files of a subfolder (or of the folder itself: `""`) that begin and end like this.
#[derive(Clone, Copy, Debug)]
pub struct Pattern {
    /// The subfolder.
    pub folder: &'static str,
    /// How names begin.
    pub prefix: &'static str,
    /// How they end, without the dot.
    pub extension: &'static str,
}

/// What a command reads and writes.
#[derive(Debug, Default)]
pub struct Claims {
    /// What is read, by identity.
    inputs: HashMap<Identity, Input>,
    outputs: Vec<Output>,
}

#[derive(Clone, Debug)]
struct Input {
    /// For a person: what it is, and its name.
    shown: String,
    is_folder: bool,
}

#[derive(Debug)]
struct Output {
    flag: String,
    /// As it was given.
    path: PathBuf,
    /// Where that is: `new/../a` is `a` once there is a folder `new`.
    place: PathBuf,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    File(Existing),
    /// Made and tried out before the work if so.
    Folder(bool),
    /// Any file in the folder with this prefix and extension.
    Any(&'static str, &'static str, Existing),
}

/// What the file system knows a file or folder by.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Identity {
    /// Device and inode.
    #[cfg(unix)]
    Inode(u64, u64),
    /// The canonical path: of what does not exist yet, and where there are no inodes.
    Path(PathBuf),
}

impl Identity {
    /// Of a file or folder that exists; `None` also for devices and pipes, which nothing is lost by writing.
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

/// Whether it is neither a file nor a folder: it is written to, not replaced.
pub fn is_device(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir())
}

impl Claims {
    /// Nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Reads a file, or a folder with all that is in it; `what` names it in errors. One that is missing is no matter
    /// here: whoever reads it says so.
    pub fn reads(mut self, what: &str, path: &Path) -> Self {
        if let Some(identity) = Identity::of(path) {
            let shown = format!("{what} {}", path.display());
            self.inputs.entry(identity).or_insert(Input { shown, is_folder: path.is_dir() });
        }
        self
    }

    /// As [`reads`](Self::reads), where a flag was given.
    pub fn reads_if(self, what: &str, path: Option<&Path>) -> Self {
        match path {
            Some(path) => self.reads(what, path),
            None => self,
        }
    }

    /// Writes the file that `flag` names.
    pub fn writes(self, flag: &str, path: &Path) -> Self {
        self.output(flag, path, Kind::File(Existing::Replace))
    }

    /// Writes a file whose name follows from another one's.
    pub fn derives(self, what: &str, path: &Path, existing: Existing) -> Self {
        self.output(what, path, Kind::File(existing))
    }

    /// Writes into the folder that `flag` names.
    pub fn writes_folder(self, flag: &str, folder: &Path, contents: &Contents) -> Self {
        let mut claims = self.output(flag, folder, Kind::Folder(true));
        for name in contents.files {
            claims = claims.output(flag, &folder.join(name), Kind::File(Existing::Replace));
        }
        for pattern in contents.patterns {
            claims = claims.writes_any(flag, folder, pattern, Existing::Replace);
        }
        claims
    }

    /// As [`writes_folder`](Self::writes_folder), where the flag was given.
    pub fn writes_folder_if(self, flag: &str, folder: Option<&Path>, contents: &Contents) -> Self {
        match folder {
            Some(folder) => self.writes_folder(flag, folder, contents),
            None => self,
        }
    }

    /// Writes files of the folder that `flag` names, under numbered names.
    pub fn writes_frames(self, flag: &str, folder: &Path, pattern: &Pattern) -> Self {
        self.output(flag, folder, Kind::Folder(true)).writes_any(flag, folder, pattern, Existing::ReplaceOwn)
    }

    fn writes_any(self, flag: &str, folder: &Path, pattern: &Pattern, existing: Existing) -> Self {
        let Pattern { folder: below, prefix, extension } = *pattern;
        let folder = if below.is_empty() { folder.to_owned() } else { folder.join(below) };
        self.output(flag, &folder, Kind::Folder(false)).output(
            flag,
            &folder,
            Kind::Any(prefix, extension, existing),
        )
    }

    fn output(mut self, flag: &str, path: &Path, kind: Kind) -> Self {
        let place = if path.exists() { path.to_owned() } else { resolved(path) };
        self.outputs.push(Output { flag: flag.to_owned(), path: path.to_owned(), place, kind });
        self
    }

    /// Compares all outputs with all inputs and with each other; makes nothing.
    ///
    /// # Errors
    /// [`ClaimError`] names the output and what it would destroy.
    pub fn check(&self) -> Result<(), ClaimError> {
        let mut taken: HashMap<Identity, &str> = HashMap::new();
        for output in &self.outputs {
            self.check_output(output)?;
            if matches!(output.kind, Kind::File(_)) && !is_device(&output.path) {
                let identity = Identity::of(&output.place);
                let identity = identity.unwrap_or_else(|| Identity::Path(output.place.clone()));
                if let Some(other) = taken.insert(identity, &output.flag) {
                    let (path, other) = (output.path.clone(), other.to_owned());
                    return Err(ClaimError::Twice { output: output.flag.clone(), path, other });
                }
            }
        }
        Ok(())
    }

    /// As [`check`](Self::check), then makes the folders of all outputs and tries them out.
    ///
    /// # Errors
    /// [`ClaimError`]; nothing is made where anything is refused by comparison or by name.
    pub fn settle(&self) -> Result<(), ClaimError> {
        self.check()?;
        let mut tried = BTreeSet::new();
        for Output { flag, path, kind, .. } in &self.outputs {
            let folder = match kind {
                Kind::Folder(true) => path.clone(),
                // A link is followed: what counts is the folder of the file it stands for.
                Kind::File(_) if path.is_file() => folder_of(&resolved(path)).to_owned(),
                Kind::File(_) => folder_of(path).to_owned(),
                _ => continue,
            };
            if !is_device(path) && tried.insert(folder.clone()) {
                ensure_folder(folder)
                    .map_err(|source| ClaimError::Output { output: flag.clone(), source })?;
            }
        }
        Ok(())
    }

    fn check_output(&self, output: &Output) -> Result<(), ClaimError> {
        match output.kind {
            Kind::File(existing) => {
                check_name(output)?;
                self.check_input(output, &output.place)?;
                self.check_inside(output)?;
                check_existing(output, &output.place, existing)
            }
            Kind::Folder(_) => {
                self.check_input(output, &output.place)?;
                self.check_inside(output)
            }
            Kind::Any(prefix, extension, existing) => {
                // A folder that is not there holds nothing; one that cannot be read says so when it is tried out.
                let entries = fs::read_dir(&output.place).into_iter().flatten().flatten();
                for path in entries.map(|entry| entry.path()).filter(|path| is_like(path, prefix, extension))
                {
                    self.check_input(output, &path)?;
                    check_existing(output, &path, existing)?;
                }
                Ok(())
            }
        }
    }

    fn check_input(&self, output: &Output, path: &Path) -> Result<(), ClaimError> {
        let Some(input) = Identity::of(path).and_then(|identity| self.inputs.get(&identity)) else {
            return Ok(());
        };
        let (output, path, input_shown) = (output.flag.clone(), path.to_owned(), input.shown.clone());
        Err(match input.is_folder {
            true => ClaimError::Inside { output, path, input: input_shown },
            false => ClaimError::Input { output, path, input: input_shown },
        })
    }

    /// Looks at the folders above the name and, where that is a link, above what it stands for.
    fn check_inside(&self, output: &Output) -> Result<(), ClaimError> {
        let places = [resolved(&output.path), resolved(folder_of(&output.path)).join("name")];
        for folder in places.iter().flat_map(|place| place.ancestors().skip(1)) {
            let input = Identity::of(folder).and_then(|identity| self.inputs.get(&identity));
            if let Some(Input { shown, is_folder: true }) = input {
                let (flag, path) = (output.flag.clone(), output.path.clone());
                return Err(ClaimError::Inside { output: flag, path, input: shown.clone() });
            }
        }
        Ok(())
    }
}

/// Refuses folders and names that are too long.
fn check_name(output: &Output) -> Result<(), ClaimError> {
    let Output { flag, path, place, .. } = output;
    let ends_in_slash =
        path.as_os_str().as_encoded_bytes().last().is_some_and(|&last| std::path::is_separator(last.into()));
    if ends_in_slash || path.file_name().is_none() || place.is_dir() {
        return Err(ClaimError::Folder { output: flag.clone(), path: path.clone() });
    }
    let found = path.file_name().map_or(0, |name| name.as_encoded_bytes().len());
    if found > MAX_NAME_BYTES {
        return Err(ClaimError::Long { output: flag.clone(), path: path.clone(), found });
    }
    match fs::symlink_metadata(path) {
        // Said by whoever makes the folder.
        Err(error) if !matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            let source = OutputError::new(super::Attempt::Create, path, error);
            Err(ClaimError::Output { output: flag.clone(), source })
        }
        _ => Ok(()),
    }
}

fn check_existing(output: &Output, path: &Path, existing: Existing) -> Result<(), ClaimError> {
    let why = match existing {
        Existing::Replace => return Ok(()),
        _ if !path.is_file() => return Ok(()),
        Existing::ReplaceOwn if was_made_here(path) => return Ok(()),
        Existing::ReplaceOwn => {
            " and nerf-train did not make it; move it away, or choose another name for -o"
        }
        Existing::Refuse(why) => why,
    };
    Err(ClaimError::Taken { output: output.flag.clone(), path: path.to_owned(), why })
}

/// Whether a file's name begins and ends so, whatever its case.
fn is_like(path: &Path, prefix: &str, extension: &str) -> bool {
    let begins = path.file_name().is_some_and(|name| {
        name.as_encoded_bytes().get(..prefix.len()).is_some_and(|b| b.eq_ignore_ascii_case(prefix.as_bytes()))
    });
    begins && path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension))
}

/// The path without links, `.` and `..`, as far as it exists; the rest by its letters.
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
