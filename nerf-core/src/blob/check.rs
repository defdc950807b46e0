//! Checks of a blob's body by the rules of the format, after reading or before writing.

use super::body::{
    Body, Content, FrontPoint, MAX_OCCUPANCY_RESOLUTION, MAX_PICTURE_SIDE, MAX_SAMPLES, MAX_TEXT,
    PictureFacts, Proposal, SceneFacts, SceneSampling, StoredOccupancy, Viewpoint, steps,
};
use super::coded;
use super::error::{BlobError, FrontFault, Section};
use crate::encoding::{AngleScale, SinusoidalEncoding};
use crate::errors::ensure;
use crate::math::{MathBackend, polynomial::SIN_COS_DOMAIN};
use crate::network::Architecture;
use crate::sampling::Bins;
use crate::space::{BoundsError, Contraction, SceneBox};
use core::f32::consts::TAU;
use glam::Vec3;

/// Checks the body, including entropy-coded tables, by all rules of the format except canonical form, which is checked
/// by `check_form` in `view.rs`.
pub(super) fn check(body: &Body<'_>) -> Result<(), BlobError> {
    check_undecoded(body)?;
    check_coded(body)
}

/// Checks entropy-coded tables by decoding all values; accepts a body without entropy-coded tables.
pub(super) fn check_coded(body: &Body<'_>) -> Result<(), BlobError> {
    body.coded().map_or(Ok(()), |(grid, bytes)| coded::decode_tables(grid, bytes, |_| {}))
}

/// Checks the body as [`check`] does, but does not decode entropy-coded tables.
pub(super) fn check_undecoded(body: &Body<'_>) -> Result<(), BlobError> {
    body.architecture.check().map_err(BlobError::Architecture)?;
    let density_head = body.architecture.density.is_some();
    let scene = matches!(body.content, Content::Scene(_));
    ensure!(density_head == scene, BlobError::Kind { density_head, scene });
    match &body.content {
        // Needs no `check_domain`: a coordinate is at most 1, and `2^(levels − 1)` at most 2^15.
        &Content::Picture(PictureFacts { width, height }) => {
            let sides = 1..=MAX_PICTURE_SIDE;
            let fits = sides.contains(&width) && sides.contains(&height);
            ensure!(fits, BlobError::PictureSize { width, height });
            ensure!(body.occupancy.is_none(), BlobError::Field(Section::OccupancyBits));
            ensure!(body.front.is_empty(), BlobError::Field(Section::Front));
            ensure!(body.proposal.is_none(), BlobError::Field(Section::Proposal));
        }
        Content::Scene(scene) => {
            check_scene(scene, &body.architecture)?;
            match &body.occupancy {
                Some(occupancy) => check_occupancy(occupancy)?,
                None => ensure!(!scene.occupancy_required, BlobError::Field(Section::OccupancyRequired)),
            }
            check_front(body, scene)?;
            if let Some(proposal) = &body.proposal {
                check_proposal(proposal, scene)?;
            }
        }
    }
    let p = &body.provenance;
    let finite = [p.psnr_db, p.quantisation_loss_db].into_iter().flatten().all(f32::is_finite);
    let short = [p.data, p.made_by, p.psnr_convention].iter().all(|text| text.len() <= MAX_TEXT);
    ensure!(short && finite, BlobError::Field(Section::Provenance));
    check_values(&body.architecture, body.architecture.parameters(), body.weights, Section::Weights)?;
    check_tables(body)
}

fn check_scene(scene: &SceneFacts, architecture: &Architecture) -> Result<(), BlobError> {
    let bounds = SceneBox::new(Vec3::from(scene.min), Vec3::from(scene.max)).map_err(BlobError::Bounds)?;
    let (near, far) = (scene.near, scene.far);
    ensure!(
        near >= 0.0 && near < far && far.is_finite(),
        BlobError::Bounds(BoundsError::Range { near, far })
    );
    match scene.sampling {
        SceneSampling::Bins(samples) => {
            ensure!((1..=MAX_SAMPLES).contains(&samples), BlobError::Field(Section::Samples));
            // Refuses bins too narrow for f32, since planning a frame would fail on them.
            Bins::new(near, far, u32::from(samples)).map_err(BlobError::Bounds)?;
        }
        SceneSampling::March(step) => {
            let fits = step > 0.0 && step.is_finite() && steps(scene.diagonal(), step) <= MAX_SAMPLES.into();
            ensure!(fits, BlobError::Step { found: step });
        }
        SceneSampling::Contracted { step, power } => {
            ensure!(cfg!(feature = "contraction"), BlobError::NotBuilt { feature: "contraction" });
            let fits = Contraction::new(&bounds, power).is_some()
                && step > 0.0
                && step <= 1.0
                && steps(2.0 * (1.0 + f32::from(power)), step) <= MAX_SAMPLES.into();
            ensure!(fits, BlobError::Contraction { step, power });
        }
    }
    ensure!(scene.background.iter().all(|c| (0.0..=1.0).contains(c)), BlobError::Field(Section::Background));
    ensure!(
        scene.viewpoint.is_none_or(|viewpoint| looks_somewhere(&viewpoint)),
        BlobError::Field(Section::Viewpoint)
    );
    match architecture.position.sinusoidal() {
        Some(encoding) => check_domain(&bounds, encoding),
        // A grid encoding has no limit on coordinates, since its cells span the scene box.
        None => Ok(()),
    }
}

/// Whether a camera pose can be computed from the viewpoint, and `arc` is 0 to 2π. The pose requires finite coordinates
/// and a vector `up` of unit length that is not parallel to the view direction.
fn looks_somewhere(viewpoint: &Viewpoint) -> bool {
    let (eye, up) = (Vec3::from(viewpoint.eye), Vec3::from(viewpoint.up));
    let back = eye - Vec3::from(viewpoint.target);
    // Refuses NaN and infinities too: comparisons with NaN are false, and infinity is not above infinity.
    eye.is_finite()
        && (up.length_squared() - 1.0).abs() <= 2e-3
        && up.cross(back).length_squared() > 1e-6 * back.length_squared()
        && (0.0..=TAU).contains(&viewpoint.arc)
}

/// Whether rays of the scene can have `samples` samples. The number must be 1 to [`MAX_SAMPLES`], and the distance
/// between samples must not round to 0.
fn samples_fit(scene: &SceneFacts, samples: u16) -> bool {
    (1..=MAX_SAMPLES).contains(&samples)
        && match scene.sampling {
            SceneSampling::Bins(_) => Bins::new(scene.near, scene.far, u32::from(samples)).is_ok(),
            SceneSampling::March(_) => scene.diagonal() / f32::from(samples) > 0.0,
            SceneSampling::Contracted { .. } => true,
        }
}

/// Checks that this crate's sine and cosine are accurate for the encoding's largest angle inside the box. For
/// [`AngleScale::One`], the angle's limit is [`SIN_COS_DOMAIN`]. For [`AngleScale::Pi`], any finite angle is allowed.
fn check_domain(bounds: &SceneBox, position: &SinusoidalEncoding) -> Result<(), BlobError> {
    // The highest level multiplies coordinates by 2^(levels − 1).
    let reach = bounds.min.abs().max(bounds.max.abs()).max_element();
    let found = reach * (1u32 << position.levels.saturating_sub(1)) as f32;
    let limit = match position.scale {
        AngleScale::One => SIN_COS_DOMAIN,
        // Angles of any finite size are reduced exactly.
        AngleScale::Pi => f32::MAX,
    };
    if found > limit { Err(BlobError::EncodingDomain { found, limit }) } else { Ok(()) }
}

fn check_occupancy(occupancy: &StoredOccupancy<'_>) -> Result<(), BlobError> {
    ensure!(
        occupancy.resolution.iter().all(|side| (1..=MAX_OCCUPANCY_RESOLUTION).contains(side)),
        BlobError::Field(Section::OccupancyResolution)
    );
    check_length(Section::OccupancyBits, StoredOccupancy::bytes(occupancy.resolution), occupancy.bits)?;
    let cells: usize = occupancy.resolution.iter().map(|&side| usize::from(side)).product();
    let padding = occupancy.bits.last().map_or(0, |last| last.checked_shr(cells as u32 % 8).unwrap_or(0));
    ensure!(cells.is_multiple_of(8) || padding == 0, BlobError::Field(Section::OccupancyBits));
    Ok(())
}

/// Checks the proposal network: architecture, number of samples, largest angle of the encoding, and weights.
fn check_proposal(proposal: &Proposal<'_>, scene: &SceneFacts) -> Result<(), BlobError> {
    let architecture = proposal.architecture();
    architecture.check().map_err(BlobError::ProposalArchitecture)?;
    // Only a scene with bins can have a proposal network, since the network places samples between `near` and `far`.
    let bins = matches!(scene.sampling, SceneSampling::Bins(_));
    ensure!(bins && samples_fit(scene, proposal.samples), BlobError::Field(Section::ProposalSamples));
    check_domain(&scene.bounds(), &proposal.position)?;
    check_values(&architecture, architecture.density_parameters(), proposal.weights, Section::ProposalWeights)
}

#[cfg(not(feature = "grid"))]
fn check_tables(body: &Body<'_>) -> Result<(), BlobError> {
    if body.tables.is_some() { Err(BlobError::Field(Section::Tables)) } else { Ok(()) }
}

/// Checks a grid encoding's tables: lengths, scales, finite values. Without a grid encoding, tables are an error.
#[cfg(feature = "grid")]
fn check_tables(body: &Body<'_>) -> Result<(), BlobError> {
    use super::body::StoredTables;
    /// Maximum number of values that one byte of coded tables can hold, rounded up. A value is two symbols. A symbol
    /// takes at least 0.00066 bits, since its probability is at most 1 - 15/2^15.
    const MAX_VALUES_OF_A_BYTE: usize = 6100;
    let (grid, tables) = match (body.architecture.position.grid(), &body.tables) {
        (None, None) => return Ok(()),
        (Some(grid), Some(tables)) => (grid, tables),
        _ => return Err(BlobError::Field(Section::Tables)),
    };
    if let Some(scales) = tables.scales() {
        check_length(Section::TableScales, 4 * grid.resolutions.len(), scales)?;
        for (level, &scale) in scales.as_chunks().0.iter().enumerate() {
            let found = f32::from_le_bytes(scale);
            // Ensures that every value of the level is finite.
            let fits = found > 0.0 && found <= f32::MAX / 128.0;
            ensure!(fits, BlobError::TableScale { level: level as u8, found });
        }
    }
    let bytes = match tables {
        StoredTables::F16(bytes) => bytes,
        StoredTables::Int8 { bytes, .. } => return check_length(Section::Tables, grid.values(), bytes),
        // Ensures that a short file cannot demand much memory.
        StoredTables::Coded { bytes, .. } => {
            let least = grid.values().div_ceil(MAX_VALUES_OF_A_BYTE);
            return check_length(Section::Tables, least.max(bytes.len()), bytes);
        }
    };
    check_length(Section::Tables, 2 * grid.values(), bytes)?;
    let Some(at) = first_not_finite(bytes) else { return Ok(()) };
    let features = usize::from(grid.features);
    let owner = grid.levels().take_while(|level| level.first * features <= at).last();
    let (level, first) = owner.map_or((0, 0), |level| (level.index as u8, level.first * features));
    Err(BlobError::TableValue { level, index: (at - first) as u32 })
}

fn check_length(section: Section, expected: usize, bytes: &[u8]) -> Result<(), BlobError> {
    let (expected, found) = (expected as u64, bytes.len() as u64);
    if expected == found { Ok(()) } else { Err(BlobError::Length { section, expected, found }) }
}

/// Index of the first infinite or NaN value in `bytes`, a list of little-endian f16; `None` if all values are finite.
fn first_not_finite(bytes: &[u8]) -> Option<usize> {
    // An f16 is finite unless its five exponent bits are all set.
    bytes.as_chunks().0.iter().position(|&[_, high]| high & 0x7c == 0x7c)
}

/// Checks that `weights` holds exactly `parameters` f16, and that all are finite. An error names the layer of the first
/// value that is not finite.
fn check_values(
    architecture: &Architecture,
    parameters: usize,
    weights: &[u8],
    section: Section,
) -> Result<(), BlobError> {
    check_length(section, 2 * parameters, weights)?;
    let Some(at) = first_not_finite(weights) else { return Ok(()) };
    Err(match architecture.layers().iter().rev().find(|layer| layer.weights <= at) {
        Some(layer) => BlobError::Weight { section, role: layer.role, index: (at - layer.weights) as u32 },
        None => BlobError::Field(section),
    })
}

/// Checks that each point of the Pareto front has valid settings for the scene. The cost of a point must be lower than
/// the cost of the previous point. The PSNR of a point must not be higher than the PSNR of the previous point.
fn check_front(body: &Body<'_>, scene: &SceneFacts) -> Result<(), BlobError> {
    let mut before: Option<&FrontPoint> = None;
    for (index, point) in body.front.iter().enumerate() {
        let at = |fault| BlobError::Front { index: index as u8, fault };
        check_point(point, body, scene).map_err(at)?;
        if let Some(&FrontPoint { cost, loss_db, .. }) = before {
            ensure!(point.cost < cost, at(FrontFault::CostOrder { before: cost, found: point.cost }));
            let fault = FrontFault::LossOrder { before: loss_db, found: point.loss_db };
            ensure!(point.loss_db >= loss_db, at(fault));
        }
        before = Some(point);
    }
    Ok(())
}

fn check_point(point: &FrontPoint, body: &Body<'_>, scene: &SceneFacts) -> Result<(), FrontFault> {
    ensure!(samples_fit(scene, point.samples), FrontFault::Samples { found: point.samples });
    ensure!(
        (0.0..1.0).contains(&point.transmittance_cut),
        FrontFault::TransmittanceCut { found: point.transmittance_cut }
    );
    ensure!((0.0..1.0).contains(&point.colour_cut), FrontFault::ColourCut { found: point.colour_cut });
    let fits = if point.occupancy { body.occupancy.is_some() } else { !scene.occupancy_required };
    ensure!(fits, FrontFault::Occupancy { found: point.occupancy });
    ensure!(point.math < MathBackend::TAGS, FrontFault::Math { found: point.math });
    ensure!(!point.proposal || body.proposal.is_some(), FrontFault::Proposal);
    ensure!(point.loss_db.is_finite(), FrontFault::LossDb { found: point.loss_db });
    ensure!(point.cost > 0.0 && point.cost.is_finite(), FrontFault::Cost { found: point.cost });
    Ok(())
}
