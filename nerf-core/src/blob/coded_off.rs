//! Replacement of `coded.rs` in builds without the feature `coded`, which refuse entropy-coded tables.

use super::error::BlobError;
use crate::encoding::GridEncoding;

/// Refuses entropy-coded tables: this build has no decoder.
///
/// # Errors
/// [`BlobError::NotBuilt`].
pub fn decode_tables(_: &GridEncoding, _: &[u8], _: impl FnMut(u8)) -> Result<(), BlobError> {
    Err(BlobError::NotBuilt { feature: "coded" })
}
