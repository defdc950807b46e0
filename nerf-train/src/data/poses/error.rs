//! Why there are no poses.

use crate::data::DatasetError;
use crate::system::output::OutputError;
use std::path::PathBuf;

/// Poses that could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PosesError {
    /// A folder without photographs, or with fewer than a reconstruction takes.
    #[error("{}: expected at least {} photographs, found {found}{skipped}", folder.display(), super::MIN_PHOTOGRAPHS)]
    Few {
        /// The folder.
        folder: PathBuf,
        /// How many there are.
        found: usize,
        /// What was skipped, in words.
        skipped: String,
    },
    /// No such program.
    #[error(
        "no colmap found on PATH: install it (Debian and Ubuntu: `apt-get install colmap`; macOS: `brew install colmap`; \
         elsewhere: https://colmap.github.io/install.html)"
    )]
    Missing,
    /// It does not start.
    #[error("colmap does not start: {0}")]
    Start(std::io::Error),
    /// It has said nothing for so long that it was ended.
    #[error("colmap {stage} has said nothing for {seconds} s and was ended; --patience gives it longer")]
    Silent {
        /// Its command.
        stage: &'static str,
        /// How long it was waited for.
        seconds: u64,
    },
    /// One that has other options.
    #[error("this colmap ({version}) does not know an option; expected one of versions 3.6 to 4: {said}")]
    Version {
        /// What it says to be.
        version: String,
        /// Its last messages.
        said: String,
    },
    /// It failed.
    #[error("colmap {stage} failed ({status}): {said}")]
    Failed {
        /// Its command.
        stage: &'static str,
        /// How it ended.
        status: String,
        /// Its last messages.
        said: String,
    },
    /// It found no pose.
    #[error(
        "colmap registered none of {photographs} photographs: each part of the scene must be in several of them, sharp and \
         taken from different places; it said: {said}"
    )]
    NoneRegistered {
        /// How many were tried.
        photographs: usize,
        /// Its last messages.
        said: String,
    },
    /// A photograph cannot be read, or the model not that COLMAP wrote.
    #[error(transparent)]
    Data(#[from] DatasetError),
    /// The result cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}
