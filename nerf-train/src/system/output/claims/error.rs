//! Why an output cannot be.

use super::MAX_NAME_BYTES;
use crate::system::output::OutputError;
use std::path::PathBuf;

/// An output that cannot be, in one sentence: which, why, and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClaimError {
    /// It is a file that is read.
    #[error("{output}: {} is {input} and would be destroyed; choose another name", path.display())]
    Input {
        /// The flag, or what is derived from it.
        output: String,
        /// The file that would be written.
        path: PathBuf,
        /// What is read, and its name.
        input: String,
    },
    /// It lies in a folder that is read.
    #[error("{output}: {} lies in {input}, which is being read; choose a place outside of it", path.display())]
    Inside {
        /// The flag, or what is derived from it.
        output: String,
        /// What would be written.
        path: PathBuf,
        /// What is read, and its name.
        input: String,
    },
    /// Two outputs are one file.
    #[error("{output}: {} is also what {other} writes; choose another name", path.display())]
    Twice {
        /// The flag, or what is derived from it.
        output: String,
        /// The file.
        path: PathBuf,
        /// The other flag.
        other: String,
    },
    /// A folder where a file is to be.
    #[error("{output}: expected the name of a file, found the folder {}", path.display())]
    Folder {
        /// The flag, or what is derived from it.
        output: String,
        /// The folder.
        path: PathBuf,
    },
    /// A name that no file system takes.
    #[error(
        "{output}: expected a name of at most {MAX_NAME_BYTES} bytes, found {found} in {}; choose a shorter one",
        path.display()
    )]
    Long {
        /// The flag, or what is derived from it.
        output: String,
        /// The file.
        path: PathBuf,
        /// Bytes of its name.
        found: usize,
    },
    /// A file that was not named, and must not be replaced without a word.
    #[error("{output}: {} is there already{why}", path.display())]
    Taken {
        /// What it would be.
        output: String,
        /// The file.
        path: PathBuf,
        /// Why it is kept, and what to do.
        why: &'static str,
    },
    /// A place that cannot be written.
    #[error("{output}: {source}")]
    Output {
        /// The flag, or what is derived from it.
        output: String,
        /// What failed.
        source: OutputError,
    },
}
