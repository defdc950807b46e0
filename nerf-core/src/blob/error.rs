//! What can be wrong with a blob.

use super::body::{MAX_PICTURE_SIDE, MAX_SAMPLES};
use crate::camera::BoundsError;
use crate::math::MathBackend;
use crate::network::{ArchitectureError, Role};
use core::fmt;

/// A part of the body, for messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Section {
    /// `architecture.position`
    Position,
    /// `architecture.direction`
    Direction,
    /// `architecture`
    Architecture,
    /// `content`
    Content,
    /// `scene.sampling`, of a scene with bins
    Samples,
    /// `scene.background`
    Background,
    /// `scene.occupancy_required`
    OccupancyRequired,
    /// `scene.viewpoint`
    Viewpoint,
    /// `occupancy`
    Occupancy,
    /// `occupancy.resolution`
    OccupancyResolution,
    /// `occupancy.bits`
    OccupancyBits,
    /// `front`
    Front,
    /// `proposal`
    Proposal,
    /// `proposal.samples`
    ProposalSamples,
    /// `proposal.weights`
    ProposalWeights,
    /// `provenance`
    Provenance,
    /// `weights`
    Weights,
    /// `tables`
    Tables,
    /// `tables.scales`
    TableScales,
}

/// What is wrong with a point of the front.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum FrontFault {
    /// No samples, more than [`MAX_SAMPLES`], or bins too narrow for the scene.
    Samples {
        /// What the point says.
        found: u16,
    },
    /// A transmittance cut outside `[0, 1)`.
    TransmittanceCut {
        /// What the point says.
        found: f32,
    },
    /// A colour cut outside `[0, 1)`.
    ColourCut {
        /// What the point says.
        found: f32,
    },
    /// An occupancy grid the scene has not, or none where it is part of the model.
    Occupancy {
        /// What the point says.
        found: bool,
    },
    /// A tag that names no maths backend.
    Math {
        /// What the point says.
        found: u8,
    },
    /// A proposal the scene has not.
    Proposal,
    /// A loss that is not finite.
    LossDb {
        /// What the point says.
        found: f32,
    },
    /// A cost that is not finite and above 0.
    Cost {
        /// What the point says.
        found: f32,
    },
    /// A cost that is not below that of the point before.
    CostOrder {
        /// Cost of the point before.
        before: f32,
        /// What the point says.
        found: f32,
    },
    /// A loss below that of the point before, which is thus neither cheaper nor better.
    LossOrder {
        /// Loss of the point before, dB.
        before: f32,
        /// What the point says.
        found: f32,
    },
}

impl fmt::Display for FrontFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Samples { found } => {
                write!(f, "samples: expected 1 to {MAX_SAMPLES} bins of some width, found {found}")
            }
            Self::TransmittanceCut { found } => {
                write!(f, "transmittance_cut: expected 0 <= cut < 1, found {found}")
            }
            Self::ColourCut { found } => write!(f, "colour_cut: expected 0 <= cut < 1, found {found}"),
            Self::Occupancy { found: true } => {
                write!(f, "occupancy: expected false in a scene without an occupancy grid")
            }
            Self::Occupancy { found: false } => {
                write!(f, "occupancy: expected true in a scene whose occupancy grid is part of its model")
            }
            Self::Math { found } => {
                write!(f, "math: expected a tag below {}, found {found}", MathBackend::TAGS)
            }
            Self::Proposal => write!(f, "proposal: expected false in a scene without one"),
            Self::LossDb { found } => write!(f, "loss_db: expected a finite value, found {found}"),
            Self::Cost { found } => write!(f, "cost: expected a finite value above 0, found {found}"),
            Self::CostOrder { before, found } => {
                write!(f, "cost: expected less than the {before} of the point before, found {found}")
            }
            Self::LossOrder { before, found } => {
                write!(f, "loss_db: expected at least the {before} of the point before, found {found}")
            }
        }
    }
}

impl core::error::Error for FrontFault {}

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
    /// Made by another version of the format.
    Version {
        /// The version this build reads.
        expected: u16,
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
    /// A section of the body is no postcard of this format's shape: a list beyond its cap, a number beyond its type, a
    /// tag without a meaning, text that is not UTF-8, an end too early.
    Body(Section),
    /// The body is not the one form of what it says: a number in more bytes than it takes, bytes behind the last.
    Form {
        /// Where it differs, bytes behind the header.
        at: u64,
    },
    /// The architecture is outside the format's caps.
    Architecture(ArchitectureError),
    /// The proposal network is outside the format's caps.
    ProposalArchitecture(ArchitectureError),
    /// A point of the front that cannot be rendered, or makes it no front.
    Front {
        /// Which point.
        index: u8,
        /// What is wrong with it.
        fault: FrontFault,
    },
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
    /// The step of a scene's march is no number above 0, or too small for its box.
    Step {
        /// What the scene says, world units.
        found: f32,
    },
    /// An unbounded scene whose box is no cube, or whose steps are out of range.
    Contraction {
        /// What the scene says.
        step: f32,
        /// What the scene says.
        power: u8,
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
        /// Of the scene's network or of the proposal.
        section: Section,
        /// Layer.
        role: Role,
        /// Index among the layer's parameters, weights first.
        index: u32,
    },
    /// The scale of a level of int8 or coded tables that is not above 0, or makes a value infinite.
    TableScale {
        /// Level.
        level: u8,
        /// What the blob says.
        found: f32,
    },
    /// A value of the grid's tables is infinite or NaN.
    TableValue {
        /// Level.
        level: u8,
        /// Index among the level's values.
        index: u32,
    },
    /// The bytes of coded tables end before this value.
    CodedEnd {
        /// Level.
        level: u8,
        /// Index among the level's values.
        index: u32,
    },
    /// The bytes of coded tables are not what an encoder of their values writes: the decoder does not end with the last byte
    /// and in the coder's first state, or begins below that.
    CodedRest {
        /// State of the decoder there.
        state: u32,
        /// Bytes that are left.
        bytes: u64,
    },
    /// The file needs what this build has no code for.
    NotBuilt {
        /// The cargo feature that has it.
        feature: &'static str,
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
            Self::Version { expected, found } => {
                let advice = match found < expected {
                    true => "older: fit or import the scene again with this build",
                    false => "newer: open it with a newer build",
                };
                write!(f, "format version: this build reads version {expected}, found {found} ({advice})")
            }
            Self::Endian { found } => write!(f, "endian tag: expected 0xfeff, found {found:#06x}"),
            Self::Flags { found } => write!(f, "flags: expected 0, found {found:#x}"),
            Self::Reserved { found } => write!(f, "reserved header bytes: expected 0, found {found:#x}"),
            Self::Checksum { expected, found } => {
                write!(f, "CRC-32: expected {expected:#010x}, found {found:#010x} (the file is damaged)")
            }
            Self::Body(section) => {
                write!(
                    f,
                    "{section}: expected this format's lists, numbers, tags and texts and an end, found others"
                )
            }
            Self::Form { at } => {
                write!(f, "body: expected canonical postcard, found another form at byte {at}")
            }
            Self::Architecture(error) => write!(f, "architecture: {error}"),
            Self::ProposalArchitecture(error) => write!(f, "proposal: {error}"),
            Self::Front { index, fault } => write!(f, "front point {index}: {fault}"),
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
            Self::Step { found } => write!(
                f,
                "scene.sampling: expected a finite step above 0, at most {MAX_SAMPLES} of them to the box's \
                 diagonal, found {found}"
            ),
            Self::Contraction { step, power } => write!(
                f,
                "scene.sampling: expected a contraction into a cube with a power of 1, 2 or 4 and steps above 0 \
                 and at most 1, at most {MAX_SAMPLES} of them, found power {power} and step {step}"
            ),
            Self::Field(section) => write!(f, "{section}: expected {}, found otherwise", section.range()),
            Self::Length { section, expected, found } => {
                write!(f, "{section}: expected {expected} bytes, found {found}")
            }
            Self::EncodingDomain { found, limit } => {
                write!(
                    f,
                    "scene box: 2^(levels - 1) times its coordinates reaches {found}, the encoding ends at {limit}"
                )
            }
            Self::Weight { section, role, index } => {
                write!(f, "{section}: layer {role:?}, parameter {index} is not finite")
            }
            Self::TableScale { level, found } => {
                write!(
                    f,
                    "tables.scales: level {level}: expected a number above 0 of which 128 are finite, found {found}"
                )
            }
            Self::TableValue { level, index } => {
                write!(f, "tables: level {level}, value {index} is not finite")
            }
            Self::CodedEnd { level, index } => {
                write!(f, "tables: level {level}: expected value {index}, found the end of the coded bytes")
            }
            Self::CodedRest { state, bytes } => write!(
                f,
                "tables: expected coded bytes that end in state 65536 behind the last value, found state {state} and \
                 {bytes} bytes more"
            ),
            Self::NotBuilt { feature } => {
                let part = match *feature {
                    "contraction" => Section::Samples,
                    "coded" => Section::Tables,
                    _ => Section::Position,
                };
                // int8 needs no memory to be decoded into.
                let advice = if *feature == "coded" { " (or a file fitted with --export int8)" } else { "" };
                write!(f, "{part}: expected a build with the feature `{feature}`{advice}, found one without")
            }
            Self::Space { expected, found } => {
                write!(f, "output buffer: expected {expected} bytes, found {found}")
            }
        }
    }
}

impl Section {
    /// What a value of it may be.
    const fn range(self) -> &'static str {
        match self {
            Self::Samples => "1 to 4096 samples, in bins that f32 tells apart",
            Self::ProposalSamples => "1 to 4096 samples, in bins that f32 tells apart, of a scene with bins",
            Self::Background => "0 to 1",
            Self::OccupancyRequired => "false without an occupancy grid",
            Self::Viewpoint => {
                "an eye and a target apart, up of unit length across the way between them, and an arc of 0 to 2 pi"
            }
            Self::OccupancyResolution => "1 to 512 cells a side",
            Self::OccupancyBits => "none in a picture, and padding of zeros",
            Self::Front | Self::Proposal => "none in a picture",
            Self::Tables => "tables exactly where the position is a grid",
            Self::Provenance => "texts of at most 1024 bytes and finite numbers",
            _ => "a value in its range",
        }
    }
}

impl fmt::Display for Section {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "architecture.position",
            Self::Direction => "architecture.direction",
            Self::Architecture => "architecture",
            Self::Content => "content",
            Self::Samples => "scene.sampling",
            Self::Background => "scene.background",
            Self::OccupancyRequired => "scene.occupancy_required",
            Self::Viewpoint => "scene.viewpoint",
            Self::Occupancy => "occupancy",
            Self::OccupancyResolution => "occupancy.resolution",
            Self::OccupancyBits => "occupancy.bits",
            Self::Front => "front",
            Self::Proposal => "proposal",
            Self::ProposalSamples => "proposal.samples",
            Self::ProposalWeights => "proposal.weights",
            Self::Provenance => "provenance",
            Self::Weights => "weights",
            Self::Tables => "tables",
            Self::TableScales => "tables.scales",
        })
    }
}

impl core::error::Error for BlobError {}
