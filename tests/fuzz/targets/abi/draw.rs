//! Frames of scenes and pictures.

use crate::lent::{Lent, Message, workspace};
use crate::planes::{Surface, rect, surface};
use crate::scenes::Host;
use crate::settings::options;
use arbitrary::{Result, Unstructured};
use nerf_fuzz::values::{any_f32, mostly};
use nerf_render::{self as ffi, Status};
use nerf_tests::memory::Guarded;
use nerf_tests::{call, scenes};
use std::ffi::c_void;
use std::ptr::{null, null_mut};

/// Counts calls, and stops at the one whose number it is.
struct Watch {
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
    camera.reserved = u32::from(u.ratio(1, 64)?);
    Ok(camera)
}

/// What a call that draws is given.
struct Drawing {
    options: Option<Lent>,
    rect: Option<ffi::Rect>,
    surfaces: [Option<Surface>; 6],
    target: ffi::Target,
    outputs: u32,
}

impl Drawing {
    fn new(u: &mut Unstructured<'_>, side: [u32; 2], colour_only: bool) -> Result<Self> {
        let options = if u.ratio(1, 8)? { None } else { Some(Lent::new(&options(u)?, u)?) };
        let small = side[0] <= 17 && side[1] <= 17;
        let rect = if small && u.ratio(1, 4)? { None } else { Some(rect(u, side)?) };
        let (width, height) = rect.map_or((side[0], side[1]), |rect| (rect.width, rect.height));
        let mut surfaces = [const { None }; 6];
        for (i, place) in surfaces.iter_mut().enumerate() {
            if (i == 0 && u.ratio(7, 8)?) || (i > 0 && u.ratio(1, if colour_only { 32 } else { 4 })?) {
                *place = surface(u, width, height, i == 0, i == 5)?;
            }
        }
        let plane = |i: usize| surfaces[i].as_ref().map_or(call::NO_PLANE, |surface: &Surface| surface.plane);
        let target = ffi::Target {
            struct_size: size_of::<ffi::Target>(),
            rgb: plane(0),
            opacity: plane(1),
            ray_distance: plane(2),
            z_depth: plane(3),
            median_distance: plane(4),
            normals: plane(5),
        };
        let outputs = surfaces.iter().enumerate().map(|(i, surface)| u32::from(surface.is_some()) << i).sum();
        Ok(Self { options, rect, surfaces, target, outputs })
    }

    /// Lays one of the planes over the scene, its blob or the workspace; says which.
    fn lay_over(&mut self, host: &Host, room: &mut Guarded, u: &mut Unstructured<'_>) -> Result<usize> {
        let t = &mut self.target;
        let mut planes = [
            &mut t.rgb,
            &mut t.opacity,
            &mut t.ray_distance,
            &mut t.z_depth,
            &mut t.median_distance,
            &mut t.normals,
        ];
        let index = planes.iter().position(|plane| !plane.data.is_null()).unwrap_or(0);
        let plane = &mut planes[index];
        let blob = host.blob.as_ptr().cast_mut().cast::<c_void>();
        let places = [room.at(), host.scene.cast_mut().cast(), blob];
        let place = *u.choose(&places)?;
        // Aligned, and with the first pixel inside.
        plane.data = place.wrapping_byte_add(place.align_offset(4));
        Ok(index)
    }

    fn options(&mut self) -> *const ffi::RenderOptions {
        self.options.as_mut().map_or(null(), |options| options.at::<ffi::RenderOptions>().cast_const())
    }
}

pub fn render(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
    let camera = any_camera(u)?;
    let mut drawing = Drawing::new(u, [camera.width, camera.height], false)?;
    let mut camera = Lent::new(&camera, u)?;
    let (mut size, mut align, none) = (usize::MAX, usize::MAX, null_mut());
    let outputs = if u.ratio(1, 64)? { u.arbitrary()? } else { drawing.outputs };
    let options = drawing.options();
    // SAFETY: the scene is intact and everything lives until the call returns.
    let asked =
        unsafe { ffi::nerf_workspace_size(host.scene, options, outputs, &mut size, &mut align, none, 0) };
    if asked != Status::Ok {
        assert_eq!((size, align), (usize::MAX, usize::MAX), "{asked:?}");
    }
    let known = asked == Status::Ok && outputs == drawing.outputs;
    // Far more than any small scene needs.
    if known && size > 1 << 25 {
        return Ok(());
    }
    let (mut room, enough) = workspace(u, known.then_some(size))?;
    let taken = if u.ratio(1, 24)? { Some(drawing.lay_over(host, &mut room, u)?) } else { None };
    let mut target = Lent::new(&drawing.target, u)?;
    let mut counters = if u.ratio(1, 4)? { None } else { Some(Lent::new(&call::counters(), u)?) };
    let mut seen =
        Watch { calls: 0, stop: if u.ratio(1, 8)? { u.int_in_range(0..=3)? } else { u32::MAX }, done: 0 };
    let mut message = Message::new(u)?;
    let scene = if u.ratio(1, 64)? { null() } else { host.scene };
    let rect = drawing.rect.as_ref().map_or(null(), |rect| rect as *const ffi::Rect);
    let given = room.size();
    let out = counters.as_mut().map_or(null_mut(), |counters| counters.at());
    let (text, capacity) = (message.at(), message.0.size());
    // SAFETY: as above.
    let status = unsafe {
        ffi::nerf_render(
            scene,
            camera.at(),
            options,
            rect,
            target.at(),
            room.at(),
            given,
            Some(watch),
            (&raw mut seen).cast(),
            out,
            text,
            capacity,
        )
    };
    message.check(status);
    assert!(room.surroundings_are_intact(), "{status:?}: written beyond the workspace");
    // A target of an older version has fewer planes, which need less.
    let whole = target.words[0] as usize >= size_of::<ffi::Target>();
    if let Some(index) = taken.filter(|&index| index < 4 || whole) {
        let empty = drawing.rect.is_some_and(|rect| rect.width == 0 || rect.height == 0);
        assert!(status != Status::Ok || empty, "plane {index} lies where it must not");
        assert!(status != Status::Overlap || room.is_untouched(), "the workspace was written to");
        return Ok(());
    }
    if known && whole {
        assert!(status != Status::Ok || enough, "{status:?} in {given} bytes, misaligned or of {size}");
        assert!(status != Status::Memory || !enough, "{status:?}: {given} bytes of {size} are too few");
    }
    if status == Status::Cancelled {
        assert!(seen.calls == seen.stop.saturating_add(1));
    }
    for (i, surface) in drawing.surfaces.iter().enumerate() {
        let read = i < 4 || whole;
        if let Some(surface) = surface.as_ref().filter(|_| read) {
            surface.check(status, status == Status::Cancelled && seen.done == 0);
        }
    }
    if let Some(counters) = counters {
        if status == Status::Ok {
            let work: ffi::Counters = counters.value();
            let [width, height] = drawing.rect.map_or([8, 8], |rect| [rect.width, rect.height]);
            let empty = width == 0 || height == 0;
            assert_eq!(work.rays == 0, empty, "{work:?}");
        } else {
            assert!(counters.is_untouched(), "{status:?}: counters were written");
        }
    }
    Ok(())
}

pub fn picture(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
    let side =
        [*u.choose(&[6u32, 1, 17, 1 << 23, u32::MAX])?, *u.choose(&[5u32, 1, 16, 1 << 23, (1 << 23) + 1])?];
    let mut drawing = Drawing::new(u, side, true)?;
    let (mut size, mut align, none) = (usize::MAX, usize::MAX, null_mut());
    let options = drawing.options();
    // SAFETY: the scene is intact and everything lives until the call returns.
    let asked =
        unsafe { ffi::nerf_picture_workspace_size(host.scene, options, &mut size, &mut align, none, 0) };
    if asked != Status::Ok {
        assert_eq!((size, align), (usize::MAX, usize::MAX), "{asked:?}");
    }
    let known = asked == Status::Ok;
    let (mut room, enough) = workspace(u, known.then_some(size))?;
    let (mut target, mut message) = (Lent::new(&drawing.target, u)?, Message::new(u)?);
    let mut counters = Lent::new(&call::counters(), u)?;
    let rect = drawing.rect.as_ref().map_or(null(), |rect| rect as *const ffi::Rect);
    let (given, out) = (room.size(), counters.at());
    let (text, capacity) = (message.at(), message.0.size());
    // SAFETY: as above.
    let status = unsafe {
        ffi::nerf_render_picture(
            host.scene,
            side[0],
            side[1],
            options,
            rect,
            target.at(),
            room.at(),
            given,
            None,
            null_mut(),
            out,
            text,
            capacity,
        )
    };
    message.check(status);
    assert!(room.surroundings_are_intact(), "{status:?}: written beyond the workspace");
    assert!(!known || status != Status::Ok || enough, "{status:?} in {given} bytes, misaligned or of {size}");
    assert!(status != Status::Memory || !enough, "{status:?}: {given} bytes of {size} are too few");
    let whole = target.words[0] as usize >= size_of::<ffi::Target>();
    for surface in drawing.surfaces.iter().take(if whole { 6 } else { 4 }).flatten() {
        surface.check(status, false);
    }
    assert!(status == Status::Ok || counters.is_untouched(), "{status:?}: counters were written");
    Ok(())
}
