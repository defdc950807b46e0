//! One frame: rays to occupied samples to network to pixels, in the caller's memory.
//!
//! A tile's rays are marched front to back (`march`). A block takes the next occupied sample of as many active rays as
//! it has room for and goes through trunk and density head; rays above the transmittance threshold join a later block.
//! Samples whose weight calls for a colour are compacted over several blocks until they fill one for the colour branch; of a
//! field shaded once a ray their `h` is added to their ray, and the branch is run once a ray behind the march (`deferred`).
//! Neither pixels nor work depend on the size of tile or batch. A 2D field has no rays: its pixels go through the
//! network block by block (`picture`).

#[cfg(feature = "anti-aliasing")]
mod anti_aliasing;
#[cfg(not(feature = "anti-aliasing"))]
#[path = "anti_aliasing_off.rs"]
mod anti_aliasing;
mod coarse;
mod counters;
mod deferred;
#[cfg(feature = "depth-of-field")]
mod depth_of_field;
#[cfg(not(feature = "depth-of-field"))]
#[path = "depth_of_field_off.rs"]
mod depth_of_field;
mod directions;
mod error;
mod explain;
mod frame;
#[cfg(feature = "instances")]
mod instances;
mod march;
mod pace;
mod picture;
mod points;
mod prepared;
#[cfg(feature = "proposal")]
mod proposal;
#[cfg(not(feature = "proposal"))]
#[path = "proposal_off.rs"]
mod proposal;
mod rect;
mod segment;
mod side_by_side;
mod source;
mod surface;
#[cfg(feature = "tone-map")]
mod tone;
#[cfg(not(feature = "tone-map"))]
#[path = "tone_off.rs"]
mod tone;
mod window;
mod worker;

#[cfg(test)]
pub(crate) mod tests;

pub use counters::Counters;
pub use error::RenderError;
pub use explain::{Explanation, Shares, Stage, Switch};
#[cfg(feature = "instances")]
pub use instances::{Instance, InstanceProblem};
pub use pace::Pace;
pub use picture::MAX_RENDER_SIDE;
pub use rect::{Rect, Target};
pub use segment::{Limit, RaySegment};
pub use worker::{TILE_SIDE, Worker};

use crate::blob::Blob;
use crate::camera::Camera;
#[cfg(feature = "train")]
use crate::encoding::GridTables;
use crate::matrix::Kernel;
#[cfg(feature = "train")]
use crate::matrix::Storage;
use crate::memory::{Arena, Line, Measure};
use crate::network::Network;
#[cfg(feature = "train")]
use crate::network::Weights;
use crate::plan::Plan;
use crate::space::SceneBox;
pub(crate) use coarse::CoarseOccupancy;
use frame::Frame;
pub(crate) use prepared::Prepared;
use proposal::Proposer;

/// A scene made ready for one kernel.
#[derive(Clone, Debug)]
pub struct Renderer<'a> {
    blob: Blob<'a>,
    network: Network<'a>,
    proposer: Proposer<'a>,
    /// A box around what the occupancy grid has.
    occupied: Option<SceneBox>,
    coarse: CoarseOccupancy,
}

impl<'a> Renderer<'a> {
    /// Lines of memory [`Renderer::new`] needs: with portable instructions, which read the blob in place, those of coded tables
    /// alone.
    pub fn prepared_lines(blob: &Blob<'_>, kernel: Kernel) -> usize {
        let mut measure = Measure::default();
        Prepared::lay_out(&mut measure, blob, kernel);
        measure.lines
    }

    /// Prepares a scene for `kernel`, unpacking its weights and decoding its tables once into `memory`.
    ///
    /// # Errors
    /// [`RenderError::Memory`] if `memory` is smaller than [`Renderer::prepared_lines`] says, [`RenderError::Tables`] of a blob
    /// that was opened undecoded, and [`RenderError::Network`] if the blob's parameters or tables are not those of its architecture.
    pub fn new(blob: Blob<'a>, kernel: Kernel, memory: &'a mut [Line]) -> Result<Self, RenderError> {
        let (expected, found) = (Self::prepared_lines(&blob, kernel), memory.len());
        if found < expected {
            return Err(RenderError::Memory { expected, found });
        }
        let mut prepared = Prepared::lay_out(&mut Arena::new(memory), &blob, kernel);
        prepared.unpack(&blob, kernel).map_err(RenderError::Tables)?;
        let Prepared { unpacked, decoded } = prepared;
        let prepared = Prepared { unpacked: unpacked.map(|values| &*values), decoded: &*decoded };
        let network = prepared.view(&blob, kernel).ok_or(RenderError::Network)?;
        let proposer = prepared.view_proposal(&blob, kernel);
        let (occupied, coarse) = Self::occupied(&blob);
        Ok(Self { blob, network, proposer, occupied, coarse })
    }

    /// A scene over values that were prepared for `kernel`, with [`Renderer::occupied`] of its blob; `None` where they are too
    /// few.
    #[cfg(all(feature = "std", not(target_os = "none")))]
    pub(crate) fn of_prepared(
        blob: Blob<'a>,
        kernel: Kernel,
        prepared: &Prepared<&'a [f32], &'a [u8]>,
        (occupied, coarse): (Option<SceneBox>, CoarseOccupancy),
    ) -> Option<Self> {
        let (network, proposer) = (prepared.view(&blob, kernel)?, prepared.view_proposal(&blob, kernel));
        Some(Self { blob, network, proposer, occupied, coarse })
    }

    /// A box around what the occupancy grid has, and its blocks.
    pub(crate) fn occupied(blob: &Blob<'_>) -> (Option<SceneBox>, CoarseOccupancy) {
        let occupancy = blob.occupancy();
        let around = occupancy.as_ref().and_then(|occupancy| occupancy.occupied_box());
        (around, CoarseOccupancy::new(occupancy.as_ref()))
    }

    /// The scene of `blob` with other parameters, f32 in the same order: what rounding costs. Its proposal and its
    /// tables keep their own.
    ///
    /// `None` if they are too few, of coded tables, and where there are no [`VECTORS`](crate::simd::VECTORS).
    #[cfg(feature = "train")]
    pub fn with_parameters(blob: Blob<'a>, kernel: Kernel, parameters: &'a [f32]) -> Option<Self> {
        let tables = prepared::tables_of(&blob, Kernel::new(kernel.isa, Storage::F16), &[], &[]);
        Self::with_parameters_and_tables(blob, kernel, parameters, tables)
    }

    /// As [`Renderer::with_parameters`], with other tables for the grid, too.
    #[cfg(feature = "train")]
    pub fn with_parameters_and_tables(
        blob: Blob<'a>,
        kernel: Kernel,
        parameters: &'a [f32],
        tables: GridTables<'a>,
    ) -> Option<Self> {
        let weights = Weights::Prepared(parameters);
        let network = Network::of_checked(blob.architecture(), weights, tables, kernel.isa)?;
        let proposer = Proposer::view(&blob, Kernel::new(kernel.isa, Storage::F16), &[]);
        let (occupied, coarse) = Self::occupied(&blob);
        Some(Self { blob, network, proposer, occupied, coarse })
    }

    /// The scene.
    pub fn blob(&self) -> &Blob<'a> {
        &self.blob
    }

    /// What it renders with.
    pub fn kernel(&self) -> Kernel {
        self.network.kernel()
    }

    /// The network.
    #[cfg(any(feature = "train", feature = "instances"))]
    #[cfg_attr(
        not(feature = "train"),
        allow(unreachable_pub, reason = "networks are public for trainers alone")
    )]
    pub fn network(&self) -> &Network<'a> {
        &self.network
    }

    /// Lines of workspace that [`Renderer::worker`] needs for `plan`, as do [`Renderer::render`] and
    /// [`Renderer::query`].
    pub fn workspace_lines(&self, plan: &Plan<'_>) -> usize {
        let mut measure = Measure::default();
        Frame::lay_out(&mut measure, &self.network, &self.proposer, plan, (None, None));
        measure.lines
    }

    /// Makes a worker for frames of `plan`: one for each thread, for as many calls as there are.
    ///
    /// # Errors
    /// [`RenderError::OtherScene`] if the plan was made for another blob, and [`RenderError::Memory`] if `workspace` is
    /// smaller than [`Renderer::workspace_lines`] says.
    pub fn worker<'f>(
        &'f self,
        plan: &'f Plan<'f>,
        workspace: &'f mut [Line],
    ) -> Result<Worker<'f>, RenderError> {
        if plan.scene != self.blob.identity() {
            return Err(RenderError::OtherScene);
        }
        let (expected, found) = (self.workspace_lines(plan), workspace.len());
        if found < expected {
            return Err(RenderError::Memory { expected, found });
        }
        let mut arena = Arena::new(workspace);
        let around = (self.occupied, self.coarse.packets(plan, self.occupied));
        let frame = Frame::lay_out(&mut arena, &self.network, &self.proposer, plan, around);
        Ok(Worker::of_frame(frame))
    }

    /// [`Worker::render`] by a worker for this call alone.
    ///
    /// # Errors
    /// As [`Renderer::worker`] and [`Worker::render`].
    pub fn render(
        &self,
        plan: &Plan<'_>,
        camera: &Camera,
        rect: Rect,
        workspace: &mut [Line],
        target: &mut impl Target,
    ) -> Result<Counters, RenderError> {
        self.worker(plan, workspace)?.render(camera, rect, target)
    }

    /// [`Worker::query`] by a worker for this call alone.
    ///
    /// # Errors
    /// As [`Renderer::worker`] and [`Worker::query`].
    pub fn query(
        &self,
        plan: &Plan<'_>,
        positions: &[[f32; 3]],
        dirs: &[[f32; 3]],
        workspace: &mut [Line],
        sigma: &mut [f32],
        rgb: &mut [[f32; 3]],
    ) -> Result<Counters, RenderError> {
        self.worker(plan, workspace)?.query(positions, dirs, sigma, rgb)
    }
}
