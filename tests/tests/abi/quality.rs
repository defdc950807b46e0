//! Quality settings by loss, cost, time and preset, through the C interface.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::plan::{Preset, Quality};
use nerf_render::{self as ffi, Status};
use nerf_testing::call::{self, Message, Opened};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::{self, Recipe};
use std::ffi::c_void;
use std::ptr;

const OUTPUTS: u32 = ffi::NERF_OUTPUT_RGB;

fn choice() -> ffi::Choice {
    ffi::Choice {
        struct_size: size_of::<ffi::Choice>(),
        loss_db: -1.0,
        cost: -1.0,
        milliseconds: -1.0,
        within: 9,
    }
}

/// Returns the quality settings in options.
fn quality_of(options: &ffi::RenderOptions) -> (u32, f32, f32, u32, u32, u32) {
    let o = options;
    (o.samples, o.transmittance_cut, o.colour_cut, o.ignore_occupancy, o.maths, o.ignore_proposal)
}

fn expected(quality: &Quality) -> (u32, f32, f32, u32, u32, u32) {
    let q = quality;
    let maths = q.math.tag().into();
    // In C a cut of 0 is the default.
    let cut = |cut: f32| if cut == 0.0 { ffi::NERF_NONE } else { cut };
    (
        q.samples.into(),
        cut(q.transmittance_cut),
        cut(q.colour_cut),
        (!q.occupancy).into(),
        maths,
        (!q.proposal).into(),
    )
}

#[test]
fn wishes_are_answered_as_in_rust_and_leave_the_rest_of_the_options() {
    let opened = call::open(Recipe::PROPOSAL.blob(), Kernel::IN_PLACE);
    let blob = Blob::open(&opened.blob).expect("a blob");
    let mut options = call::render_options();
    options.effects.anti_aliasing = 3;
    options.batch_rays = 17;
    let none = ptr::null_mut();
    for wish in [-1.0, 0.0, 0.05, 0.5, 100.0, f32::NAN] {
        let (mut by_loss, mut by_cost, mut seen) = (options, options, [choice(), choice()]);
        // SAFETY: everything lives until the calls return.
        let status = unsafe {
            [
                ffi::nerf_quality_within_loss(opened.scene, wish, &mut by_loss, &mut seen[0], none, 0),
                ffi::nerf_quality_within_cost(opened.scene, wish, &mut by_cost, &mut seen[1], none, 0),
            ]
        };
        assert_eq!(status, [Status::Ok; 2]);
        let rust = [Quality::within_loss(&blob, wish), Quality::within_cost(&blob, wish)];
        for ((found, seen), rust) in [by_loss, by_cost].iter().zip(seen).zip(rust) {
            let rust = rust.expect("a front");
            assert_eq!(quality_of(found), expected(&rust.quality), "{wish}");
            assert_eq!((seen.loss_db, seen.cost, seen.within), (rust.loss_db, rust.cost, rust.within.into()));
            assert!(seen.milliseconds.is_nan());
            assert_eq!((found.effects.anti_aliasing, found.batch_rays), (3, 17));
        }
    }
    for (number, preset) in Preset::ALL.into_iter().enumerate() {
        let mut found = options;
        // SAFETY: as above.
        let status = unsafe { ffi::nerf_quality_preset(opened.scene, number as u32, &mut found, none, 0) };
        assert_eq!(status, Status::Ok);
        assert_eq!(quality_of(&found), expected(&Quality::preset(&blob, preset)), "{preset:?}");
    }
    let mut message = Message::default();
    // SAFETY: as above.
    let status =
        unsafe { ffi::nerf_quality_preset(opened.scene, 5, &mut options, message.0.as_mut_ptr(), 256) };
    assert_eq!(status, Status::Options);
    assert!(message.text().contains("preset") && message.text().contains('5'), "{}", message.text());
}

#[test]
fn each_point_of_a_front_can_be_had() {
    let opened = call::open(Recipe::PROPOSAL.blob(), Kernel::IN_PLACE);
    let blob = Blob::open(&opened.blob).expect("a blob");
    let ask = |point, options: &mut ffi::RenderOptions, seen: &mut ffi::Choice| {
        let mut message = Message::default();
        let text = message.0.as_mut_ptr();
        // SAFETY: everything lives until the call returns.
        let status = unsafe { ffi::nerf_quality_point(opened.scene, point, options, seen, text, 256) };
        (status, message.text())
    };
    for (index, rust) in Quality::front(&blob) {
        let (mut options, mut seen) = (call::render_options(), choice());
        options.batch_rays = 17;
        assert_eq!(ask(index as u32, &mut options, &mut seen), (Status::Ok, String::new()));
        assert_eq!(quality_of(&options), expected(&rust.quality));
        assert_eq!((seen.loss_db, seen.cost, seen.within), (rust.loss_db, rust.cost, 1));
        assert!(seen.milliseconds.is_nan() && options.batch_rays == 17);
    }
    let (mut options, mut seen) = (call::render_options(), choice());
    let (status, message) = ask(blob.front().len() as u32, &mut options, &mut seen);
    assert_eq!((status, seen.within), (Status::Options, 9));
    assert!(message.contains("front_points"), "{message}");
}

/// Clock that advances by one tick at each call. `user`: two numbers, the time and the length of a tick.
unsafe extern "C-unwind" fn ticking(user: *mut c_void) -> u64 {
    // SAFETY: the test passes two numbers: the time and the tick.
    let [now, tick] = unsafe { &mut *user.cast::<[u64; 2]>() };
    *now += *tick;
    *now
}

fn measure(opened: &Opened, workspace: &mut Guarded, size: usize, limit: f32) -> (Status, String, ffi::Pace) {
    let camera = call::camera(&scenes::camera(60, 40));
    let mut pace = ffi::Pace { struct_size: size_of::<ffi::Pace>(), milliseconds: [-1.0; 16] };
    let (mut message, mut time) = (Message::default(), [5u64, 250]);
    // SAFETY: everything lives until the call returns.
    let status = unsafe {
        call::pace_measure(
            opened.scene,
            &camera,
            ptr::null(),
            OUTPUTS,
            limit,
            Some(ticking),
            (&raw mut time).cast(),
            workspace.at(),
            size,
            &mut pace,
            message.0.as_mut_ptr(),
            256,
        )
    };
    (status, message.text(), pace)
}

#[test]
fn a_pace_is_measured_in_memory_of_the_size_that_was_asked_and_buys_quality() {
    let opened = call::open(Recipe::PROPOSAL.blob(), Kernel::IN_PLACE);
    let (mut size, mut align, none) = (0, 0, ptr::null_mut());
    // SAFETY: the scene is intact and the places live until the call returns.
    let status = unsafe {
        call::pace_workspace_size(opened.scene, ptr::null(), OUTPUTS, &mut size, &mut align, none, 0)
    };
    assert_eq!((status, align), (Status::Ok, 64));
    let mut workspace = Guarded::new(size, 0);
    let (status, message, pace) = measure(&opened, &mut workspace, size - 64, 1e9);
    assert_eq!((status, pace.milliseconds), (Status::Memory, [-1.0; 16]), "{message}");
    assert!(message.contains(&size.to_string()), "{message}");
    let (status, message, pace) = measure(&opened, &mut workspace, size, 1e9);
    assert_eq!(status, Status::Ok, "{message}");
    assert!(workspace.surroundings_are_intact());
    // 2,400 pixels, of which every second of every second row is rendered; a tick is ¼ ms.
    let points = Blob::open(&opened.blob).expect("a blob").front().len();
    let expected: Vec<f32> = (0..16).map(|i| if i < points { 1.0 } else { f32::INFINITY }).collect();
    assert_eq!(pace.milliseconds.to_vec(), expected);

    let (mut options, mut seen) = (call::render_options(), choice());
    for (wish, within) in [(1.0, 1), (0.9, 0)] {
        // SAFETY: as above.
        let status = unsafe {
            ffi::nerf_quality_within_time(opened.scene, wish, &pace, &mut options, &mut seen, none, 0)
        };
        assert_eq!((status, seen.within, seen.milliseconds), (Status::Ok, within, 1.0));
    }
    // The library's own clock.
    let camera = call::camera(&scenes::camera(60, 40));
    let mut own = ffi::Pace { struct_size: size_of::<ffi::Pace>(), milliseconds: [-1.0; 16] };
    // SAFETY: as above.
    let status = unsafe {
        let (at, none) = (workspace.at(), ptr::null_mut());
        let (null, text) = (ptr::null(), ptr::null_mut());
        call::pace_measure(opened.scene, &camera, null, OUTPUTS, 1e9, None, none, at, size, &mut own, text, 0)
    };
    assert_eq!(status, Status::Ok);
    assert!(own.milliseconds[..points].iter().all(|ms| ms.is_finite() && *ms > 0.0), "{own:?}");
}

#[test]
fn a_scene_without_a_front_says_so_and_writes_nothing() {
    let opened = call::open(Recipe::PLAIN.blob(), Kernel::IN_PLACE);
    let (mut options, mut seen, mut message) = (call::render_options(), choice(), Message::default());
    options.samples = 77;
    let text = message.0.as_mut_ptr();
    // SAFETY: everything lives until the call returns.
    let status =
        unsafe { ffi::nerf_quality_within_loss(opened.scene, 0.1, &mut options, &mut seen, text, 256) };
    assert_eq!((status, options.samples, seen.within), (Status::NoFront, 77, 9));
    assert!(message.text().contains("front"), "{}", message.text());
    let mut workspace = Guarded::new(64, 0);
    let (status, message, pace) = measure(&opened, &mut workspace, 64, 1e9);
    assert_eq!((status, pace.milliseconds), (Status::NoFront, [-1.0; 16]), "{message}");
    // SAFETY: as above.
    let status = unsafe {
        ffi::nerf_quality_within_loss(opened.scene, 0.1, ptr::null_mut(), &mut seen, ptr::null_mut(), 0)
    };
    assert_eq!(status, Status::NullPointer);
}
