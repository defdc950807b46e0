//! What can be wrong with a data set.

use nerf_core::camera::CameraError;
use nerf_core::space::BoundsError;
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// A data set that cannot be read: which file, which field, what was expected and found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    #[error("{}: no such file or folder", path.display())]
    Missing { path: PathBuf },
    #[error("{}: cannot be read: {source}", path.display())]
    Io { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Range(#[from] BoundsError),
    /// What is in a file, or what a folder lacks.
    #[error("{}: {fault}", path.display())]
    Fault { path: PathBuf, fault: String },
}

impl DatasetError {
    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        match source.kind() {
            std::io::ErrorKind::NotFound => Self::Missing { path: path.into() },
            _ => Self::Io { path: path.into(), source },
        }
    }

    pub(super) fn fault(path: &Path, fault: impl Into<String>) -> Self {
        Self::Fault { path: path.into(), fault: fault.into() }
    }

    /// What was expected at a place of a file, and found there.
    pub(super) fn value(
        file: &Path,
        place: impl Display,
        expected: impl Display,
        found: impl Display,
    ) -> Self {
        Self::fault(file, format!("{place}: expected {expected}, found {found}"))
    }

    /// A view's pose or intrinsics that make no camera.
    pub(super) fn camera(file: &Path, view: &str, source: &CameraError) -> Self {
        Self::fault(file, format!("view `{view}`: {source}"))
    }

    pub(super) fn json(file: &Path, error: &serde_json::Error) -> Self {
        let text = error.to_string();
        // serde_json ends its message with the place, which stands in front here.
        let found = text.rsplit_once(" at line ").map_or(text.as_str(), |(what, _)| what);
        Self::fault(file, format!("line {}, column {}: {found}", error.line(), error.column()))
    }
}
