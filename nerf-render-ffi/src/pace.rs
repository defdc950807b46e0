//! Measurement of the time per frame on this host.

use crate::boundary::{Message, Out, by_width, call, call_for_size, read_versioned, versioned};
use crate::camera::Camera;
use crate::failure::Failure;
use crate::outputs::read_outputs;
use crate::render_options::{RenderOptions, Settings};
use crate::scene::Scene;
use crate::span::Span;
use crate::status::Status;
use core::ffi::{c_char, c_void};
use nerf_core::blob::MAX_FRONT;
use nerf_core::memory::Line;
use nerf_core::plan::{Plan, Quality};
use nerf_core::render;

/// Measured time of a frame on one thread of this host, for each point (quality settings) of a scene's Pareto front.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Pace {
    /// `sizeof(nerf_pace)`, set by the caller.
    pub struct_size: usize,
    /// Milliseconds per frame, by the index of the point on the Pareto front; infinity for points that were not
    /// measured. If n threads share the tiles of a frame, the frame takes about 1/n of this time.
    pub milliseconds: [f32; 16],
}

// The array length above is a literal for the C header.
const _: () = assert!(MAX_FRONT == 16);

versioned!(unsafe Pace, "pace", by_width(68, 72));

/// Clock of the caller: returns the time in microseconds since any fixed moment. The time must never decrease.
pub type Clock = Option<unsafe extern "C-unwind" fn(user: *mut c_void) -> u64>;

/// Request to measure the time per frame of a scene.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct PaceRequest {
    /// `sizeof(nerf_pace_request)`.
    pub struct_size: usize,
    /// Scene whose frame time is measured.
    pub scene: *const Scene,
    /// Camera of the measured frame; not read by `nerf_pace_workspace_size`.
    pub camera: *const Camera,
    /// Options of the frame; NULL for the defaults. Each point of the Pareto front replaces the quality settings
    /// (samples, cuts, occupancy grid, maths, proposal).
    pub options: *const RenderOptions,
    /// Outputs of the measured frame: `NERF_OUTPUT_*` flags, or-ed.
    pub outputs: u32,
    /// Limit, milliseconds per frame. Pareto points are measured in order of rising cost. Measuring ends after the
    /// first point with a time above the limit.
    pub limit_milliseconds: f32,
    /// Clock, called with `user`; must not use the workspace. NULL for the library's clock, which needs feature `std`.
    pub clock: Clock,
    /// Argument passed to `clock`.
    pub user: *mut c_void,
}

versioned!(unsafe PaceRequest, "request", by_width(32, 56));

/// Computes the size and alignment of the workspace that `nerf_pace_measure` needs.
///
/// `size` and `align`, bytes, are written on success only. `message`: NULL, or a buffer for an error message.
///
/// # Safety
/// Each pointer is NULL or points to an object of its type. The memory of `request->scene` and its file's bytes have
/// not been freed, moved or overwritten.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_pace_workspace_size(
    request: *const PaceRequest,
    size: *mut usize,
    align: *mut usize,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    let body = || {
        // SAFETY: `request` is valid, as this function's `# Safety` requires.
        let (_, scene, plan) = unsafe { planned(request)? };
        let lines = render::Pace::lines(scene.renderer(), &plan);
        lines.checked_mul(size_of::<Line>()).ok_or(Failure::Overflow("workspace"))
    };
    let message = Message { text: message, capacity: message_capacity };
    // SAFETY: `size` and `align` are valid, as this function's `# Safety` requires.
    unsafe { call_for_size((size, align), message, body) }
}

/// Measures the time of a frame on this thread for each point (quality settings) of the scene's Pareto front.
///
/// For each point, cheapest first, renders about 2,048 pixels, spread over the view, and scales the time up to a whole
/// frame. Stops after the first point with a time above `request->limit_milliseconds`; the times of the more expensive
/// points are infinity. Returns `NERF_STATUS_NO_FRONT` without a Pareto front, or if this build can render no point.
///
/// Measure on an idle host. `workspace`: must have the size and alignment from `nerf_pace_workspace_size`, and must not
/// overlap the scene or the bytes of the scene's file. `pace`: receives the times on success; the caller sets
/// `struct_size`. `message`: NULL, or a buffer for an error message.
///
/// # Safety
/// Each pointer is NULL or points to an object of its type. The memory of `request->scene` and its file's bytes have
/// not been freed, moved or overwritten.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_pace_measure(
    request: *const PaceRequest,
    workspace: *mut c_void,
    workspace_size: usize,
    pace: *mut Pace,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: `request` is valid, as this function's `# Safety` requires.
        let (request, scene, plan) = unsafe { planned(request)? };
        // SAFETY: `camera` is valid, as this function's `# Safety` requires.
        let (camera, out) = unsafe { (Camera::read(request.camera)?, Out::new(pace)?) };
        if Quality::front(scene.renderer().blob()).next().is_none() {
            return Err(Failure::NoFront);
        }
        Span::of("workspace", workspace.cast::<Line>().cast_const(), 0)?;
        scene.check_apart("workspace", Span::new("workspace", workspace, workspace_size)?)?;
        let mut now = time(request.clock, request.user)?;
        let lines = workspace_size / size_of::<Line>();
        // SAFETY: the workspace is aligned (checked above), and used by no one else (`# Safety`). Any bytes are valid.
        let lines = unsafe { core::slice::from_raw_parts_mut(workspace.cast::<Line>(), lines) };
        let (renderer, limit) = (scene.renderer(), request.limit_milliseconds);
        let found = render::Pace::measure(renderer, &plan, &camera, limit, lines, &mut now);
        let found = found.map_err(Failure::of_workspace)?;
        out.write(Pace { struct_size: size_of::<Pace>(), milliseconds: found.milliseconds });
        Ok(())
    })
}

/// Returns a copy of the request at `at`, the request's scene, and a plan. The plan has the request's options, but the
/// quality settings of the exact rendering.
///
/// # Safety
/// As for [`nerf_pace_measure`].
unsafe fn planned<'s>(at: *const PaceRequest) -> Result<(PaceRequest, &'s Scene, Plan<'s>), Failure> {
    // SAFETY: `at` is valid, as this function's `# Safety` requires.
    let request = unsafe { read_versioned(at)? };
    // SAFETY: the scene is valid, as this function's `# Safety` requires.
    let scene = unsafe { Scene::of(request.scene)? };
    // SAFETY: the options are valid, as this function's `# Safety` requires.
    let mut settings = unsafe { Settings::read(request.options)? };
    // The quality settings of each Pareto point replace the caller's, which therefore must not cause an error.
    settings.frame.quality = Quality::exact(scene.renderer().blob());
    let outputs = read_outputs("request.outputs", request.outputs)?;
    let plan = settings.plan(scene.renderer().blob(), outputs, 1.0)?;
    Ok((request, scene, plan))
}

/// Returns a function that reads the time, microseconds. The function calls `clock`, or reads std's clock if `clock` is
/// `None`. In a build without std, a `clock` of `None` is an error.
fn time(clock: Clock, user: *mut c_void) -> Result<impl FnMut() -> u64, Failure> {
    #[cfg(feature = "std")]
    let start = std::time::Instant::now();
    #[cfg(not(feature = "std"))]
    if clock.is_none() {
        return Err(Failure::Null("clock"));
    }
    // Nothing unwinds without std. The ABI "C" says so to the compiler, which then links no panic code for the call.
    #[cfg(not(feature = "std"))]
    // SAFETY: the ABIs "C" and "C-unwind" pass arguments in the same way, and nothing unwinds.
    let clock: Option<unsafe extern "C" fn(*mut c_void) -> u64> = unsafe { core::mem::transmute(clock) };
    Ok(move || match clock {
        // SAFETY: the caller's function, called with the caller's argument.
        Some(clock) => unsafe { clock(user) },
        #[cfg(feature = "std")]
        None => start.elapsed().as_micros() as u64,
        #[cfg(not(feature = "std"))]
        None => 0,
    })
}
