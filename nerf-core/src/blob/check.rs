//! The rules of the format, checked in one pass over a body after it is read or before it is written.

use super::body::{
    Body, Content, MAX_OCCUPANCY_RESOLUTION, MAX_PICTURE_SIDE, MAX_SAMPLES, MAX_TEXT, PictureFacts,
    SceneFacts, SceneSampling, StoredOccupancy, StoredTables, Viewpoint, steps,
};
use super::coded;
use super::error::{BlobError, FrontFault, Section};
use super::front::FrontPoint;
use super::proposal::Proposal;
use crate::encoding::{AngleScale, SinusoidalEncoding};
use crate::math::{MathBackend, polynomial::SIN_COS_DOMAIN};
use crate::network::{Architecture, Layers};
use crate::sampling::Bins;
use crate::space::{BoundsError, Contraction, SceneBox};
use core::f32::consts::TAU;
use glam::Vec3;

/// Maximum number of values per byte of coded tables, rounded up: each of a value's two symbols has a probability of
/// at most 1 - 15/2^15.
#[cfg(feature = "grid")]
const MAX_VALUES_OF_A_BYTE: usize = 6100;

/// Checks every rule of the format except those of the header and of the canonical form.
pub(super) fn check(body: &Body<'_>) -> Result<(), BlobError> {
    check_undecoded(body)?;
    check_coded(body)
}

/// Checks coded tables by decoding them.
pub(super) fn check_coded(body: &Body<'_>) -> Result<(), BlobError> {
    match (body.architecture.position.grid(), body.tables) {
        (Some(grid), Some(StoredTables::Coded { bytes, .. })) => coded::decode_tables(grid, bytes, |_| {}),
        _ => Ok(()),
    }
}

/// Checks every rule of [`check`] except those of coded tables.
pub(super) fn check_undecoded(body: &Body<'_>) -> Result<(), BlobError> {
    body.architecture.check().map_err(BlobError::Architecture)?;
    let density_head = body.architecture.density.is_some();
    let scene = matches!(body.content, Content::Scene(_));
    if density_head != scene {
        return Err(BlobError::Kind { density_head, scene });
    }
    match &body.content {
        Content::Picture(picture) => check_picture(*picture)?,
        Content::Scene(scene) => check_scene(scene, &body.architecture)?,
    }
    match (&body.occupancy, &body.content) {
        (Some(_), Content::Picture(_)) => return Err(BlobError::Field(Section::OccupancyBits)),
        (None, Content::Scene(scene)) if scene.occupancy_required => {
            return Err(BlobError::Field(Section::OccupancyRequired));
        }
        (Some(occupancy), Content::Scene(_)) => check_occupancy(occupancy)?,
        _ => {}
    }
    match &body.content {
        Content::Picture(_) if !body.front.is_empty() => return Err(BlobError::Field(Section::Front)),
        Content::Picture(_) if body.proposal.is_some() => return Err(BlobError::Field(Section::Proposal)),
        Content::Picture(_) => {}
        Content::Scene(scene) => {
            check_front(&body.front, scene, body.occupancy.is_some(), body.proposal.is_some())
                .map_err(|(index, fault)| BlobError::Front { index: index as u8, fault })?;
            if let Some(proposal) = &body.proposal {
                check_proposal(proposal, scene)?;
            }
        }
    }
    let p = &body.provenance;
    let finite = [p.psnr_db, p.quantisation_loss_db].into_iter().flatten().all(f32::is_finite);
    if [p.data, p.made_by, p.psnr_convention].iter().any(|text| text.len() > MAX_TEXT) || !finite {
        return Err(BlobError::Field(Section::Provenance));
    }
    check_weights(body)?;
    check_tables(body)
}

/// The encoding's domain needs no check: `2^(levels − 1)` times a coordinate is 2^15 at most.
fn check_picture(PictureFacts { width, height }: PictureFacts) -> Result<(), BlobError> {
    let sides = 1..=MAX_PICTURE_SIDE;
    if sides.contains(&width) && sides.contains(&height) {
        Ok(())
    } else {
        Err(BlobError::PictureSize { width, height })
    }
}

fn check_scene(scene: &SceneFacts, architecture: &Architecture) -> Result<(), BlobError> {
    let bounds = SceneBox::new(Vec3::from(scene.min), Vec3::from(scene.max)).map_err(BlobError::Bounds)?;
    let (near, far) = (scene.near, scene.far);
    if !(near >= 0.0 && near < far && far.is_finite()) {
        return Err(BlobError::Bounds(BoundsError::Range { near, far }));
    }
    match scene.sampling {
        SceneSampling::Bins(samples) if !(1..=MAX_SAMPLES).contains(&samples) => {
            return Err(BlobError::Field(Section::Samples));
        }
        // Refuses bins too narrow for f32, so that every opened scene can be planned.
        SceneSampling::Bins(samples) => {
            Bins::new(near, far, u32::from(samples)).map_err(BlobError::Bounds)?;
        }
        SceneSampling::March(step) => {
            let fits = step > 0.0 && step.is_finite() && steps(scene.diagonal(), step) <= MAX_SAMPLES.into();
            if !fits {
                return Err(BlobError::Step { found: step });
            }
        }
        SceneSampling::Contracted { .. } if !cfg!(feature = "contraction") => {
            return Err(BlobError::NotBuilt { feature: "contraction" });
        }
        SceneSampling::Contracted { step, power } => {
            let fits = Contraction::new(&bounds, power).is_some()
                && step > 0.0
                && step <= 1.0
                && steps(2.0 * (1.0 + f32::from(power)), step) <= MAX_SAMPLES.into();
            if !fits {
                return Err(BlobError::Contraction { step, power });
            }
        }
    }
    if !scene.background.iter().all(|c| (0.0..=1.0).contains(c)) {
        return Err(BlobError::Field(Section::Background));
    }
    if !scene.viewpoint.is_none_or(|viewpoint| looks_somewhere(&viewpoint)) {
        return Err(BlobError::Field(Section::Viewpoint));
    }
    match architecture.position.sinusoidal() {
        Some(encoding) => check_domain(&bounds, encoding),
        // A grid spans the scene box, at any coordinates.
        None => Ok(()),
    }
}

/// Whether the viewpoint determines a camera pose.
fn looks_somewhere(viewpoint: &Viewpoint) -> bool {
    let (eye, up) = (Vec3::from(viewpoint.eye), Vec3::from(viewpoint.up));
    let back = eye - Vec3::from(viewpoint.target);
    // NaN, and infinity against infinity, compare false.
    eye.is_finite()
        && (up.length_squared() - 1.0).abs() <= 2e-3
        && up.cross(back).length_squared() > 1e-6 * back.length_squared()
        && (0.0..=TAU).contains(&viewpoint.arc)
}

/// Whether rays of the scene can have `samples` samples. Checked when a blob is opened, so that planning cannot fail
/// on it later.
pub(super) fn samples_fit(scene: &SceneFacts, samples: u16) -> bool {
    (1..=MAX_SAMPLES).contains(&samples)
        && match scene.sampling {
            SceneSampling::Bins(_) => Bins::new(scene.near, scene.far, u32::from(samples)).is_ok(),
            SceneSampling::March(_) => scene.diagonal() / f32::from(samples) > 0.0,
            SceneSampling::Contracted { .. } => true,
        }
}

/// Whether every point of the box can be encoded.
fn check_domain(bounds: &SceneBox, position: &SinusoidalEncoding) -> Result<(), BlobError> {
    // The highest level multiplies by 2^(levels − 1).
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
    if occupancy.resolution.iter().any(|&side| side == 0 || side > MAX_OCCUPANCY_RESOLUTION) {
        return Err(BlobError::Field(Section::OccupancyResolution));
    }
    check_length(Section::OccupancyBits, StoredOccupancy::bytes(occupancy.resolution), occupancy.bits)?;
    let cells: usize = occupancy.resolution.iter().map(|&side| usize::from(side)).product();
    let padding = occupancy.bits.last().map_or(0, |last| last.checked_shr(cells as u32 % 8).unwrap_or(0));
    if !cells.is_multiple_of(8) && padding != 0 {
        return Err(BlobError::Field(Section::OccupancyBits));
    }
    Ok(())
}

/// Checks the proposal network by the rules of the scene's network, without the colour branch.
fn check_proposal(proposal: &Proposal<'_>, scene: &SceneFacts) -> Result<(), BlobError> {
    let architecture = proposal.architecture();
    architecture.check().map_err(BlobError::ProposalArchitecture)?;
    // A proposal draws samples between near and far: only scenes with bins have one.
    let bins = matches!(scene.sampling, SceneSampling::Bins(_));
    if !(bins && samples_fit(scene, proposal.samples)) {
        return Err(BlobError::Field(Section::ProposalSamples));
    }
    let bounds = SceneBox { min: Vec3::from(scene.min), max: Vec3::from(scene.max) };
    check_domain(&bounds, &proposal.position)?;
    let parameters = architecture.density_parameters();
    check_values(&architecture.layers(), parameters, proposal.weights, Section::ProposalWeights)
}

fn check_weights(body: &Body<'_>) -> Result<(), BlobError> {
    let layers = body.architecture.layers();
    check_values(&layers, body.architecture.parameters(), body.weights, Section::Weights)
}

#[cfg(not(feature = "grid"))]
fn check_tables(body: &Body<'_>) -> Result<(), BlobError> {
    if body.tables.is_some() { Err(BlobError::Field(Section::Tables)) } else { Ok(()) }
}

/// Checks that a grid has tables with the right number of finite values and scales, and that other positions have
/// none.
#[cfg(feature = "grid")]
fn check_tables(body: &Body<'_>) -> Result<(), BlobError> {
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
            if !fits {
                return Err(BlobError::TableScale { level: level as u8, found });
            }
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

/// Index of the first f16 that is infinite or NaN.
fn first_not_finite(bytes: &[u8]) -> Option<usize> {
    // An f16 is finite unless its five exponent bits are all set.
    bytes.as_chunks().0.iter().position(|&[_, high]| high & 0x7c == 0x7c)
}

/// Checks that `weights` are `parameters` finite f16. `layers` name the faulty one.
fn check_values(
    layers: &Layers,
    parameters: usize,
    weights: &[u8],
    section: Section,
) -> Result<(), BlobError> {
    check_length(section, 2 * parameters, weights)?;
    let Some(at) = first_not_finite(weights) else { return Ok(()) };
    let owner = layers.iter().rev().find(|layer| layer.weights <= at);
    Err(match owner {
        Some(layer) => BlobError::Weight { section, role: layer.role, index: (at - layer.weights) as u32 },
        None => BlobError::Field(section),
    })
}

/// Checks that every point can be planned and that the points form a Pareto front. `occupancy` and `proposal` say
/// whether the scene has these.
fn check_front(
    front: &[FrontPoint],
    scene: &SceneFacts,
    occupancy: bool,
    proposal: bool,
) -> Result<(), (usize, FrontFault)> {
    for (index, point) in front.iter().enumerate() {
        check_point(point, scene, occupancy, proposal).map_err(|fault| (index, fault))?;
        if let Some(before) = index.checked_sub(1).and_then(|i| front.get(i)) {
            if point.cost >= before.cost {
                return Err((index, FrontFault::CostOrder { before: before.cost, found: point.cost }));
            }
            if point.loss_db < before.loss_db {
                return Err((index, FrontFault::LossOrder { before: before.loss_db, found: point.loss_db }));
            }
        }
    }
    Ok(())
}

fn check_point(
    point: &FrontPoint,
    scene: &SceneFacts,
    occupancy: bool,
    proposal: bool,
) -> Result<(), FrontFault> {
    if !samples_fit(scene, point.samples) {
        return Err(FrontFault::Samples { found: point.samples });
    }
    if !(0.0..1.0).contains(&point.transmittance_cut) {
        return Err(FrontFault::TransmittanceCut { found: point.transmittance_cut });
    }
    if !(0.0..1.0).contains(&point.colour_cut) {
        return Err(FrontFault::ColourCut { found: point.colour_cut });
    }
    if (point.occupancy && !occupancy) || (scene.occupancy_required && !point.occupancy) {
        return Err(FrontFault::Occupancy { found: point.occupancy });
    }
    if point.math >= MathBackend::TAGS {
        return Err(FrontFault::Math { found: point.math });
    }
    if point.proposal && !proposal {
        return Err(FrontFault::Proposal);
    }
    if !point.loss_db.is_finite() {
        return Err(FrontFault::LossDb { found: point.loss_db });
    }
    if !(point.cost > 0.0 && point.cost.is_finite()) {
        return Err(FrontFault::Cost { found: point.cost });
    }
    Ok(())
}
