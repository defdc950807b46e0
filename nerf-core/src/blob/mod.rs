//! The `*.nerf` file: a header, then a body in postcard format. Large parts of an opened body borrow the file's bytes.
//!
//! The format is specified in `docs/blob-format.md`. A [`Blob`] is checked once, in
//! [`Blob::open`]; reading its content is then infallible.

mod body;
mod check;
#[cfg(feature = "coded")]
mod coded;
#[cfg(not(feature = "coded"))]
#[path = "coded_off.rs"]
mod coded;
mod error;
mod header;
mod view;
mod write;

#[cfg(test)]
mod tests;

pub(crate) use body::steps;
pub use body::{
    Body, Content, FrontPoint, MAX_FRONT, MAX_OCCUPANCY_RESOLUTION, MAX_PICTURE_SIDE, MAX_SAMPLES, MAX_TEXT,
    ParetoFront, PictureFacts, Proposal, Provenance, SceneFacts, SceneSampling, StoredOccupancy,
    StoredTables, Viewpoint,
};
#[cfg(all(feature = "coded", any(feature = "train", test)))]
pub use coded::{decode_tables, encode_tables};
pub use error::{BlobError, FrontFault, Section};
pub use header::{FORMAT_VERSION, HEADER_LEN, MAGIC};
pub use view::Blob;
pub use write::{encoded_len, write};
