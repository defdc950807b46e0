//! What can be wrong with a network from elsewhere.

use crate::data::DatasetError;
use crate::measure::eval::EvalError;
use crate::model::export::ExportError;
use nerf_core::network::ArchitectureError;
use std::path::PathBuf;

/// A network that cannot be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names say what they are")]
pub enum ImportError {
    /// A file that cannot be read, or an array of it.
    #[error(transparent)]
    File(#[from] DatasetError),
    /// A file or a setting that is not as an import needs it.
    #[error("{place}: expected {expected}, found {found}")]
    Refused { place: String, expected: String, found: String },
    /// The network is outside the format's caps.
    #[error("{}: {error}", file.display())]
    Architecture { file: PathBuf, error: ArchitectureError },
    /// The format refuses the network.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// It cannot be rendered.
    #[error(transparent)]
    Eval(#[from] EvalError),
}

impl ImportError {
    /// [`ImportError::Refused`].
    pub(super) fn refused(
        place: impl ToString,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Refused { place: place.to_string(), expected: expected.into(), found: found.into() }
    }
}
