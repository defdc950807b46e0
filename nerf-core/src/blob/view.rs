//! Opening a blob: check once, then borrow.

use super::body::{
    Body, Content, Grid, MAX_GRID_SIDE, MAX_PICTURE_SIDE, MAX_SAMPLES, MAX_TEXT, PictureFacts, Provenance,
    SceneFacts,
};
use super::error::{BlobError, Section};
use super::header;
use crate::encoding::AngleScale;
use crate::math::polynomial::SIN_COS_DOMAIN;
use crate::network::{Architecture, Layers};
use crate::ray::{BoundsError, SceneBox};
use crate::sampling::{Bins, SkipGrid};
use glam::Vec3;
use postcard::ser_flavors::Flavor;

/// An opened blob: a view of the caller's bytes in which everything has been checked.
#[derive(Clone, Debug)]
pub struct Blob<'a> {
    body: Body<'a>,
    layers: Layers,
}

impl<'a> Blob<'a> {
    /// Checks `bytes` once; nothing is copied but the description, no byte needs any alignment.
    ///
    /// # Errors
    /// [`BlobError`] says what was expected and found. No input panics or is read out of bounds.
    pub fn open(bytes: &'a [u8]) -> Result<Self, BlobError> {
        let bytes = header::open(bytes)?;
        let (body, rest) = postcard::take_from_bytes::<Body<'a>>(bytes).map_err(|_| BlobError::Body)?;
        if !rest.is_empty() || !is_canonical(&body, bytes) {
            return Err(BlobError::Body);
        }
        let layers = check(&body)?;
        Ok(Self { body, layers })
    }

    /// The network's shape.
    pub fn architecture(&self) -> &Architecture {
        &self.body.architecture
    }

    /// The network's layers, in the order of their parameters.
    pub fn layers(&self) -> &Layers {
        &self.layers
    }

    /// Bounds and conventions of a scene; `None` in a 2D field.
    pub fn scene(&self) -> Option<&SceneFacts> {
        match &self.body.content {
            Content::Scene(scene) => Some(scene),
            Content::Picture(_) => None,
        }
    }

    /// Size of the picture a 2D field was made of; `None` in a scene.
    pub fn picture(&self) -> Option<PictureFacts> {
        match self.body.content {
            Content::Picture(picture) => Some(picture),
            Content::Scene(_) => None,
        }
    }

    /// The scene box; `None` in a 2D field.
    pub fn scene_box(&self) -> Option<SceneBox> {
        let scene = self.scene()?;
        Some(SceneBox { min: Vec3::from(scene.min), max: Vec3::from(scene.max) })
    }

    /// The skip grid, if there is one.
    pub fn grid(&self) -> Option<SkipGrid<'a>> {
        let grid = self.body.grid.as_ref()?;
        Some(SkipGrid::new(self.scene_box()?, grid.resolution, grid.bits))
    }

    /// Where the blob comes from.
    pub fn provenance(&self) -> &Provenance<'a> {
        &self.body.provenance
    }

    /// The parameters, little-endian f16.
    pub fn weights(&self) -> &'a [u8] {
        self.body.weights
    }
}

/// Every rule of the format but the ones of header and encoding.
pub(super) fn check(body: &Body<'_>) -> Result<Layers, BlobError> {
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
    match (&body.grid, &body.content) {
        (Some(_), Content::Picture(_)) => return Err(BlobError::Field(Section::GridBits)),
        (None, Content::Scene(scene)) if scene.grid_required => {
            return Err(BlobError::Field(Section::GridRequired));
        }
        (Some(grid), Content::Scene(_)) => check_grid(grid)?,
        _ => {}
    }
    let p = &body.provenance;
    let finite = [p.psnr_db, p.quantisation_loss_db].into_iter().flatten().all(f32::is_finite);
    if [p.data, p.made_by, p.psnr_convention].iter().any(|text| text.len() > MAX_TEXT) || !finite {
        return Err(BlobError::Field(Section::Provenance));
    }
    check_weights(body)
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
    if scene.samples == 0 || scene.samples > MAX_SAMPLES {
        return Err(BlobError::Field(Section::Samples));
    }
    if !scene.background.iter().all(|c| (0.0..=1.0).contains(c)) {
        return Err(BlobError::Field(Section::Background));
    }
    // Bins too narrow for f32: what opens can be planned.
    Bins::new(near, far, u32::from(scene.samples)).map_err(BlobError::Bounds)?;
    // The highest level multiplies by 2^(levels − 1).
    let reach = bounds.min.abs().max(bounds.max.abs()).max_element();
    let found = reach * (1u32 << architecture.position.levels.saturating_sub(1)) as f32;
    let limit = match architecture.position.scale {
        AngleScale::One => SIN_COS_DOMAIN,
        // Reduced exactly, whatever its size, as long as it is a number.
        AngleScale::Pi => f32::MAX,
    };
    if found > limit { Err(BlobError::EncodingDomain { found, limit }) } else { Ok(()) }
}

fn check_grid(grid: &Grid<'_>) -> Result<(), BlobError> {
    if grid.resolution.iter().any(|&side| side == 0 || side > MAX_GRID_SIDE) {
        return Err(BlobError::Field(Section::GridResolution));
    }
    let (expected, found) = (Grid::bytes(grid.resolution), grid.bits.len());
    if expected != found {
        let (expected, found) = (expected as u64, found as u64);
        return Err(BlobError::Length { section: Section::GridBits, expected, found });
    }
    let cells: usize = grid.resolution.iter().map(|&side| usize::from(side)).product();
    let padding = grid.bits.last().map_or(0, |last| last.checked_shr(cells as u32 % 8).unwrap_or(0));
    if !cells.is_multiple_of(8) && padding != 0 {
        return Err(BlobError::Field(Section::GridBits));
    }
    Ok(())
}

fn check_weights(body: &Body<'_>) -> Result<Layers, BlobError> {
    let layers = body.architecture.layers();
    let (expected, found) = (body.architecture.parameters() * 2, body.weights.len());
    if expected != found {
        let (expected, found) = (expected as u64, found as u64);
        return Err(BlobError::Length { section: Section::Weights, expected, found });
    }
    // An f16 is finite unless its five exponent bits are all set.
    let finite = |pair: &[u8]| pair[1] & 0x7c != 0x7c;
    if let Some(at) = body.weights.chunks_exact(2).position(|pair| !finite(pair)) {
        let owner = layers.iter().rev().find(|layer| layer.weights <= at);
        return Err(match owner {
            Some(layer) => BlobError::Weight { role: layer.role, index: (at - layer.weights) as u32 },
            None => BlobError::Field(Section::Weights),
        });
    }
    Ok(layers)
}

/// Whether `bytes` is what writing `body` gives: one meaning, one form.
fn is_canonical(body: &Body<'_>, bytes: &[u8]) -> bool {
    postcard::serialize_with_flavor(body, Compare { rest: bytes }).is_ok_and(|rest: &[u8]| rest.is_empty())
}

/// Compares what is serialised with bytes that are already there.
struct Compare<'a> {
    rest: &'a [u8],
}

impl<'a> Flavor for Compare<'a> {
    type Output = &'a [u8];

    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.try_extend(&[byte])
    }

    fn try_extend(&mut self, bytes: &[u8]) -> postcard::Result<()> {
        self.rest = self.rest.strip_prefix(bytes).ok_or(postcard::Error::DeserializeBadEncoding)?;
        Ok(())
    }

    fn finalize(self) -> postcard::Result<Self::Output> {
        Ok(self.rest)
    }
}
