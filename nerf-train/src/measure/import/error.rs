//! What can be wrong with a network from elsewhere.

use crate::data::DatasetError;
use crate::measure::eval::EvalError;
use crate::model::export::ExportError;
use nerf_core::network::ArchitectureError;
use std::path::PathBuf;

/// A network that cannot be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// A file that cannot be read, or an array of it.
    #[error(transparent)]
    File(#[from] DatasetError),
    /// A file or a setting that is not as an import needs it.
    #[error("{place}: expected {expected}, found {found}")]
    Refused {
        /// The file, and the tensor in it; or the flag.
        place: String,
        /// What would do.
        expected: String,
        /// What is there.
        found: String,
    },
    /// The network is outside the format's caps.
    #[error("{}: {error}", file.display())]
    Architecture {
        /// The checkpoint.
        file: PathBuf,
        /// What is beyond them.
        error: ArchitectureError,
    },
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
