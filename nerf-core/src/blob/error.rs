//! What can be wrong with a blob.

use super::body::MAX_PICTURE_SIDE;
use crate::network::{ArchitectureError, Role};
use crate::ray::BoundsError;
use core::fmt;

/// A part of the body, for messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Section {
    /// `scene.samples`
    Samples,
    /// `scene.background`
    Background,
    /// `scene.grid_required`
    GridRequired,
    /// `grid.resolution`
    GridResolution,
    /// `grid.bits`
    GridBits,
    /// `provenance`
    Provenance,
    /// `weights`
    Weights,
}

/// Why bytes are no blob this version can open.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum BlobError {
    /// The file does not begin with the magic bytes.
    NotABlob,
    /// The file ends early.
    Truncated {
        /// Bytes the header announces (or the header itself needs).
        expected: u64,
        /// Bytes there are.
        found: u64,
    },
    /// Bytes follow the body.
    TrailingBytes {
        /// Bytes the header announces.
        expected: u64,
        /// Bytes there are.
        found: u64,
    },
    /// Made by a later version of the format.
    Version {
        /// The newest version this build reads.
        newest: u16,
        /// The version of the file.
        found: u16,
    },
    /// Written with the other byte order.
    Endian {
        /// The tag of the file.
        found: u16,
    },
    /// Flags that this version does not know.
    Flags {
        /// The flags of the file.
        found: u32,
    },
    /// Reserved bytes of the header that are not 0.
    Reserved {
        /// What they hold.
        found: u32,
    },
    /// A bit flipped somewhere.
    Checksum {
        /// CRC-32 stored in the header.
        expected: u32,
        /// CRC-32 of header and body.
        found: u32,
    },
    /// The body is no postcard of this format's shape, or not its one canonical form.
    Body,
    /// The architecture is outside the format's caps.
    Architecture(ArchitectureError),
    /// The scene's bounds hold nothing.
    Bounds(BoundsError),
    /// The network has a density head but is said to be a picture, or the other way round.
    Kind {
        /// Whether the network has a density head.
        density_head: bool,
        /// Whether the blob says that it is a scene.
        scene: bool,
    },
    /// The picture has a side of 0 or beyond [`MAX_PICTURE_SIDE`].
    PictureSize {
        /// Pixels to a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A value outside its range.
    Field(Section),
    /// A section of the wrong length.
    Length {
        /// Which.
        section: Section,
        /// Bytes that the description implies.
        expected: u64,
        /// Bytes there are.
        found: u64,
    },
    /// Scene coordinates times `2^(levels − 1)`, the factor of the highest level, leave the encoding's domain.
    EncodingDomain {
        /// Largest scaled coordinate.
        found: f32,
        /// Largest the encoding is accurate for.
        limit: f32,
    },
    /// A weight is infinite or NaN.
    Weight {
        /// Layer.
        role: Role,
        /// Index among the layer's parameters, weights first.
        index: u32,
    },
    /// The output buffer of a write is too small.
    Space {
        /// Bytes the blob takes.
        expected: u64,
        /// Bytes there are.
        found: u64,
    },
}

impl fmt::Display for BlobError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotABlob => write!(f, "not a .nerf blob: the first bytes are not its magic"),
            Self::Truncated { expected, found } => {
                write!(f, "truncated: expected {expected} bytes, found {found}")
            }
            Self::TrailingBytes { expected, found } => {
                write!(f, "trailing bytes: expected {expected} bytes, found {found}")
            }
            Self::Version { newest, found } => {
                write!(f, "format version: this build reads up to {newest}, found {found}")
            }
            Self::Endian { found } => write!(f, "endian tag: expected 0xfeff, found {found:#06x}"),
            Self::Flags { found } => write!(f, "flags: expected 0, found {found:#x}"),
            Self::Reserved { found } => write!(f, "reserved header bytes: expected 0, found {found:#x}"),
            Self::Checksum { expected, found } => {
                write!(f, "CRC-32: expected {expected:#010x}, found {found:#010x} (the file is damaged)")
            }
            Self::Body => write!(f, "body: no canonical postcard of this format's shape"),
            Self::Architecture(error) => write!(f, "architecture: {error}"),
            Self::Bounds(error) => write!(f, "scene: {error}"),
            Self::Kind { density_head, scene } => write!(
                f,
                "content: expected a {} of a network {} density head, found a {}",
                if *density_head { "scene" } else { "picture" },
                if *density_head { "with a" } else { "without a" },
                if *scene { "scene" } else { "picture" }
            ),
            Self::PictureSize { width, height } => {
                write!(f, "picture: expected sides of 1 to {MAX_PICTURE_SIDE} pixels, found {width}x{height}")
            }
            Self::Field(section) => write!(f, "{section}: value out of range"),
            Self::Length { section, expected, found } => {
                write!(f, "{section}: expected {expected} bytes, found {found}")
            }
            Self::EncodingDomain { found, limit } => {
                write!(
                    f,
                    "scene box: 2^(levels - 1) times its coordinates reaches {found}, the encoding ends at {limit}"
                )
            }
            Self::Weight { role, index } => {
                write!(f, "weights: layer {role:?}, parameter {index} is not finite")
            }
            Self::Space { expected, found } => {
                write!(f, "output buffer: expected {expected} bytes, found {found}")
            }
        }
    }
}

impl fmt::Display for Section {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Samples => "scene.samples",
            Self::Background => "scene.background",
            Self::GridRequired => "scene.grid_required",
            Self::GridResolution => "grid.resolution",
            Self::GridBits => "grid.bits",
            Self::Provenance => "provenance",
            Self::Weights => "weights",
        })
    }
}

impl core::error::Error for BlobError {}
