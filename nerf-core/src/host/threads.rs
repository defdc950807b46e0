//! Rendering on several threads. Each thread repeatedly takes the next tile, band of rows or chunk of rays, renders the
//! pixels, and stores the pixels under a lock.

use super::Image;
use super::image::plane;
use crate::camera::Camera;
use crate::math::MathBackend;
use crate::memory::Line;
use crate::plan::{Batch, Plan};
use crate::render::{Counters, RaySegment, Rect, RenderError, Renderer, TILE_SIDE};
use crate::volume::Pixel;
use glam::Vec3;
use std::num::NonZeroUsize;
use std::sync::{Mutex, PoisonError};
use std::vec;
use std::vec::Vec;

/// Number of image rows that a thread takes at a time when a 2D field is rendered.
const BAND: u32 = 8;
/// Number of rays that a thread takes at a time when a list of rays is rendered.
const CHUNK: u32 = 256;

/// Renders all of `camera`'s image on `threads` threads. The image has a plane for each output of the plan.
///
/// # Errors
/// [`RenderError::OtherScene`] if the plan was made for another scene, and [`RenderError::ImageMemory`] if there is
/// not enough memory for the image.
pub fn render(
    renderer: &Renderer<'_>,
    plan: &Plan<'_>,
    camera: &Camera,
    threads: NonZeroUsize,
) -> Result<Image, RenderError> {
    let full = Rect::full(camera);
    let mut image = Image::new(full.width as usize, full.height as usize, &plan.outputs())?;
    let width = image.width;
    let lines = renderer.workspace_lines(plan);
    let counters = in_parallel(
        threads,
        full.tiles(TILE_SIDE, TILE_SIDE),
        |tiles| {
            let mut memory = vec![Line::UNINIT; lines];
            let mut worker = renderer.worker(plan, &mut memory)?;
            each(tiles, |tile, pixels| {
                worker.render(camera, tile, &mut |x, y, pixel: &Pixel| pixels.push((x, y, *pixel)))
            })
        },
        |(x, y, pixel)| image.put(y as usize * width + x as usize, &pixel),
    )?;
    image.counters = counters;
    Ok(image)
}

/// Renders one pixel per ray on `threads` threads, as [`Worker::render_rays`] does. Returns the pixels in the order of
/// `rays`, and counters. `axis`: unit vector along which `z_depth` is measured; `None` for a `z_depth` of 0.
///
/// [`Worker::render_rays`]: crate::render::Worker::render_rays
///
/// # Errors
/// The errors of [`Worker::render_rays`]. Also [`RenderError::OtherScene`] if the plan was made for another scene, and
/// [`RenderError::ImageMemory`] if there is not enough memory for the pixels.
pub fn render_rays(
    renderer: &Renderer<'_>,
    plan: &Plan<'_>,
    rays: &[RaySegment],
    axis: Option<Vec3>,
    threads: NonZeroUsize,
) -> Result<(Vec<Pixel>, Counters), RenderError> {
    let mut found = plane(rays.len(), 1, Pixel::BLANK)?;
    let lines = renderer.workspace_lines(plan);
    let chunks = (0..rays.len()).step_by(CHUNK as usize);
    let threads = threads.min(NonZeroUsize::new(chunks.len()).unwrap_or(NonZeroUsize::MIN));
    let counters = in_parallel(
        threads,
        chunks,
        |chunks| {
            let mut memory = vec![Line::UNINIT; lines];
            let mut worker = renderer.worker(plan, &mut memory)?;
            each(chunks, |first, pixels| {
                let end = rays.len().min(first + CHUNK as usize);
                let mut put = |i: usize, pixel: &Pixel| pixels.push((i, *pixel));
                worker.render_range_of_rays(rays, first..end, axis, &mut put)
            })
        },
        |(i, pixel)| found[i] = pixel,
    )?;
    Ok((found, counters))
}

/// Renders a 2D field in `size` (width, height) pixels on `threads` threads, and returns the pixels row by row from the
/// top left. `finished` is called with the number of rows finished since the previous call.
///
/// # Errors
/// [`RenderError`] if the blob is a scene, if a side is 0 or above `MAX_RENDER_SIDE`, or if there is not enough memory.
pub fn render_picture(
    renderer: &Renderer<'_>,
    math: MathBackend,
    size: [u32; 2],
    threads: NonZeroUsize,
    mut finished: impl FnMut(u32) + Send,
) -> Result<(Vec<[f32; 3]>, Counters), RenderError> {
    let [width, height] = size;
    let batch = Batch::FULL;
    let full = Rect { x: 0, y: 0, width, height };
    renderer.check_picture(batch, size, full)?;
    let mut rgb = plane(width as usize, height as usize, [0.0; 3])?;
    let lines = renderer.picture_workspace_lines(batch);
    let counters = in_parallel(
        threads,
        full.tiles(width, BAND),
        |bands| {
            let mut memory = vec![Line::UNINIT; lines];
            each(bands, |band, rows| {
                let mut pixels = Vec::with_capacity(band.width as usize * band.height as usize);
                let mut put = |_: u32, _: u32, rgb: [f32; 3]| pixels.push(rgb);
                let done = renderer.render_picture(math, batch, size, band, &mut memory, &mut put);
                rows.push((band.y, pixels));
                done
            })
        },
        |(y, pixels)| {
            let first = y as usize * width as usize;
            rgb[first..first + pixels.len()].copy_from_slice(&pixels);
            finished((pixels.len() / width as usize) as u32);
        },
    )?;
    Ok((rgb, counters))
}

/// Does the work of one thread: takes tasks until none is left. Returns the sum of the counters.
///
/// `tasks`: a mutex around the iterator of tasks and the function that receives results. `run`: function that does one
/// task, appends the results to its second argument and returns counters. After each task, the thread locks `tasks` and
/// passes each result to the receiving function.
fn each<T, I: Iterator, F: FnMut(T)>(
    tasks: &Mutex<(I, F)>,
    mut run: impl FnMut(I::Item, &mut Vec<T>) -> Result<Counters, RenderError>,
) -> Result<Counters, RenderError> {
    // Ignores poisoning: the shared state stays consistent, and `in_parallel` raises the panic again.
    let lock = || tasks.lock().unwrap_or_else(PoisonError::into_inner);
    let (mut found, mut counters) = (Vec::new(), Counters::default());
    loop {
        let Some(task) = lock().0.next() else { return Ok(counters) };
        counters += run(task, &mut found)?;
        let mut shared = lock();
        found.drain(..).for_each(&mut shared.1);
    }
}

/// Calls `work` once on each of `threads` threads, including the calling thread. Returns the sum of the counters that the
/// calls return. Each call takes tasks from the iterator `tasks`, and passes each result to the function `take`; one
/// mutex guards both. The order of the results is arbitrary.
fn in_parallel<I: Iterator + Send, F: Send>(
    threads: NonZeroUsize,
    tasks: I,
    work: impl Fn(&Mutex<(I, F)>) -> Result<Counters, RenderError> + Sync,
    take: F,
) -> Result<Counters, RenderError> {
    let tasks = Mutex::new((tasks, take));
    std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads.get()).map(|_| scope.spawn(|| work(&tasks))).collect();
        others.into_iter().fold(work(&tasks), |all, other| {
            let found = other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            let mut all = all?;
            all += found?;
            Ok(all)
        })
    })
}
