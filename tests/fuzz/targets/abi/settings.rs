//! Settings, asked for and explained.

use crate::draw::any_camera;
use crate::lent::{Lent, Message, workspace};
use crate::scenes::Host;
use crate::workers;
use arbitrary::{Result, Unstructured};
use nerf_fuzz::values::{any_f32, any_vec3, mostly, rarely};
use nerf_render::{self as ffi, Status};
use nerf_testing::call;
use nerf_testing::memory::Guarded;
use std::ffi::c_void;
use std::ptr::{null, null_mut};

pub fn options(u: &mut Unstructured<'_>) -> Result<ffi::RenderOptions> {
    let flag =
        |u: &mut Unstructured<'_>| if rarely(u, 32)? { u.arbitrary() } else { u.int_in_range(0..=1u32) };
    let mut o = ffi::RenderOptions {
        samples: *u.choose(&[4u32, 9, 16, 0, 1, 4097, u32::MAX])?,
        ignore_occupancy: flag(u)?,
        maths: u.int_in_range(0..=4)?,
        batch_rays: *u.choose(&[0u32, 1, 3, 17, 256, 257, u32::MAX])?,
        batch_samples: *u.choose(&[0u32, 1, 5, 64, 65])?,
        ignore_proposal: flag(u)?,
        normal_blur: mostly(u, 1.0)?,
        near_distance: if u.ratio(1, 4)? { any_f32(u)? } else { 0.0 },
        far_distance: if u.ratio(1, 4)? { any_f32(u)? } else { 0.0 },
        own_bins: u.int_in_range(0..=1)?,
        reserved: u32::from(rarely(u, 64)?),
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

/// Settings by a wish; what could be rendered with before, can be after it.
pub fn wish(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
    let mut options = Lent::new(&options(u)?, u)?;
    let rendered = can_be_rendered_with(host, options.at());
    let choice = ffi::Choice {
        struct_size: size_of::<ffi::Choice>(),
        loss_db: 0.0,
        cost: 0.0,
        milliseconds: 0.0,
        within: 9,
    };
    let (mut choice, mut message, number) = (Lent::new(&choice, u)?, Message::new(u)?, any_f32(u)?);
    let (text, room) = (message.at(), message.0.size());
    let which = u.int_in_range(0..=4u8)?;
    let pace = ffi::Pace { struct_size: size_of::<ffi::Pace>(), milliseconds: paces(u)? };
    let (mut pace, point) = (Lent::new(&pace, u)?, u.choose(&[0u32, 1, 2, 16, u32::MAX]).copied()?);
    let (scene, o, c) = (host.scene, options.at(), choice.at());
    // SAFETY: the scene is intact and everything lives until the call returns.
    let status = unsafe {
        match which {
            0 => ffi::nerf_quality_within_loss(scene, number, o, c, text, room),
            1 => ffi::nerf_quality_within_cost(scene, number, o, c, text, room),
            2 => ffi::nerf_quality_within_time(scene, number, pace.at(), o, c, text, room),
            3 => ffi::nerf_quality_point(scene, point, o, c, text, room),
            _ => ffi::nerf_quality_preset(scene, point, o, text, room),
        }
    };
    message.check(status);
    if status != Status::Ok {
        assert!(options.is_untouched() && choice.is_untouched(), "{status:?}: a wish half granted");
    } else {
        assert!(
            !rendered || can_be_rendered_with(host, options.at()),
            "{which}: settings that cannot be had"
        );
    }
    Ok(())
}

fn paces(u: &mut Unstructured<'_>) -> Result<[f32; 16]> {
    let mut paces = [f32::INFINITY; 16];
    for pace in &mut paces[..3] {
        *pace = any_f32(u)?;
    }
    Ok(paces)
}

fn can_be_rendered_with(host: &Host, options: *const ffi::RenderOptions) -> bool {
    let (mut size, mut align, rgb) = (0, 0, ffi::NERF_OUTPUT_RGB);
    // SAFETY: the scene is intact and everything lives until the call returns.
    let status = unsafe { call::worker_size(host.scene, options, rgb, &mut size, &mut align, null_mut(), 0) };
    status == Status::Ok
}

unsafe extern "C-unwind" fn ticking(user: *mut c_void) -> u64 {
    // SAFETY: `user` is the time and the tick of the call.
    let [now, tick] = unsafe { &mut *user.cast::<[u64; 2]>() };
    // A clock that stands still, or wraps: the host's promise is broken, but nothing else.
    *now = now.wrapping_add(*tick);
    *now
}

/// What frames of a few pixels take by a clock of any pace.
pub fn pace(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
    let camera = any_camera(u)?;
    // Beyond this, 2,048 pixels are drawn at each point.
    if u64::from(camera.width) * u64::from(camera.height) > 300 {
        return Ok(());
    }
    let (mut camera, mut options) = (Lent::new(&camera, u)?, Lent::new(&options(u)?, u)?);
    let outputs = u.int_in_range(0..=15u32)?;
    let mut time = [u.arbitrary()?, *u.choose(&[250u64, 0, 1, 1 << 40, u64::MAX])?];
    let request = ffi::PaceRequest {
        camera: camera.at(),
        limit_milliseconds: mostly(u, 1e9)?,
        clock: Some(ticking),
        user: (&raw mut time).cast(),
        ..call::pace_request(host.scene, options.at(), outputs)
    };
    let mut request = Lent::new(&request, u)?;
    let (mut size, mut align, none) = (usize::MAX, usize::MAX, null_mut());
    // SAFETY: the scene is intact and everything lives until the call returns.
    let asked = unsafe { ffi::nerf_pace_workspace_size(request.at(), &mut size, &mut align, none, 0) };
    let known = asked == Status::Ok;
    if known && size > 1 << 25 {
        return Ok(());
    }
    let (mut room, enough) = workspace(u, known.then_some(size))?;
    let pace = ffi::Pace { struct_size: size_of::<ffi::Pace>(), milliseconds: [-1.0; 16] };
    let (mut pace, mut message) = (Lent::new(&pace, u)?, Message::new(u)?);
    let given = room.size();
    let (text, capacity) = (message.at(), message.0.size());
    // SAFETY: as above.
    let status = unsafe { ffi::nerf_pace_measure(request.at(), room.at(), given, pace.at(), text, capacity) };
    message.check(status);
    assert!(room.surroundings_are_intact(), "{status:?}: written beyond the workspace");
    assert!(status != Status::Ok || enough, "{status:?} in {given} bytes, misaligned or of {size}");
    assert!(status != Status::Memory || !enough, "{status:?}: {given} bytes of {size} are too few");
    if status != Status::Ok {
        assert!(pace.is_untouched(), "{status:?}: a pace half written");
    } else if pace.words[0] as usize >= size_of::<ffi::Pace>() {
        let found: ffi::Pace = pace.value();
        assert!(found.milliseconds.iter().all(|&ms| ms >= 0.0), "{found:?}");
    }
    Ok(())
}

pub fn explain(hosts: &[Host], at: usize, u: &mut Unstructured<'_>) -> Result<()> {
    let options = options(u)?;
    let (mut options, outputs) = (Lent::new(&options, u)?, u.int_in_range(0..=64u32)?);
    let Some(worker) = workers::open(hosts, at, options.at(), outputs, u)? else { return Ok(()) };
    let mut counters = Lent::new(&call::counters(), u)?;
    let mut text = Guarded::new(*u.choose(&[0usize, 1, 17, 4096])?, 3);
    let (mut needed, mut message, capacity) = (usize::MAX, Message::new(u)?, text.size());
    let (said, room) = (message.at(), message.0.size());
    // SAFETY: the scene is intact and everything lives until the call returns.
    let status = unsafe {
        let work = if u.arbitrary()? { null() } else { counters.at::<ffi::Counters>().cast_const() };
        ffi::nerf_explain(worker.handle, work, text.at().cast(), capacity, &mut needed, said, room)
    };
    message.check(status);
    worker.check(status);
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
