//! What a frame takes on this host, measured.

use crate::boundary::{LayoutOut, Message, Out, Versioned, call};
use crate::camera::Camera;
use crate::failure::Failure;
use crate::render_options::{RenderOptions, Settings};
use crate::scene::Scene;
use crate::status::Status;
use crate::workspace::{Workspace, read_outputs};
use core::ffi::{c_char, c_void};
use nerf_core::blob::MAX_FRONT;
use nerf_core::memory::Line;
use nerf_core::plan::{Plan, Quality};

/// What a frame takes at each point of a scene's front, on one thread of this host.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Pace {
    /// `sizeof(nerf_pace)`, set by the caller.
    pub struct_size: usize,
    /// Milliseconds, in the front's order; infinity where nothing was measured. A host that renders tiles on
    /// n threads divides by n.
    pub milliseconds: [f32; 16],
}

// The header spells the format's cap out.
const _: () = assert!(MAX_FRONT == 16);

// SAFETY: `repr(C)`, `struct_size` comes first, and numbers have no invalid bytes.
unsafe impl Versioned for Pace {
    const NAME: &'static str = "pace";
}

/// Microseconds since any moment, never falling.
pub type Clock = Option<unsafe extern "C-unwind" fn(user: *mut c_void) -> u64>;

/// Says how much workspace `nerf_pace_measure` needs, and at which alignment.
///
/// `options`, `outputs`, `size`, `align` and `message` as in `nerf_workspace_size`.
///
/// # Safety
/// Pointers are NULL or point to what is described there; `scene` is intact.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_pace_workspace_size(
    scene: *const Scene,
    options: *const RenderOptions,
    outputs: u32,
    size: *mut usize,
    align: *mut usize,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: `size` and `align` are as this function's `# Safety` has it.
        let layout = unsafe { LayoutOut::new(size, align)? };
        // SAFETY: `scene` and `options` are as this function's `# Safety` has it.
        let (scene, plan) = unsafe { planned(scene, options, outputs)? };
        let bytes = scene.renderer().pace_lines(&plan).checked_mul(size_of::<Line>());
        let bytes = bytes.ok_or(Failure::Overflow("workspace"))?;
        layout.write(bytes);
        Ok(())
    })
}

/// Measures what a frame takes on this thread at each point of the scene's front.
///
/// Renders about 2,048 pixels over the whole view at each point, cheapest first, and stops behind the first whose
/// frame would take more than `limit_milliseconds`; dearer ones stay at infinity. Measure on an idle host.
///
/// `options`: what `nerf_render` will get; its shortcuts do not matter. `outputs`: `NERF_OUTPUT_*` of the
/// planes that will not be NULL. `clock`: called with `user`, must not touch the workspace; NULL for the
/// library's own, which a build without std has not. `workspace`: of the size and alignment that
/// `nerf_pace_workspace_size` says, apart from scene and blob. `pace`: `struct_size` set by the caller; written
/// on success. A scene without a front is `NERF_STATUS_NO_FRONT`. `message`: NULL, or `message_capacity` bytes
/// for a sentence about what was expected and found; empty on success.
///
/// # Safety
/// Pointers are NULL or point to what is described here; `scene` is intact.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_pace_measure(
    scene: *const Scene,
    camera: *const Camera,
    options: *const RenderOptions,
    outputs: u32,
    limit_milliseconds: f32,
    clock: Clock,
    user: *mut c_void,
    workspace: *mut c_void,
    workspace_size: usize,
    pace: *mut Pace,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: `scene` and `options` are as this function's `# Safety` has it.
        let (scene, plan) = unsafe { planned(scene, options, outputs)? };
        // SAFETY: `camera` is as this function's `# Safety` has it.
        let (camera, out) = unsafe { (Camera::read(camera)?, Out::new(pace)?) };
        if Quality::front(scene.renderer().blob()).next().is_none() {
            return Err(Failure::NoFront);
        }
        let mut workspace = Workspace::new(workspace, workspace_size, scene)?;
        let mut now = time(clock, user)?;
        // SAFETY: the workspace is this call's own, as this function's `# Safety` has it.
        let lines = unsafe { workspace.lines() };
        let found = scene.renderer().pace(&plan, &camera, limit_milliseconds, lines, &mut now);
        let found = found.map_err(Failure::of_workspace)?;
        out.write(Pace { struct_size: size_of::<Pace>(), milliseconds: found.milliseconds });
        Ok(())
    })
}

/// A scene, and what its frames consist of.
///
/// # Safety
/// As [`nerf_pace_measure`].
unsafe fn planned<'s>(
    scene: *const Scene,
    options: *const RenderOptions,
    outputs: u32,
) -> Result<(&'s Scene, Plan<'s>), Failure> {
    // SAFETY: `scene` is as this function's `# Safety` has it.
    let scene = unsafe { Scene::of(scene)? };
    // SAFETY: `options` is as this function's `# Safety` has it.
    let mut settings = unsafe { Settings::read(options)? };
    // Each point brings its own; what the caller's are is no reason to refuse.
    settings.quality = Quality::exact(scene.renderer().blob());
    let plan = settings.plan(scene.renderer().blob(), read_outputs(outputs)?, false)?;
    Ok((scene, plan))
}

/// The caller's clock, or the library's own.
fn time(clock: Clock, user: *mut c_void) -> Result<impl FnMut() -> u64, Failure> {
    #[cfg(feature = "std")]
    let start = std::time::Instant::now();
    #[cfg(not(feature = "std"))]
    if clock.is_none() {
        return Err(Failure::Null("clock"));
    }
    // As with a progress function: where nothing unwinds, a call that might would need a panic.
    #[cfg(not(feature = "std"))]
    // SAFETY: the two ABIs pass the same arguments in the same way, and there are no exceptions.
    let clock: Option<unsafe extern "C" fn(*mut c_void) -> u64> = unsafe { core::mem::transmute(clock) };
    Ok(move || match clock {
        // SAFETY: the caller's function, with what the caller gave it.
        Some(clock) => unsafe { clock(user) },
        #[cfg(feature = "std")]
        None => start.elapsed().as_micros() as u64,
        #[cfg(not(feature = "std"))]
        None => 0,
    })
}
