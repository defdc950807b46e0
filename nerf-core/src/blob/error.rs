//! Errors of opening and writing a blob.

use super::body::{MAX_PICTURE_SIDE, MAX_SAMPLES};
use crate::errors::errors;
use crate::math::MathBackend;
use crate::names::names;
use crate::network::{ArchitectureError, Role};
use crate::space::BoundsError;
use core::fmt;

names! {
    /// A section of a blob's body. Error messages name the section.
    #[non_exhaustive]
    pub enum Section {
        Position = "architecture.position",
        Direction = "architecture.direction",
        Architecture = "architecture",
        Content = "content",
        Samples = "scene.sampling",
        Background = "scene.background",
        OccupancyRequired = "scene.occupancy_required",
        Viewpoint = "scene.viewpoint",
        Occupancy = "occupancy",
        OccupancyResolution = "occupancy.resolution",
        OccupancyBits = "occupancy.bits",
        Front = "front",
        Proposal = "proposal",
        ProposalSamples = "proposal.samples",
        ProposalWeights = "proposal.weights",
        Provenance = "provenance",
        Weights = "weights",
        Tables = "tables",
        TableScales = "tables.scales",
    }
}

impl Section {
    /// Describes the valid values of the section, for the message of [`BlobError::Field`].
    const fn range(self) -> &'static str {
        match self {
            Self::Samples => "1 to 4096 samples, in bins that f32 tells apart",
            Self::Background => "0 to 1",
            Self::OccupancyRequired => "false without an occupancy grid",
            Self::Viewpoint => {
                "an eye and a target apart, up of unit length across the way between them, and an arc of 0 to 2 pi"
            }
            Self::OccupancyResolution => "1 to 512 cells a side",
            Self::OccupancyBits => "none in a picture, and padding of zeros",
            Self::Front | Self::Proposal => "none in a picture",
            Self::ProposalSamples => "1 to 4096 samples, in bins that f32 tells apart, of a scene with bins",
            Self::Provenance => "texts of at most 1024 bytes and finite numbers",
            Self::Tables => "tables exactly where the position is a grid",
            _ => "a value in its range",
        }
    }
}

impl fmt::Display for Section {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

errors! {
    /// Reason why a point of a blob's Pareto front is invalid.
    FrontFault:
    Samples { found: u16 } => "samples: expected 1 to {MAX_SAMPLES} bins of some width, found {found}";
    TransmittanceCut { found: f32 } => "transmittance_cut: expected 0 <= cut < 1, found {found}";
    ColourCut { found: f32 } => "colour_cut: expected 0 <= cut < 1, found {found}";
    /// The front point uses an occupancy grid in a scene that has none, or does not use the occupancy grid that the
    /// scene requires. `found`: whether the front point uses an occupancy grid.
    Occupancy { found: bool } =>
        "occupancy: expected {expected}",
        expected = match found {
            true => "false in a scene without an occupancy grid",
            false => "true in a scene whose occupancy grid is part of its model",
        };
    Math { found: u8 } => "math: expected a tag below {tags}, found {found}", tags = MathBackend::TAGS;
    Proposal => "proposal: expected false in a scene without one";
    LossDb { found: f32 } => "loss_db: expected a finite value, found {found}";
    Cost { found: f32 } => "cost: expected a finite value above 0, found {found}";
    CostOrder { before: f32, found: f32 } =>
        "cost: expected less than the {before} of the point before, found {found}";
    LossOrder { before: f32, found: f32 } =>
        "loss_db: expected at least the {before} of the point before, found {found}";
}

errors! {
    /// Reason why a blob cannot be opened or written.
    BlobError:
    NotABlob => "not a .nerf blob: the first bytes are not its magic";
    Truncated { expected: u64, found: u64 } => "truncated: expected {expected} bytes, found {found}";
    TrailingBytes { expected: u64, found: u64 } => "trailing bytes: expected {expected} bytes, found {found}";
    Version { expected: u16, found: u16 } =>
        "format version: this build reads version {expected}, found {found} ({advice})",
        advice = match found < expected {
            true => "older: fit or import the scene again with this build",
            false => "newer: open it with a newer build",
        };
    /// The header's endian tag is not 0xfeff: the file was written in big-endian byte order, or is damaged.
    Endian { found: u16 } => "endian tag: expected 0xfeff, found {found:#06x}";
    Flags { found: u32 } => "flags: expected 0, found {found:#x}";
    Reserved { found: u32 } => "reserved header bytes: expected 0, found {found:#x}";
    Checksum { expected: u32, found: u32 } =>
        "CRC-32: expected {expected:#010x}, found {found:#010x} (the file is damaged)";
    /// A section of the body cannot be decoded: a list longer than its limit, a number too large for its type, an
    /// unknown tag, text that is not UTF-8, or an early end.
    Body(section: Section) =>
        "{section}: expected this format's lists, numbers, tags and texts and an end, found others";
    /// The body is longer than its canonical form: a number takes more bytes than needed, or bytes follow the last
    /// section.
    Form { expected: u64, found: u64 } => "body: expected {expected} bytes of canonical postcard, found {found}";
    Architecture(error: ArchitectureError) => "architecture: {error}";
    ProposalArchitecture(error: ArchitectureError) => "proposal: {error}";
    Front { index: u8, fault: FrontFault } => "front point {index}: {fault}";
    Bounds(error: BoundsError) => "scene: {error}";
    /// A 2D field's network has a density head, or a scene's network has none.
    Kind { density_head: bool, scene: bool } =>
        "content: expected a {expected} of a network {with} density head, found a {found}",
        expected = kind(*density_head), with = if *density_head { "with a" } else { "without a" }, found = kind(*scene);
    PictureSize { width: u32, height: u32 } =>
        "picture: expected sides of 1 to {MAX_PICTURE_SIDE} pixels, found {width}x{height}";
    Step { found: f32 } =>
        "scene.sampling: expected a finite step above 0, at most {MAX_SAMPLES} of them to the box's diagonal, found {found}";
    Contraction { step: f32, power: u8 } =>
        "scene.sampling: expected a contraction into a cube with a power of 1, 2 or 4 and steps above 0 and at most 1, \
         at most {MAX_SAMPLES} of them, found power {power} and step {step}";
    Field(section: Section) => "{section}: expected {range}, found otherwise", range = section.range();
    Length { section: Section, expected: u64, found: u64 } =>
        "{section}: expected {expected} bytes, found {found}";
    EncodingDomain { found: f32, limit: f32 } =>
        "scene box: 2^(levels - 1) times its coordinates reaches {found}, the encoding ends at {limit}";
    /// A parameter of the network or of the proposal network is infinite or NaN. `index`: index of the parameter in its
    /// layer, whose weights come before its biases.
    Weight { section: Section, role: Role, index: u32 } =>
        "{section}: layer {role:?}, parameter {index} is not finite";
    TableScale { level: u8, found: f32 } =>
        "tables.scales: level {level}: expected a number above 0 of which 128 are finite, found {found}";
    TableValue { level: u8, index: u32 } => "tables: level {level}, value {index} is not finite";
    CodedEnd { level: u8, index: u32 } =>
        "tables: level {level}: expected value {index}, found the end of the coded bytes";
    /// The coded bytes are not the output of an encoder: the decoder's initial state is too low, bytes are left after
    /// the last value, or the decoder does not end in the encoder's initial state. `state`: the decoder's initial state
    /// if that state is too low; otherwise the decoder's last state. `bytes`: number of bytes not yet decoded.
    CodedRest { state: u32, bytes: u64 } =>
        "tables: expected coded bytes that end in state 65536 behind the last value, found state {state} and {bytes} \
         bytes more";
    NotBuilt { feature: &'static str } =>
        "{part}: expected a build with the feature `{feature}`{advice}, found one without",
        part = match *feature {
            "contraction" => Section::Samples,
            "coded" => Section::Tables,
            _ => Section::Position,
        },
        // int8 tables are read directly from the blob's bytes and need no decoder.
        advice = if *feature == "coded" { " (or a file fitted with --export int8)" } else { "" };
    Space { expected: u64, found: u64 } => "output buffer: expected {expected} bytes, found {found}";
}

/// Name of a blob's content in error messages: "scene" for content with density, "picture" for a 2D field.
const fn kind(density: bool) -> &'static str {
    if density { "scene" } else { "picture" }
}
