//! What can go wrong in making and writing a report.

use crate::system::output::OutputError;
use std::error::Error;

/// A picture, plot, table or summary that could not be made or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The file system said no.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A buffer whose length is not the one its picture size calls for.
    #[error("{what}: {width}×{height} pixels need {expected} values, found {found}")]
    Length {
        /// Which buffer.
        what: &'static str,
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
        /// Values that the size calls for; `usize::MAX` where the size itself overflows.
        expected: usize,
        /// Values in the buffer.
        found: usize,
    },
    /// A size that the file format cannot hold.
    #[error("{format} cannot hold a picture of {width}×{height} pixels; allowed is 1 to {limit} a side")]
    Size {
        /// The file format.
        format: &'static str,
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
        /// Largest side, pixels.
        limit: usize,
    },
    /// The encoder of a file format or the plotting library failed.
    #[error("cannot make the {what}: {source}")]
    Encode {
        /// What was being made, for example "PNG".
        what: &'static str,
        /// The library's own error.
        source: Box<dyn Error + Send + Sync>,
    },
    /// An animation without frames, with a wrong rate, or with frames of different sizes.
    #[error("cannot make the animation: {0}")]
    Animation(String),
    /// `ffmpeg` is missing or failed.
    #[error(transparent)]
    Video(Box<dyn Error + Send + Sync>),
}

impl ReportError {
    /// Wraps a library's error.
    pub(crate) fn encode<E: Into<Box<dyn Error + Send + Sync>>>(what: &'static str) -> impl Fn(E) -> Self {
        move |source| Self::Encode { what, source: source.into() }
    }
}

/// Checks that `found` is `width * height`.
pub(crate) fn check_length(
    what: &'static str,
    width: usize,
    height: usize,
    found: usize,
) -> Result<(), ReportError> {
    let expected = width.saturating_mul(height);
    if expected == found { Ok(()) } else { Err(ReportError::Length { what, width, height, expected, found }) }
}
