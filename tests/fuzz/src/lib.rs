//! What the fuzz targets share: values at the edges of formats, blobs made whole again after damage, laws
//! of pixels.

pub mod damage;
#[cfg(feature = "train")]
pub mod files;
pub mod laws;
pub mod values;
