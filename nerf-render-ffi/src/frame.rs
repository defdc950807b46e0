//! Rendering of images: a scene seen by a camera, or a 2D field at any size.

use crate::boundary::{Message, by_width, call, check_zeros, versioned};
use crate::camera::Camera;
use crate::counters::Counters;
use crate::failure::Failure;
use crate::progress::{self, Progress};
use crate::span::check_aligned;
use crate::status::Status;
use crate::target::{Canvas, Target};
use crate::worker::{State, Work, Worker, tile_size, with_worker_and};
use core::ffi::{c_char, c_void};
use nerf_core::render::{self, Limit, RenderError};
use nerf_core::volume::Pixel;

/// A rectangle of an image's pixels: columns `x..x + width`, rows `y..y + height`.
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
    /// Reads and checks the rectangle at `at`; NULL is the whole `width` × `height` image.
    ///
    /// # Safety
    /// `at` is NULL or points to a readable rectangle.
    unsafe fn read(at: *const Self, width: u32, height: u32) -> Result<render::Rect, Failure> {
        if at.is_null() {
            return Ok(render::Rect { x: 0, y: 0, width, height });
        }
        check_aligned("frame.rect", at as usize, align_of::<Self>())?;
        // SAFETY: `at` is not NULL and is aligned; a rectangle is readable, as this function's `# Safety` requires.
        let found = unsafe { at.read() };
        let rect = render::Rect { x: found.x, y: found.y, width: found.width, height: found.height };
        if rect.fits(width, height) {
            Ok(rect)
        } else {
            Err(RenderError::Rect { rect, width, height }.into())
        }
    }
}

/// A frame: the part of an image to render, and the planes that receive its pixels.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Frame {
    /// `sizeof(nerf_frame)`.
    pub struct_size: usize,
    /// Camera from which a scene is seen; must be NULL for a 2D field.
    pub camera: *const Camera,
    /// Rectangle to render; NULL for the whole image. An empty rectangle writes nothing.
    pub rect: *const Rect,
    /// Planes for the pixels. A plane's `data` must be NULL if `outputs` of `nerf_request` lacks the plane's flag.
    pub target: *const Target,
    /// Image width, pixels, if a 2D field is rendered. Must be 0 for a scene, since `camera` has the width.
    pub width: u32,
    /// Image height, pixels, if a 2D field is rendered. Must be 0 for a scene, since `camera` has the height.
    pub height: u32,
    /// Callback, called with `user` before the first tile and after each tile of at most 16x16 pixels; may be NULL.
    pub progress: Progress,
    /// Argument passed to each call of `progress`.
    pub user: *mut c_void,
}

versioned!(unsafe Frame, "frame", by_width(32, 56));

/// Renders a rectangle of a camera's image into the planes of a target.
///
/// With the same kernel, the result for a pixel is bit-identical in every rectangle, with every batch size, on every
/// thread, and after any earlier calls. `frame->target` may contain limits at which rays end, such as a depth buffer.
///
/// `counters`: NULL, or receives counts of the work on success; the caller sets `struct_size`. `message`: NULL, or a
/// buffer for an error message.
///
/// All arguments are checked before the first pixel is written. Pixels are written in whole tiles: after
/// `NERF_STATUS_CANCELLED` or `NERF_STATUS_PANIC` each tile is finished or untouched.
///
/// # Safety
/// Pointers are NULL or point to what is described here. The caller has not freed, moved or overwritten the memory of
/// `worker` or its scenes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_render(
    worker: *mut Worker,
    frame: *const Frame,
    counters: *mut Counters,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    let draw = |worker: &mut State, frame: Frame| {
        worker.fields()?;
        check_zeros("frame.width, frame.height", &[frame.width, frame.height])?;
        // SAFETY: `camera` is valid, as this function's `# Safety` requires.
        let camera = unsafe { Camera::read(frame.camera)? };
        let image = camera.intrinsics();
        // SAFETY: `rect` is valid, as this function's `# Safety` requires.
        let rect = unsafe { Rect::read(frame.rect, image.width, image.height)? };
        // SAFETY: `target` is valid, as this function's `# Safety` requires.
        let canvas = unsafe { Canvas::of_image(frame.target, rect, worker)? };
        canvas.set_up(worker)?;
        let limit = canvas.limit;
        render_tiles(worker, &frame, canvas, rect, |worker, tile| {
            let State { work: Work::Fields(fields), pixels, .. } = worker else {
                return Err(Failure::Null("worker"));
            };
            let mut put = |x: u32, y: u32, pixel: &Pixel| {
                pixels.put(((y - tile.y) * tile.width + (x - tile.x)) as usize, pixel);
            };
            // One closure serves rays with and without limits, so that the frame loop is compiled only once.
            let limit =
                |x: u32, y: u32| limit.map_or(Limit::NONE, |plane| plane.limit(x - rect.x, y - rect.y));
            Ok(fields.render_limited(&camera, tile, limit, &mut put)?)
        })
    };
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        unsafe { with_worker_and(worker, frame, counters, draw) }
    })
}

/// Renders a rectangle of an image of a 2D field (`NERF_KIND_PICTURE`), `frame->width` x `frame->height` pixels large.
///
/// Pixel (x, y) is the field's colour at the pixel's centre, ((x + 0.5) / width, (y + 0.5) / height). Every size from
/// 1x1 to 8388608x8388608 shows the whole field. `picture_width` and `picture_height` of `nerf_scene_info` give the
/// field's own aspect ratio. To show a detail, render a rectangle of a large image.
///
/// `worker`: must be opened for the 2D field. Of the worker's options, only `maths`, `batch_rays` and `batch_samples`
/// matter. Every plane of the target but `rgb` must have `data` NULL. Alpha is 1. All else is as in `nerf_render`.
///
/// # Safety
/// Pointers are NULL or point to what is described here. The caller has not freed, moved or overwritten the memory of
/// `worker` or its scene.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_render_picture(
    worker: *mut Worker,
    frame: *const Frame,
    counters: *mut Counters,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    let draw = |worker: &mut State, frame: Frame| {
        let [member] = worker.members else { return Err(RenderError::NotAPicture.into()) };
        let renderer = member.scene.renderer();
        let (math, batch) = (worker.settings.frame.quality.math, worker.settings.batch);
        let size = [frame.width, frame.height];
        let nothing = render::Rect { x: 0, y: 0, width: 0, height: 0 };
        renderer.check_picture(batch, size, nothing)?;
        if !frame.camera.is_null() {
            return Err(Failure::Reserved("frame.camera"));
        }
        // SAFETY: `rect` is valid, as this function's `# Safety` requires.
        let rect = unsafe { Rect::read(frame.rect, size[0], size[1])? };
        // SAFETY: `target` is valid, as this function's `# Safety` requires.
        let canvas = unsafe { Canvas::of_image(frame.target, rect, worker)? };
        canvas.check_picture()?;
        render_tiles(worker, &frame, canvas, rect, |worker, tile| {
            let State { work: Work::Picture(lines), pixels, .. } = worker else {
                return Err(Failure::Null("worker"));
            };
            let mut put = |x: u32, y: u32, rgb: [f32; 3]| {
                let pixel = Pixel { rgb, opacity: 1.0, ..Pixel::BLANK };
                pixels.put(((y - tile.y) * tile.width + (x - tile.x)) as usize, &pixel);
            };
            Ok(renderer.render_picture(math, batch, size, tile, lines, &mut put)?)
        })
    };
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        unsafe { with_worker_and(worker, frame, counters, draw) }
    })
}

/// Renders `rect` tile by tile into `canvas`. `draw` renders a tile into the worker's `pixels`, row by row.
fn render_tiles(
    worker: &mut State,
    frame: &Frame,
    mut canvas: Canvas,
    rect: render::Rect,
    mut draw: impl FnMut(&mut State, render::Rect) -> Result<render::Counters, Failure>,
) -> Result<render::Counters, Failure> {
    let all = u64::from(rect.width) * u64::from(rect.height);
    let report = |done: u64| {
        // SAFETY: the caller passed the callback `progress` together with its argument `user`.
        let on = unsafe { progress::call(frame.progress, frame.user, done, all) };
        if on { Ok(()) } else { Err(Failure::Cancelled) }
    };
    let (mut done, mut work) = (0, render::Counters::default());
    report(done)?;
    let (width, height) = tile_size(worker.settings.batch);
    for tile in rect.tiles(width, height) {
        work += draw(worker, tile)?;
        canvas.write(tile, &worker.pixels);
        done += u64::from(tile.width * tile.height);
        report(done)?;
    }
    Ok(work)
}
