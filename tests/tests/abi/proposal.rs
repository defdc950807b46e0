//! A scene with a proposal network, rendered through the C interface.

use nerf_core::Kernel;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Message, Opened, plane};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::{Recipe, camera, kernels};
use std::ptr::{null, null_mut};

const SIDE: u32 = 20;

/// Renders a frame. Returns status, image, counters and the size of the workspace.
fn render(opened: &Opened, options: &ffi::RenderOptions) -> (Status, Vec<u8>, ffi::Counters, usize) {
    let mut workspace = opened.workspace(Some(options), ffi::NERF_OUTPUT_RGB);
    let mut picture = Guarded::new((3 * SIDE * SIDE) as usize, 0);
    let (camera, mut counters) = (call::camera(&camera(SIDE, SIDE)), call::counters());
    let target = call::target(plane(picture.at(), PixelFormat::RgbU8));
    let (at, size, mut message) = (workspace.at(), workspace.size(), Message::default());
    let (text, none) = (message.0.as_mut_ptr(), null_mut());
    // SAFETY: everything lives until the call returns.
    let status = unsafe {
        call::render(
            opened.scene,
            &camera,
            options,
            null(),
            &target,
            at,
            size,
            None,
            none,
            &mut counters,
            text,
            256,
        )
    };
    assert!(workspace.surroundings_are_intact() && picture.surroundings_are_intact());
    (status, picture.bytes().to_vec(), counters, size)
}

pub(super) fn describe(opened: &Opened) -> ffi::SceneInfo {
    let mut info = std::mem::MaybeUninit::<ffi::SceneInfo>::zeroed();
    // SAFETY: zeros are valid numbers and pointers that nobody follows; the place lives until the call returns.
    unsafe {
        (*info.as_mut_ptr()).struct_size = size_of::<ffi::SceneInfo>();
        assert_eq!(ffi::nerf_scene_describe(opened.scene, info.as_mut_ptr()), Status::Ok);
        info.assume_init()
    }
}

#[test]
fn a_proposal_ignored_is_a_scene_without_one() {
    for kernel in kernels() {
        let with = call::open(Recipe::PROPOSAL.blob(), kernel);
        let without = call::open(Recipe { proposal: None, ..Recipe::PROPOSAL }.blob(), kernel);
        let on = call::render_options();
        let off = ffi::RenderOptions { ignore_proposal: 1, ..on };
        let (drawn, even, plain) = (render(&with, &on), render(&with, &off), render(&without, &on));
        assert_eq!([drawn.0, even.0, plain.0], [Status::Ok; 3]);
        assert!(even.1 == plain.1 && even.3 == plain.3 && even.2.macs == plain.2.macs, "{}", kernel);
        assert_eq!((even.2.proposal_evaluations, plain.2.proposal_evaluations), (0, 0));
        let rays = u64::from(SIDE * SIDE);
        assert!(drawn.2.proposal_evaluations > 0 && drawn.3 > even.3 && drawn.1 != even.1);
        // 48 drawn, 12 the proposal's own.
        assert_eq!(drawn.2.samples_kept + drawn.2.samples_skipped, rays * 60);
        assert_eq!(even.2.samples_kept + even.2.samples_skipped, rays * 48);
    }
}

#[test]
fn a_scene_says_that_it_has_one_and_what_it_costs() {
    let info = describe(&call::open(Recipe::PROPOSAL.blob(), Kernel::IN_PLACE));
    assert_eq!((info.proposal_samples, info.front_points), (12, 2));
    assert!(info.proposal_macs > 0 && info.proposal_macs < info.density_macs);
    for recipe in [Recipe::OCCUPANCY, Recipe::PICTURE] {
        let info = describe(&call::open(recipe.blob(), Kernel::IN_PLACE));
        assert_eq!((info.proposal_samples, info.front_points, info.proposal_macs), (0, 0, 0));
    }
}

#[test]
fn a_flag_is_0_or_1() {
    let opened = call::open(Recipe::PROPOSAL.blob(), Kernel::IN_PLACE);
    let good = call::render_options();
    let wrong = ffi::RenderOptions { ignore_proposal: 2, ..good };
    let (mut size, mut align, mut message) = (7, 7, Message::default());
    let text = message.0.as_mut_ptr();
    // SAFETY: everything lives until the call returns.
    let status = unsafe {
        call::worker_size(opened.scene, &wrong, ffi::NERF_OUTPUT_RGB, &mut size, &mut align, text, 256)
    };
    assert!(status != Status::Ok && (size, align) == (7, 7));
    assert!(message.text().contains("options.ignore_proposal"), "{}", message.text());
}
