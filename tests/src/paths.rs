//! Where things lie.

use std::path::{Path, PathBuf};

/// The workspace.
pub fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ lies in the workspace").to_path_buf()
}

/// The generated header.
pub fn header() -> PathBuf {
    workspace().join("include/nerf_render.h")
}

/// A directory of its own for a test, removed when dropped.
pub fn temporary() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary directory")
}

/// The folder of real scenes and networks: `$NERF_DATA`, or `../shared/data` beside the workspace; `None` without.
pub fn data() -> Option<PathBuf> {
    let beside = || workspace().join("../shared/data");
    let folder = std::env::var_os("NERF_DATA").map_or_else(beside, PathBuf::from);
    folder.is_dir().then_some(folder)
}
