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

use crate::blob::{Blob, StoredTables};
use crate::camera::{Camera, SceneBox};
use crate::encoding::GridTables;
use crate::matrix::{Kernel, Storage};
use crate::memory::{Arena, Layout, Line, Measure};
use crate::network::{Network, Weights, unpack};
use crate::plan::Plan;
use crate::simd::VECTORS;
pub(crate) use coarse::CoarseOccupancy;
use frame::Frame;
use proposal::Proposer;

/// Whether a kernel reads weights where they lie.
fn in_place(kernel: Kernel) -> bool {
    kernel.storage == Storage::F16 || !VECTORS
}

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
        Self::lay_out(&mut measure, blob, kernel);
        measure.lines
    }

    /// The parameters of the scene's network and of its proposal, and the grid's tables, unpacked; and the tables, decoded.
    #[inline]
    fn lay_out(
        layout: &mut impl Layout<'a>,
        blob: &Blob<'_>,
        kernel: Kernel,
    ) -> ([&'a mut [f32]; 3], &'a mut [u8]) {
        let unpacked = match in_place(kernel) {
            true => [&mut [][..], &mut [], &mut []],
            false => Self::unpacked_lengths(blob, kernel).map(|count| layout.slice(count, 0.0)),
        };
        (unpacked, layout.slice(blob.decoded_len(), 0))
    }

    /// How many values the parameters of the scene's network and of its proposal are unpacked to, and the grid's tables.
    pub(crate) fn unpacked_lengths(blob: &Blob<'_>, kernel: Kernel) -> [usize; 3] {
        if in_place(kernel) {
            return [0; 3];
        }
        let tables = Self::widened_tables(blob, kernel).map_or(0, |bytes| bytes.len() / 2);
        [blob.architecture().parameters(), Proposer::parameters(blob), tables]
    }

    /// The f16 tables of an instruction set that does not read them where they lie.
    fn widened_tables<'b>(blob: &Blob<'b>, kernel: Kernel) -> Option<&'b [u8]> {
        let tables =
            blob.tables().filter(|tables| !kernel.isa.reads_f16_tables() && tables.scales().is_none());
        tables.map(|tables| tables.bytes())
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
        let (mut unpacked, decoded) = Self::lay_out(&mut Arena::new(memory), &blob, kernel);
        Self::unpack(&blob, kernel, &mut unpacked);
        blob.decode_tables(decoded).map_err(RenderError::Tables)?;
        let (weights, proposer, tables) = Self::unpacked(&blob, kernel, (unpacked.map(|it| &*it), decoded));
        let network = Network::with_grid(blob.architecture(), weights, tables, kernel.isa)
            .ok_or(RenderError::Network)?;
        let (occupied, coarse) = Self::occupied(&blob);
        Ok(Self { blob, network, proposer, occupied, coarse })
    }

    /// A box around what the occupancy grid has, and its blocks.
    pub(crate) fn occupied(blob: &Blob<'_>) -> (Option<SceneBox>, CoarseOccupancy) {
        let occupancy = blob.occupancy();
        let around = occupancy.as_ref().and_then(|occupancy| occupancy.occupied_box());
        (around, CoarseOccupancy::new(occupancy.as_ref()))
    }

    /// Unpacks the parameters of the scene's network and of its proposal.
    pub(crate) fn unpack<T: AsMut<[f32]>>(blob: &Blob<'_>, kernel: Kernel, to: &mut [T; 3]) {
        if !in_place(kernel) {
            let [own, proposal, tables] = to;
            Weights::unpack(blob.architecture(), kernel.storage, blob.weights(), own.as_mut());
            Proposer::unpack(blob, kernel.storage, proposal.as_mut());
            if let Some(bytes) = Self::widened_tables(blob, kernel) {
                unpack(bytes, tables.as_mut());
            }
        }
    }

    /// What [`Renderer::unpack`] made, or the weights where they lie; and the tables, by what they were decoded to.
    fn unpacked(
        blob: &Blob<'a>,
        kernel: Kernel,
        ([own, proposal, tables], decoded): ([&'a [f32]; 3], &'a [u8]),
    ) -> (Weights<'a>, Proposer<'a>, GridTables<'a>) {
        let in_file = Self::tables_of(blob, decoded);
        if in_place(kernel) {
            return (Weights::InPlace(blob.weights()), Proposer::in_place(blob, kernel.isa), in_file);
        }
        let tables = match Self::widened_tables(blob, kernel) {
            Some(_) => GridTables::widened(tables, blob.scene_box().as_ref()),
            None => in_file,
        };
        (
            Weights::unpacked(blob.architecture(), kernel.storage, own),
            Proposer::of_unpacked(blob, kernel, proposal),
            tables,
        )
    }

    /// A scene over weights that were unpacked, tables that were decoded, and the box around its occupied cells.
    #[cfg(all(feature = "std", not(target_os = "none")))]
    pub(crate) fn of_unpacked(
        blob: Blob<'a>,
        kernel: Kernel,
        unpacked: ([&'a [f32]; 3], &'a [u8]),
        (occupied, coarse): (Option<SceneBox>, CoarseOccupancy),
    ) -> Option<Self> {
        let (weights, proposer, tables) = Self::unpacked(&blob, kernel, unpacked);
        let network = Network::with_grid(blob.architecture(), weights, tables, kernel.isa)?;
        Some(Self { blob, network, proposer, occupied, coarse })
    }

    /// The tables of the blob's grid, where they lie: coded ones where they were decoded to.
    fn tables_of(blob: &Blob<'a>, decoded: &'a [u8]) -> GridTables<'a> {
        let (bytes, scales) = match blob.tables() {
            None => (&[][..], None),
            Some(StoredTables::Coded { scales, .. }) => (decoded, Some(scales)),
            Some(tables) => (tables.bytes(), tables.scales()),
        };
        GridTables::in_place(bytes, scales, blob.scene_box().as_ref())
    }

    /// The scene of `blob` with other parameters, f32 in the same order: what rounding costs. Its proposal and its
    /// tables keep their own.
    ///
    /// `None` if they are too few, of coded tables, and where there are no [`VECTORS`].
    #[cfg(feature = "train")]
    pub fn with_parameters(blob: Blob<'a>, kernel: Kernel, parameters: &'a [f32]) -> Option<Self> {
        let tables = Self::tables_of(&blob, &[]);
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
        let network = Network::with_grid(blob.architecture(), weights, tables, kernel.isa)?;
        let proposer = Proposer::in_place(&blob, kernel.isa);
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
