//! A worker: scenes, options, outputs and memory, checked once for any number of calls.
//!
//! This file is longer than 400 lines, since the request, its checks and the division of its memory stay together.

use crate::boundary::{
    Message, Out, Versioned, by_width, call, call_for_size, check_out, check_zeros, read_versioned, span_of,
    versioned,
};
use crate::counters::Counters;
use crate::failure::Failure;
#[cfg(feature = "instances")]
use crate::instance::Instance;
use crate::outputs::read_outputs;
use crate::render_options::{RenderOptions, Settings};
use crate::scene::Scene;
use crate::span::{Span, check_aligned};
use crate::status::Status;
use crate::tile_pixels::TilePixels;
use core::cell::UnsafeCell;
use core::ffi::{c_char, c_void};
use core::sync::atomic::{AtomicBool, Ordering};
use nerf_core::memory::{Arena, Line, lines_for};
use nerf_core::plan::{Batch, Outputs, Plan, PlanError};
use nerf_core::render::{self, TILE_SIDE};
#[cfg(feature = "instances")]
use nerf_core::space::Placement;

/// A request to open a worker. The library reads the request only during the call. The scenes that the request names
/// must stay open until the worker is closed.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Request {
    /// `sizeof(nerf_request)`.
    pub struct_size: usize,
    /// Scene or 2D field, in its own coordinates; NULL if there are `instances`.
    pub scene: *const Scene,
    /// Scenes that the host has placed in its own world, or NULL. If not NULL, cameras, rays, points and distances are
    /// in the host's world. Where instances overlap, densities add, and colours are averaged with the densities as
    /// weights. An unbounded scene must be the last instance. The background is that of the last instance. Proposal
    /// networks are not used. Only in a library built with the feature `instances`.
    pub instances: *const crate::instance::Instance,
    /// Number of instances; 0 if `scene` is set.
    pub instance_count: usize,
    /// Options of the frames; NULL for the defaults.
    pub options: *const RenderOptions,
    /// `NERF_OUTPUT_*` flags, or-ed, of the planes that the worker renders. For a worker that only `nerf_query` uses:
    /// `NERF_OUTPUT_RGB` if colours are requested, else 0.
    pub outputs: u32,
    /// Reserved; must be 0.
    pub reserved: u32,
}

versioned!(unsafe Request, "request", by_width(28, 48));

/// A scene or 2D field that a worker renders.
pub(crate) struct Member {
    pub scene: &'static Scene,
    /// Plan (stages and settings) of the scene's frames; `None` for a 2D field.
    pub plan: Option<Plan<'static>>,
}

/// A renderer of given scenes, with given options, at the beginning of the memory passed to `nerf_worker_open`.
///
/// A worker borrows the scenes and owns nothing: there is nothing to close. Only one call at a time may use a worker: a
/// concurrent call returns `NERF_STATUS_BUSY`, as does every call after `NERF_STATUS_PANIC`. A worker is valid until
/// the caller reuses the worker's memory or a scene's memory.
#[repr(align(64))]
pub struct Worker {
    /// True while a call uses `state`. The flag lies outside of the state, since concurrent calls read the flag.
    busy: AtomicBool,
    state: UnsafeCell<State>,
}

/// Renderer of a worker's scenes, or, for a 2D field, only a workspace.
#[allow(clippy::large_enum_variant, reason = "one lies in each worker, and nothing here allocates")]
pub(crate) enum Work {
    Fields(render::Worker<'static>),
    /// Workspace for rendering a 2D field; the field's scene has the renderer.
    Picture(&'static mut [Line]),
}

/// State of a worker. A call has exclusive access from setting [`Worker::busy`] until clearing it.
pub(crate) struct State {
    pub(crate) work: Work,
    pub(crate) members: &'static [Member],
    pub(crate) settings: Settings,
    /// Outputs that the worker was opened for: `NERF_OUTPUT_*`, or-ed.
    pub(crate) outputs: u32,
    /// Pixels of the tile in progress. Only a finished tile is copied to the target, even if a call panics.
    pub(crate) pixels: TilePixels<'static>,
    pub(crate) memory: Span,
    /// Size of the memory that the worker takes, bytes.
    pub(crate) size: usize,
}

impl Worker {
    /// Marks the worker as busy. Returns true if the worker was busy already.
    fn take(&self) -> bool {
        #[cfg(target_has_atomic = "8")]
        let taken = self.busy.swap(true, Ordering::Acquire);
        #[cfg(not(target_has_atomic = "8"))]
        let taken = {
            let taken = self.busy.load(Ordering::Acquire);
            self.busy.store(true, Ordering::Relaxed);
            taken
        };
        taken
    }
}

/// Calls `body` with exclusive access to the worker's state; `Failure::Busy` during another call and after a panic.
///
/// # Safety
/// `worker` is NULL or the handle of an opened worker. The caller has not freed, moved or overwritten the memory of the
/// worker or its scenes, and uses the worker's memory through this handle alone.
pub(crate) unsafe fn with_worker(
    worker: *mut Worker,
    body: impl FnOnce(&mut State) -> Result<(), Failure>,
) -> Result<(), Failure> {
    if worker.is_null() {
        return Err(Failure::Null("worker"));
    }
    check_aligned("worker", worker as usize, align_of::<Worker>())?;
    // SAFETY: `worker` is not NULL, is aligned, and is valid, as this function's `# Safety` requires. A running call,
    // of another thread or further up this stack, may hold a `&mut State`, which stays valid under Stacked and Tree
    // Borrows: flag and state lie in `UnsafeCell`s, about whose content the shared reference made here claims nothing.
    let worker = unsafe { &*worker };
    if worker.take() {
        return Err(Failure::Busy);
    }
    // SAFETY: the flag was clear, so no other call has a reference to the state, or gets one before this call ends.
    let result = body(unsafe { &mut *worker.state.get() });
    worker.busy.store(false, Ordering::Release);
    result
}

/// Calls `body` with the worker's state and a copy of `*asked`. Writes the result of `body` to `counters` if not NULL.
///
/// # Safety
/// `worker` as in [`with_worker`]. `asked` and `counters`: NULL, or address of a structure of `struct_size` bytes.
pub(crate) unsafe fn with_worker_and<T: Versioned>(
    worker: *mut Worker,
    asked: *const T,
    counters: *mut Counters,
    body: impl FnOnce(&mut State, T) -> Result<render::Counters, Failure>,
) -> Result<(), Failure> {
    let count = |state: &mut State| {
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        let (asked, out) = unsafe { (read_versioned(asked)?, Out::new_or_none(counters)?) };
        let work = body(state, asked)?;
        if let Some(out) = out {
            out.write(work.into());
        }
        Ok(())
    };
    // SAFETY: the arguments are valid, as this function's `# Safety` requires.
    unsafe { with_worker(worker, count) }
}

impl State {
    pub(crate) fn check_apart(&self, name: &'static str, span: Span) -> Result<(), Failure> {
        span.check_apart(name, self.memory, "the worker's memory")?;
        self.members.iter().try_for_each(|member| member.scene.check_apart(name, span))
    }

    /// Returns the renderer of radiance fields; an error for a 2D field.
    pub(crate) fn fields(&mut self) -> Result<&mut render::Worker<'static>, Failure> {
        match &mut self.work {
            Work::Fields(fields) => Ok(fields),
            Work::Picture(_) => Err(PlanError::NotAScene.into()),
        }
    }
}

/// Computes the width and height of a frame's tiles, pixels. A tile has at most as many pixels as a batch has rays.
pub(crate) fn tile_size(batch: Batch) -> (u32, u32) {
    let side = TILE_SIDE as usize;
    let width = side.min(batch.rays).max(1);
    (width as u32, side.min(batch.rays / width).max(1) as u32)
}

/// A request that is checked except for its scenes; each scene is checked when it is read.
#[derive(Clone, Copy)]
struct Checked {
    request: Request,
    settings: Settings,
    outputs: Outputs,
}

/// Sizes of the parts of a worker's memory. In lines of 64 bytes: the [`Worker`] itself (`own`), a tile's pixels
/// (`pixels`), and the renderer's workspace (`rest`). In bytes: the whole memory (`bytes`), which also holds the list
/// of scenes.
struct Shares {
    own: usize,
    pixels: usize,
    rest: usize,
    bytes: usize,
}

impl Checked {
    /// Reads and checks the request at `at`.
    /// # Safety
    /// `at` is NULL or points to a request whose pointers are NULL or point to what [`Request`] describes.
    unsafe fn read(at: *const Request) -> Result<Self, Failure> {
        // SAFETY: `at` is valid, as this function's `# Safety` requires.
        let request = unsafe { read_versioned(at)? };
        check_zeros("request.reserved", &[request.reserved])?;
        let placed = !request.instances.is_null();
        if !placed && request.scene.is_null() {
            return Err(Failure::Null("request.scene"));
        }
        if placed != request.scene.is_null() || placed != (request.instance_count > 0) {
            return Err(Failure::SceneOrInstances);
        }
        if placed && !cfg!(feature = "instances") {
            return Err(Failure::NotBuilt("request.instances"));
        }
        // SAFETY: `options` is valid, as this function's `# Safety` requires.
        let mut settings = unsafe { Settings::read(request.options)? };
        if placed {
            // Instances are sampled uniformly, without proposal networks.
            settings.frame.quality.proposal = false;
        }
        let outputs = read_outputs("request.outputs", request.outputs)?;
        Ok(Self { request, settings, outputs })
    }

    /// Returns whether the request has instances, rather than a single scene.
    fn placed(&self) -> bool {
        cfg!(feature = "instances") && !self.request.instances.is_null()
    }

    fn count(&self) -> usize {
        if self.placed() { self.request.instance_count } else { 1 }
    }

    /// Returns the scene of instance `_index`; the request's only scene if the request has no instances.
    ///
    /// # Safety
    /// `_index` is below [`Checked::count`]. The request is as in [`Checked::read`]; its scenes are valid during `'a`.
    unsafe fn scene<'a>(&self, _index: usize) -> Result<&'a Scene, Failure> {
        #[cfg(feature = "instances")]
        if self.placed() {
            // SAFETY: `_index` is below the number of instances, which are valid (`# Safety`).
            let scene = unsafe {
                Instance::read(self.request.instances, _index).and_then(|instance| Scene::of(instance.scene))
            };
            return scene.map_err(|failure| self.of_scene(_index, failure));
        }
        // SAFETY: `scene` is valid, as this function's `# Safety` requires.
        unsafe { Scene::of(self.request.scene) }
    }

    /// Returns the transform of instance `index`; the identity if the request has no instances.
    /// # Safety
    /// `index` is below [`Checked::count`]. The request is valid as in [`Checked::read`].
    #[cfg(feature = "instances")]
    unsafe fn placement(&self, index: usize) -> Result<Placement, Failure> {
        if !self.placed() {
            return Ok(Placement::IDENTITY);
        }
        // SAFETY: `index` is below the number of instances; they are valid, as this function's `# Safety` requires.
        unsafe { Instance::read(self.request.instances, index)?.placement(index) }
    }

    /// Converts `failure` to a failure of instance `_index`; leaves it unchanged if the request has no instances.
    fn of_scene(&self, _index: usize, failure: Failure) -> Failure {
        #[cfg(feature = "instances")]
        if self.placed() {
            return failure.of_instance(_index);
        }
        failure
    }

    /// Makes the plan of scene `index`. Returns `None` for a 2D field; a 2D field among instances is an error.
    /// `scale`: world units per unit of length in the scene.
    fn plan(&self, index: usize, scene: &Scene, scale: f32) -> Result<Option<Plan<'static>>, Failure> {
        let blob = scene.renderer().blob();
        if blob.picture().is_some() && !self.placed() {
            return Ok(None);
        }
        let plan = self.settings.plan(blob, self.outputs, scale);
        plan.map(Some).map_err(|failure| self.of_scene(index, failure))
    }

    /// Computes the sizes of the parts of the worker's memory; an error if a scene does not suit the request.
    /// # Safety
    /// The request and its scenes are valid, as [`Checked::scene`] requires.
    unsafe fn shares(&self) -> Result<Shares, Failure> {
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        let (index, last) = (self.count() - 1, unsafe { self.scene(self.count() - 1)? });
        let batch = self.settings.batch;
        let rest = match self.plan(index, last, 1.0)? {
            #[cfg(feature = "instances")]
            Some(plan) if self.placed() => {
                // Makes the plan of each instance, so that a request fails here if opening the worker would fail.
                for index in 0..self.count() {
                    // SAFETY: the arguments are valid, as this function's `# Safety` requires.
                    let scene = unsafe { self.scene(index)? };
                    // SAFETY: the arguments are valid, as this function's `# Safety` requires.
                    let scale = unsafe { self.placement(index)? }.scale();
                    self.plan(index, scene, scale)?;
                }
                // SAFETY: the scenes are valid, as this function's `# Safety` requires.
                let scenes = (0..self.count()).filter_map(|index| unsafe { self.scene(index) }.ok());
                render::Worker::instances_lines(scenes.map(Scene::renderer), &plan)
            }
            Some(plan) => last.renderer().workspace_lines(&plan),
            None => last.renderer().picture_workspace_lines(batch),
        };
        let (width, height) = tile_size(batch);
        let (own, pixels) =
            (lines_for::<Worker>(1), TilePixels::lines((width * height) as usize, self.outputs));
        let members = lines_for::<Member>(self.count());
        #[cfg(feature = "instances")]
        let members =
            members + if self.placed() { lines_for::<render::Instance<'_>>(self.count()) } else { 0 };
        let lines = (own + members + pixels).checked_add(rest);
        let bytes = lines.and_then(|lines| lines.checked_mul(size_of::<Line>()));
        Ok(Shares { own, pixels, rest, bytes: bytes.ok_or(Failure::Overflow("memory"))? })
    }
}

/// Computes the size and alignment of the memory that a worker for a request takes.
///
/// The size depends on the scene's network, the outputs, the batch and the number of instances, not on the image size.
///
/// `size` and `align`, bytes, are written on success only. `message`: NULL, or a buffer for an error message.
///
/// # Safety
/// Pointers are NULL or point to what is described here. The caller has not freed, moved or overwritten the memory of
/// the scenes or their files' bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_worker_size(
    request: *const Request,
    size: *mut usize,
    align: *mut usize,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    let message = Message { text: message, capacity: message_capacity };
    // SAFETY: the arguments are valid, as this function's `# Safety` requires.
    unsafe { call_for_size((size, align), message, || Ok(Checked::read(request)?.shares()?.bytes)) }
}

/// Opens a worker in the caller's memory. Checks the request and lays out the memory once; later calls repeat neither.
///
/// The worker borrows `memory` and the scenes: the caller must not move or change these while the worker is used. Each
/// thread needs a worker of its own. `memory` must have at least the size and alignment from `nerf_worker_size`, and
/// must not overlap scenes, scene files or any other argument. `worker` receives the handle on success only; there is
/// nothing to close. `message`: NULL, or a buffer for an error message.
///
/// # Safety
/// Pointers are NULL or point to what is described here. The caller has not freed, moved or overwritten the memory of
/// the scenes or their files' bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_worker_open(
    request: *const Request,
    memory: *mut c_void,
    memory_size: usize,
    worker: *mut *mut Worker,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    let message = Message { text: message, capacity: message_capacity };
    call(message, || {
        check_out("worker", worker)?;
        let out = Span::of("worker", worker, 1)?;
        // SAFETY: `request` is valid, as this function's `# Safety` requires.
        let checked = unsafe { Checked::read(request)? };
        // SAFETY: `request` is valid, as this function's `# Safety` requires.
        let shares = unsafe { checked.shares()? };
        Span::of("memory", memory.cast::<Line>().cast_const(), 0)?;
        let span = Span::new("memory", memory, memory_size)?;
        let Request { options, instances, instance_count, .. } = checked.request;
        for (name, first, count) in [
            ("request", request.cast(), 1),
            ("request.options", options.cast(), 1),
            ("request.instances", instances.cast(), instance_count),
        ] {
            // SAFETY: each of these structures was read when `checked` and `shares` were made.
            let read = unsafe { span_of(name, first, count)? };
            read.check_apart(name, span, "the worker's memory")?;
        }
        for (name, written) in [("worker", out), ("message", message.first()?)] {
            written.check_apart(name, span, "the worker's memory")?;
        }
        for index in 0..checked.count() {
            // SAFETY: the scenes are valid, as this function's `# Safety` requires.
            let scene = unsafe { checked.scene(index)? };
            scene.check_apart("memory", span)?;
            scene.check_apart("worker", out)?;
        }
        if memory_size < shares.bytes {
            return Err(Failure::Memory { name: "memory", expected: shares.bytes, found: memory_size });
        }
        // SAFETY: `memory` is aligned, large enough, and apart from the scenes (checked above); the caller lends it.
        let handle = unsafe { open_in(&checked, &shares, memory.cast(), span)? };
        // SAFETY: the pointers were checked above, and are writable, as this function's `# Safety` requires.
        unsafe { worker.write(handle) };
        Ok(())
    })
}

/// Unused part of the memory that the caller lends to a worker; begins at `at`.
struct Lent {
    at: *mut Line,
}

impl Lent {
    /// Returns the next `count` unused lines.
    /// # Safety
    /// The lent memory has at least `count` unused lines, and nothing but the worker uses these lines.
    #[inline]
    unsafe fn lines(&mut self, count: usize) -> &'static mut [Line] {
        let first = self.at;
        // SAFETY: `count` lines are left and lent (`# Safety`). Any bytes are a valid line; no line is taken twice.
        unsafe {
            self.at = first.add(count);
            core::slice::from_raw_parts_mut(first, count)
        }
    }

    /// Stores `make(index)` for each `index` below `count` in the next unused lines. Returns the stored values.
    ///
    /// # Safety
    /// As for [`Lent::lines`], for the number of lines that the values take.
    #[inline(always)]
    unsafe fn values<T>(
        &mut self,
        count: usize,
        mut make: impl FnMut(usize) -> Result<T, Failure>,
    ) -> Result<&'static [T], Failure> {
        const { assert!(align_of::<T>() <= align_of::<Line>()) };
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        let first = unsafe { self.lines(lines_for::<T>(count)) }.as_mut_ptr().cast::<T>();
        for index in 0..count {
            let value = make(index)?;
            // SAFETY: `first.add(index)` is one of `count` places in the lines, and is aligned for T (asserted above).
            unsafe { first.add(index).write(value) };
        }
        // SAFETY: all `count` values have just been written, and nobody writes to them again.
        Ok(unsafe { core::slice::from_raw_parts(first, count) })
    }
}

/// Opens a worker in `memory`; the returned handle points to the beginning of `memory`.
///
/// # Safety
/// `memory` points to `shares.bytes` writable bytes, aligned as a [`Line`], and does not overlap the scenes. Nothing
/// else uses the memory, and the scenes stay valid, while the worker is used.
unsafe fn open_in(
    checked: &Checked,
    shares: &Shares,
    memory: *mut Line,
    span: Span,
) -> Result<*mut Worker, Failure> {
    // SAFETY: the first `shares.own` lines of the memory are the worker's own.
    let mut lent = Lent { at: unsafe { memory.add(shares.own) } };
    let member = |index| {
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        let scene = unsafe { checked.scene(index)? };
        #[cfg(feature = "instances")]
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        let scale = unsafe { checked.placement(index)? }.scale();
        #[cfg(not(feature = "instances"))]
        let scale = 1.0;
        Ok(Member { scene, plan: checked.plan(index, scene, scale)? })
    };
    // SAFETY: `shares` counted these lines, so they lie in the memory.
    let members = unsafe { lent.values(checked.count(), member)? };
    #[cfg(feature = "instances")]
    // SAFETY: `shares` counted these lines, too; there is one member per instance.
    let instances = unsafe {
        lent.values(if checked.placed() { members.len() } else { 0 }, |index| {
            let Member { scene, plan } = &members[index];
            let plan = plan.as_ref().ok_or(PlanError::NotAScene)?;
            let placement = checked.placement(index)?;
            Ok(render::Instance { renderer: scene.renderer(), plan, placement })
        })?
    };
    // SAFETY: `shares` counted these lines, so they lie in the memory.
    let (pixels, lines) = unsafe { (lent.lines(shares.pixels), lent.lines(shares.rest)) };
    let (width, height) = tile_size(checked.settings.batch);
    let pixels = TilePixels::lay_out(&mut Arena::new(pixels), (width * height) as usize, checked.outputs);
    let work = match members {
        #[cfg(feature = "instances")]
        _ if checked.placed() => Work::Fields(render::Worker::of_instances(instances, lines)?),
        [Member { scene, plan: Some(plan) }] => Work::Fields(scene.renderer().worker(plan, lines)?),
        _ => Work::Picture(lines),
    };
    let state = State {
        work,
        members,
        settings: checked.settings,
        outputs: checked.request.outputs,
        pixels,
        memory: span,
        size: shares.bytes,
    };
    let handle = memory.cast::<Worker>();
    // SAFETY: a worker fits into the first `shares.own` lines. The lines are aligned, and in none of the slices above.
    unsafe { handle.write(Worker { busy: AtomicBool::new(false), state: UnsafeCell::new(state) }) };
    Ok(handle)
}
