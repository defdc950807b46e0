//! Writing of files, each whole or not at all. All files are written here.
//!
//! [`AtomicFile`] writes a hidden file next to the final name; [`AtomicFile::commit`] renames it to that name. A reader
//! never sees half a file, and neither a crash nor a full disk leaves one. If two processes write the same name, one of
//! the two files remains, whole. A signal removes uncommitted files ([`crate::system::stop`]). A process that is killed
//! outright may leave a hidden `.nerf-*.tmp` behind, which is safe to delete.

pub mod claims;
mod folder;
pub mod mark;

pub use folder::AtomicFolder;

use crate::system::lock;
use std::collections::BTreeSet;
use std::fmt;
use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use tempfile::NamedTempFile;

/// Size of write buffers, bytes: large, as images and scene files are written in small parts.
const BUFFER_BYTES: usize = 1 << 16;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Attempt {
    CreateFolder,
    /// Writing a trial file into a folder.
    ProbeFolder,
    /// Creating the temporary file next to the final name, or opening a device.
    Create,
    Write,
    Rename,
}

impl fmt::Display for Attempt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::CreateFolder => "create the folder",
            Self::ProbeFolder => "write into the folder",
            Self::Create => "create the file",
            Self::Write => "write the file",
            Self::Rename => "put the finished file in place as",
        })
    }
}

/// Error about a file or folder that could not be written: what was tried, where, and what the system said.
///
/// Its text is for example `cannot write the file out/a.nerf: No space left on device (os error 28)`.
#[derive(Debug, thiserror::Error)]
#[error("cannot {attempt} {}: {source}", path.display())]
pub struct OutputError {
    pub path: PathBuf,
    pub attempt: Attempt,
    pub source: io::Error,
}

impl OutputError {
    pub(crate) fn new(attempt: Attempt, path: &Path, source: io::Error) -> Self {
        Self { path: path.to_owned(), attempt, source }
    }
}

#[derive(Debug)]
enum Sink {
    /// A hidden file in the target's folder. A signal removes the file, as it is on the list of temporaries.
    Temporary(BufWriter<NamedTempFile>, Listed),
    /// A device or pipe such as `/dev/null`, which is written to and not replaced.
    Direct(BufWriter<File>),
}

/// A file that appears under its name only when [`commit`](Self::commit) succeeds.
///
/// A drop without commit removes the temporary file, and an earlier file of that name stays intact. If the name is a
/// symbolic link to a file, the link stays, and the file it points to is replaced. A replaced file keeps its
/// permissions; a new file gets 0666 less the umask. Devices and pipes are written directly.
#[derive(Debug)]
pub struct AtomicFile {
    sink: Sink,
    /// Name that the caller gave; used in messages.
    path: PathBuf,
    /// Name of the file that is replaced: `path` with symbolic links resolved.
    target: PathBuf,
    /// Whether a write has failed; the file must then never be committed.
    failed: bool,
}

impl AtomicFile {
    /// Opens a temporary file in the folder of `path`. Fails with [`Attempt::Create`] if `path` is a folder, or its
    /// folder is missing or not writable.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, OutputError> {
        let path = path.as_ref();
        let fail = |source| OutputError::new(Attempt::Create, path, source);
        let existing = match fs::metadata(path) {
            Ok(metadata) => Some(metadata),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(fail(error)),
        };
        if existing.as_ref().is_some_and(fs::Metadata::is_dir) {
            return Err(fail(io::Error::new(io::ErrorKind::IsADirectory, "it is a folder")));
        }
        if path.file_name().is_none() {
            return Err(fail(io::Error::new(io::ErrorKind::InvalidInput, "the path names no file")));
        }
        if existing.as_ref().is_some_and(|metadata| !metadata.is_file()) {
            let device = File::options().write(true).open(path).map_err(fail)?;
            let sink = Sink::Direct(BufWriter::with_capacity(BUFFER_BYTES, device));
            return Ok(Self { sink, path: path.to_owned(), target: path.to_owned(), failed: false });
        }
        let target = match existing {
            Some(_) => fs::canonicalize(path).map_err(fail)?,
            None => path.to_owned(),
        };
        let (temporary, listed) = new_temporary(folder_of(&target)).map_err(fail)?;
        if let Some(metadata) = existing {
            // Errors are ignored: not every file system keeps permissions, and the content matters more.
            let _ = temporary.as_file().set_permissions(metadata.permissions());
        }
        let sink = Sink::Temporary(BufWriter::with_capacity(BUFFER_BYTES, temporary), listed);
        Ok(Self { sink, path: path.to_owned(), target, failed: false })
    }

    /// Flushes the file, syncs it to the disk and renames it to its final name. Fails with [`Attempt::Write`] if bytes
    /// did not reach the disk, now or in an earlier write whose error the caller ignored; with [`Attempt::Rename`] if
    /// the name could not be replaced, or if the disk is too full to sync the rename. An error before the rename leaves
    /// the earlier file intact and removes the temporary file.
    pub fn commit(self) -> Result<(), OutputError> {
        let Self { sink, path, target, failed } = self;
        let cannot_write = |source| OutputError::new(Attempt::Write, &path, source);
        if failed {
            return Err(cannot_write(io::Error::other("an earlier write to it failed")));
        }
        match sink {
            Sink::Direct(mut device) => device.flush().map_err(cannot_write),
            Sink::Temporary(buffer, _listed) => {
                let temporary = buffer.into_inner().map_err(|e| cannot_write(e.into_error()))?;
                sync(temporary.as_file()).map_err(cannot_write)?;
                let cannot_rename = |source| OutputError::new(Attempt::Rename, &path, source);
                temporary.persist(&target).map_err(|e| cannot_rename(e.error))?;
                sync_folder(folder_of(&target)).map_err(cannot_rename)
            }
        }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the path of the temporary file, or of the device. Another program may write to this file before the
    /// commit, but must not replace it.
    pub fn place(&self) -> &Path {
        match &self.sink {
            Sink::Temporary(buffer, _) => buffer.get_ref().path(),
            Sink::Direct(_) => &self.target,
        }
    }

    fn writer(&mut self) -> &mut dyn Write {
        match &mut self.sink {
            Sink::Temporary(buffer, _) => buffer,
            Sink::Direct(buffer) => buffer,
        }
    }

    fn note<T>(&mut self, result: io::Result<T>) -> io::Result<T> {
        // An interrupted write is no failure: every caller in std repeats it.
        self.failed |= result.as_ref().is_err_and(|e| e.kind() != io::ErrorKind::Interrupted);
        result
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let result = self.writer().write(bytes);
        self.note(result)
    }

    fn flush(&mut self) -> io::Result<()> {
        let result = self.writer().flush();
        self.note(result)
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        let result = match &mut self.sink {
            Sink::Temporary(buffer, _) => buffer.seek(position),
            Sink::Direct(buffer) => buffer.seek(position),
        };
        self.note(result)
    }
}

/// Writes `bytes` to `path`, whole or not at all; the folder must exist.
pub fn write_atomic(path: impl AsRef<Path>, bytes: &[u8]) -> Result<(), OutputError> {
    let mut file = AtomicFile::create(path)?;
    if let Err(source) = file.write_all(bytes) {
        return Err(OutputError::new(Attempt::Write, &file.path, source));
    }
    file.commit()
}

/// Writes `bytes` to `path`, whole, unless a file of that name exists. Returns whether the file was written.
///
/// If several processes call this with one name, exactly one gets true. Some file systems have neither hard links nor a
/// rename that refuses to replace a file. On such a file system the file is written as by [`write_atomic`], and more
/// than one process may get true.
pub fn write_new(path: impl AsRef<Path>, bytes: &[u8]) -> Result<bool, OutputError> {
    let path = path.as_ref();
    let fail = |attempt| move |source| OutputError::new(attempt, path, source);
    let (mut temporary, _listed) = new_temporary(folder_of(path)).map_err(fail(Attempt::Create))?;
    temporary.write_all(bytes).map_err(fail(Attempt::Write))?;
    sync(temporary.as_file()).map_err(fail(Attempt::Write))?;
    match temporary.persist_noclobber(path) {
        Ok(_) => sync_folder(folder_of(path)).map_err(fail(Attempt::Rename)).map(|()| true),
        Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => Ok(false),
        Err(error) if cannot_link(error.error.kind()) && !path.exists() => {
            write_atomic(path, bytes).map(|()| true)
        }
        Err(error) => Err(fail(Attempt::Rename)(error.error)),
    }
}

/// Whether an error of this kind may mean that the file system has no hard links. Depending on the operating system,
/// link(2) then fails with EPERM, EINVAL or ENOSYS.
fn cannot_link(kind: io::ErrorKind) -> bool {
    matches!(kind, io::ErrorKind::Unsupported | io::ErrorKind::InvalidInput | io::ErrorKind::PermissionDenied)
}

/// Creates the folder with its parents, and tests that files can be written there. Call this before long work.
pub fn ensure_folder(path: impl AsRef<Path>) -> Result<(), OutputError> {
    let path = path.as_ref();
    let folder = if path.as_os_str().is_empty() { Path::new(".") } else { path };
    fs::create_dir_all(folder).map_err(|e| OutputError::new(Attempt::CreateFolder, path, e))?;
    let probe = || -> io::Result<()> {
        let (mut temporary, _listed) = new_temporary(folder)?;
        temporary.write_all(b"probe")?;
        temporary.close()
    };
    probe().map_err(|e| OutputError::new(Attempt::ProbeFolder, path, e))
}

/// Returns the folder that a file lies in; "." for a bare name.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

static TEMPORARIES: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// Entry in [`TEMPORARIES`] of a temporary file or folder. A drop removes the entry from the list.
#[derive(Debug)]
struct Listed(PathBuf);

impl Drop for Listed {
    fn drop(&mut self) {
        lock(&TEMPORARIES).remove(&self.0);
    }
}

/// Removes all temporary files and folders, and blocks the creation of new ones. Call this when the process ends.
pub fn remove_temporaries() {
    let listed = lock(&TEMPORARIES);
    for path in &*listed {
        // Fails for a folder, and for a file that already has its final name.
        if fs::remove_file(path).is_err() {
            remove_folder(path);
        }
    }
    // The lock is never released: a thread that wants to make another temporary waits until the process ends.
    std::mem::forget(listed);
}

/// Removes a folder; tries again while a killed program still creates files in it.
fn remove_folder(path: &Path) {
    const ATTEMPTS: usize = 20;
    for _ in 0..ATTEMPTS {
        if fs::remove_dir_all(path).is_ok() || !path.exists() {
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
}

/// Returns a builder of a hidden temporary file or folder. `mode`: permissions before the umask (0o666 or 0o777).
fn hidden(#[cfg_attr(not(unix), expect(unused))] mode: u32) -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    // A fixed short prefix: the target's name may already be as long as the file system allows.
    builder.prefix(".nerf-").suffix(".tmp");
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(mode));
    builder
}

fn new_temporary(folder: &Path) -> io::Result<(NamedTempFile, Listed)> {
    // tempfile's error ends with the path of the temporary. The path is cut off, as the caller adds the final name.
    let mut listed = lock(&TEMPORARIES);
    let temporary = hidden(0o666).tempfile_in(folder).map_err(|error| {
        let message = error.to_string();
        let reason = message.split(" at path ").next().unwrap_or(&message);
        io::Error::new(error.kind(), reason.to_owned())
    })?;
    let path = temporary.path().to_owned();
    listed.insert(path.clone());
    Ok((temporary, Listed(path)))
}

/// Waits until the contents of a file or folder are on the disk.
fn sync(file: &File) -> io::Result<()> {
    #[cfg(test)]
    tests::at_sync(file);
    file.sync_all()
}

/// Syncs a folder after a rename. Ignores all errors except a full disk: some file systems cannot sync folders.
fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(unix) {
        match File::open(folder).and_then(|folder| sync(&folder)) {
            Err(error) if error.kind() == io::ErrorKind::StorageFull => return Err(error),
            _ => {}
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
