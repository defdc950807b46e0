//! Picture files: decoded whole or refused, turned, made smaller, masked, and written.

pub mod colour;
pub mod decode;
pub(crate) mod exif;
pub(crate) mod file;
pub(crate) mod found;
pub(crate) mod photo;
pub mod photograph;
pub mod rgb;
pub(crate) mod scale;
pub(crate) mod thumbnail;
