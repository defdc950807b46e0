//! Replaces `coded` in builds without that feature: coded tables are refused.

use super::error::BlobError;
use crate::encoding::GridEncoding;

/// Refuses coded tables: this build has no decoder.
///
/// # Errors
/// [`BlobError::NotBuilt`].
pub fn decode_tables(_: &GridEncoding, _: &[u8], _: impl FnMut(u8)) -> Result<(), BlobError> {
    Err(BlobError::NotBuilt { feature: "coded" })
}
