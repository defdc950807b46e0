//! One frame: rays to live samples to network to pixels, in the caller's memory.
//!
//! A tile's rays walk front to back (`march`). A block takes the next live sample of as many rays as it
//! has room for and goes through trunk and density head; rays that still see wait for another block. The
//! samples whose colour matters are gathered over several blocks until they fill one for the colour
//! branch. Neither pixels nor work depend on the size of tile or batch. A 2D field has no rays: its
//! pixels go through the network block by block (`picture`).

mod counters;
mod error;
mod explain;
mod frame;
mod march;
mod pace;
mod picture;
#[cfg(feature = "proposal")]
mod proposal;
#[cfg(not(feature = "proposal"))]
#[path = "render/proposal_absent.rs"]
mod proposal;
mod rect;
mod surface;
mod window;

#[cfg(test)]
mod tests;

pub use counters::Counters;
pub use error::RenderError;
pub use explain::{Explanation, Shares, Stage, Switch};
pub use pace::Pace;
pub use picture::MAX_RENDER_SIDE;
pub use rect::{Rect, Target};

use crate::blob::Blob;
use crate::camera::Camera;
use crate::encoding::GridTables;
use crate::kernels::{Arena, Line, Tier, VECTORS, lines_for};
use crate::math::with_math;
use crate::network::{Network, Weights};
use crate::plan::Plan;
use crate::ray::{SceneBox, is_unit};
use frame::{Frame, Sizes};
use glam::Vec3;
use proposal::Proposer;

/// Width of the squares a rectangle is rendered in, pixels: neighbouring rays end together.
const TILE_SIDE: u32 = 16;

/// A scene made ready for one kernel tier.
#[derive(Clone, Debug)]
pub struct Renderer<'a> {
    blob: Blob<'a>,
    network: Network<'a>,
    proposer: Proposer<'a>,
    /// A box around what the occupancy grid has.
    occupied: Option<SceneBox>,
}

impl<'a> Renderer<'a> {
    /// Lines of memory [`Renderer::new`] needs: 0 on the scalar tier, which reads the blob in place.
    pub fn prepared_lines(blob: &Blob<'_>, tier: Tier) -> usize {
        if tier == Tier::Scalar || !VECTORS {
            0
        } else {
            lines_for::<f32>(blob.architecture().parameters()) + Proposer::prepared_lines(blob)
        }
    }

    /// Prepares a scene for `tier`, unpacking its weights once into `memory`.
    ///
    /// # Errors
    /// [`RenderError::Memory`] if `memory` is smaller than [`Renderer::prepared_lines`] says.
    pub fn new(blob: Blob<'a>, tier: Tier, memory: &'a mut [Line]) -> Result<Self, RenderError> {
        let expected = Self::prepared_lines(&blob, tier);
        let found = memory.len();
        let too_small = RenderError::Memory { expected, found };
        let (weights, proposer) = if tier == Tier::Scalar || !VECTORS {
            (Weights::InPlace(blob.weights()), Proposer::in_place(&blob, tier))
        } else {
            let parameters = blob.architecture().parameters();
            let mut arena = Arena::new(memory);
            let unpacked = arena.slice(parameters, 0.0f32).ok_or(too_small)?;
            let weights = Weights::prepare(blob.architecture(), tier, blob.weights(), unpacked);
            (weights, Proposer::prepare(&blob, tier, &mut arena).ok_or(too_small)?)
        };
        let tables = Self::tables_of(&blob);
        let network = Network::with_grid(blob.architecture(), weights, tables, tier).ok_or(too_small)?;
        Ok(Self {
            occupied: blob.occupancy().and_then(|occupancy| occupancy.occupied_box()),
            blob,
            network,
            proposer,
        })
    }

    /// The tables of the blob's grid, where they lie.
    fn tables_of(blob: &Blob<'a>) -> GridTables<'a> {
        let (bytes, scales) =
            blob.tables().map_or((&[][..], None), |tables| (tables.bytes(), tables.scales()));
        GridTables::in_place(bytes, scales, blob.scene_box().as_ref())
    }

    /// The scene of `blob` with other parameters, f32 in the same order: what rounding costs. Its proposal and its
    /// tables keep their own.
    ///
    /// `None` if they are too few, and where there are no [`VECTORS`].
    pub fn with_parameters(blob: Blob<'a>, tier: Tier, parameters: &'a [f32]) -> Option<Self> {
        let tables = Self::tables_of(&blob);
        Self::with_parameters_and_tables(blob, tier, parameters, tables)
    }

    /// As [`Renderer::with_parameters`], with other tables for the grid, too.
    pub fn with_parameters_and_tables(
        blob: Blob<'a>,
        tier: Tier,
        parameters: &'a [f32],
        tables: GridTables<'a>,
    ) -> Option<Self> {
        let weights = Weights::Prepared(parameters);
        let network = Network::with_grid(blob.architecture(), weights, tables, tier)?;
        let proposer = Proposer::in_place(&blob, tier);
        Some(Self {
            occupied: blob.occupancy().and_then(|occupancy| occupancy.occupied_box()),
            blob,
            network,
            proposer,
        })
    }

    /// The scene.
    pub fn blob(&self) -> &Blob<'a> {
        &self.blob
    }

    /// The network.
    pub fn network(&self) -> &Network<'a> {
        &self.network
    }

    /// Lines of workspace one [`Renderer::render`] or [`Renderer::query`] call needs under `plan`.
    pub fn workspace_lines(&self, plan: &Plan<'_>) -> usize {
        Sizes::of(&self.network, &self.proposer, plan).lines()
    }

    /// Renders the pixels of `rect`.
    ///
    /// Within one tier and maths backend the pixels do not depend on `rect`, on the plan's batch or
    /// on who else renders at the same time, bit for bit.
    ///
    /// # Errors
    /// [`RenderError`] on a rectangle outside the image and on too little workspace; nothing has
    /// been written then.
    pub fn render(
        &self,
        plan: &Plan<'_>,
        camera: &Camera,
        rect: Rect,
        workspace: &mut [Line],
        target: &mut impl Target,
    ) -> Result<Counters, RenderError> {
        let i = camera.intrinsics();
        if !rect.fits(i.width, i.height) {
            return Err(RenderError::Rect { rect, width: i.width, height: i.height });
        }
        let mut frame = Frame::carve(&self.network, &self.proposer, plan, self.occupied, workspace)?;
        // Lossless: a plan has at most `Batch::MOST_RAYS`.
        let capacity = plan.batch.rays as u32;
        let width = TILE_SIDE.min(capacity);
        for tile in rect.tiles(width, capacity / width.max(1)) {
            with_math!(plan.math, M => frame.tile::<M>(camera, tile, target));
        }
        Ok(frame.counters)
    }

    /// Asks for density and colour at points seen along directions.
    ///
    /// `positions`, `dirs` (unit): `[n]`, world space; `sigma`: `[n]`, 1/world unit; `rgb`: `[n]`,
    /// display-encoded. Points outside the scene box or in a cell the plan's occupancy calls empty, and
    /// points where its density is NaN, have density 0 and black colour; where its colour is NaN, it is
    /// black ([`Counters::invalid_samples`]).
    ///
    /// # Errors
    /// [`RenderError`] on lengths that differ, on a direction that is not of unit length where colour is asked for,
    /// and on too little workspace.
    pub fn query(
        &self,
        plan: &Plan<'_>,
        positions: &[[f32; 3]],
        dirs: &[[f32; 3]],
        workspace: &mut [Line],
        sigma: &mut [f32],
        rgb: &mut [[f32; 3]],
    ) -> Result<Counters, RenderError> {
        let n = positions.len();
        if dirs.len() != n || sigma.len() != n || rgb.len() != n {
            return Err(RenderError::Lengths {
                positions: n,
                dirs: dirs.len(),
                sigma: sigma.len(),
                rgb: rgb.len(),
            });
        }
        // A position outside the box is never encoded, nor is what is no direction.
        if plan.outputs.rgb
            && let Some((index, &found)) =
                dirs.iter().enumerate().find(|(_, dir)| !is_unit(Vec3::from(**dir)))
        {
            return Err(RenderError::Direction { index, found });
        }
        let mut frame = Frame::carve(&self.network, &self.proposer, plan, self.occupied, workspace)?;
        let capacity = plan.batch.rays.min(plan.batch.samples).max(1);
        let points = positions.chunks(capacity).zip(dirs.chunks(capacity));
        let answers = sigma.chunks_mut(capacity).zip(rgb.chunks_mut(capacity));
        for ((positions, dirs), (sigma, rgb)) in points.zip(answers) {
            frame.points(positions, dirs, sigma, rgb);
        }
        Ok(frame.counters)
    }
}
