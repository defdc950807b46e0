//! What can go wrong in making and writing a report.

use crate::system::output::OutputError;
use std::error::Error;

/// A picture, plot, table or summary that could not be made or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    #[error(transparent)]
    Output(#[from] OutputError),
    #[error("{what}: {width}×{height} pixels need {expected} values, found {found}")]
    Length { what: &'static str, width: usize, height: usize, expected: usize, found: usize },
    #[error("{format} cannot hold a picture of {width}×{height} pixels; allowed is 1 to {limit} a side")]
    Size { format: &'static str, width: usize, height: usize, limit: usize },
    #[error("cannot make the {what}: {source}")]
    Encode { what: &'static str, source: Box<dyn Error + Send + Sync> },
    #[error("cannot make the animation: {0}")]
    Animation(String),
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
