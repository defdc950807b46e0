//! Opening a blob (a `*.nerf` file): the bytes are checked once and then borrowed.

use super::body::{Body, Content, FrontPoint, PictureFacts, Proposal, Provenance, SceneFacts, StoredTables};
use super::check::{check_coded, check_undecoded};
use super::coded;
use super::error::{BlobError, Section};
use super::header;
use super::write::body_len;
use crate::errors::ensure;
use crate::network::{Architecture, Layers};
use crate::sampling::OccupancyGrid;
use crate::space::SceneBox;
use postcard::Deserializer;
use postcard::de_flavors::Slice;
use serde::Deserialize;

/// First byte of a blob's body if the position encoding is a grid.
#[cfg(not(feature = "grid"))]
const GRID_TAG: u8 = 1;

/// Reads a blob's body section by section, so that an error can name the section. A macro, since a function would copy
/// the large body.
macro_rules! read_body {
    ($input:expr) => {
        Body {
            architecture: Architecture {
                position: read($input, Section::Position)?,
                direction: read($input, Section::Direction)?,
                trunk: read($input, Section::Architecture)?,
                density: read($input, Section::Architecture)?,
                colour: read($input, Section::Architecture)?,
                shading: read($input, Section::Architecture)?,
            },
            content: read($input, Section::Content)?,
            occupancy: read($input, Section::Occupancy)?,
            front: read($input, Section::Front)?,
            proposal: read($input, Section::Proposal)?,
            provenance: read($input, Section::Provenance)?,
            weights: read($input, Section::Weights)?,
            tables: read($input, Section::Tables)?,
        }
    };
}

/// An opened blob (`*.nerf` file). The blob borrows the caller's bytes, which have been checked.
#[derive(Clone, Debug)]
pub struct Blob<'a> {
    body: Body<'a>,
}

impl<'a> Blob<'a> {
    /// Checks the bytes of a blob and opens the blob. Weights and tables are borrowed, not copied, at any alignment.
    ///
    /// # Errors
    /// [`BlobError`] says what was expected and found. No input causes a panic or a read out of bounds.
    pub fn open(bytes: &'a [u8]) -> Result<Self, BlobError> {
        let blob = Self::open_undecoded(bytes)?;
        check_coded(&blob.body)?;
        Ok(blob)
    }

    /// Opens a blob as [`Blob::open`] does, but does not check entropy-coded tables, since that check takes as long as
    /// decoding. For callers that decode the tables next, such as [`Renderer::new`](crate::render::Renderer::new).
    ///
    /// # Errors
    /// The errors of [`Blob::open`], except for faults of entropy-coded tables.
    pub fn open_undecoded(bytes: &'a [u8]) -> Result<Self, BlobError> {
        let bytes = header::open(bytes)?;
        #[cfg(not(feature = "grid"))]
        if bytes.first() == Some(&GRID_TAG) {
            return Err(BlobError::NotBuilt { feature: "grid" });
        }
        let mut input = Deserializer::from_bytes(bytes);
        let body = read_body!(&mut input);
        check_form(&body, bytes)?;
        check_undecoded(&body)?;
        Ok(Self { body })
    }

    /// Opens a blob without checks. The caller ensures that [`Blob::open`] or [`Blob::open_undecoded`] has accepted the
    /// bytes before; the function then does not fail.
    #[cfg(all(feature = "std", not(target_os = "none")))]
    pub(crate) fn decode(bytes: &'a [u8]) -> Result<Self, BlobError> {
        let mut input = Deserializer::from_bytes(bytes.get(header::HEADER_LEN..).unwrap_or_default());
        Ok(Self { body: read_body!(&mut input) })
    }

    #[cfg(test)]
    pub(crate) fn with_weights(mut self, weights: &'a [u8]) -> Self {
        self.body.weights = weights;
        self
    }

    /// Address of the weights, which identifies the blob. A renderer compares the address of its own blob with the
    /// address of the blob that a plan was made for. Two blobs that exist at the same time have equal addresses only if
    /// both borrow the same bytes.
    pub(crate) fn identity(&self) -> usize {
        self.body.weights.as_ptr().addr()
    }

    /// The network's shape: encodings, layers, activations.
    pub fn architecture(&self) -> &Architecture {
        &self.body.architecture
    }

    /// Computes and returns the network's layers, in the order in which the blob stores their parameters.
    pub fn layers(&self) -> Layers {
        self.body.architecture.layers()
    }

    /// Bounds of the scene, placement of samples, background and default viewpoint; `None` in a 2D field (an image).
    pub fn scene(&self) -> Option<&SceneFacts> {
        match &self.body.content {
            Content::Scene(scene) => Some(scene),
            Content::Picture(_) => None,
        }
    }

    /// Size of the image that a 2D field was fitted to; `None` in a scene.
    pub fn picture(&self) -> Option<PictureFacts> {
        match self.body.content {
            Content::Picture(picture) => Some(picture),
            Content::Scene(_) => None,
        }
    }

    /// The axis-aligned box that bounds the scene, world units; `None` in a 2D field (an image).
    pub fn scene_box(&self) -> Option<SceneBox> {
        Some(self.scene()?.bounds())
    }

    /// The occupancy grid; `None` in a 2D field (an image) and in a scene without an occupancy grid.
    pub fn occupancy(&self) -> Option<OccupancyGrid<'a>> {
        let occupancy = self.body.occupancy.as_ref()?;
        Some(OccupancyGrid::new(self.scene_box()?, occupancy.resolution, occupancy.bits))
    }

    /// Pareto front of render settings: PSNR against multiply-adds, most expensive first. Empty if not measured.
    pub fn front(&self) -> &[FrontPoint] {
        &self.body.front
    }

    /// The coarse proposal network; `None` if the scene has none.
    pub fn proposal(&self) -> Option<&Proposal<'a>> {
        self.body.proposal.as_ref()
    }

    /// Origin of the blob: data, program, settings and measured PSNR.
    pub fn provenance(&self) -> &Provenance<'a> {
        &self.body.provenance
    }

    /// Weights and biases of the network as little-endian f16, in the order of [`Architecture::layers`].
    pub fn weights(&self) -> &'a [u8] {
        self.body.weights
    }

    /// The table entries of the grid encoding; `None` if the position is not encoded by a grid.
    pub fn tables(&self) -> Option<StoredTables<'a>> {
        self.body.tables
    }

    /// Number of bytes that the entropy-coded grid tables decode to; 0 if the blob has no entropy-coded tables.
    pub fn decoded_len(&self) -> usize {
        self.body.coded().map_or(0, |(grid, _)| grid.values())
    }

    /// Decodes entropy-coded grid tables into `to`, one signed 8-bit integer per byte; `to` must have
    /// [`Blob::decoded_len`] bytes. Does nothing if the blob has no entropy-coded tables.
    ///
    /// # Errors
    /// Cannot fail after [`Blob::open`]. After [`Blob::open_undecoded`], fails if the coded bytes are invalid.
    pub fn decode_tables(&self, to: &mut [u8]) -> Result<(), BlobError> {
        let Some((grid, bytes)) = self.body.coded() else { return Ok(()) };
        let mut to = to.iter_mut();
        coded::decode_tables(grid, bytes, |value| to.next().into_iter().for_each(|to| *to = value))
    }
}

/// Reads the next value of the body from `input`; an error names `section`.
fn read<'a, T: Deserialize<'a>>(
    input: &mut Deserializer<'a, Slice<'a>>,
    section: Section,
) -> Result<T, BlobError> {
    T::deserialize(input).map_err(|_| BlobError::Body(section))
}

/// Checks that `bytes`, from which `body` was read, are the canonical form of `body`, by their length alone. Any other
/// form is longer: an integer takes more bytes than needed, or bytes follow the last section.
fn check_form(body: &Body<'_>, bytes: &[u8]) -> Result<(), BlobError> {
    let (expected, found) = (body_len(body), bytes.len());
    ensure!(expected == found, BlobError::Form { expected: expected as u64, found: found as u64 });
    Ok(())
}
