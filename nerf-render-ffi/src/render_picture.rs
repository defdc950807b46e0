//! A 2D field, drawn at any size.

use crate::boundary::{LayoutOut, Message, Out, call};
use crate::counters::Counters;
use crate::failure::Failure;
use crate::progress::Progress;
use crate::render::Rect;
use crate::render_options::{RenderOptions, Settings};
use crate::scene::Scene;
use crate::status::Status;
use crate::target::{Canvas, Target};
use crate::tile_pixels::TilePixels;
use crate::tiles::{Watcher, render_tiles};
use crate::workspace::{Workspace, size};
use core::ffi::{c_char, c_void};
use nerf_core::memory::Line;
use nerf_core::plan::Outputs;
use nerf_core::render::{self, RenderError, Renderer};
use nerf_core::volume::Pixel;

/// The renderer of a scene handle whose blob is a 2D field.
fn picture_of(scene: &Scene) -> Result<&Renderer<'static>, Failure> {
    let renderer = scene.renderer();
    if renderer.blob().picture().is_some() {
        Ok(renderer)
    } else {
        Err(Failure::Render(RenderError::NotAPicture))
    }
}

/// Says how much workspace one `nerf_render_picture` call needs, and at which alignment.
///
/// `options`: those of the call, NULL for the defaults; neither the picture's size nor its rectangle
/// matters. `size` and `align` are written on success only. `message`: NULL, or `message_capacity`
/// bytes for a sentence about what was expected and found; empty on success.
///
/// # Safety
/// Pointers are NULL or point to what is described here; `scene` is intact.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_picture_workspace_size(
    scene: *const Scene,
    options: *const RenderOptions,
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
        let renderer = picture_of(scene)?;
        // SAFETY: `options` is as this function's `# Safety` has it.
        let settings = unsafe { Settings::read(options)? };
        let lines = renderer.picture_workspace_lines(settings.batch);
        let bytes = self::size(settings.batch, Outputs::NONE, lines)?;
        layout.write(bytes);
        Ok(())
    })
}

/// Renders a rectangle of a picture (a 2D field: `NERF_KIND_PICTURE`), drawn in `width` x `height`
/// pixels.
///
/// Pixel (x, y) is the field's colour at its centre, ((x + 0.5) / width, (y + 0.5) / height): any
/// size from 1x1 to 8388608x8388608 shows the whole picture, `picture_width` x `picture_height` of
/// `nerf_scene_info` without distortion, and a rectangle of a larger size is a detail of it.
///
/// `options`: NULL for the defaults; only maths and batch matter. `rect`: NULL for the whole picture;
/// an empty one is rendered with nothing written. `target`: only `rgb` may be a plane; a picture is
/// opaque, so that the alpha of RGBA formats is 1. `workspace`: at least the size and alignment that
/// `nerf_picture_workspace_size` says for these options. The rest, and all else: as in `nerf_render`.
///
/// # Safety
/// Pointers are NULL or point to what is described here; `scene` is intact.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_render_picture(
    scene: *const Scene,
    width: u32,
    height: u32,
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
        let renderer = picture_of(scene)?;
        // SAFETY: `options` is as this function's `# Safety` has it.
        let settings = unsafe { Settings::read(options)? };
        let (quality, batch) = (settings.quality, settings.batch);
        let nothing = render::Rect { x: 0, y: 0, width: 0, height: 0 };
        renderer.check_picture(batch, [width, height], nothing).map_err(Failure::Render)?;
        // SAFETY: `rect` and `width` are as this function's `# Safety` has it.
        let rect = unsafe { Rect::read(rect, width, height)? };
        // SAFETY: `counters` is as this function's `# Safety` has it.
        let out = if counters.is_null() { None } else { Some(unsafe { Out::new(counters)? }) };
        let workspace = Workspace::new(workspace, workspace_size, scene)?;
        // SAFETY: `target` and its planes are as this function's `# Safety` has them.
        let canvas = unsafe { Canvas::new(target, rect, scene, workspace.span())? };
        canvas.check_colour_only()?;
        workspace.check_size(batch, Outputs::NONE, renderer.picture_workspace_lines(batch))?;

        let draw = |tile: render::Rect, pixels: &mut TilePixels<'_>, lines: &mut [Line]| {
            let mut put = |x: u32, y: u32, rgb: [f32; 3]| {
                let pixel = Pixel { rgb, opacity: 1.0, ..Pixel::BLANK };
                pixels.put(((y - tile.y) * tile.width + (x - tile.x)) as usize, &pixel);
            };
            let drawn = renderer.render_picture(quality.math, batch, [width, height], tile, lines, &mut put);
            drawn.map_err(Failure::Render)
        };
        let watcher = Watcher { progress, user };
        // SAFETY: the size was checked, and the memory is this call's own by this function's `# Safety`.
        let work = unsafe { render_tiles(rect, batch, workspace, canvas, watcher, draw)? };
        if let Some(out) = out {
            out.write(work.into());
        }
        Ok(())
    })
}
