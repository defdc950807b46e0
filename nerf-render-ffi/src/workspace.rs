//! Memory that one call works in.

use crate::boundary::{LayoutOut, Message, call};
use crate::failure::Failure;
use crate::render_options::{RenderOptions, Settings};
use crate::scene::Scene;
use crate::span::Span;
use crate::status::Status;
use crate::tile_pixels::TilePixels;
use core::ffi::{c_char, c_void};
use nerf_core::memory::{Arena, Line};
use nerf_core::plan::{Batch, Outputs};
use nerf_core::render::TILE_SIDE;

/// Colour is wanted.
pub const NERF_OUTPUT_RGB: u32 = 1;
/// Opacity is wanted.
pub const NERF_OUTPUT_OPACITY: u32 = 2;
/// Distance along the ray is wanted.
pub const NERF_OUTPUT_RAY_DISTANCE: u32 = 4;
/// Distance along the view axis is wanted.
pub const NERF_OUTPUT_Z_DEPTH: u32 = 8;
/// Distance along the ray at which half of the light is gone is wanted.
pub const NERF_OUTPUT_MEDIAN_DISTANCE: u32 = 16;
/// Normals are wanted.
pub const NERF_OUTPUT_NORMALS: u32 = 32;

/// Width and height of the tiles a batch is rendered in: no more pixels than rays.
pub(crate) fn tile_size(batch: Batch) -> (u32, u32) {
    let side = TILE_SIDE as usize;
    let width = side.min(batch.rays).max(1);
    (width as u32, side.min(batch.rays / width).max(1) as u32)
}

/// Pixels of the largest tile.
fn tile_pixels(batch: Batch) -> usize {
    let (width, height) = tile_size(batch);
    (width * height) as usize
}

/// Bytes one call needs: room for a tile's `outputs`, and the renderer's `lines`.
pub(crate) fn size(batch: Batch, outputs: Outputs, lines: usize) -> Result<usize, Failure> {
    let lines = TilePixels::lines(tile_pixels(batch), outputs).checked_add(lines);
    lines.and_then(|lines| lines.checked_mul(size_of::<Line>())).ok_or(Failure::Overflow("workspace"))
}

/// A workspace that is large enough, aligned and apart from the scene.
pub(crate) struct Workspace {
    at: *mut Line,
    lines: usize,
    span: Span,
}

impl Workspace {
    /// Checks the memory, but not yet its size, which follows from the plan.
    pub fn new(at: *mut c_void, size: usize, scene: &Scene) -> Result<Self, Failure> {
        Span::of("workspace", at.cast::<Line>().cast_const(), 0)?;
        let span = Span::new("workspace", at, size)?;
        scene.check_apart("workspace", span)?;
        Ok(Self { at: at.cast(), lines: size / size_of::<Line>(), span })
    }

    pub fn span(&self) -> Span {
        self.span
    }

    /// Checks the size, of which the renderer needs `lines`.
    pub fn check_size(&self, batch: Batch, outputs: Outputs, lines: usize) -> Result<(), Failure> {
        let expected = size(batch, outputs, lines)?;
        let found = self.lines * size_of::<Line>();
        if found < expected { Err(Failure::Memory { name: "workspace", expected, found }) } else { Ok(()) }
    }

    /// All of it.
    ///
    /// # Safety
    /// The memory is writable, and not used elsewhere as long as the slice lives.
    pub unsafe fn lines(&mut self) -> &mut [Line] {
        // SAFETY: aligned (`new`), a line holds any bytes, and the rest is as this function's `# Safety` has it.
        unsafe { core::slice::from_raw_parts_mut(self.at, self.lines) }
    }

    /// Room for a tile's pixels, and the rest.
    ///
    /// # Safety
    /// The memory is writable, and not used elsewhere as long as the slices live.
    pub unsafe fn split(
        &mut self,
        batch: Batch,
        outputs: Outputs,
    ) -> Result<(TilePixels<'_>, &mut [Line]), Failure> {
        // SAFETY: aligned (`new`), a line holds any bytes, and the rest is as this function's `# Safety` has it.
        let lines = unsafe { core::slice::from_raw_parts_mut(self.at, self.lines) };
        let count = tile_pixels(batch);
        let first = TilePixels::lines(count, outputs);
        let (first, rest) = lines.split_at_mut_checked(first).ok_or(Failure::Null("workspace"))?;
        Ok((TilePixels::lay_out(&mut Arena::new(first), count, outputs), rest))
    }
}

/// Says how much workspace one `nerf_render` or `nerf_query` call needs, and at which alignment.
///
/// `options`: those of the call, NULL for the defaults. `outputs`: `NERF_OUTPUT_*` of the planes
/// that will not be NULL, or-ed; for a query `NERF_OUTPUT_RGB` or 0. `size` and `align` are written
/// on success only. `message`: NULL, or `message_capacity` bytes for a sentence about what was
/// expected and found; empty on success.
///
/// # Safety
/// Pointers are NULL or point to what is described here; `scene` is intact.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_workspace_size(
    scene: *const Scene,
    options: *const RenderOptions,
    outputs: u32,
    size: *mut usize,
    align: *mut usize,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: `scene` is as this function's `# Safety` has it.
        let scene = unsafe { Scene::of(scene)? };
        // SAFETY: `size` and `align` are as this function's `# Safety` has it.
        let layout = unsafe { LayoutOut::new(size, align)? };
        // SAFETY: `options` is as this function's `# Safety` has it.
        let settings = unsafe { Settings::read(options)? };
        let plan = settings.plan(scene.renderer().blob(), read_outputs(outputs)?, false)?;
        let lines = scene.renderer().workspace_lines(&plan);
        let bytes = self::size(settings.batch, plan.outputs(), lines)?;
        layout.write(bytes);
        Ok(())
    })
}

pub(crate) fn read_outputs(found: u32) -> Result<Outputs, Failure> {
    let all = NERF_OUTPUT_RGB
        | NERF_OUTPUT_OPACITY
        | NERF_OUTPUT_RAY_DISTANCE
        | NERF_OUTPUT_Z_DEPTH
        | NERF_OUTPUT_MEDIAN_DISTANCE
        | NERF_OUTPUT_NORMALS;
    if found & !all != 0 {
        return Err(Failure::Setting { name: "outputs", expected: "NERF_OUTPUT_* or-ed", found });
    }
    Ok(Outputs {
        rgb: found & NERF_OUTPUT_RGB != 0,
        opacity: found & NERF_OUTPUT_OPACITY != 0,
        ray_distance: found & NERF_OUTPUT_RAY_DISTANCE != 0,
        z_depth: found & NERF_OUTPUT_Z_DEPTH != 0,
        median_distance: found & NERF_OUTPUT_MEDIAN_DISTANCE != 0,
        normals: found & NERF_OUTPUT_NORMALS != 0,
    })
}
