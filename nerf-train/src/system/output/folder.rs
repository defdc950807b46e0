//! Folders that appear whole or not at all.

use super::{Attempt, Listed, OutputError, TEMPORARIES, ensure_folder, folder_of, hidden, sync_folder};
use crate::system::lock;
use std::path::{Path, PathBuf};
use std::{fs, io};
use tempfile::TempDir;

/// A folder that appears under its name only when [`commit`](Self::commit) succeeds.
///
/// Until then the contents are in a hidden folder in the same parent. If the value is dropped without a commit, or a
/// signal ends the process, the hidden folder is removed.
#[derive(Debug)]
pub struct AtomicFolder {
    temporary: TempDir,
    _listed: Listed,
    target: PathBuf,
}

impl AtomicFolder {
    /// Creates the hidden folder in the parent of `path`; creates the parent, too, if it is missing. Fails with
    /// [`Attempt::CreateFolder`] if `path` exists and is not an empty folder.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, OutputError> {
        let path = path.as_ref();
        let fail = |source| OutputError::new(Attempt::CreateFolder, path, source);
        check_free(path).map_err(fail)?;
        ensure_folder(folder_of(path))?;
        let mut listed = lock(&TEMPORARIES);
        let temporary = hidden(0o777).tempdir_in(folder_of(path)).map_err(fail)?;
        let place = temporary.path().to_owned();
        listed.insert(place.clone());
        Ok(Self { temporary, _listed: Listed(place), target: path.to_owned() })
    }

    /// Returns the path of the hidden folder to write into. `commit` renames this folder to its final name.
    pub fn place(&self) -> &Path {
        self.temporary.path()
    }

    /// Renames the folder to its final name. Fails if something of that name was created meanwhile
    /// ([`Attempt::Rename`]); the hidden folder is then removed.
    pub fn commit(self) -> Result<(), OutputError> {
        let fail = |source| OutputError::new(Attempt::Rename, &self.target, source);
        check_free(&self.target).map_err(fail)?;
        // Systems other than Unix cannot rename over a folder. This call removes only an empty folder.
        let _ = fs::remove_dir(&self.target);
        fs::rename(self.temporary.path(), &self.target).map_err(fail)?;
        sync_folder(folder_of(&self.target)).map_err(fail)
    }
}

/// Fails if `path` exists, unless it is an empty folder.
fn check_free(path: &Path) -> io::Result<()> {
    let empty = || fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
    if fs::symlink_metadata(path).is_err() || empty() {
        return Ok(());
    }
    Err(io::Error::new(io::ErrorKind::AlreadyExists, "it is there already; choose another name"))
}
