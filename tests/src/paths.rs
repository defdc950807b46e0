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
