//! Views from any distance through the C interface, and the caller's own near and far distances.

use nerf_core::Kernel;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Message, Opened, plane};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::Recipe;
use std::ptr::{null, null_mut};

const SIDE: u32 = 20;
/// Distance half way between the recipes' near and far, world units.
const TRAINED: f32 = 4.0;

/// Returns a camera in the direction `towards` from the origin, at `times` times the distance [`TRAINED`]; the box
/// fills the image.
fn from(times: f32, towards: [f32; 3]) -> Camera {
    let eye = glam::Vec3::from(towards).normalize() * times * TRAINED;
    let pose = Pose::look_at(eye, glam::Vec3::ZERO, glam::Vec3::Y).expect("a pose");
    let focal = SIDE as f32 * (times * TRAINED / 3.0).max(0.4);
    Camera::new(Intrinsics::centred(SIDE, SIDE, focal), Lens::NONE, pose).expect("a camera")
}

/// Renders an image. Returns the status, the share of pixels that are not background, and the message.
fn seen(opened: &Opened, camera: &Camera, options: &ffi::RenderOptions) -> (Status, f32, String) {
    let mut workspace = opened.workspace(Some(&call::render_options()), ffi::NERF_OUTPUT_RGB);
    let mut picture = Guarded::new((3 * SIDE * SIDE) as usize, 0);
    let camera = call::camera(camera);
    let target = call::target(plane(picture.at(), PixelFormat::RgbU8));
    let (at, size, mut message) = (workspace.at(), workspace.size(), Message::default());
    let (text, none, counters) = (message.0.as_mut_ptr(), null_mut(), null_mut());
    let (scene, rect) = (opened.scene, null());
    // SAFETY: everything lives until the call returns.
    let status = unsafe {
        call::render(scene, &camera, options, rect, &target, at, size, None, none, counters, text, 256)
    };
    let foreground = picture.bytes().chunks_exact(3).filter(|pixel| **pixel != [255, 128, 64]).count();
    (status, foreground as f32 / (SIDE * SIDE) as f32, message.text())
}

fn info(opened: &Opened) -> ffi::SceneInfo {
    let mut info = std::mem::MaybeUninit::<ffi::SceneInfo>::zeroed();
    // SAFETY: zeros are valid numbers and pointers that nobody follows; the place lives until the call returns.
    unsafe {
        (*info.as_mut_ptr()).struct_size = size_of::<ffi::SceneInfo>();
        assert_eq!(ffi::nerf_scene_describe(opened.scene, info.as_mut_ptr()), Status::Ok);
        info.assume_init()
    }
}

#[test]
fn a_scene_is_there_from_anywhere() {
    let scenes = [
        (Recipe::PLAIN, 0.0, 48, ffi::TableStorage::None),
        (Recipe::LEARNED, 0.08, 49, ffi::TableStorage::F16),
        (Recipe::LEARNED_INT8, 0.08, 49, ffi::TableStorage::Int8),
        (Recipe::LEARNED_CODED, 0.08, 49, ffi::TableStorage::Coded),
        (Recipe::DEFERRED, 0.08, 49, ffi::TableStorage::F16),
    ];
    for (recipe, step, samples, storage) in scenes {
        let opened = call::open(recipe.blob(), Kernel::IN_PLACE);
        let info = info(&opened);
        assert_eq!(
            (info.step, info.samples, info.near_distance, info.far_distance),
            (step, samples, 2.0, 6.0)
        );
        assert_eq!(info.table_storage, storage as u32);
        assert_eq!((info.contraction_radius, info.contraction_power), (0.0, 0));
        assert_eq!((info.eye, info.target, info.up, info.arc), ([0.0; 3], [0.0; 3], [0.0; 3], 0.0));
        let options = call::render_options();
        for towards in [[0.3, 0.5, 0.8], [-0.3, -0.5, -0.8], [0.0, 0.01, 1.0]] {
            let (status, usual, _) = seen(&opened, &from(1.0, towards), &options);
            assert!(status == Status::Ok && usual > 0.3, "{status:?}, {usual}");
            for times in [0.1, 0.3, 0.6, 1.5, 4.0, 1000.0] {
                let (status, found, _) = seen(&opened, &from(times, towards), &options);
                assert!(
                    status == Status::Ok && found > 0.4 * usual,
                    "{recipe:?} from {times}: {found} of {usual}"
                );
            }
        }
    }
}

#[test]
fn an_unbounded_scene_says_so_and_surrounds_the_camera() {
    let opened = call::open(Recipe::CONTRACTED.blob(), Kernel::IN_PLACE);
    let info = info(&opened);
    assert_eq!((info.contraction_radius, info.contraction_power, info.step), (1.0, 2, 0.0625));
    // The cube around the contracted space.
    assert_eq!((info.box_min, info.box_max), ([-2.0, -2.25, -2.0], [2.0, 1.75, 2.0]));
    assert_eq!((info.near_distance, info.far_distance), (0.125, 50.0));
    assert_eq!((info.eye, info.target, info.up, info.arc), ([3.0, 1.0, 0.0], [0.0; 3], [0.0, 1.0, 0.0], 2.0));
    for times in [0.1, 1.0, 10.0] {
        let (status, found, _) = seen(&opened, &from(times, [0.3, 0.5, 0.8]), &call::render_options());
        assert!(status == Status::Ok && found > 0.3, "from {times}: {found}");
    }
}

#[test]
fn near_and_far_are_the_caller_s() {
    let camera = from(4.0, [0.3, 0.5, 0.8]);
    for recipe in [Recipe::PLAIN, Recipe::LEARNED] {
        let opened = call::open(recipe.blob(), Kernel::IN_PLACE);
        let with = |near_distance, far_distance, own_bins| {
            let options =
                ffi::RenderOptions { near_distance, far_distance, own_bins, ..call::render_options() };
            seen(&opened, &camera, &options)
        };
        let (_, whole, _) = with(0.0, 0.0, 0);
        assert!(whole > 0.3);
        assert_eq!(with(0.0, f32::INFINITY, 0), with(0.0, 0.0, 0));
        assert_eq!(with(0.0, 13.0, 0).1, 0.0, "the box begins behind it");
        assert_eq!(with(19.0, 0.0, 0).1, 0.0, "the box ends in front of it");
        let (_, part, _) = with(15.9, 16.1, 0);
        assert!(part > 0.0 && part <= whole, "{part} of {whole}");
        // From here the bins that a network was trained on lie in front of the scene; a march has no others.
        let own = with(0.0, 0.0, 1).1;
        assert_eq!(own, if recipe.features == 0 { 0.0 } else { whole });
        for (near, far) in [(-1.0, 0.0), (3.0, 2.0), (f32::NAN, 0.0), (0.0, f32::NAN), (0.0, -1.0)] {
            let (status, _, message) = with(near, far, 0);
            assert_eq!(status, Status::Options, "{near}, {far}");
            assert!(message.contains("near/far: expected 0 <= near <= far"), "{message}");
        }
        assert_eq!(with(0.0, 0.0, 2).0, Status::Options);
    }
}
