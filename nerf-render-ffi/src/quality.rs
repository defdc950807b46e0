//! Choice of quality settings by loss (dB of PSNR below the exact rendering), cost (multiply-adds) or time.

use crate::boundary::{Message, Out, by_width, call, read_versioned, versioned};
use crate::failure::Failure;
use crate::pace::Pace;
use crate::render_options::RenderOptions;
use crate::scene::Scene;
use crate::status::Status;
use core::ffi::c_char;
use nerf_core::blob::Blob;
use nerf_core::plan::{self, Quality};
use nerf_core::render;

/// Largest allowed loss of PSNR, by which `nerf_quality_preset` chooses quality settings. The loss is the PSNR of the
/// exact rendering minus the PSNR with the settings, dB; `nerf-train study` measures the loss for each point of a
/// scene's Pareto front (PSNR against multiply-adds).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Preset {
    /// PSNR at least as high as with the exact rendering.
    Exact = 0,
    /// PSNR at most 0.01 dB below the PSNR of the exact rendering: no visible difference.
    High = 1,
    /// PSNR at most 0.1 dB below the PSNR of the exact rendering.
    Balanced = 2,
    /// PSNR at most 0.3 dB below the PSNR of the exact rendering.
    Fast = 3,
    /// PSNR at most 1 dB below the PSNR of the exact rendering: for navigation.
    Preview = 4,
}

/// The chosen point of a scene's Pareto front: loss and cost of the chosen settings.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Choice {
    /// `sizeof(nerf_choice)`, set by the caller.
    pub struct_size: usize,
    /// PSNR of the exact rendering minus PSNR with the settings, dB, from `nerf-train study`; negative for a gain.
    pub loss_db: f32,
    /// Number of multiply-adds with the settings, divided by the number for the exact rendering.
    pub cost: f32,
    /// Expected milliseconds per frame; NaN unless the settings were chosen by time.
    pub milliseconds: f32,
    /// 1 if the settings meet the limit of loss, cost or time. 0 if no point of the Pareto front meets the limit; in
    /// this case, the point nearest to the limit was chosen.
    pub within: u32,
}

versioned!(unsafe Choice, "choice", by_width(20, 24));

/// Calls `choose`, which selects one point of the scene's Pareto front. Writes the point's settings to `options`, and
/// the point's loss, cost and time to `choice` unless `choice` is NULL. Returns an error if `choose` returns `None`.
///
/// # Safety
/// Pointers are NULL or point to what the calling functions describe.
unsafe fn answer(
    scene: *const Scene,
    options: *mut RenderOptions,
    choice: *mut Choice,
    choose: impl FnOnce(&Blob<'_>) -> Result<Option<(plan::Choice, f32)>, Failure>,
) -> Result<(), Failure> {
    // SAFETY: `scene` is valid, as this function's `# Safety` requires.
    let scene = unsafe { Scene::of(scene)? };
    // SAFETY: `options` and `choice` are NULL or readable and writable, as this function's `# Safety` requires.
    let (read, place) = unsafe { (read_versioned(options.cast_const())?, Out::new(options)?) };
    // SAFETY: `choice` is NULL or writable, as this function's `# Safety` requires.
    let out = unsafe { Out::new_or_none(choice)? };
    let (found, milliseconds) = choose(scene.renderer().blob())?.ok_or(Failure::NoFront)?;
    place.write(read.with(&found.quality));
    if let Some(out) = out {
        out.write(Choice {
            struct_size: size_of::<Choice>(),
            loss_db: found.loss_db,
            cost: found.cost,
            milliseconds,
            within: found.within.into(),
        });
    }
    Ok(())
}

fn without_time(choice: plan::Choice) -> (plan::Choice, f32) {
    (choice, f32::NAN)
}

/// Writes to `options` the cheapest settings with a PSNR at most `loss_db` below the PSNR of the exact rendering.
///
/// `options`: the caller sets `struct_size`; the quality settings (samples, cuts, occupancy grid, maths, proposal) are
/// replaced, other fields are kept. `choice`: NULL, or receives the chosen point. If the PSNR of every point of the
/// scene's Pareto front is lower, the point of highest PSNR is chosen, and `choice->within` is 0. Writes nothing and
/// returns `NERF_STATUS_NO_FRONT` if the scene has no Pareto front with a point that this build can render. A point's
/// transmittance cut may exceed 0.5; a request for median distances with such a cut is an error. `message`: NULL, or a
/// buffer for an error message.
///
/// # Safety
/// Pointers are NULL or point to what is described here. The caller has not freed, moved or overwritten the memory of
/// `scene` or its file's bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_quality_within_loss(
    scene: *const Scene,
    loss_db: f32,
    options: *mut RenderOptions,
    choice: *mut Choice,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        let choose = |blob: &Blob<'_>| Ok(Quality::within_loss(blob, loss_db).map(without_time));
        // SAFETY: `scene` and `options` are valid, as this function's `# Safety` requires.
        unsafe { answer(scene, options, choice, choose) }
    })
}

/// Writes to `options` the settings of highest PSNR with at most `ratio` times the multiply-adds of exact rendering.
///
/// If every point of the scene's Pareto front costs more, the cheapest point is chosen. Everything else is as in
/// `nerf_quality_within_loss`.
///
/// # Safety
/// Pointers are NULL or point to what `nerf_quality_within_loss` describes. The caller has not freed, moved or
/// overwritten the memory of `scene` or its file's bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_quality_within_cost(
    scene: *const Scene,
    ratio: f32,
    options: *mut RenderOptions,
    choice: *mut Choice,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        let choose = |blob: &Blob<'_>| Ok(Quality::within_cost(blob, ratio).map(without_time));
        // SAFETY: `scene` and `options` are valid, as this function's `# Safety` requires.
        unsafe { answer(scene, options, choice, choose) }
    })
}

/// Writes to `options` the settings of highest PSNR with a frame time of at most `milliseconds`. `pace`: frame times
/// from `nerf_pace_measure`.
///
/// Considers only points of the scene's Pareto front with a finite time in `pace`. If each of these points takes
/// longer, chooses the fastest. Returns `NERF_STATUS_NO_FRONT` if no point has a finite time. `choice->milliseconds`
/// is the expected time of a frame. Everything else is as in `nerf_quality_within_loss`.
///
/// # Safety
/// Pointers are NULL or point to what `nerf_quality_within_loss` describes, `pace` to a `nerf_pace`. The caller has not
/// freed, moved or overwritten the memory of `scene` or its file's bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_quality_within_time(
    scene: *const Scene,
    milliseconds: f32,
    pace: *const Pace,
    options: *mut RenderOptions,
    choice: *mut Choice,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: `pace` is valid, as this function's `# Safety` requires.
        let pace = render::Pace { milliseconds: unsafe { read_versioned(pace)? }.milliseconds };
        let choose = |blob: &Blob<'_>| Ok(pace.within(blob, milliseconds));
        // SAFETY: `scene` and `options` are valid, as this function's `# Safety` requires.
        unsafe { answer(scene, options, choice, choose) }
    })
}

/// Writes to `options` the settings of a point of the scene's Pareto front.
///
/// `point`: index of the point, below `front_points` of `nerf_scene_info`; 0 is the most expensive point. A host can
/// thus show all points or choose by its own rules. Returns `NERF_STATUS_OPTIONS` if the point does not exist, and
/// `NERF_STATUS_NO_FRONT` if this build cannot render the point. Sets `choice->within` to 1. Everything else is as in
/// `nerf_quality_within_loss`.
///
/// # Safety
/// Pointers are NULL or point to what `nerf_quality_within_loss` describes. The caller has not freed, moved or
/// overwritten the memory of `scene` or its file's bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_quality_point(
    scene: *const Scene,
    point: u32,
    options: *mut RenderOptions,
    choice: *mut Choice,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        let choose = |blob: &Blob<'_>| {
            if point as usize >= blob.front().len() {
                let expected = "a number below nerf_scene_info.front_points";
                return Err(Failure::Setting { name: "point", expected, found: point });
            }
            let found = Quality::front(blob).find(|(index, _)| *index == point as usize);
            Ok(found.map(|(_, choice)| without_time(plan::Choice { within: true, ..choice })))
        };
        // SAFETY: `scene` and `options` are valid, as this function's `# Safety` requires.
        unsafe { answer(scene, options, choice, choose) }
    })
}

/// Writes to `options` the cheapest settings that lose no more PSNR than `preset`, a `nerf_preset`, allows.
///
/// If every point of the scene's Pareto front loses more, writes the settings of the exact rendering.
///
/// For every scene without a Pareto front, writes the fixed settings of the following list. Their loss in such a scene
/// is unknown; the losses in the list were measured in one test scene.
/// - EXACT: the exact rendering.
/// - HIGH: the default options.
/// - BALANCED: transmittance cut 0.03, colour cut 0.03; loss 0.05 dB.
/// - FAST: transmittance cut 0.1, colour cut 0.03; loss 0.2 dB.
/// - PREVIEW: transmittance cut 0.1, colour cut 0.1, four fifths of the scene's samples; loss 0.9 dB.
///
/// `options`: the caller sets `struct_size`; only the quality settings are replaced. `message`: NULL, or a buffer for
/// an error message.
///
/// # Safety
/// Pointers are NULL or point to what is described here. The caller has not freed, moved or overwritten the memory of
/// `scene` or its file's bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_quality_preset(
    scene: *const Scene,
    preset: u32,
    options: *mut RenderOptions,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        let Some(&preset) = plan::Preset::ALL.get(preset as usize) else {
            return Err(Failure::Setting { name: "preset", expected: "a nerf_preset", found: preset });
        };
        // SAFETY: `scene` is valid, as this function's `# Safety` requires.
        let scene = unsafe { Scene::of(scene)? };
        // SAFETY: `options` is NULL or readable and writable, as this function's `# Safety` requires.
        let (read, place) = unsafe { (read_versioned(options.cast_const())?, Out::new(options)?) };
        place.write(read.with(&Quality::preset(scene.renderer().blob(), preset)));
        Ok(())
    })
}
