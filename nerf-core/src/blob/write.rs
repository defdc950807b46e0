//! Writing a blob into the caller's buffer.

use super::body::Body;
use super::check::check;
use super::error::BlobError;
use super::header::{self, HEADER_LEN};

/// Length, bytes, of the blob that [`write()`] writes for `body`.
///
/// # Errors
/// The errors of [`write()`], except [`BlobError::Space`].
pub fn encoded_len(body: &Body<'_>) -> Result<usize, BlobError> {
    check(body)?;
    Ok(HEADER_LEN.saturating_add(body_len(body)))
}

/// Returns the number of bytes of a blob's body.
pub(super) fn body_len(body: &Body<'_>) -> usize {
    let size = postcard::ser_flavors::Size::default();
    // Counting bytes does not fail. If it did, `write` would fail for lack of space.
    postcard::serialize_with_flavor(body, size).unwrap_or(usize::MAX)
}

/// Writes a blob (a header, then `body`) to the beginning of `out` and returns the written bytes.
///
/// # Errors
/// The [`BlobError`] with which [`super::Blob::open`] would refuse the blob, or [`BlobError::Space`] if `out` is too
/// small.
pub fn write<'o>(body: &Body<'_>, out: &'o mut [u8]) -> Result<&'o [u8], BlobError> {
    let expected = encoded_len(body)?;
    let found = out.len();
    let space = BlobError::Space { expected: expected as u64, found: found as u64 };
    let out = out.get_mut(..expected).ok_or(space)?;
    let (head, rest) = out.split_at_mut(HEADER_LEN);
    postcard::to_slice(body, rest).map_err(|_| space)?;
    head.copy_from_slice(&header::write(rest));
    Ok(out)
}
