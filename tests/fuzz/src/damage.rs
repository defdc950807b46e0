//! Blobs that are wrong in their content, but not in their checksum.

use arbitrary::{Result, Unstructured};
use nerf_core::blob::{
    Body, Content, FrontPoint, HEADER_LEN, PictureFacts, Proposal, SceneSampling, StoredOccupancy,
    StoredTables, Viewpoint,
};
use nerf_core::encoding::{
    AngleScale, DirectionEncoding, GridEncoding, PositionEncoding, SinusoidalEncoding,
};
use nerf_core::network::{Architecture, DensityActivation, Shading, TrunkLayer};
use nerf_testing::scenes::{self, Recipe};

use crate::values::{any_f32, any_vec3};

/// Small blobs of every kind.
pub const RECIPES: [Recipe; 12] = [
    Recipe { trunk: (1, 4), levels: 2, ..Recipe::CONTRACTED },
    Recipe { trunk: (1, 4), levels: 2, ..Recipe::LEARNED },
    Recipe { trunk: (1, 4), ..Recipe::LEARNED_PICTURE },
    Recipe { trunk: (1, 4), levels: 3, ..Recipe::LEARNED_INT8 },
    Recipe { trunk: (1, 4), levels: 2, ..Recipe::LEARNED_CODED },
    Recipe { levels: 2, ..Recipe::DEFERRED },
    Recipe::TINY,
    Recipe::TINY_PROPOSAL,
    Recipe::TINY_PICTURE,
    Recipe { trunk: (2, 5), skip: true, levels: 3, ..Recipe::PLAIN },
    Recipe { trunk: (2, 16), levels: 2, ..Recipe::PROPOSAL },
    Recipe { trunk: (3, 17), levels: 4, skip: true, ..Recipe::PICTURE },
];

/// Weights at the edges of f16.
const EDGES: [u16; 8] = [0x0000, 0x8000, 0x0001, 0x03ff, 0x7bff, 0xfbff, 0x3c00, 0x7c00];

/// Sets length and checksum right, so that the rules behind them are met.
pub fn fix_header(blob: &mut [u8]) {
    let Some(length) = blob.len().checked_sub(HEADER_LEN) else { return };
    blob[16..24].copy_from_slice(&(length as u64).to_le_bytes());
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let mut digest = crc.digest();
    digest.update(&blob[..24]);
    digest.update(&[0; 8]);
    digest.update(&blob[HEADER_LEN..]);
    blob[24..28].copy_from_slice(&digest.finalize().to_le_bytes());
}

/// The blob of any body, sound or not, under a sound header.
pub fn blob_of(body: &Body<'_>) -> Option<Vec<u8>> {
    let mut blob = Recipe::TINY.blob()[..HEADER_LEN].to_vec();
    blob.extend(postcard::to_allocvec(body).ok()?);
    fix_header(&mut blob);
    Some(blob)
}

/// The body of a blob whose rules nobody has checked.
pub fn body_of(blob: &[u8]) -> Option<Body<'_>> {
    let (body, rest) = postcard::take_from_bytes(blob.get(HEADER_LEN..)?).ok()?;
    rest.is_empty().then_some(body)
}

/// Another blob: a few fields changed, the bytes of weights and occupancy grids made to fit their sizes again.
pub fn edit(blob: &[u8], u: &mut Unstructured<'_>) -> Option<Vec<u8>> {
    let mut body = body_of(blob)?;
    let (mut weights, mut bits, mut coarse) = (body.weights.to_vec(), Vec::new(), Vec::new());
    if let Some(occupancy) = &body.occupancy {
        bits = occupancy.bits.to_vec();
    }
    if let Some(proposal) = &body.proposal {
        coarse = proposal.weights.to_vec();
    }
    let mut scales = body.tables.and_then(|tables| tables.scales()).map(<[u8]>::to_vec);
    // What bytes are left over changes nothing more.
    let _ = change(&mut body, &mut weights, &mut scales, u);
    // Shapes beyond these are the format's to refuse, not this process's to allocate.
    let sound = |a: &Architecture| a.trunk.iter().all(|layer| layer.width <= 64) && a.trunk.len() <= 6;
    if sound(&body.architecture) {
        refill(&mut weights, 2 * body.architecture.parameters());
    }
    if let Some(occupancy) = &mut body.occupancy {
        if StoredOccupancy::bytes(occupancy.resolution) <= 1 << 12 {
            refill(&mut bits, StoredOccupancy::bytes(occupancy.resolution));
            let cells = occupancy.resolution.iter().map(|&side| u32::from(side)).product::<u32>();
            if let Some(last) = bits.last_mut().filter(|_| cells % 8 != 0) {
                *last &= (1 << (cells % 8)) - 1;
            }
        }
        occupancy.bits = &bits;
    }
    if let Some(proposal) = &mut body.proposal {
        let shape = proposal.architecture();
        if sound(&shape) {
            refill(&mut coarse, 2 * shape.density_parameters());
        }
        proposal.weights = &coarse;
    }
    // As with weights: tables of the length that the grid asks for, if this process can have so much. Coded ones are decoded,
    // changed and coded again, or stay damaged.
    let grid = body.architecture.position.grid();
    let is_coded = matches!(body.tables, Some(StoredTables::Coded { .. }));
    let mut entries = body.tables.map_or(Vec::new(), |tables| tables.bytes().to_vec());
    if let Some(values) = grid.map(|grid| grid.values()).filter(|&values| values <= 1 << 16) {
        refill(&mut entries, if scales.is_some() { values } else { 2 * values });
    }
    let recode =
        grid.filter(|grid| is_coded && grid.values() == entries.len() && u.ratio(7, 8).unwrap_or(true));
    if let Some(grid) = recode {
        entries = scenes::coded(grid, &entries);
    }
    if let (Some(scales), Some(grid)) = (&mut scales, grid) {
        refill(scales, 4 * grid.resolutions.len());
    }
    body.tables = grid.map(|_| match &scales {
        Some(scales) if is_coded => StoredTables::Coded { scales, bytes: &entries },
        Some(scales) => StoredTables::Int8 { scales, bytes: &entries },
        None => StoredTables::F16(&entries),
    });
    body.weights = &weights;
    blob_of(&body)
}

/// Repeats what is there to a new length.
fn refill(bytes: &mut Vec<u8>, length: usize) {
    let old = bytes.len();
    if old == 0 {
        bytes.resize(length, 0x2a);
    } else {
        bytes.truncate(length);
        (old..length).for_each(|i| bytes.push(bytes[i % old]));
    }
}

fn any_encoding(u: &mut Unstructured<'_>, inputs: u8) -> Result<SinusoidalEncoding> {
    let levels = *u.choose(&[0, 1, 2, 4, 10, 16, 17])?;
    let scale = if u.arbitrary()? { AngleScale::Pi } else { AngleScale::One };
    Ok(SinusoidalEncoding { inputs, levels, scale, identity: u.arbitrary()? })
}

/// Sines and cosines, or a learned grid, within the caps or beyond.
fn any_position(u: &mut Unstructured<'_>, inputs: u8) -> Result<PositionEncoding> {
    if u.arbitrary()? {
        return Ok(any_encoding(u, inputs)?.into());
    }
    let (features, log2_entries) = (*u.choose(&[0, 1, 2, 3, 4])?, *u.choose(&[0, 1, 4, 8, 24, 25])?);
    let mut levels = Vec::new();
    for _ in 0..u.int_in_range(0..=32u8)?.min(u.int_in_range(0..=32)?) {
        let mut side = || u.choose(&[0u16, 1, 2, 3, 9, 40, 16_384, 16_385]).copied();
        levels.push([side()?, side()?, if inputs == 3 { side()? } else { 0 }]);
    }
    let resolutions = levels.into_iter().collect();
    Ok(PositionEncoding::Grid(GridEncoding { inputs, features, log2_entries, resolutions }))
}

/// `scales`: of int8 tables; f16 without.
fn change(
    body: &mut Body<'_>,
    weights: &mut [u8],
    scales: &mut Option<Vec<u8>>,
    u: &mut Unstructured<'_>,
) -> Result<()> {
    const WIDTHS: [u16; 9] = [0, 1, 2, 3, 16, 17, 33, 64, 513];
    const SAMPLES: [u16; 8] = [0, 1, 2, 3, 48, 1000, 4096, 4097];
    let inputs = if matches!(body.content, Content::Scene(_)) { 3 } else { 2 };
    for _ in 0..u.int_in_range(1..=3u8)? {
        let shape = &mut body.architecture;
        match u.int_in_range(0..=17u8)? {
            0 => shape.position = any_position(u, inputs)?,
            1 => {
                shape.direction = match u.int_in_range(0..=2u8)? {
                    0 => None,
                    1 => Some(any_encoding(u, 3)?.into()),
                    _ => Some(DirectionEncoding::SphericalHarmonics { degree: u.int_in_range(0..=5)? }),
                }
            }
            2 => {
                let _ = shape.trunk.push(TrunkLayer { width: *u.choose(&WIDTHS)?, skip: u.arbitrary()? });
            }
            3 => {
                let at = u.choose_index(shape.trunk.len().max(1))?;
                if let Some(layer) = shape.trunk.get_mut(at) {
                    *layer = TrunkLayer { width: *u.choose(&WIDTHS)?, skip: u.arbitrary()? };
                }
            }
            4 => drop(shape.trunk.pop()),
            5 => drop(shape.colour.push(*u.choose(&WIDTHS)?)),
            6 => drop(shape.colour.pop()),
            7 => {
                shape.density = *u.choose(&[
                    None,
                    Some(DensityActivation::Relu),
                    Some(DensityActivation::ShiftedSoftplus),
                    Some(DensityActivation::Exponential),
                ])?;
            }
            8 | 9 => match &mut body.content {
                Content::Picture(picture) => {
                    *picture = PictureFacts { width: u.arbitrary()?, height: u.arbitrary()? }
                }
                Content::Scene(scene) => match u.int_in_range(0..=7u8)? {
                    0 => scene.min = any_vec3(u)?,
                    1 => scene.max = any_vec3(u)?,
                    2 => scene.near = any_f32(u)?,
                    3 => scene.far = any_f32(u)?,
                    4 => {
                        scene.sampling = match u.int_in_range(0..=2u8)? {
                            0 => SceneSampling::March(any_f32(u)?),
                            1 => {
                                SceneSampling::Contracted { step: any_f32(u)?, power: u.int_in_range(0..=5)? }
                            }
                            _ => SceneSampling::Bins(*u.choose(&SAMPLES)?),
                        };
                    }
                    5 => scene.background = any_vec3(u)?,
                    6 => {
                        let (eye, target, up, arc) = (any_vec3(u)?, any_vec3(u)?, any_vec3(u)?, any_f32(u)?);
                        scene.viewpoint =
                            u.arbitrary::<bool>()?.then_some(Viewpoint { eye, target, up, arc });
                    }
                    _ => scene.occupancy_required = u.arbitrary()?,
                },
            },
            10 => {
                let side = |u: &mut Unstructured<'_>| u.choose(&[0u16, 1, 2, 3, 8, 19, 512, 513]).copied();
                let resolution = [side(u)?, side(u)?, side(u)?];
                body.occupancy =
                    if u.ratio(3, 4)? { Some(StoredOccupancy { resolution, bits: &[] }) } else { None };
            }
            11 => {
                body.proposal = if u.ratio(3, 4)? {
                    let layer =
                        |skip, u: &mut Unstructured<'_>| Ok(TrunkLayer { width: *u.choose(&WIDTHS)?, skip });
                    let trunk = [layer(false, u)?, layer(u.arbitrary()?, u)?].into_iter().collect();
                    let (position, density) = (any_encoding(u, 3)?, DensityActivation::Relu);
                    Some(Proposal { position, trunk, density, samples: *u.choose(&SAMPLES)?, weights: &[] })
                } else {
                    None
                };
            }
            12 => drop(body.front.push(FrontPoint {
                samples: *u.choose(&SAMPLES)?,
                transmittance_cut: any_f32(u)?,
                colour_cut: any_f32(u)?,
                occupancy: u.arbitrary()?,
                math: u.int_in_range(0..=5)?,
                proposal: u.arbitrary()?,
                loss_db: any_f32(u)?,
                cost: any_f32(u)?,
            })),
            13 => body.provenance.psnr_db = Some(any_f32(u)?),
            17 => shape.shading = if u.arbitrary()? { Shading::PerRay } else { Shading::PerSample },
            // Repeated for as many levels as there are.
            14 => *scales = if u.ratio(3, 4)? { Some(any_f32(u)?.to_le_bytes().to_vec()) } else { None },
            _ => {
                for _ in 0..u.int_in_range(1..=8u8)? {
                    let at = u.choose_index((weights.len() / 2).max(1))?;
                    let bits = if u.arbitrary()? { *u.choose(&EDGES)? } else { u.arbitrary()? };
                    if let Some(weight) = weights.get_mut(2 * at..2 * at + 2) {
                        weight.copy_from_slice(&bits.to_le_bytes());
                    }
                }
            }
        }
    }
    Ok(())
}
