//! A scene, seen by a camera.

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
use crate::tile_pixels::TilePixels;
use crate::tiles::{Watcher, render_tiles};
use crate::workspace::Workspace;
use core::ffi::{c_char, c_void};
use nerf_core::memory::Line;
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
    /// The rectangle behind a pointer, or all of a `width` × `height` image.
    ///
    /// # Safety
    /// `at` is NULL or points to a readable rectangle.
    pub(crate) unsafe fn read(at: *const Self, width: u32, height: u32) -> Result<render::Rect, Failure> {
        if at.is_null() {
            return Ok(render::Rect { x: 0, y: 0, width, height });
        }
        check_aligned("rect", at as usize, align_of::<Self>())?;
        // SAFETY: not NULL, aligned, and readable by this function's `# Safety`.
        let found = unsafe { at.read() };
        let rect = render::Rect { x: found.x, y: found.y, width: found.width, height: found.height };
        if rect.fits(width, height) {
            Ok(rect)
        } else {
            Err(Failure::Render(render::RenderError::Rect { rect, width, height }))
        }
    }
}

/// Renders a rectangle of a camera's image of a scene into the planes of a target.
///
/// The pixels do not depend on the rectangle, the batch or on who else renders, bit for bit within
/// one kernel. Threads may render one scene at the same time, each with a workspace of its own.
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
        // SAFETY: `scene` is as this function's `# Safety` has it.
        let scene = unsafe { Scene::of(scene)? };
        // SAFETY: `camera` is as this function's `# Safety` has it.
        let camera = unsafe { Camera::read(camera)? };
        // SAFETY: `options` is as this function's `# Safety` has it.
        let settings = unsafe { Settings::read(options)? };
        let image = camera.intrinsics();
        // SAFETY: `rect` is as this function's `# Safety` has it.
        let rect = unsafe { Rect::read(rect, image.width, image.height)? };
        // SAFETY: `counters` is as this function's `# Safety` has it.
        let out = if counters.is_null() { None } else { Some(unsafe { Out::new(counters)? }) };
        let workspace = Workspace::new(workspace, workspace_size, scene)?;
        // SAFETY: `target` and its planes are as this function's `# Safety` has them.
        let canvas = unsafe { Canvas::new(target, rect, scene, workspace.span())? };
        let renderer = scene.renderer();
        let plan = settings.plan(renderer.blob(), canvas.outputs(), canvas.has_alpha())?;
        workspace.check_size(settings.batch, plan.outputs(), renderer.workspace_lines(&plan))?;

        let draw = |tile: render::Rect, pixels: &mut TilePixels<'_>, lines: &mut [Line]| {
            let mut put = |x: u32, y: u32, pixel: &Pixel| {
                pixels.put(((y - tile.y) * tile.width + (x - tile.x)) as usize, pixel);
            };
            renderer.render(&plan, &camera, tile, lines, &mut put).map_err(Failure::Render)
        };
        let watcher = Watcher { progress, user };
        // SAFETY: the size was checked, and the memory is this call's own by this function's `# Safety`.
        let work = unsafe { render_tiles(rect, settings.batch, workspace, canvas, watcher, draw)? };
        if let Some(out) = out {
            out.write(work.into());
        }
        Ok(())
    })
}
