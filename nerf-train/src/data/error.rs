//! Errors of reading a data set.

use crate::data::pictures::decode::DecodeError;
use nerf_core::camera::CameraError;
use nerf_core::space::BoundsError;
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Error of reading a data set. The message names file and field, and says what was expected and what was found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    #[error("{}: no such file or folder", path.display())]
    Missing { path: PathBuf },
    #[error("{}: cannot be read: {source}", path.display())]
    Io { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Range(#[from] BoundsError),
    #[error(transparent)]
    Picture(#[from] DecodeError),
    /// A wrong value in a file, or something missing in a folder.
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

    /// Makes the error that the value at the place `at` in a file is not as expected.
    pub(super) fn value(file: &Path, at: impl Display, expected: impl Display, found: impl Display) -> Self {
        Self::fault(file, format!("{at}: expected {expected}, found {found}"))
    }

    /// Makes the error that a view's pose or intrinsics form no valid camera.
    pub(super) fn camera(file: &Path, view: &str, source: &CameraError) -> Self {
        Self::fault(file, format!("view `{view}`: {source}"))
    }

    pub(super) fn json(file: &Path, error: &serde_json::Error) -> Self {
        let text = error.to_string();
        // serde_json ends its message with line and column; this error begins with them.
        let found = text.rsplit_once(" at line ").map_or(text.as_str(), |(what, _)| what);
        Self::fault(file, format!("line {}, column {}: {found}", error.line(), error.column()))
    }
}
