//! Paths of the workspace and of the generated header, and temporary folders.

use std::path::PathBuf;

/// Returns the root folder of the workspace.
pub fn workspace() -> PathBuf {
    crate::tools::workspace().to_path_buf()
}

/// Returns the path of the generated header.
pub fn header() -> PathBuf {
    workspace().join("include/nerf_render.h")
}

/// Makes an empty temporary folder, which is removed when dropped.
pub fn temporary() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary directory")
}
