//! Reads picture files (an incomplete file is an error), rotates, reduces and masks pictures, and writes PNG files.

pub mod colour;
pub mod decode;
pub(crate) mod exif;
pub(crate) mod file;
pub(crate) mod found;
pub(crate) mod photo;
pub mod photograph;
pub mod rgb;
pub(crate) mod scale;
#[cfg(test)]
pub(crate) mod testing;
pub(crate) mod thumbnail;
