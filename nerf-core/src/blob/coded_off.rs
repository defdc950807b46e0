//! In the place of `coded` where the feature is off: no tables are decoded.

use super::error::BlobError;
use crate::encoding::GridEncoding;

/// Nothing: this build has no decoder.
///
/// # Errors
/// [`BlobError::NotBuilt`].
pub fn decode_tables(_: &GridEncoding, _: &[u8], _: impl FnMut(u8)) -> Result<(), BlobError> {
    Err(BlobError::NotBuilt { feature: "coded" })
}
