//! Errors of opening and rendering a scene.

use crate::blob::BlobError;
use crate::plan::PlanError;
use crate::render::RenderError;
use std::path::PathBuf;

/// The reason why a scene was not opened or rendered.
#[derive(Debug)]
#[allow(missing_docs, reason = "a field's name says what it is")]
#[non_exhaustive]
pub enum HostError {
    /// The file could not be read.
    Read { path: PathBuf, source: std::io::Error },
    /// The file's content is invalid, or this build cannot open it.
    Open { path: PathBuf, source: BlobError },
    /// A requested setting or output is invalid, or not supported by the scene or this build.
    Plan(PlanError),
    /// Rendering failed: for example, a ray or the image size is invalid, or there is not enough memory.
    Render(RenderError),
}

impl core::fmt::Display for HostError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Read { path, source } => write!(f, "{}: {source}", path.display()),
            Self::Open { path, source } => write!(f, "{}: {source}", path.display()),
            Self::Plan(error) => error.fmt(f),
            Self::Render(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for HostError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Read { source, .. } => Some(source),
            Self::Open { source, .. } => Some(source),
            Self::Plan(error) => Some(error),
            Self::Render(error) => Some(error),
        }
    }
}

impl From<PlanError> for HostError {
    fn from(error: PlanError) -> Self {
        Self::Plan(error)
    }
}

impl From<RenderError> for HostError {
    fn from(error: RenderError) -> Self {
        Self::Render(error)
    }
}
