//! Frames of scenes and pictures.

use crate::lent::{Lent, Message};
use crate::planes::{Surface, rect, surface};
use crate::scenes::Host;
use crate::settings::options;
use crate::workers::{self, Worker};
use arbitrary::{Result, Unstructured};
use nerf_fuzz::values::{any_f32, mostly, rarely};
use nerf_render::{self as ffi, Status};
use nerf_testing::{call, scenes};
use std::ffi::c_void;
use std::ptr::{null, null_mut};

/// Counts calls, and stops at the one whose number it is.
struct Watch {
    worker: *mut ffi::Worker,
    calls: u32,
    stop: u32,
    done: u64,
}

unsafe extern "C-unwind" fn watch(user: *mut c_void, done: u64, all: u64) -> i32 {
    // SAFETY: `user` is the watch of the call.
    let watch = unsafe { &mut *user.cast::<Watch>() };
    assert!(done >= watch.done && done <= all, "progress fell");
    watch.done = done;
    watch.calls += 1;
    // SAFETY: the worker is intact, and all else is NULL.
    let again = unsafe { ffi::nerf_explain(watch.worker, null(), null_mut(), 0, null_mut(), null_mut(), 0) };
    assert_eq!(again, Status::Busy, "a worker that is at work");
    i32::from(watch.calls > watch.stop)
}

pub fn any_camera(u: &mut Unstructured<'_>) -> Result<ffi::Camera> {
    let size =
        |u: &mut Unstructured<'_>| u.choose(&[8u32, 5, 17, 1, 65_535, 1 << 23, (1 << 23) + 1]).copied();
    let mut camera = call::camera(&scenes::camera(8, 8));
    (camera.width, camera.height) = (size(u)?, size(u)?);
    (camera.fx, camera.fy) = (mostly(u, 1.2 * camera.width as f32)?, mostly(u, 1.2 * camera.height as f32)?);
    (camera.cx, camera.cy) = (mostly(u, camera.width as f32 / 2.0)?, mostly(u, camera.height as f32 / 2.0)?);
    if u.ratio(1, 8)? {
        camera.c2w[u.choose_index(12)?] = any_f32(u)?;
        (camera.k1, camera.k2) = (any_f32(u)?, any_f32(u)?);
    }
    if u.ratio(1, 8)? {
        (camera.k3, camera.k4, camera.lens_model) = (any_f32(u)?, any_f32(u)?, u.int_in_range(0..=2)?);
    }
    camera.reserved = u32::from(rarely(u, 64)?);
    Ok(camera)
}

/// What a call that draws is given.
pub struct Drawing {
    pub options: Option<Lent>,
    pub rect: Option<ffi::Rect>,
    pub surfaces: [Option<Surface>; 6],
    /// What is read, with its bytes.
    limits: Vec<(Surface, Vec<u8>)>,
    pub target: ffi::Target,
    pub outputs: u32,
}

impl Drawing {
    /// Planes of a rectangle of an image of `side` pixels.
    fn new(u: &mut Unstructured<'_>, side: [u32; 2], colour_only: bool) -> Result<Self> {
        let small = side[0] <= 17 && side[1] <= 17;
        let rect = if small && u.ratio(1, 4)? { None } else { Some(rect(u, side)?) };
        let size = rect.map_or((side[0], side[1]), |rect| (rect.width, rect.height));
        let mut drawing = Self::of(u, size, colour_only)?;
        drawing.rect = rect;
        if u.ratio(1, if colour_only { 32 } else { 4 })? {
            let which = u.int_in_range(0..=15u8)?;
            for (place, wanted) in [
                (&mut drawing.target.limit_ray_distance, which & 1 == 0 || which == 15),
                (&mut drawing.target.limit_z_depth, which & 1 == 1),
            ] {
                if wanted && let Some(mut plane) = surface(u, size.0, size.1, false, false)? {
                    let bytes = plane.fill(3.0, u)?;
                    *place = plane.plane;
                    drawing.limits.push((plane, bytes));
                }
            }
        }
        Ok(drawing)
    }

    /// Planes of so many pixels, and options.
    pub fn of(u: &mut Unstructured<'_>, (width, height): (u32, u32), colour_only: bool) -> Result<Self> {
        let options = if u.ratio(1, 8)? { None } else { Some(Lent::new(&options(u)?, u)?) };
        let mut surfaces = [const { None }; 6];
        for (i, place) in surfaces.iter_mut().enumerate() {
            if (i == 0 && u.ratio(7, 8)?) || (i > 0 && u.ratio(1, if colour_only { 32 } else { 4 })?) {
                *place = surface(u, width, height, i == 0, i == 5)?;
            }
        }
        let plane = |i: usize| surfaces[i].as_ref().map_or(call::NO_PLANE, |surface: &Surface| surface.plane);
        let target = ffi::Target {
            opacity: plane(1),
            ray_distance: plane(2),
            z_depth: plane(3),
            median_distance: plane(4),
            normals: plane(5),
            ..call::target(plane(0))
        };
        let outputs = surfaces.iter().enumerate().map(|(i, surface)| u32::from(surface.is_some()) << i).sum();
        Ok(Self { options, rect: None, surfaces, limits: Vec::new(), target, outputs })
    }

    /// A worker for it; `None` where that is refused. What it was opened with is gone by then.
    pub fn worker(&mut self, hosts: &[Host], at: usize, u: &mut Unstructured<'_>) -> Result<Option<Worker>> {
        let outputs = match u.int_in_range(0..=63u8)? {
            63 => u.arbitrary()?,
            56..=62 => self.outputs | u.int_in_range(0..=63u32)?,
            54 | 55 => u.int_in_range(0..=63u32)?,
            _ => self.outputs,
        };
        let mut options = self.options.take();
        let options =
            options.as_mut().map_or(null(), |options| options.at::<ffi::RenderOptions>().cast_const());
        workers::open(hosts, at, options, outputs, u)
    }

    /// Lays one of the planes over one of those places.
    pub fn lay_over(&mut self, places: &[*mut c_void], u: &mut Unstructured<'_>) -> Result<()> {
        let t = &mut self.target;
        let planes = [
            &mut t.rgb,
            &mut t.opacity,
            &mut t.ray_distance,
            &mut t.z_depth,
            &mut t.median_distance,
            &mut t.normals,
        ];
        let index = planes.iter().position(|plane| !plane.data.is_null()).unwrap_or(0);
        let place = *u.choose(places)?;
        // Aligned, and with the first pixel inside.
        planes[index].data = place.wrapping_byte_add(place.align_offset(4));
        Ok(())
    }

    fn rect(&self) -> *const ffi::Rect {
        self.rect.as_ref().map_or(null(), |rect| rect as *const ffi::Rect)
    }

    /// After a call: what was asked for alone was written, and nothing that was read.
    pub fn check(&self, status: Status, cancelled_early: bool, sound: fn(f32) -> bool) {
        for surface in self.surfaces.iter().flatten() {
            surface.check(status, cancelled_early, sound);
        }
        for (limit, before) in &self.limits {
            let intact = limit.memory.surroundings_are_intact() && limit.memory.bytes() == before;
            assert!(intact, "{status:?}: a limit was written to");
        }
    }

    /// The bytes of all planes.
    fn bytes(&self) -> Vec<u8> {
        self.surfaces.iter().flatten().flat_map(|surface| surface.memory.bytes()).copied().collect()
    }
}

pub fn render(hosts: &[Host], at: usize, u: &mut Unstructured<'_>) -> Result<()> {
    let camera = any_camera(u)?;
    let mut drawing = Drawing::new(u, [camera.width, camera.height], false)?;
    let mut camera = Lent::new(&camera, u)?;
    let Some(mut worker) = drawing.worker(hosts, at, u)? else { return Ok(()) };
    let taken = rarely(u, 24)?;
    if taken {
        drawing.lay_over(&worker.places(hosts, u)?, u)?;
    }
    let mut target = Lent::new(&drawing.target, u)?;
    let mut counters = if u.ratio(1, 4)? { None } else { Some(Lent::new(&call::counters(), u)?) };
    let stop = if u.ratio(1, 8)? { u.int_in_range(0..=3)? } else { u32::MAX };
    let mut seen = Watch { worker: worker.handle, calls: 0, stop, done: 0 };
    let mut frame = ffi::Frame {
        rect: drawing.rect(),
        progress: Some(watch),
        user: (&raw mut seen).cast(),
        ..call::whole_frame(camera.at(), target.at())
    };
    if rarely(u, 64)? {
        (frame.width, frame.height) = (u.arbitrary()?, 8);
    }
    let (mut frame, mut message, handle) = (Lent::new(&frame, u)?, Message::new(u)?, worker.handle(u)?);
    let out = counters.as_mut().map_or(null_mut(), |counters| counters.at());
    let (text, capacity) = (message.at(), message.0.size());
    let before = worker.memory.bytes().to_vec();
    // SAFETY: worker and scenes are intact and everything lives until the call returns.
    let status = unsafe { ffi::nerf_render(handle, frame.at(), out, text, capacity) };
    message.check(status);
    worker.check(status);
    let empty = drawing.rect.is_some_and(|rect| rect.width == 0 || rect.height == 0);
    if taken {
        assert!(status != Status::Ok || empty, "a plane lies where it must not");
        assert!(status != Status::Overlap || worker.memory.bytes() == before, "the worker was written to");
        return Ok(());
    }
    if status == Status::Ok {
        assert_eq!(drawing.outputs & !worker.outputs, 0, "planes that the worker was not opened for");
    }
    if status == Status::Cancelled {
        assert!(seen.calls == seen.stop.saturating_add(1));
    }
    drawing.check(status, status == Status::Cancelled && seen.done == 0, f32::is_finite);
    if let Some(counters) = counters {
        if status == Status::Ok {
            let work: ffi::Counters = counters.value();
            assert_eq!(work.rays == 0, empty, "{work:?}");
        } else {
            assert!(counters.is_untouched(), "{status:?}: counters were written");
        }
    }
    if matches!(status, Status::Ok | Status::Cancelled) && u.ratio(1, 4)? {
        // Whatever it did before, and whether or not that was to the end.
        let mut twice = || {
            (seen.calls, seen.stop, seen.done) = (0, u32::MAX, 0);
            // SAFETY: as above.
            let status = unsafe { ffi::nerf_render(worker.handle, frame.at(), null_mut(), null_mut(), 0) };
            assert_eq!(status, Status::Ok, "a worker draws once");
            drawing.bytes()
        };
        assert!(twice() == twice(), "a worker draws two pictures");
    }
    Ok(())
}

pub fn picture(hosts: &[Host], at: usize, u: &mut Unstructured<'_>) -> Result<()> {
    let side =
        [*u.choose(&[6u32, 1, 17, 1 << 23, u32::MAX])?, *u.choose(&[5u32, 1, 16, 1 << 23, (1 << 23) + 1])?];
    let mut drawing = Drawing::new(u, side, true)?;
    let Some(mut worker) = drawing.worker(hosts, at, u)? else { return Ok(()) };
    let taken = rarely(u, 24)?;
    if taken {
        drawing.lay_over(&worker.places(hosts, u)?, u)?;
    }
    let (mut target, mut camera) = (Lent::new(&drawing.target, u)?, Lent::new(&any_camera(u)?, u)?);
    let frame = ffi::Frame {
        rect: drawing.rect(),
        width: side[0],
        height: side[1],
        ..call::whole_frame(if rarely(u, 64)? { camera.at() } else { null() }, target.at())
    };
    let (mut frame, mut message, handle) = (Lent::new(&frame, u)?, Message::new(u)?, worker.handle(u)?);
    let mut counters = Lent::new(&call::counters(), u)?;
    let (text, capacity) = (message.at(), message.0.size());
    // SAFETY: worker and scenes are intact and everything lives until the call returns.
    let status = unsafe { ffi::nerf_render_picture(handle, frame.at(), counters.at(), text, capacity) };
    message.check(status);
    worker.check(status);
    assert!(status == Status::Ok || counters.is_untouched(), "{status:?}: counters were written");
    if taken {
        let empty = drawing.rect.is_some_and(|rect| rect.width == 0 || rect.height == 0);
        assert!(status != Status::Ok || empty, "a plane lies where it must not");
        return Ok(());
    }
    drawing.check(status, false, f32::is_finite);
    Ok(())
}
