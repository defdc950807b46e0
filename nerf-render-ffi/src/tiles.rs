//! A rectangle, tile by tile: what the calls that make pictures share.

use crate::failure::Failure;
use crate::progress::{self, Progress};
use crate::target::Canvas;
use crate::tile_pixels::TilePixels;
use crate::workspace::{Workspace, tile_size};
use core::ffi::c_void;
use nerf_core::memory::Line;
use nerf_core::plan::Batch;
use nerf_core::render::{Counters, Rect};

/// The caller's progress function with its argument.
#[derive(Clone, Copy)]
pub(crate) struct Watcher {
    pub progress: Progress,
    pub user: *mut c_void,
}

impl Watcher {
    /// Calls the caller, who may cancel.
    fn report(&self, done: u64, all: u64) -> Result<(), Failure> {
        // SAFETY: the caller of `nerf_render` passed the function with this argument.
        let on = unsafe { progress::call(self.progress, self.user, done, all) };
        if on { Ok(()) } else { Err(Failure::Cancelled) }
    }
}

/// Renders `rect`, the canvas' own, tile by tile.
///
/// `render` puts every pixel of the tile it is given, row by row, and may work in the lines.
///
/// # Safety
/// The workspace is large enough for `batch`, the canvas' outputs and the call's own.
pub(crate) unsafe fn render_tiles(
    rect: Rect,
    batch: Batch,
    mut workspace: Workspace,
    mut canvas: Canvas,
    watcher: Watcher,
    render: impl Fn(Rect, &mut TilePixels<'_>, &mut [Line]) -> Result<Counters, Failure>,
) -> Result<Counters, Failure> {
    let all = u64::from(rect.width) * u64::from(rect.height);
    let (mut done, mut work) = (0, Counters::default());
    watcher.report(done, all)?;
    let (width, height) = tile_size(batch);
    for tile in rect.tiles(width, height) {
        // A tile is finished aside and then copied, so that not even a panic leaves half of one;
        // no slice of the workspace outlives the tile, so that the callback may use it.
        // SAFETY: the memory is this call's own by this function's `# Safety`.
        let (mut pixels, lines) = unsafe { workspace.split(batch, canvas.outputs())? };
        work += render(tile, &mut pixels, lines)?;
        canvas.write(tile, &pixels);
        done += u64::from(tile.width * tile.height);
        watcher.report(done, all)?;
    }
    Ok(work)
}
