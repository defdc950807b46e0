//! A rectangle of a picture, tile by tile.

use crate::boundary::{Message, Out, call};
use crate::camera::Camera;
use crate::counters::Counters;
use crate::failure::Failure;
use crate::progress::Progress;
use crate::render_options::{RenderOptions, Settings};
use crate::scene::Scene;
use crate::span::check_aligned;
use crate::status::Status;
use crate::target::{Canvas, Target};
use crate::workspace::{Workspace, tile_size};
use core::ffi::{c_char, c_void};
use nerf_core::render;
use nerf_core::volume::Pixel;

/// Pixels of an image, `x..x + width`, `y..y + height`.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Rect {
    /// Left edge, pixels.
    pub x: u32,
    /// Top edge, pixels.
    pub y: u32,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
}

impl Rect {
    /// The rectangle behind a pointer, or the whole image.
    ///
    /// # Safety
    /// `at` is NULL or points to a readable rectangle.
    unsafe fn read(at: *const Self, camera: &nerf_core::camera::Camera) -> Result<render::Rect, Failure> {
        if at.is_null() {
            return Ok(render::Rect::full(camera));
        }
        check_aligned("rect", at as usize, align_of::<Self>())?;
        // SAFETY: not NULL, aligned, and readable by the caller's promise.
        let Self { x, y, width, height } = unsafe { at.read() };
        let (rect, i) = (render::Rect { x, y, width, height }, camera.intrinsics());
        if rect.fits(i.width, i.height) {
            Ok(rect)
        } else {
            let outside = render::RenderError::Rect { rect, width: i.width, height: i.height };
            Err(Failure::Render(outside))
        }
    }
}

/// Renders a rectangle of a camera's image into the planes of a target.
///
/// The pixels do not depend on the rectangle, the batch or on who else renders, bit for bit within
/// one tier. Threads may render one scene at the same time, each with a workspace of its own.
///
/// `options`: NULL for the defaults. `rect`: NULL for the whole image; an empty one is rendered
/// with nothing written. `workspace`: at least the size and alignment that `nerf_workspace_size`
/// says for these options and planes, apart from scene, blob and planes. `progress`: NULL, or
/// called with `user` before the first tile and after each tile of at most 16x16 pixels.
/// `counters`: NULL, or written on success, with `struct_size` set by the caller. `message`: NULL,
/// or `message_capacity` bytes for a sentence about what was expected and found; empty on success.
///
/// Everything is checked before the first pixel is written. Pixels are written in whole tiles:
/// after `NERF_STATUS_CANCELLED` or `NERF_STATUS_PANIC` each tile is finished or untouched.
///
/// # Safety
/// Pointers are NULL or point to what is described here; `scene` is intact.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_render(
    scene: *const Scene,
    camera: *const Camera,
    options: *const RenderOptions,
    rect: *const Rect,
    target: *const Target,
    workspace: *mut c_void,
    workspace_size: usize,
    progress: Progress,
    user: *mut c_void,
    counters: *mut Counters,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: the caller's promise.
        let scene = unsafe { Scene::of(scene)? };
        // SAFETY: the caller's promise.
        let camera = unsafe { Camera::read(camera)? };
        // SAFETY: the caller's promise.
        let settings = unsafe { Settings::read(options, scene.renderer().network().tier())? };
        // SAFETY: the caller's promise.
        let rect = unsafe { Rect::read(rect, &camera)? };
        // SAFETY: the caller's promise.
        let out = if counters.is_null() { None } else { Some(unsafe { Out::new(counters)? }) };
        let mut workspace = Workspace::new(workspace, workspace_size, scene)?;
        // SAFETY: the caller's promise.
        let mut canvas = unsafe { Canvas::new(target, rect, scene, workspace.span())? };
        let plan = settings.plan(scene.renderer().blob(), canvas.outputs(), canvas.has_alpha())?;
        workspace.check_size(scene, settings.batch, &plan)?;

        let all = u64::from(rect.width) * u64::from(rect.height);
        let (mut done, mut work) = (0, render::Counters::default());
        report(progress, user, done, all)?;
        let (width, height) = tile_size(settings.batch);
        for tile in rect.tiles(width, height) {
            // A tile is finished aside and then copied, so that not even a panic leaves half of one;
            // no slice of the workspace outlives the tile, so that the callback may use it.
            // SAFETY: the memory is this call's own by the caller's promise.
            let (pixels, lines) = unsafe { workspace.split(settings.batch)? };
            let mut put = |x: u32, y: u32, pixel: &Pixel| {
                pixels[((y - tile.y) * tile.width + (x - tile.x)) as usize] = *pixel;
            };
            let tile_work = scene.renderer().render(&plan, &camera, tile, lines, &mut put);
            work += tile_work.map_err(Failure::Render)?;
            let count = (tile.width * tile.height) as usize;
            canvas.write(tile, &pixels[..count]);
            done += count as u64;
            report(progress, user, done, all)?;
        }
        if let Some(out) = out {
            out.write(work.into());
        }
        Ok(())
    })
}

/// Calls the caller, who may cancel.
fn report(progress: Progress, user: *mut c_void, done: u64, all: u64) -> Result<(), Failure> {
    // SAFETY: the caller of `nerf_render` vouches for its function.
    match progress.map_or(0, |progress| unsafe { progress(user, done, all) }) {
        0 => Ok(()),
        _ => Err(Failure::Cancelled),
    }
}
