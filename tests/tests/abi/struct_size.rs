//! Versioned structures with a `struct_size` that no version has, in every smaller call that takes the structure: each
//! call is refused, and nothing is written. `cases.rs` tests the structures of a frame.

use nerf_core::Kernel;
use nerf_render as ffi;
use nerf_render::{NERF_OUTPUT_RGB, Status};
use nerf_testing::call::{self, Opened};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::{self, Recipe};
use std::ffi::c_void;
use std::marker::PhantomData;
use std::mem::offset_of;
use std::ptr::{null, null_mut};

/// Memory of a structure in which only `struct_size` is set, to any value.
struct OfSize<T> {
    words: Vec<usize>,
    says: usize,
    of: PhantomData<T>,
}

impl<T> OfSize<T> {
    const FILL: usize = usize::from_ne_bytes([0xa5; size_of::<usize>()]);

    fn new(says: usize) -> Self {
        let mut words = vec![Self::FILL; size_of::<T>().div_ceil(size_of::<usize>())];
        words[0] = says;
        Self { words, says, of: PhantomData }
    }

    /// Returns structures with each size that no version has. `first`: the structure's size in the first version,
    /// bytes.
    fn wrong(first: usize) -> impl Iterator<Item = Self> {
        [0, 1, 8, first - 1, 4097, usize::MAX].into_iter().map(Self::new)
    }

    fn at(&mut self) -> *mut T {
        self.words.as_mut_ptr().cast()
    }

    /// Verifies that the calls refused the structure's size and wrote nothing to the structure.
    fn refused<const N: usize>(&self, found: [Status; N]) {
        assert_eq!(found, [Status::StructSize; N], "{} of {} bytes", std::any::type_name::<T>(), self.says);
        assert!(self.words[0] == self.says && self.words[1..].iter().all(|&word| word == Self::FILL));
    }
}

/// Opens a scene that has a Pareto front.
fn opened() -> Opened {
    call::open(Recipe::PROPOSAL.blob(), Kernel::IN_PLACE)
}

/// Returns options that a refused call must not change.
fn options() -> ffi::RenderOptions {
    ffi::RenderOptions { samples: 77, ..call::render_options() }
}

#[test]
fn structures_of_open_options_of_no_version_s_size_open_nothing() {
    let (opened, none) = (opened(), null_mut());
    let (blob, length) = (opened.blob.as_ptr().cast::<c_void>(), opened.blob.len());
    let mut memory = Guarded::new(opened.memory.size(), 0);
    let (at, room) = (memory.at(), memory.size());
    let (mut size, mut align, mut scene) = (7, 7, null());
    for mut options in OfSize::<ffi::OpenOptions>::wrong(size_of::<ffi::OpenOptions>()) {
        // SAFETY: everything lives until the calls return; what is as long as it says must not be believed.
        let found = unsafe {
            [
                ffi::nerf_scene_memory(blob, length, options.at(), &mut size, &mut align, none, 0),
                ffi::nerf_scene_open(blob, length, options.at(), at, room, &mut scene, none, 0),
                ffi::nerf_scene_open_file(c"none".as_ptr(), options.at(), &mut scene, none, 0),
            ]
        };
        options.refused(found);
    }
    assert!((size, align) == (7, 7) && scene.is_null() && memory.is_untouched());
}

#[test]
fn structures_of_scene_info_of_no_version_s_size_are_not_filled() {
    let opened = opened();
    // The proposal's fields came later.
    for mut info in OfSize::<ffi::SceneInfo>::wrong(offset_of!(ffi::SceneInfo, proposal_samples)) {
        // SAFETY: as above.
        let found = unsafe { ffi::nerf_scene_describe(opened.scene, info.at()) };
        info.refused([found]);
    }
}

#[test]
fn structures_of_pace_of_no_version_s_size_measure_and_buy_nothing() {
    let (opened, none, user) = (opened(), null_mut(), null_mut());
    let (scene, rgb) = (opened.scene, NERF_OUTPUT_RGB);
    let (mut size, mut align) = (0, 0);
    // SAFETY: as above.
    let status = unsafe { call::pace_workspace_size(scene, null(), rgb, &mut size, &mut align, none, 0) };
    assert_eq!(status, Status::Ok);
    let mut workspace = Guarded::new(size, 0);
    let (seen, mut options, lines) = (call::camera(&scenes::camera(8, 8)), options(), workspace.at());
    for mut pace in OfSize::<ffi::Pace>::wrong(size_of::<ffi::Pace>()) {
        let at = pace.at();
        // SAFETY: as above.
        let found = unsafe {
            [
                call::pace_measure(scene, &seen, null(), rgb, 9.0, None, user, lines, size, at, none, 0),
                ffi::nerf_quality_within_time(scene, 9.0, at, &mut options, null_mut(), none, 0),
            ]
        };
        pace.refused(found);
    }
    assert!(options.samples == 77 && workspace.is_untouched());
}

#[test]
fn structures_of_choice_of_no_version_s_size_choose_nothing() {
    let (opened, none) = (opened(), null_mut());
    let (scene, mut options) = (opened.scene, options());
    let pace = ffi::Pace { struct_size: size_of::<ffi::Pace>(), milliseconds: [1.0; 16] };
    for mut choice in OfSize::<ffi::Choice>::wrong(size_of::<ffi::Choice>()) {
        let (to, at) = (&raw mut options, choice.at());
        // SAFETY: as above.
        let found = unsafe {
            [
                ffi::nerf_quality_within_loss(scene, 0.1, to, at, none, 0),
                ffi::nerf_quality_within_cost(scene, 0.5, to, at, none, 0),
                ffi::nerf_quality_within_time(scene, 9.0, &pace, to, at, none, 0),
                ffi::nerf_quality_point(scene, 0, to, at, none, 0),
            ]
        };
        choice.refused(found);
    }
    assert_eq!(options.samples, 77);
}

#[test]
fn structures_of_render_options_of_no_version_s_size_plan_and_choose_nothing() {
    let (opened, none) = (opened(), null_mut());
    let (scene, rgb) = (opened.scene, NERF_OUTPUT_RGB);
    let (mut size, mut align) = (7, 7);
    // The effects came later.
    for mut options in OfSize::<ffi::RenderOptions>::wrong(offset_of!(ffi::RenderOptions, effects)) {
        let at = options.at();
        // SAFETY: as above.
        let found = unsafe {
            [
                call::worker_size(scene, at, rgb, &mut size, &mut align, none, 0),
                call::pace_workspace_size(scene, at, rgb, &mut size, &mut align, none, 0),
                ffi::nerf_quality_within_loss(scene, 0.1, at, null_mut(), none, 0),
                ffi::nerf_quality_point(scene, 0, at, null_mut(), none, 0),
                ffi::nerf_quality_preset(scene, 0, at, none, 0),
            ]
        };
        options.refused(found);
    }
    assert_eq!((size, align), (7, 7));
}

#[test]
fn structures_of_camera_of_no_version_s_size_turn_and_see_nothing() {
    let (eye, target, up) = ([3.0f32, 0.0, 0.0], [0.0f32; 3], [0.0f32, 1.0, 0.0]);
    let (mut origin, mut dir, mut z) = ([7.0f32; 3], [7.0f32; 3], 7.0f32);
    let (o, d) = (origin.as_mut_ptr(), dir.as_mut_ptr());
    for mut camera in OfSize::<ffi::Camera>::wrong(size_of::<ffi::Camera>()) {
        // SAFETY: as above.
        let found = unsafe {
            let (eye, target, up) = (eye.as_ptr(), target.as_ptr(), up.as_ptr());
            [
                ffi::nerf_camera_look_at(camera.at(), eye, target, up, null_mut(), 0),
                ffi::nerf_camera_ray(camera.at(), 1.0, 1.0, o, d, &mut z, null_mut(), 0),
            ]
        };
        camera.refused(found);
    }
    assert_eq!((origin, dir, z), ([7.0; 3], [7.0; 3], 7.0));
}

/// Returns a copy of a structure with `struct_size` set to `bytes`, its size in version 2 of the ABI.
fn of_version_2<T: Copy>(value: &T, bytes: usize) -> T {
    let mut value = *value;
    // SAFETY: each structure begins with its size.
    unsafe { (&raw mut value).cast::<usize>().write(bytes) };
    value
}

/// Structure sizes that hosts compiled against version 2 pass on 64-bit machines. Every later library of version 2
/// accepts them.
#[cfg(target_pointer_width = "64")]
#[test]
fn structures_of_version_2_stay_long_enough() {
    let (opened, none, out) = (opened(), null_mut(), null_mut());
    let (mut size, mut align, blob) = (0, 0, &opened.blob);
    let open = of_version_2(&call::open_options(Kernel::IN_PLACE), 40);
    let options = of_version_2(&call::render_options(), 136);
    let instance = ffi::Instance { struct_size: 64, scene: opened.scene, to_world: [0.0; 12] };
    let one = call::request(opened.scene, &options, NERF_OUTPUT_RGB);
    let placed = ffi::Request { scene: null(), instances: &instance, instance_count: 1, ..one };
    let camera = of_version_2(&call::camera(&scenes::camera(1, 1)), 120);
    let mut pixel = [0.0f32; 3];
    let rgb = call::plane(pixel.as_mut_ptr().cast(), ffi::PixelFormat::RgbF32);
    let target = of_version_2(&call::target(rgb), 264);
    let frame = of_version_2(&call::whole_frame(&camera, &target), 56);
    let (place, dir) = ([0.0f32; 3], [0.0f32, 0.0, -1.0]);
    let (positions, dirs) = (call::floats(place.as_ptr()), call::floats(dir.as_ptr()));
    let (nothing, axis) = (call::floats(null()), null());
    let rays = ffi::Rays {
        struct_size: 112,
        count: 1,
        origins: positions,
        dirs,
        t_min: nothing,
        t_max: nothing,
        random: nothing,
        axis,
        target: &target,
    };
    let mut sigma = 0.0f32;
    let sigma = call::plane((&raw mut sigma).cast(), ffi::PixelFormat::F32);
    let points = ffi::Points { struct_size: 112, count: 1, positions, dirs, sigma, rgb };
    let mut counters = of_version_2(&call::counters(), 80);
    let pace = ffi::Pace { struct_size: 72, milliseconds: [1.0; 16] };
    let pace_request = of_version_2(&call::pace_request(opened.scene, &options, NERF_OUTPUT_RGB), 56);
    // SAFETY: zeros are numbers and pointers.
    let (info, choice) = unsafe { (std::mem::zeroed::<ffi::SceneInfo>(), std::mem::zeroed::<ffi::Choice>()) };
    let (mut info, mut choice) = (of_version_2(&info, 320), of_version_2(&choice, 24));
    let mut chosen = options;
    let mut memory = opened.workspace(Some(&options), NERF_OUTPUT_RGB);
    let (at, room, mut worker) = (memory.at(), memory.size(), null_mut());
    // SAFETY: everything lives until the calls return.
    let found = unsafe {
        [
            ffi::nerf_scene_memory(blob.as_ptr().cast(), blob.len(), &open, &mut size, &mut align, none, 0),
            ffi::nerf_scene_describe(opened.scene, &mut info),
            ffi::nerf_worker_size(&of_version_2(&placed, 48), &mut size, &mut align, none, 0),
            ffi::nerf_worker_open(&of_version_2(&one, 48), at, room, &mut worker, none, 0),
            ffi::nerf_render(worker, &frame, &mut counters, none, 0),
            ffi::nerf_render_rays(worker, &rays, out, none, 0),
            ffi::nerf_query(worker, &points, out, none, 0),
            ffi::nerf_pace_workspace_size(&pace_request, &mut size, &mut align, none, 0),
            ffi::nerf_quality_within_time(opened.scene, 9.0, &pace, &mut chosen, &mut choice, none, 0),
        ]
    };
    assert_eq!(found, [Status::Ok; 9]);
}
