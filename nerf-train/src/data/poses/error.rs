//! Why there are no poses.

use crate::data::DatasetError;
use crate::system::output::OutputError;

/// Poses that could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PosesError {
    #[error(
        "no colmap found on PATH: install it (Debian and Ubuntu: `apt-get install colmap`; macOS: `brew install colmap`; \
         elsewhere: https://colmap.github.io/install.html)"
    )]
    Missing,
    #[error("{0}")]
    Colmap(String),
    #[error(transparent)]
    Data(#[from] DatasetError),
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl PosesError {
    pub(super) fn none_registered(photographs: usize, said: &str) -> Self {
        Self::Colmap(format!(
            "colmap registered none of {photographs} photographs: each part of the scene must be in several of them, \
             sharp and taken from different places; it said: {said}"
        ))
    }
}
