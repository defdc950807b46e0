//! Sequences of calls through the C interface, with arguments no compiler checks.
//!
//! The host keeps its side of the contract, which is that pointers are NULL or point to what the
//! header says; nothing else. Then: no crash and no panic, canaries around all memory intact, what a
//! failed call would have written untouched, a message exactly where a call failed, and memory of
//! the size that was asked for is enough.
#![no_main]
#![allow(unsafe_code, reason = "the target calls the C interface")]

use arbitrary::{Result, Unstructured};
use libfuzzer_sys::{Corpus, fuzz_target};
use nerf_fuzz::damage::{RECIPES, edit};
use nerf_fuzz::values::{any_f32, any_vec3, mostly};
use nerf_render::{self as ffi, Status};
use nerf_tests::call;
use nerf_tests::memory::Guarded;
use nerf_tests::scenes;
use std::ffi::{c_char, c_void};
use std::ptr::{null, null_mut};

fuzz_target!(|data: &[u8]| -> Corpus {
    let mut u = Unstructured::new(data);
    if host(&mut u).is_ok() { Corpus::Keep } else { Corpus::Reject }
});

/// A call's message buffer, of any capacity.
struct Message(Guarded);

impl Message {
    fn new(u: &mut Unstructured<'_>) -> Result<Self> {
        Ok(Self(Guarded::new(*u.choose(&[256usize, 256, 0, 1, 7])?, 1)))
    }

    fn at(&mut self) -> *mut c_char {
        self.0.at().cast()
    }

    /// Empty on success, a sentence on failure, and always with an end.
    fn check(&self, status: Status) {
        assert!(self.0.surroundings_are_intact(), "{status:?}: written beyond the message");
        assert_ne!(status, Status::Panic, "{}", String::from_utf8_lossy(self.0.bytes()));
        if let Some(&first) = self.0.bytes().first() {
            assert!(self.0.bytes().contains(&0), "{status:?}: a message without an end");
            assert!(self.0.size() == 1 || (status == Status::Ok) == (first == 0), "{status:?} and {first}");
        }
    }
}

/// A structure as a host of another version may have it.
struct Lent {
    words: Vec<u64>,
    before: Vec<u64>,
}

impl Lent {
    fn new<T: Copy>(value: &T, u: &mut Unstructured<'_>) -> Result<Self> {
        let own = size_of::<T>();
        let size = match u.int_in_range(0..=15u8)? {
            0 => u.arbitrary()?,
            1 => own - 1,
            2 => own + 8 * u.int_in_range(0..=3usize)?,
            3 => u.int_in_range(0..=own)?,
            _ => own,
        };
        let mut words = vec![0u64; own.max(size.min(4096)).div_ceil(8)];
        // SAFETY: plain C structures of numbers and pointers, and as many bytes as the words have.
        unsafe { std::ptr::from_ref(value).cast::<u8>().copy_to(words.as_mut_ptr().cast(), own) };
        words[0] = size as u64;
        if u.ratio(1, 32)? && words.len() > own.div_ceil(8) {
            words[own.div_ceil(8)] = 1;
        }
        Ok(Self { before: words.clone(), words })
    }

    fn at<T>(&mut self) -> *mut T {
        self.words.as_mut_ptr().cast()
    }

    fn value<T: Copy>(&self) -> T {
        // SAFETY: made of a `T`, with all its bytes.
        unsafe { self.words.as_ptr().cast::<T>().read() }
    }

    fn is_untouched(&self) -> bool {
        self.words == self.before
    }
}

struct Host {
    blob: Vec<u8>,
    memory: Guarded,
    scene: *const ffi::Scene,
}

fn host(u: &mut Unstructured<'_>) -> Result<()> {
    let mut hosts: Vec<Host> = Vec::new();
    for _ in 0..u.int_in_range(2..=10u8)? {
        if hosts.is_empty() || (hosts.len() < 3 && u.ratio(1, 6)?) {
            hosts.extend(open(u)?);
            continue;
        }
        let at = u.choose_index(hosts.len())?;
        let host = &hosts[at];
        let memory = host.memory.bytes().to_vec();
        match u.int_in_range(0..=11u8)? {
            0..=3 => render(host, u)?,
            4 | 5 => picture(host, u)?,
            6 | 7 => query(host, u)?,
            8 => describe(host, u)?,
            9 => wish(host, u)?,
            10 => cameras(u)?,
            _ => explain(host, u)?,
        }
        assert!(
            host.memory.surroundings_are_intact() && host.memory.bytes() == memory,
            "a scene was written to"
        );
    }
    Ok(())
}

/// Multiply-adds of a ray, about.
fn cost(blob: &nerf_core::Blob<'_>) -> usize {
    let samples = blob.scene().map_or(16, |scene| usize::from(scene.samples.max(16)));
    let coarse = blob.proposal().map_or(0, |it| usize::from(it.samples) * it.architecture().density_macs());
    blob.architecture().parameters() * samples + coarse
}

/// Opens a scene in memory of any size; `None` where that is refused.
fn open(u: &mut Unstructured<'_>) -> Result<Option<Host>> {
    let mut blob = u.choose(&RECIPES)?.blob();
    if u.ratio(1, 4)? {
        blob = edit(&blob, u).unwrap_or(blob);
    }
    // Beyond this one picture takes seconds.
    if nerf_core::Blob::open(&blob).is_ok_and(|blob| cost(&blob) > 200_000) {
        return Ok(None);
    }
    if u.ratio(1, 16)? {
        let bit = u.choose_index(8 * blob.len())?;
        blob[bit / 8] ^= 1 << (bit % 8);
    }
    let kernel = if u.ratio(1, 8)? { u.arbitrary()? } else { u.int_in_range(0..=5)? };
    let options = ffi::OpenOptions {
        kernel,
        reserved: [u32::from(u.ratio(1, 32)?); 7],
        ..call::open_options(nerf_core::Tier::Scalar)
    };
    let mut options = Lent::new(&options, u)?;
    let options: *const ffi::OpenOptions = if u.ratio(1, 8)? { null() } else { options.at() };
    let (mut size, mut align, mut message) = (usize::MAX, usize::MAX, Message::new(u)?);
    let bytes: *const c_void = if u.ratio(1, 32)? { null() } else { blob.as_ptr().cast() };
    let (text, room) = (message.at(), message.0.size());
    // SAFETY: everything lives until the call returns.
    let status =
        unsafe { ffi::nerf_scene_memory(bytes, blob.len(), options, &mut size, &mut align, text, room) };
    message.check(status);
    if status != Status::Ok {
        assert_eq!((size, align), (usize::MAX, usize::MAX), "{status:?}");
    } else {
        assert!(size % 64 == 0 && align == 64);
    }
    let (found, off) = (if status == Status::Ok { size } else { 4096 }, u.int_in_range(0..=15u8)?);
    let (given, misaligned) = match off {
        0 => (found - 1, 0),
        1 => (u.int_in_range(0..=found)?, 0),
        2 => (found, u.int_in_range(0..=63)?),
        3 => (found + u.int_in_range(0..=100usize)?, 0),
        _ => (found, 0),
    };
    let mut memory = Guarded::new(given, misaligned);
    let (at, mut scene) = (memory.at(), null());
    let mut message = Message::new(u)?;
    let (text, room) = (message.at(), message.0.size());
    // SAFETY: as above; blob and memory live as long as the host.
    let opened =
        unsafe { ffi::nerf_scene_open(bytes, blob.len(), options, at, given, &mut scene, text, room) };
    message.check(opened);
    assert!(memory.surroundings_are_intact(), "written beyond the scene's memory");
    let enough = status == Status::Ok && given >= size && misaligned == 0;
    assert_eq!(opened == Status::Ok, enough, "{opened:?} after {status:?}, {given} of {size}");
    if status == Status::Ok && given < size && misaligned == 0 {
        assert_eq!(opened, Status::Memory);
    }
    if opened != Status::Ok {
        assert!(scene.is_null() && memory.is_untouched(), "{opened:?}: a scene half open");
        return Ok(None);
    }
    assert_eq!(scene.cast(), at.cast_const());
    Ok(Some(Host { blob, memory, scene }))
}

fn options(u: &mut Unstructured<'_>) -> Result<ffi::RenderOptions> {
    let flag =
        |u: &mut Unstructured<'_>| if u.ratio(1, 32)? { u.arbitrary() } else { u.int_in_range(0..=1u32) };
    let mut o = ffi::RenderOptions {
        samples: *u.choose(&[4u32, 9, 16, 0, 1, 4097, u32::MAX])?,
        ignore_grid: flag(u)?,
        maths: u.int_in_range(0..=4)?,
        batch_rays: *u.choose(&[0u32, 1, 3, 17, 256, 257, u32::MAX])?,
        batch_samples: *u.choose(&[0u32, 1, 5, 64, 65])?,
        ignore_proposal: flag(u)?,
        normal_blur: mostly(u, 1.0)?,
        reserved: [u32::from(u.ratio(1, 64)?); 4],
        ..call::render_options()
    };
    if u.ratio(1, 3)? {
        (o.transmittance_cut, o.colour_cut) = (mostly(u, 0.01)?, mostly(u, 0.001)?);
        (o.background_set, o.background) = (flag(u)?, any_vec3(u)?);
        let e = &mut o.effects;
        (e.jitter, e.seed) = (flag(u)?, u.arbitrary()?);
        e.anti_aliasing = *u.choose(&[0u32, 1, 2, 4, 257])?;
        (e.aperture_radius, e.focus_distance) = (mostly(u, 0.0)?, mostly(u, 3.0)?);
        (e.exposure, e.tone_map, e.linear) = (mostly(u, 0.5)?, u.int_in_range(0..=3)?, flag(u)?);
    }
    Ok(o)
}

/// A rectangle of an image of `side` pixels, or one that is not.
fn rect(u: &mut Unstructured<'_>, side: [u32; 2]) -> Result<ffi::Rect> {
    if u.ratio(1, 16)? {
        return Ok(ffi::Rect {
            x: u.arbitrary()?,
            y: u.arbitrary()?,
            width: u.int_in_range(0..=9)?,
            height: u.arbitrary::<u32>()? | 1 << 30,
        });
    }
    let (x, y) = (u.int_in_range(0..=side[0] - 1)?, u.int_in_range(0..=side[1] - 1)?);
    let (most_x, most_y) = ((side[0] - x).min(6), (side[1] - y).min(6));
    Ok(ffi::Rect { x, y, width: u.int_in_range(0..=most_x)?, height: u.int_in_range(0..=most_y)? })
}

/// A plane in memory of its own, as large as its strides say.
struct Surface {
    plane: ffi::Plane,
    memory: Guarded,
    /// What a call may write: whole pixels.
    own: Vec<bool>,
    floats: bool,
}

const RGB: [(u32, usize, usize); 4] = [(1, 3, 1), (2, 12, 4), (3, 4, 1), (4, 16, 4)];

/// `None` where the plane is not wanted, or spans more than a test has.
fn surface(
    u: &mut Unstructured<'_>,
    width: u32,
    height: u32,
    colour: bool,
    normal: bool,
) -> Result<Option<Surface>> {
    let (format, size, align) = match (colour, normal) {
        (true, _) => *u.choose(&RGB)?,
        (_, true) => (6, 12, 4),
        _ => (5, 4, 4),
    };
    let step = if u.ratio(1, 16)? { 1 } else { align };
    let pixel = if u.arbitrary()? { 0 } else { size / step * step + step * u.int_in_range(0..=3usize)? };
    let tight = (if pixel == 0 { size } else { pixel }) as i64;
    let row = match u.int_in_range(0..=3u8)? {
        0 => tight * i64::from(width) + (step * u.int_in_range(0..=4usize)?) as i64,
        1 => -(tight * i64::from(width)),
        2 if u.ratio(1, 4)? => i64::from(u.arbitrary::<i8>()?),
        _ => 0,
    };
    let down = if row == 0 { tight * i64::from(width) } else { row };
    let (columns, rows) = (i64::from(width.max(1)) - 1, i64::from(height.max(1)) - 1);
    let span = (columns * tight).saturating_add(rows.saturating_mul(down.abs())).saturating_add(size as i64);
    if span > 1 << 15 || width > 4096 || height > 4096 {
        return Ok(None);
    }
    let mut memory = Guarded::new(span as usize, if u.ratio(1, 16)? { u.int_in_range(0..=63)? } else { 0 });
    let first = if down < 0 { rows * -down } else { 0 };
    let mut own = vec![false; span as usize];
    for y in 0..i64::from(height) {
        for x in 0..i64::from(width) {
            let at = (first + y * down + x * tight) as usize;
            own[at..at + size].fill(true);
        }
    }
    let plane = ffi::Plane {
        // SAFETY: `first` is inside the span.
        data: unsafe { memory.at().cast::<u8>().add(first as usize).cast() },
        pixel_stride: pixel,
        row_stride: row as isize,
        // One that is none, or suits another plane but is no larger than this one's.
        format: if u.ratio(1, 32)? { *u.choose(&[0u32, 5, 7, u32::MAX])? } else { format },
        reserved: u32::from(u.ratio(1, 64)?),
    };
    Ok(Some(Surface { plane, memory, own, floats: size != 3 && format != 3 }))
}

impl Surface {
    fn check(&self, status: Status, cancelled_early: bool) {
        assert!(self.memory.surroundings_are_intact(), "{status:?}: written beyond a plane");
        let between = self.memory.bytes().iter().zip(&self.own).all(|(&byte, &own)| own || byte == 0xc5);
        assert!(between, "{status:?}: written between pixels");
        if cancelled_early || !matches!(status, Status::Ok | Status::Cancelled) {
            assert!(self.memory.is_untouched(), "{status:?}: a failed call wrote pixels");
        }
        if status == Status::Ok && self.floats {
            let bytes: Vec<u8> =
                self.memory.bytes().iter().zip(&self.own).filter_map(|(&b, &own)| own.then_some(b)).collect();
            let finite = bytes.as_chunks().0.iter().all(|&four| f32::from_le_bytes(four).is_finite());
            assert!(finite, "a pixel is not finite");
        }
    }
}

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

fn any_camera(u: &mut Unstructured<'_>) -> Result<ffi::Camera> {
    let size = |u: &mut Unstructured<'_>| u.choose(&[8u32, 5, 17, 1, 65_535, 1 << 24]).copied();
    let mut camera = call::camera(&scenes::camera(8, 8));
    (camera.width, camera.height) = (size(u)?, size(u)?);
    (camera.fx, camera.fy) = (mostly(u, 1.2 * camera.width as f32)?, mostly(u, 1.2 * camera.height as f32)?);
    (camera.cx, camera.cy) = (mostly(u, camera.width as f32 / 2.0)?, mostly(u, camera.height as f32 / 2.0)?);
    if u.ratio(1, 8)? {
        camera.c2w[u.choose_index(12)?] = any_f32(u)?;
        (camera.k1, camera.k2) = (any_f32(u)?, any_f32(u)?);
    }
    camera.reserved[0] = u32::from(u.ratio(1, 64)?);
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

    fn options(&mut self) -> *const ffi::RenderOptions {
        self.options.as_mut().map_or(null(), |options| options.at::<ffi::RenderOptions>().cast_const())
    }
}

/// Workspace of the size that was asked for, or one a host might give in its place.
fn workspace(u: &mut Unstructured<'_>, asked: Option<usize>) -> Result<(Guarded, bool)> {
    let size = asked.unwrap_or(1 << 14);
    let given = match u.int_in_range(0..=15u8)? {
        0 => size - 1,
        1 => u.int_in_range(0..=size)?,
        2 => size + u.int_in_range(0..=200usize)?,
        _ => size,
    };
    let misaligned = if u.ratio(1, 16)? { u.int_in_range(0..=63)? } else { 0 };
    Ok((Guarded::new(given, misaligned), asked.is_some() && given >= size && misaligned == 0))
}

fn render(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
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

fn picture(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
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

fn query(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
    let options = options(u)?;
    let mut options = Lent::new(&options, u)?;
    let n = u.int_in_range(0..=70usize)?;
    let (mut positions, mut dirs) = (Vec::new(), Vec::new());
    for _ in 0..n {
        positions.extend(any_vec3(u)?);
        let dir = glam_unit(any_vec3(u)?);
        dirs.extend(if u.ratio(1, 64)? { any_vec3(u)? } else { dir });
    }
    let colour: bool = u.arbitrary()?;
    let (mut sigma, mut rgb) = (Guarded::new(4 * n, 0), Guarded::new(12 * n, 0));
    let (mut size, mut align, none) = (usize::MAX, usize::MAX, null_mut());
    let asked = {
        let outputs = u32::from(colour) * ffi::NERF_OUTPUT_RGB;
        // SAFETY: the scene is intact and everything lives until the call returns.
        unsafe { ffi::nerf_workspace_size(host.scene, options.at(), outputs, &mut size, &mut align, none, 0) }
    };
    let known = asked == Status::Ok;
    if known && size > 1 << 25 {
        return Ok(());
    }
    let (mut room, enough) = workspace(u, known.then_some(size))?;
    let (mut counters, mut message) = (Lent::new(&call::counters(), u)?, Message::new(u)?);
    let (given, colours) = (room.size(), if colour { rgb.at().cast() } else { null_mut() });
    let (text, capacity) = (message.at(), message.0.size());
    // SAFETY: as above.
    let status = unsafe {
        ffi::nerf_query(
            host.scene,
            options.at(),
            n,
            positions.as_ptr(),
            dirs.as_ptr(),
            sigma.at().cast(),
            colours,
            room.at(),
            given,
            counters.at(),
            text,
            capacity,
        )
    };
    message.check(status);
    let intact = [&room, &sigma, &rgb].into_iter().all(Guarded::surroundings_are_intact);
    assert!(intact, "{status:?}: written beyond the memory that was lent");
    assert!(status != Status::Memory || !enough, "{status:?}: {given} bytes of {size} are too few");
    if status == Status::Ok {
        let sound = |bytes: &[u8]| bytes.as_chunks().0.iter().all(|&four| f32::from_le_bytes(four) >= 0.0);
        assert!(sound(sigma.bytes()), "a density below 0, or none");
        assert!(!colour || sound(rgb.bytes()), "a colour below 0, or none");
    } else {
        assert!(sigma.is_untouched() && rgb.is_untouched() && counters.is_untouched(), "{status:?}");
    }
    Ok(())
}

fn glam_unit(v: [f32; 3]) -> [f32; 3] {
    glam::Vec3::from(v).try_normalize().unwrap_or(glam::Vec3::Z).to_array()
}

fn describe(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
    // SAFETY: numbers and pointers, all of which may be 0.
    let info: ffi::SceneInfo = unsafe { std::mem::zeroed() };
    let mut info = Lent::new(&info, u)?;
    // SAFETY: the scene is intact and the place lives until the call returns.
    let status = unsafe { ffi::nerf_scene_describe(host.scene, info.at()) };
    if status != Status::Ok {
        assert!(
            matches!(status, Status::StructSize | Status::NullPointer) && info.is_untouched(),
            "{status:?}"
        );
    }
    let opened = nerf_core::Blob::open(&host.blob).expect("an open blob");
    let whole = info.words[0] as usize >= size_of::<ffi::SceneInfo>();
    if status == Status::Ok && whole {
        let info: ffi::SceneInfo = info.value();
        assert_eq!(info.parameters, opened.architecture().parameters() as u64);
    }
    // Any number has a text.
    // SAFETY: static and with an end, by contract.
    let text = unsafe { std::ffi::CStr::from_ptr(ffi::nerf_status_text(u.arbitrary()?)) };
    assert!(!text.is_empty());
    Ok(())
}

/// Settings by a wish, which then must be ones that can be rendered with.
fn wish(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
    let given = options(u)?;
    let mut options = Lent::new(&given, u)?;
    let choice = ffi::Choice {
        struct_size: size_of::<ffi::Choice>(),
        loss_db: 0.0,
        cost: 0.0,
        milliseconds: 0.0,
        within: 9,
    };
    let (mut choice, mut message, number) = (Lent::new(&choice, u)?, Message::new(u)?, any_f32(u)?);
    let (text, capacity) = (message.at(), message.0.size());
    // SAFETY: the scene is intact and everything lives until the call returns.
    let status = unsafe {
        if u.arbitrary()? {
            ffi::nerf_quality_within_loss(host.scene, number, options.at(), choice.at(), text, capacity)
        } else {
            ffi::nerf_quality_within_cost(host.scene, number, options.at(), choice.at(), text, capacity)
        }
    };
    message.check(status);
    if status != Status::Ok {
        assert!(options.is_untouched() && choice.is_untouched(), "{status:?}: a wish half granted");
    }
    Ok(())
}

fn cameras(u: &mut Unstructured<'_>) -> Result<()> {
    let mut camera = Lent::new(&any_camera(u)?, u)?;
    let (eye, target, up) = (any_vec3(u)?, any_vec3(u)?, any_vec3(u)?);
    let mut message = Message::new(u)?;
    let (text, capacity) = (message.at(), message.0.size());
    if u.arbitrary()? {
        // SAFETY: everything lives until the call returns.
        let status = unsafe {
            ffi::nerf_camera_look_at(camera.at(), eye.as_ptr(), target.as_ptr(), up.as_ptr(), text, capacity)
        };
        message.check(status);
        assert!(status == Status::Ok || camera.is_untouched(), "{status:?}: a camera half turned");
        return Ok(());
    }
    let (mut origin, mut dir, mut cosine) = ([7.0f32; 3], [7.0f32; 3], 7.0f32);
    let along = if u.arbitrary()? { null_mut() } else { &raw mut cosine };
    let (x, y) = (any_f32(u)?, any_f32(u)?);
    // SAFETY: as above.
    let status = unsafe {
        ffi::nerf_camera_ray(camera.at(), x, y, origin.as_mut_ptr(), dir.as_mut_ptr(), along, text, capacity)
    };
    message.check(status);
    if status == Status::Ok {
        let length = dir.iter().map(|x| x * x).sum::<f32>().sqrt();
        assert!((length - 1.0).abs() < 1e-6, "({x}, {y}): a direction of length {length}");
        assert!(origin.iter().all(|x| x.is_finite()) && cosine.is_finite());
    } else {
        assert_eq!((origin, dir, cosine), ([7.0; 3], [7.0; 3], 7.0), "{status:?}: a ray half written");
    }
    Ok(())
}

fn explain(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
    let options = options(u)?;
    let (mut options, outputs) = (Lent::new(&options, u)?, u.int_in_range(0..=64u32)?);
    let mut counters = Lent::new(&call::counters(), u)?;
    let mut text = Guarded::new(*u.choose(&[0usize, 1, 17, 4096])?, 3);
    let (mut needed, mut message, capacity) = (usize::MAX, Message::new(u)?, text.size());
    let (said, room) = (message.at(), message.0.size());
    // SAFETY: the scene is intact and everything lives until the call returns.
    let status = unsafe {
        let work = if u.arbitrary()? { null() } else { counters.at::<ffi::Counters>().cast_const() };
        ffi::nerf_explain(
            host.scene,
            options.at(),
            outputs,
            work,
            text.at().cast(),
            capacity,
            &mut needed,
            said,
            room,
        )
    };
    message.check(status);
    assert!(text.surroundings_are_intact(), "{status:?}: written beyond the text");
    if status == Status::Ok {
        let end = text.bytes().iter().position(|&byte| byte == 0);
        assert!(capacity == 0 || end.is_some_and(|end| end < needed), "a text without an end");
        assert!(needed > capacity || end.map(|end| end + 1) == Some(needed), "a text of another length");
    } else {
        assert!(text.is_untouched() && needed == usize::MAX, "{status:?}: a text half written");
    }
    Ok(())
}
