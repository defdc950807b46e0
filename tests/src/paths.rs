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

/// Where the real scenes and networks are, if they are there: `$NERF_DATA`, or `../shared/data` beside the workspace.
pub fn data() -> PathBuf {
    let beside = || workspace().join("../shared/data");
    std::env::var_os("NERF_DATA").map_or_else(beside, PathBuf::from)
}
