//! Writing a blob into the caller's buffer.

use super::body::Body;
use super::check::check;
use super::error::BlobError;
use super::header::{self, HEADER_LEN};

/// Bytes the blob of `body` takes.
///
/// # Errors
/// As [`write()`].
pub fn encoded_len(body: &Body<'_>) -> Result<usize, BlobError> {
    check(body)?;
    let size = postcard::ser_flavors::Size::default();
    let length = postcard::serialize_with_flavor(body, size).map_err(|_| BlobError::Body)?;
    Ok(HEADER_LEN + length)
}

/// Writes the blob of `body` to the front of `out` and returns its bytes.
///
/// # Errors
/// Whatever [`super::Blob::open`] would refuse is refused here, and a buffer that is too small.
pub fn write<'o>(body: &Body<'_>, out: &'o mut [u8]) -> Result<&'o [u8], BlobError> {
    let expected = encoded_len(body)?;
    let found = out.len();
    let Some(out) = out.get_mut(..expected) else {
        return Err(BlobError::Space { expected: expected as u64, found: found as u64 });
    };
    let (head, rest) = out.split_at_mut(HEADER_LEN);
    postcard::to_slice(body, rest).map_err(|_| BlobError::Body)?;
    head.copy_from_slice(&header::write(rest));
    Ok(out)
}
