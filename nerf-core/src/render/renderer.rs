//! A scene made ready for one kernel.

use super::field::Field;
use super::frame::Frame;
use super::march::CoarseOccupancy;
use super::pixel::Pixels;
use super::stages::Proposer;
use super::{Counters, Explanation, Rect, RenderError, Shares, Target, Worker, picture};
use crate::blob::{Blob, StoredTables};
use crate::camera::{Camera, SceneBox};
use crate::encoding::GridTables;
use crate::math::MathBackend;
use crate::matrix::{Kernel, Storage};
use crate::memory::{Arena, Layout, Line, Measure};
use crate::network::{Network, Weights, unpack};
use crate::plan::{Batch, Plan};
use crate::simd::VECTORS;

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
    pub(super) occupied: Option<SceneBox>,
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
        let (unpacked, occupied) = ((unpacked.map(|it| &*it), &*decoded), Self::occupied(&blob));
        Self::of_unpacked(blob, kernel, unpacked, occupied).ok_or(RenderError::Network)
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

    /// A scene over what [`Renderer::unpack`] made, or over weights where they lie; over tables that were decoded; and the box
    /// around its occupied cells.
    pub(crate) fn of_unpacked(
        blob: Blob<'a>,
        kernel: Kernel,
        ([own, proposal, tables], decoded): ([&'a [f32]; 3], &'a [u8]),
        (occupied, coarse): (Option<SceneBox>, CoarseOccupancy),
    ) -> Option<Self> {
        let (unpacked, widened) = (!in_place(kernel), Self::widened_tables(&blob, kernel).is_some());
        let weights = match unpacked {
            true => Weights::unpacked(blob.architecture(), kernel.storage, own),
            false => Weights::InPlace(blob.weights()),
        };
        let tables = match unpacked && widened {
            true => GridTables::widened(tables, blob.scene_box().as_ref()),
            false => Self::tables_of(&blob, decoded),
        };
        let proposer = Proposer::new(&blob, kernel, unpacked.then_some(proposal));
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
        let proposer = Proposer::new(&blob, kernel, None);
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
        Frame::lay_out(&mut measure, Field { network: &self.network, plan }, &self.proposer, (None, None));
        Pixels::lay_out(&mut measure, plan);
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
        let field = Field { network: &self.network, plan };
        let frame = Frame::lay_out(&mut arena, field, &self.proposer, around);
        Ok(Worker::of_frame(frame, Pixels::lay_out(&mut arena, plan)))
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

    /// Says which stages a frame of `plan` has, which not, and why.
    pub fn explain<'e>(&'e self, plan: &'e Plan<'e>) -> Explanation<'e> {
        let workspace = self.workspace_lines(plan).saturating_mul(size_of::<Line>());
        Explanation::new(plan, &self.blob, &self.network, self.proposer.macs(), workspace)
    }

    /// The work of the scene's frames, by stage.
    pub fn shares(&self, counters: &Counters) -> Shares {
        Shares::new(counters, &self.network, self.proposer.macs())
    }

    /// Lines of workspace one [`Renderer::render_picture`] call needs.
    ///
    /// Of `batch` only the samples matter, and only to portable instructions over weights read in place: others always take
    /// whole blocks.
    pub fn picture_workspace_lines(&self, batch: Batch) -> usize {
        picture::lines(&self.network, batch)
    }

    /// Renders the pixels of `rect` of the 2D field, drawn in `size[0]` × `size[1]` pixels.
    ///
    /// Pixel (x, y) is the field's colour at its centre, ((x + ½) / width, (y + ½) / height) with
    /// x to the right and y down: 0 to 1 over the picture whatever its aspect. So any size shows the
    /// whole picture, [`PictureFacts`](crate::blob::PictureFacts) has the one without distortion, and
    /// a `rect` of a larger size is a detail of it.
    ///
    /// `target` takes x, y and the display-encoded colour, in `[0, 1]`; each pixel comes once, row by
    /// row. Within one kernel and maths backend it does not depend on `rect` or `batch` or on who else
    /// renders at the same time, bit for bit. A colour that is NaN becomes black and is counted
    /// ([`Counters::invalid_samples`]).
    ///
    /// # Errors
    /// [`RenderError`] on a scene, a size of 0 or beyond [`MAX_RENDER_SIDE`], a rectangle outside
    /// `size`, a batch that no [`Plan`](crate::plan::Plan) would take and on too little workspace;
    /// nothing has been written then.
    pub fn render_picture(
        &self,
        math: MathBackend,
        batch: Batch,
        size: [u32; 2],
        rect: Rect,
        workspace: &mut [Line],
        target: &mut impl FnMut(u32, u32, [f32; 3]),
    ) -> Result<Counters, RenderError> {
        self.check_picture(batch, size, rect)?;
        let (expected, found) = (self.picture_workspace_lines(batch), workspace.len());
        if found < expected {
            return Err(RenderError::Memory { expected, found });
        }
        Ok(picture::render(&self.network, math, batch, (size, rect), workspace, target))
    }

    /// Whether [`Renderer::render_picture`] takes these arguments; its workspace is another matter.
    ///
    /// # Errors
    /// As [`Renderer::render_picture`], but for the workspace.
    pub fn check_picture(&self, batch: Batch, size: [u32; 2], rect: Rect) -> Result<(), RenderError> {
        picture::check(&self.blob, batch, size, rect)
    }
}
