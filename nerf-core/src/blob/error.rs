//! Errors of blobs.

use super::body::{MAX_PICTURE_SIDE, MAX_SAMPLES};
use crate::errors::errors;
use crate::math::MathBackend;
use crate::network::{ArchitectureError, Role};
use crate::space::BoundsError;
use core::fmt;

/// Declares the parts of the body: each with its name, and what a value of it may be.
macro_rules! sections {
    ($($section:ident: $name:literal, $range:literal;)+) => {
        /// A part of the body, for messages.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[non_exhaustive]
        pub enum Section {
            $(#[doc = concat!("`", $name, "`")] $section,)+
        }

        impl Section {
            /// The values that it may have.
            const fn range(self) -> &'static str {
                match self {
                    $(Self::$section => $range,)+
                }
            }
        }

        impl fmt::Display for Section {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(match self {
                    $(Self::$section => $name,)+
                })
            }
        }
    };
}

sections! {
    Position: "architecture.position", "a value in its range";
    Direction: "architecture.direction", "a value in its range";
    Architecture: "architecture", "a value in its range";
    Content: "content", "a value in its range";
    Samples: "scene.sampling", "1 to 4096 samples, in bins that f32 tells apart";
    Background: "scene.background", "0 to 1";
    OccupancyRequired: "scene.occupancy_required", "false without an occupancy grid";
    Viewpoint: "scene.viewpoint",
        "an eye and a target apart, up of unit length across the way between them, and an arc of 0 to 2 pi";
    Occupancy: "occupancy", "a value in its range";
    OccupancyResolution: "occupancy.resolution", "1 to 512 cells a side";
    OccupancyBits: "occupancy.bits", "none in a picture, and padding of zeros";
    Front: "front", "none in a picture";
    Proposal: "proposal", "none in a picture";
    ProposalSamples: "proposal.samples",
        "1 to 4096 samples, in bins that f32 tells apart, of a scene with bins";
    ProposalWeights: "proposal.weights", "a value in its range";
    Provenance: "provenance", "texts of at most 1024 bytes and finite numbers";
    Weights: "weights", "a value in its range";
    Tables: "tables", "tables exactly where the position is a grid";
    TableScales: "tables.scales", "a value in its range";
}

errors! {
    /// A fault of a point of the front.
    FrontFault:
    /// Samples that are none, more than [`MAX_SAMPLES`], or in bins too narrow for the scene.
    Samples { found: u16 } => "samples: expected 1 to {MAX_SAMPLES} bins of some width, found {found}";
    /// A transmittance cut outside `[0, 1)`.
    TransmittanceCut { found: f32 } => "transmittance_cut: expected 0 <= cut < 1, found {found}";
    /// A colour cut outside `[0, 1)`.
    ColourCut { found: f32 } => "colour_cut: expected 0 <= cut < 1, found {found}";
    /// An occupancy grid the scene has not, or none where it is part of the model.
    Occupancy { found: bool } =>
        "occupancy: expected {expected}",
        expected = match found {
            true => "false in a scene without an occupancy grid",
            false => "true in a scene whose occupancy grid is part of its model",
        };
    /// A tag that names no maths backend.
    Math { found: u8 } => "math: expected a tag below {tags}, found {found}", tags = MathBackend::TAGS;
    /// A proposal the scene has not.
    Proposal => "proposal: expected false in a scene without one";
    /// A loss that is not finite.
    LossDb { found: f32 } => "loss_db: expected a finite value, found {found}";
    /// A cost that is not finite and above 0.
    Cost { found: f32 } => "cost: expected a finite value above 0, found {found}";
    /// A cost that is not below that of the point before.
    CostOrder { before: f32, found: f32 } =>
        "cost: expected less than the {before} of the point before, found {found}";
    /// A loss below that of the point before, which is thus neither cheaper nor better.
    LossOrder { before: f32, found: f32 } =>
        "loss_db: expected at least the {before} of the point before, found {found}";
}

errors! {
    /// Why bytes are no blob this version can open.
    BlobError:
    /// The file does not begin with the magic bytes.
    NotABlob => "not a .nerf blob: the first bytes are not its magic";
    /// The file ends before the bytes that its header announces, or that a header takes.
    Truncated { expected: u64, found: u64 } => "truncated: expected {expected} bytes, found {found}";
    /// Bytes follow the body.
    TrailingBytes { expected: u64, found: u64 } => "trailing bytes: expected {expected} bytes, found {found}";
    /// Made by another version of the format.
    Version { expected: u16, found: u16 } =>
        "format version: this build reads version {expected}, found {found} ({advice})",
        advice = match found < expected {
            true => "older: fit or import the scene again with this build",
            false => "newer: open it with a newer build",
        };
    /// Written with the other byte order.
    Endian { found: u16 } => "endian tag: expected 0xfeff, found {found:#06x}";
    /// Flags that this version does not know.
    Flags { found: u32 } => "flags: expected 0, found {found:#x}";
    /// Reserved bytes of the header that are not 0.
    Reserved { found: u32 } => "reserved header bytes: expected 0, found {found:#x}";
    /// A bit flipped somewhere: the CRC-32 in the header is not that of header and body.
    Checksum { expected: u32, found: u32 } =>
        "CRC-32: expected {expected:#010x}, found {found:#010x} (the file is damaged)";
    /// A section of the body is no postcard of this format's shape: a list beyond its cap, a number beyond its type, a
    /// tag without a meaning, text that is not UTF-8, an end too early.
    Body(section: Section) =>
        "{section}: expected this format's lists, numbers, tags and texts and an end, found others";
    /// The body is not the one form of what it says: a number in more bytes than it takes, bytes behind the last. `at`
    /// counts bytes from the end of the header.
    Form { at: u64 } => "body: expected canonical postcard, found another form at byte {at}";
    /// The architecture is outside the format's caps.
    Architecture(error: ArchitectureError) => "architecture: {error}";
    /// The proposal network is outside the format's caps.
    ProposalArchitecture(error: ArchitectureError) => "proposal: {error}";
    /// A point of the front that cannot be rendered, or makes it no front.
    Front { index: u8, fault: FrontFault } => "front point {index}: {fault}";
    /// The scene's bounds hold nothing.
    Bounds(error: BoundsError) => "scene: {error}";
    /// The network has a density head but is said to be a picture, or the other way round.
    Kind { density_head: bool, scene: bool } =>
        "content: expected a {expected} of a network {with} density head, found a {found}",
        expected = kind(*density_head), with = if *density_head { "with a" } else { "without a" }, found = kind(*scene);
    /// The picture has a side of 0 or beyond [`MAX_PICTURE_SIDE`].
    PictureSize { width: u32, height: u32 } =>
        "picture: expected sides of 1 to {MAX_PICTURE_SIDE} pixels, found {width}x{height}";
    /// The step of a scene's march is no number above 0, or too small for its box.
    Step { found: f32 } =>
        "scene.sampling: expected a finite step above 0, at most {MAX_SAMPLES} of them to the box's diagonal, found {found}";
    /// An unbounded scene whose box is no cube, or whose steps are out of range.
    Contraction { step: f32, power: u8 } =>
        "scene.sampling: expected a contraction into a cube with a power of 1, 2 or 4 and steps above 0 and at most 1, \
         at most {MAX_SAMPLES} of them, found power {power} and step {step}";
    /// A value outside its range.
    Field(section: Section) => "{section}: expected {range}, found otherwise", range = section.range();
    /// A section of the wrong length.
    Length { section: Section, expected: u64, found: u64 } =>
        "{section}: expected {expected} bytes, found {found}";
    /// Scene coordinates times `2^(levels − 1)`, the factor of the highest level, leave the encoding's domain.
    EncodingDomain { found: f32, limit: f32 } =>
        "scene box: 2^(levels - 1) times its coordinates reaches {found}, the encoding ends at {limit}";
    /// A weight of the scene's network or of the proposal is infinite or NaN; `index` counts the layer's weights, then its
    /// biases.
    Weight { section: Section, role: Role, index: u32 } =>
        "{section}: layer {role:?}, parameter {index} is not finite";
    /// The scale of a level of int8 or coded tables that is not above 0, or makes a value infinite.
    TableScale { level: u8, found: f32 } =>
        "tables.scales: level {level}: expected a number above 0 of which 128 are finite, found {found}";
    /// A value of the grid's tables is infinite or NaN.
    TableValue { level: u8, index: u32 } => "tables: level {level}, value {index} is not finite";
    /// The bytes of coded tables end before this value.
    CodedEnd { level: u8, index: u32 } =>
        "tables: level {level}: expected value {index}, found the end of the coded bytes";
    /// The bytes of coded tables are not what an encoder of their values writes: the decoder does not end with the last byte
    /// and in the coder's first state, or begins below that.
    CodedRest { state: u32, bytes: u64 } =>
        "tables: expected coded bytes that end in state 65536 behind the last value, found state {state} and {bytes} \
         bytes more";
    /// The file needs what this build has no code for.
    NotBuilt { feature: &'static str } =>
        "{part}: expected a build with the feature `{feature}`{advice}, found one without",
        part = match *feature {
            "contraction" => Section::Samples,
            "coded" => Section::Tables,
            _ => Section::Position,
        },
        // int8 needs no memory to be decoded into.
        advice = if *feature == "coded" { " (or a file fitted with --export int8)" } else { "" };
    /// The output buffer of a write is too small.
    Space { expected: u64, found: u64 } => "output buffer: expected {expected} bytes, found {found}";
}

/// The content of a blob with or without densities.
const fn kind(density: bool) -> &'static str {
    if density { "scene" } else { "picture" }
}
