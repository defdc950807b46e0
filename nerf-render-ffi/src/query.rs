//! Density and colour at single points.

use crate::boundary::{Message, by_width, call, versioned};
use crate::counters::Counters;
use crate::rays::Floats;
use crate::span::Pieces;
use crate::status::Status;
use crate::target::{Canvas, Plane};
use crate::worker::{State, Worker, with_worker_and};
use core::ffi::c_char;
use glam::Vec3;
use nerf_core::camera::is_unit;
use nerf_core::render::{self, RenderError};
use nerf_core::volume::Pixel;

/// Number of points that are evaluated together. Positions, directions and results of these points lie on the stack.
const CHUNK: usize = 64;

/// Points to evaluate, each with the direction along which the point is seen.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Points {
    /// `sizeof(nerf_points)`.
    pub struct_size: usize,
    /// Number of points; every array and plane below has one element per point.
    pub count: usize,
    /// Position of each point: x, y, z, world space. Density is 0 and colour is black in empty cells of the occupancy
    /// grid. The same holds outside the scene box, unless the scene is unbounded.
    pub positions: Floats,
    /// Direction from the camera to each point, of unit length (squared length within 1e-3 of 1). Not read if
    /// `rgb.data` is NULL.
    pub dirs: Floats,
    /// Plane for the density of each point, 1/world unit. The format is `NERF_FORMAT_F32`. The plane has one row of
    /// `count` pixels; `row_stride` is ignored.
    pub sigma: Plane,
    /// Plane for the colour of each point, `NERF_FORMAT_RGB_F32`: linear light if `options.effects.linear` is 1, else
    /// display-encoded. `data` may be NULL.
    pub rgb: Plane,
}

versioned!(unsafe Points, "points", by_width(64, 112));

/// Evaluates density and colour at points seen along directions.
///
/// `worker`: must have been opened with `NERF_OUTPUT_RGB` unless `points->rgb.data` is NULL. Of the worker's options,
/// only `ignore_occupancy`, `maths` and, for colour, `effects.linear` affect results. `sigma` and `rgb` must not
/// overlap other memory of the call. Returns `NERF_STATUS_DIRECTION` and no results if a direction is not of length 1.
/// `counters`: NULL, or receives counts of the work on success. `message`: NULL, or a buffer for an error message.
///
/// # Safety
/// Pointers are NULL or point to what is described here. The caller has not freed, moved or overwritten the memory of
/// `worker` or its scenes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_query(
    worker: *mut Worker,
    points: *const Points,
    counters: *mut Counters,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    let ask = |worker: &mut State, points: Points| {
        worker.fields()?;
        let n = points.count;
        let colour = !points.rgb.data.is_null();
        let (positions, of_positions) = points.positions.check("points.positions", n, 3)?;
        let (dirs, of_dirs) =
            if colour { points.dirs.check("points.dirs", n, 3)? } else { (positions, Pieces::NONE) };
        let read = [("points.positions", of_positions), ("points.dirs", of_dirs)];
        // SAFETY: the planes are valid, as this function's `# Safety` requires.
        let mut canvas = unsafe { Canvas::of_points(&points.sigma, &points.rgb, n, &read, worker)? };
        // SAFETY: `check` verified that the array holds `n` directions; the caller vouches for the array's memory.
        let dir_at = |i: usize| unsafe { dirs.at::<3>(i) };
        // All directions are checked before the first result is written; the error has the index in the array.
        if colour && let Some(index) = (0..n).find(|&i| !is_unit(Vec3::from(dir_at(i)))) {
            return Err(RenderError::Direction { index, found: dir_at(index) }.into());
        }
        let fields = worker.fields()?;
        let mut work = render::Counters::default();
        for start in (0..n).step_by(CHUNK) {
            let count = CHUNK.min(n - start);
            let (mut p, mut d) = ([[0.0; 3]; CHUNK], [[0.0, 0.0, -1.0]; CHUNK]);
            let (mut s, mut c) = ([0.0; CHUNK], [[0.0; 3]; CHUNK]);
            for i in 0..count {
                // SAFETY: `check` verified that the array holds `n` positions; the caller vouches for its memory.
                p[i] = unsafe { positions.at(start + i) };
                if colour {
                    d[i] = dir_at(start + i);
                }
            }
            let colours = if colour { &mut c[..count] } else { &mut [] };
            work += fields.query(&p[..count], &d[..count], &mut s[..count], colours)?;
            for i in 0..count {
                canvas.put(start + i, &Pixel { rgb: c[i], opacity: s[i], ..Pixel::BLANK });
            }
        }
        Ok(work)
    };
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        unsafe { with_worker_and(worker, points, counters, ask) }
    })
}
