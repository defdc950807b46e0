//! A scene that is ready to be rendered with one [`Kernel`] (an instruction set and a storage format of weights).

use super::error::check_memory;
use super::field::Field;
use super::frame::Frame;
use super::march::CoarseOccupancy;
use super::pixel::Pixels;
use super::stages::Proposer;
use super::worker::Fields;
use super::{Counters, Explanation, MAX_RENDER_SIDE, Rect, RenderError, Shares, Target, Worker, picture};
use crate::blob::{Blob, BlobError, StoredTables};
use crate::camera::Camera;
use crate::encoding::{GridTables, TableValues};
use crate::math::MathBackend;
use crate::matrix::Kernel;
#[cfg(feature = "train")]
use crate::matrix::Storage;
use crate::memory::{Arena, Layout, Line, Measure};
use crate::network::{Network, Weights, unpack};
use crate::plan::{Batch, Plan};

/// A scene ready to be rendered: its weights and tables are in the formats that one [`Kernel`] reads.
#[derive(Clone, Debug)]
pub struct Renderer<'a> {
    blob: Blob<'a>,
    network: Network<'a>,
    proposer: Proposer<'a>,
    pub(super) occupied: CoarseOccupancy,
}

impl<'a> Renderer<'a> {
    /// Number of 64-byte lines of memory that [`Renderer::new`] needs. Kernels that read f16 weights directly from the
    /// blob's bytes need memory only for entropy-coded tables.
    pub fn prepared_lines(blob: &Blob<'_>, kernel: Kernel) -> usize {
        Measure::lines_of(|it| Prepared::lay_out(it, blob, kernel))
    }

    /// Makes the renderer of a scene for `kernel`: unpacks weights and decodes tables into `memory`, once.
    ///
    /// # Errors
    /// [`RenderError::Memory`] if `memory` has fewer lines than [`Renderer::prepared_lines`] returns.
    /// [`RenderError::Tables`] on invalid coded tables, if the blob was opened by [`Blob::open_undecoded`].
    /// [`RenderError::Network`] if the blob's parameters or tables do not fit its architecture.
    pub fn new(blob: Blob<'a>, kernel: Kernel, memory: &'a mut [Line]) -> Result<Self, RenderError> {
        check_memory(Self::prepared_lines(&blob, kernel), memory)?;
        let mut prepared = Prepared::lay_out(&mut Arena::new(memory), &blob, kernel);
        prepared.unpack(&blob, kernel).map_err(RenderError::Tables)?;
        let Prepared { unpacked, decoded } = prepared;
        let prepared = Prepared { unpacked: unpacked.map(|values| &*values), decoded: &*decoded };
        let occupied = CoarseOccupancy::new(blob.occupancy().as_ref());
        // Does not call `of_prepared`, which would put another copy of the networks on a microcontroller's stack.
        let network = prepared.view(&blob, kernel).ok_or(RenderError::Network)?;
        let proposer = prepared.view_proposal(&blob, kernel);
        Ok(Self { blob, network, proposer, occupied })
    }

    /// Returns a renderer of `blob`, or `None` if parameters or table values are missing. `prepared`: copies of the
    /// values that `kernel` cannot read from the blob's bytes. `occupied`: coarse copy of the occupancy grid.
    #[cfg(all(feature = "std", not(target_os = "none")))]
    pub(crate) fn of_prepared(
        blob: Blob<'a>,
        kernel: Kernel,
        prepared: &Prepared<&'a [f32], &'a [u8]>,
        occupied: CoarseOccupancy,
    ) -> Option<Self> {
        let (network, proposer) = (prepared.view(&blob, kernel)?, prepared.view_proposal(&blob, kernel));
        Some(Self { blob, network, proposer, occupied })
    }

    /// Returns a renderer of `blob` with other parameters for the scene's network. `parameters`: f32 values in the
    /// blob's order. `tables`, if given, replace the blob's grid tables. The proposal network keeps its parameters.
    /// Used to measure how much PSNR is lost because stored parameters are rounded.
    ///
    /// Returns `None` if there are too few parameters, in builds without [`VECTORS`](crate::simd::VECTORS), or if the
    /// blob's tables are coded but no `tables` are given.
    #[cfg(feature = "train")]
    pub fn with_parameters(
        blob: Blob<'a>,
        kernel: Kernel,
        parameters: &'a [f32],
        tables: Option<GridTables<'a>>,
    ) -> Option<Self> {
        let in_place = Kernel::new(kernel.isa, Storage::F16);
        let tables = tables.unwrap_or_else(|| tables_of(&blob, in_place, &[], &[]));
        let weights = Weights::Prepared(parameters);
        let network = Network::of_layers(blob.architecture(), blob.layers(), weights, tables, kernel.isa)?;
        let proposer = Proposer::view(&blob, in_place, &[]);
        let occupied = CoarseOccupancy::new(blob.occupancy().as_ref());
        Some(Self { blob, network, proposer, occupied })
    }

    /// The blob that the renderer was made from.
    pub fn blob(&self) -> &Blob<'a> {
        &self.blob
    }

    /// The kernel that renders the scene: its instruction set and its storage of weights.
    pub fn kernel(&self) -> Kernel {
        self.network.kernel()
    }

    /// The scene's network, with weights in the format that the renderer's kernel reads.
    #[cfg(any(feature = "train", feature = "instances"))]
    #[cfg_attr(
        not(feature = "train"),
        allow(unreachable_pub, reason = "networks are public for trainers alone")
    )]
    pub fn network(&self) -> &Network<'a> {
        &self.network
    }

    /// Number of 64-byte lines of workspace that [`Renderer::worker`], [`Renderer::render`] and [`Renderer::query`]
    /// need for `plan`.
    pub fn workspace_lines(&self, plan: &Plan<'_>) -> usize {
        let field = Field { network: &self.network, plan };
        let frame = |it: &mut Measure| Frame::lay_out(it, field, &self.proposer, (None, None));
        Measure::lines_of(|it| (frame(it), Pixels::lay_out(it, plan)))
    }

    /// Returns a worker for any number of frames of `plan`. Each thread needs a worker of its own.
    ///
    /// # Errors
    /// [`RenderError::OtherScene`] if the plan was made for another scene file. [`RenderError::Memory`] if `workspace` has
    /// fewer 64-byte lines than [`Renderer::workspace_lines`] returns.
    pub fn worker<'f>(
        &'f self,
        plan: &'f Plan<'f>,
        workspace: &'f mut [Line],
    ) -> Result<Worker<'f>, RenderError> {
        if plan.scene != self.blob.identity() {
            return Err(RenderError::OtherScene);
        }
        check_memory(self.workspace_lines(plan), workspace)?;
        let mut arena = Arena::new(workspace);
        let around = (self.occupied.around, self.occupied.packets(plan));
        let field = Field { network: &self.network, plan };
        let fields = Fields::One(Frame::lay_out(&mut arena, field, &self.proposer, around));
        Ok(Worker { fields, pixels: Pixels::lay_out(&mut arena, plan) })
    }

    /// Renders the pixels of `rect`, as [`Worker::render`] does, with a worker made for this call alone.
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

    /// Computes density and colour at points, as [`Worker::query`] does, with a worker made for this call alone.
    /// `positions` (world space), `dirs` (unit vectors) and `sigma` (1/world unit): `[n]`. `rgb`: `[n]` or empty.
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

    /// Reports which stages a frame of `plan` runs, and why the other stages are off.
    pub fn explain<'e>(&'e self, plan: &'e Plan<'e>) -> Explanation<'e> {
        let workspace = self.workspace_lines(plan).saturating_mul(size_of::<Line>());
        let (blob, network, proposal_macs) = (&self.blob, &self.network, self.proposer.macs());
        Explanation { plan, blob, network, proposal_macs, workspace, counters: None }
    }

    /// Splits the multiply-adds in `counters` by stage; the counters must come from frames of this scene.
    pub fn shares(&self, counters: &Counters) -> Shares {
        Shares::new(counters, &self.network, self.proposer.macs())
    }

    /// Number of 64-byte lines of workspace that one [`Renderer::render_picture`] call needs.
    ///
    /// Most kernels evaluate blocks of 64 pixels, whatever the `batch`. [`Kernel::IN_PLACE`] evaluates blocks of
    /// `batch.samples` pixels; its workspace grows with `batch.samples`.
    pub fn picture_workspace_lines(&self, batch: Batch) -> usize {
        Measure::lines_of(|it| picture::Buffers::lay_out(it, &self.network, batch))
    }

    /// Renders the pixels of `rect` in an image of the 2D field, `size[0]` × `size[1]` pixels large.
    ///
    /// Pixel (x, y) has the field's colour at the pixel's centre, ((x + ½) / width, (y + ½) / height), with x to the
    /// right and y down. Coordinates run from 0 to 1 across the image, whatever its aspect ratio: every size shows the
    /// whole field. [`PictureFacts`](crate::blob::PictureFacts) has the size at which the field is not distorted. To
    /// enlarge a detail, request a larger size and only the detail's `rect`.
    ///
    /// `target` receives x, y and the display-encoded colour, in `[0, 1]`, of each pixel once, row by row. With the
    /// same kernel and maths backend, pixels are bit-identical: `rect`, `batch` and other threads do not affect them. A
    /// colour that is NaN becomes black and is counted ([`Counters::invalid_samples`]).
    ///
    /// # Errors
    /// [`RenderError`], before anything is written, if the blob is a scene, if a side is 0 or above
    /// [`MAX_RENDER_SIDE`](super::MAX_RENDER_SIDE), if the rectangle is not inside the image, if a
    /// [`Plan`](crate::plan::Plan) would refuse the batch, or if the workspace is too small.
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
        check_memory(self.picture_workspace_lines(batch), workspace)?;
        Ok(picture::render(&self.network, math, batch, (size, rect), workspace, target))
    }

    /// Checks the arguments of [`Renderer::render_picture`], except the workspace.
    ///
    /// # Errors
    /// As [`Renderer::render_picture`], except for the workspace.
    pub fn check_picture(&self, batch: Batch, size: [u32; 2], rect: Rect) -> Result<(), RenderError> {
        let [width, height] = size;
        if self.blob.picture().is_none() {
            return Err(RenderError::NotAPicture);
        }
        if !size.iter().all(|side| (1..=MAX_RENDER_SIDE).contains(side)) {
            return Err(RenderError::Size { width, height });
        }
        if !rect.fits(width, height) {
            return Err(RenderError::Rect { rect, width, height });
        }
        if !batch.is_valid() {
            return Err(RenderError::Batch { found: batch });
        }
        Ok(())
    }
}

/// Copies of a scene's values that a kernel cannot read directly from the blob's bytes.
///
/// `F` is a buffer of f32 values, `B` a buffer of bytes: slices of the caller's memory, or boxes. A buffer is empty if
/// its values need no copy. [`Prepared::measure`] returns the buffers' lengths (`usize`) as `F` and `B`.
#[derive(Clone, Debug)]
pub(crate) struct Prepared<F, B> {
    /// Three buffers: parameters of the network, parameters of the proposal network, and an f32 copy of f16 tables.
    /// Parameters are in f32, or paired as in [`Weights::Paired`].
    pub unpacked: [F; 3],
    /// Decoded copy of entropy-coded grid tables: each byte holds the bits of one i8 value.
    pub decoded: B,
}

impl Prepared<usize, usize> {
    /// Counts the network parameters and table values of `blob` that `kernel` cannot read in place, and of which the
    /// renderer must therefore hold a copy.
    #[inline]
    pub fn measure(blob: &Blob<'_>, kernel: Kernel) -> Self {
        let unpacked = match kernel.storage.in_place() {
            true => [0; 3],
            false => [
                blob.architecture().parameters(),
                Proposer::parameters(blob),
                widened_tables(blob, kernel).map_or(0, |bytes| bytes.len() / 2),
            ],
        };
        Self { unpacked, decoded: blob.decoded_len() }
    }
}

impl<'a> Prepared<&'a mut [f32], &'a mut [u8]> {
    /// Reserves memory in `layout` for the values of a scene that must be copied for `kernel`.
    #[inline]
    pub fn lay_out(layout: &mut impl Layout<'a>, blob: &Blob<'_>, kernel: Kernel) -> Self {
        let Prepared { unpacked, decoded } = Prepared::measure(blob, kernel);
        let unpacked = match kernel.storage.in_place() {
            true => [&mut [][..], &mut [], &mut []],
            false => unpacked.map(|count| layout.slice(count, 0.0)),
        };
        Self { unpacked, decoded: layout.slice(decoded, 0) }
    }
}

impl<F: AsMut<[f32]>, B: AsMut<[u8]>> Prepared<F, B> {
    /// Unpacks parameters and f16 tables, and decodes entropy-coded tables, into `self`.
    ///
    /// # Errors
    /// [`BlobError`] on invalid coded tables, if the blob was opened by [`Blob::open_undecoded`].
    #[inline]
    pub fn unpack(&mut self, blob: &Blob<'_>, kernel: Kernel) -> Result<(), BlobError> {
        if !kernel.storage.in_place() {
            let [parameters, proposal, tables] = self.unpacked.each_mut().map(AsMut::as_mut);
            Weights::unpack(blob.architecture(), kernel.storage, blob.weights(), parameters);
            Proposer::unpack(blob, kernel.storage, proposal);
            if let Some(bytes) = widened_tables(blob, kernel) {
                unpack(bytes, tables);
            }
        }
        blob.decode_tables(self.decoded.as_mut())
    }
}

impl<'a> Prepared<&'a [f32], &'a [u8]> {
    /// Returns the scene's network. Values without a copy in `self` are read from `blob`. `None` if there are fewer
    /// parameters or table values than the network has.
    #[inline]
    fn view(&self, blob: &Blob<'a>, kernel: Kernel) -> Option<Network<'a>> {
        let [parameters, _, tables] = self.unpacked;
        let weights = Weights::view(blob.architecture(), kernel.storage, blob.weights(), parameters);
        let tables = tables_of(blob, kernel, tables, self.decoded);
        Network::of_layers(blob.architecture(), blob.layers(), weights, tables, kernel.isa)
    }

    /// Returns the scene's proposal network. Parameters without a copy in `self` are read from `blob`.
    #[inline]
    fn view_proposal(&self, blob: &Blob<'a>, kernel: Kernel) -> Proposer<'a> {
        Proposer::view(blob, kernel, self.unpacked[1])
    }
}

/// Returns the grid tables of a scene. `widened`: f32 copy of f16 tables, for kernels that need one. `decoded`: decoded
/// copy of entropy-coded tables, in which each byte holds the bits of an i8. Other tables are read from the blob.
fn tables_of<'a>(blob: &Blob<'a>, kernel: Kernel, widened: &'a [f32], decoded: &'a [u8]) -> GridTables<'a> {
    let values = match blob.tables() {
        None => TableValues::F32(&[]),
        Some(StoredTables::F16(_)) if widened_tables(blob, kernel).is_some() => TableValues::F32(widened),
        Some(StoredTables::F16(bytes)) => TableValues::F16(bytes),
        Some(StoredTables::Int8 { scales, bytes }) => TableValues::Int8 { values: bytes, scales },
        Some(StoredTables::Coded { scales, .. }) => TableValues::Int8 { values: decoded, scales },
    };
    GridTables::new(values, blob.scene_box().as_ref())
}

/// Returns the bytes of the blob's f16 grid tables if `kernel` needs a copy of the tables in f32. `None` if the blob
/// has no f16 tables, or if `kernel` reads f16 tables directly.
fn widened_tables<'a>(blob: &Blob<'a>, kernel: Kernel) -> Option<&'a [u8]> {
    match blob.tables() {
        Some(StoredTables::F16(bytes)) if !(kernel.storage.in_place() || kernel.isa.reads_f16_tables()) => {
            Some(bytes)
        }
        _ => None,
    }
}
