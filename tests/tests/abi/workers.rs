//! Workers through the C interface: their requests, repeated and concurrent use, and placed instances.

use nerf_core::Kernel;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Message, plane};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::{self, Recipe};
use std::ffi::c_void;
use std::ptr::{null, null_mut};

const SIDE: u32 = 20;
const COUNT: usize = (SIDE * SIDE) as usize;
const RGB: u32 = ffi::NERF_OUTPUT_RGB;

/// Opens a worker in memory of exactly the required size; on failure, returns status and message.
fn open(request: &ffi::Request) -> Result<(*mut ffi::Worker, Guarded), (Status, String)> {
    let (mut size, mut align, mut message) = (0, 0, Message::default());
    let text = message.0.as_mut_ptr();
    // SAFETY: everything the request points to lives until the call returns.
    let status = unsafe { ffi::nerf_worker_size(request, &mut size, &mut align, text, 256) };
    if status != Status::Ok {
        return Err((status, message.text()));
    }
    assert_eq!(align, 64);
    let mut handle = null_mut();
    let mut short = Guarded::new(size - 1, 0);
    let text = message.0.as_mut_ptr();
    // SAFETY: as above; the memory lives as long as the worker is used.
    let status = unsafe { ffi::nerf_worker_open(request, short.at(), size - 1, &mut handle, text, 256) };
    if status == Status::Memory {
        assert!(handle.is_null() && short.is_untouched());
        assert!(message.text().contains(&size.to_string()), "{}", message.text());
    } else {
        return Err((status, message.text()));
    }
    let mut memory = Guarded::new(size, 0);
    let text = message.0.as_mut_ptr();
    // SAFETY: as above.
    let status = unsafe { ffi::nerf_worker_open(request, memory.at(), size, &mut handle, text, 256) };
    assert!(memory.surroundings_are_intact());
    if status == Status::Ok { Ok((handle, memory)) } else { Err((status, message.text())) }
}

fn picture(worker: *mut ffi::Worker) -> (Status, Vec<[f32; 4]>, ffi::Counters) {
    let mut pixels = vec![[9.0f32; 4]; COUNT];
    let target = call::target(plane(pixels.as_mut_ptr().cast(), PixelFormat::RgbaF32));
    let (camera, mut counters) = (call::camera(&scenes::camera(SIDE, SIDE)), call::counters());
    let frame = call::whole_frame(&camera, &target);
    // SAFETY: the worker is intact.
    let status = unsafe { ffi::nerf_render(worker, &frame, &mut counters, null_mut(), 0) };
    (status, pixels, counters)
}

fn instance(scene: *const ffi::Scene, to_world: [f32; 12]) -> ffi::Instance {
    ffi::Instance { struct_size: size_of::<ffi::Instance>(), scene, to_world }
}

/// Returns a transform: rotated by 90° about z, scaled, and moved to `at`.
fn placed(scale: f32, at: [f32; 3]) -> [f32; 12] {
    let s = scale;
    [0.0, -s, 0.0, at[0], s, 0.0, 0.0, at[1], 0.0, 0.0, s, at[2]]
}

fn request_of(instances: &[ffi::Instance]) -> ffi::Request {
    let instance_count = instances.len();
    ffi::Request { instances: instances.as_ptr(), instance_count, ..call::request(null(), null(), RGB) }
}

#[test]
fn a_worker_renders_the_same_again_and_zeros_are_the_defaults() {
    for kernel in Kernel::all() {
        let opened = call::open(Recipe::OCCUPANCY.blob(), kernel);
        // SAFETY: zeros are numbers.
        let mut zeros: ffi::RenderOptions = unsafe { std::mem::zeroed() };
        zeros.struct_size = size_of::<ffi::RenderOptions>();
        let (worker, memory) = open(&call::request(opened.scene, &zeros, RGB)).expect("a worker");
        let (other, _memory) = open(&call::request(opened.scene, null(), RGB)).expect("a worker");
        let first = picture(worker);
        assert_eq!(first.0, Status::Ok);
        let (again, defaults) = (picture(worker), picture(other));
        assert!(first.1 == again.1 && first.1 == defaults.1, "{kernel}");
        let work = |found: &ffi::Counters| (found.rays, found.macs, found.density_evaluations);
        assert!(work(&first.2) == work(&again.2) && work(&first.2) == work(&defaults.2), "{kernel}");
        assert!(memory.surroundings_are_intact());
        let exact = call::render_options();
        let (exact, _memory) = open(&call::request(opened.scene, &exact, RGB)).expect("a worker");
        assert!(picture(exact).2.colour_evaluations > first.2.colour_evaluations, "{kernel}");
    }
}

#[test]
fn requests_that_make_no_worker_say_which_field() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let one = [instance(opened.scene, [0.0; 12])];
    let good = call::request(opened.scene, null(), RGB);
    let refused = |request: ffi::Request, expected: Status, text: &str| match open(&request) {
        Ok(_) => panic!("{text}: opened"),
        Err((status, said)) => assert!(status == expected && said.contains(text), "{status:?}: {said}"),
    };
    refused(ffi::Request { scene: null(), ..good }, Status::NullPointer, "request.scene");
    refused(
        ffi::Request { instances: one.as_ptr(), ..good },
        Status::Options,
        "either a scene, or instances",
    );
    refused(ffi::Request { instance_count: 1, ..good }, Status::Options, "either a scene, or instances");
    refused(ffi::Request { instance_count: 0, ..request_of(&one) }, Status::Options, "instances");
    refused(ffi::Request { outputs: 64, ..good }, Status::Options, "request.outputs");
    refused(ffi::Request { reserved: 1, ..good }, Status::Reserved, "request.reserved");
    refused(ffi::Request { struct_size: 8, ..good }, Status::StructSize, "request.struct_size");
    let (mut size, mut align) = (7, 7);
    // SAFETY: NULL is refused.
    let status = unsafe { ffi::nerf_worker_size(null(), &mut size, &mut align, null_mut(), 0) };
    assert_eq!((status, size, align), (Status::NullPointer, 7, 7));
}

#[test]
fn transforms_of_instances_are_checked_one_by_one() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let bad: [(&str, [f32; 12]); 6] = [
        ("not finite", [1.0, 0.0, 0.0, f32::NAN, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]),
        ("scale", [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        ("different lengths", [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ("different lengths", [1.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]),
        ("right angles", [1.0, 0.5, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]),
        ("mirrored", [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0]),
    ];
    for (text, transform) in bad {
        let both = [instance(opened.scene, placed(2.0, [0.0; 3])), instance(opened.scene, transform)];
        let (status, said) = open(&request_of(&both)).map(|_| ()).expect_err(text);
        assert!(status == Status::Transform && said.contains(text), "{status:?}: {said}");
        assert!(said.starts_with("instances[1].to_world"), "{said}");
    }
}

#[test]
fn an_instance_that_is_none_is_named_by_its_index() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let picture = call::open(Recipe::PICTURE.blob(), Kernel::IN_PLACE);
    let good = instance(opened.scene, [0.0; 12]);
    let short = ffi::Instance { struct_size: 8, ..good };
    let shifted = ffi::Instance { scene: opened.scene.wrapping_byte_add(4), ..good };
    for (wrong, expected, text) in [
        (short, Status::StructSize, ".struct_size: expected 64"),
        (instance(null(), [0.0; 12]), Status::NullPointer, ".scene: expected an address, found NULL"),
        (shifted, Status::Alignment, ".scene: expected a multiple of 64"),
        (instance(picture.scene, [0.0; 12]), Status::NotAScene, ".scene: blob: expected a scene"),
    ] {
        for (index, both) in [[wrong, good], [good, wrong]].iter().enumerate() {
            let (status, said) = open(&request_of(both)).map(|_| ()).expect_err(text);
            assert!(status == expected && said.starts_with(&format!("instances[{index}]{text}")), "{said}");
        }
    }
}

/// Verifies that an instance with another `struct_size` than the first is refused. The first instance's size is the
/// stride of the array; a larger instance would be read beyond the end of the array.
#[test]
fn instances_of_different_sizes_are_refused_by_index() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let own = size_of::<ffi::Instance>();
    for says in [own + 8, own - 8, 0, usize::MAX] {
        // What lies behind the array could be the tail of a later version's instance.
        let mut three = [instance(opened.scene, [0.0; 12]); 3];
        (three[1].struct_size, three[2]) = (says, instance(null(), [0.0; 12]));
        three[2].struct_size = 0;
        let (status, said) = open(&request_of(&three[..2])).map(|_| ()).expect_err("refused");
        assert_eq!(status, Status::StructSize);
        assert_eq!(said, format!("instances[1].struct_size: expected {own}, as of the first, found {says}"));
    }
}

/// Renders placed scenes: unmoved, moved together with the camera, two at once, and in instance structures of any size.
#[test]
fn placed_fields_are_seen_where_they_stand() {
    for kernel in Kernel::all() {
        let opened = call::open(Recipe::OCCUPANCY.blob(), kernel);
        // Without cuts, which are drawn at other samples.
        let exact = call::render_options();
        let (alone, _memory) = open(&call::request(opened.scene, &exact, RGB)).expect("a worker");
        let alone = picture(alone).1;
        let of = |instances: &[ffi::Instance]| {
            open(&ffi::Request { options: &exact, ..request_of(instances) }).expect("a worker")
        };
        let (here, _memory) = of(&[instance(opened.scene, [0.0; 12])]);
        let here = picture(here).1;
        let limit = if kernel.rounds() { 2e-2 } else { 1e-4 };
        let off = |a: &[[f32; 4]], b: &[[f32; 4]]| {
            a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
        };
        assert_eq!(here, alone, "{kernel}");
        // Behind the camera there is nothing to be seen of it, and with both the one in front is.
        let eye = scenes::camera(SIDE, SIDE).pose().position;
        let away = instance(opened.scene, placed(0.5, (eye * 3.0).to_array()));
        let (behind, _memory) = of(&[away]);
        assert!(picture(behind).1.iter().all(|pixel| *pixel == [0.0; 4]));
        let (both, _memory) = of(&[away, instance(opened.scene, [0.0; 12])]);
        assert!(off(&picture(both).1, &here) < limit, "{kernel}");
    }
}

#[test]
fn a_scene_is_unbounded_at_the_end_or_not_at_all() {
    let (room, thing) = (
        call::open(Recipe::CONTRACTED.blob(), Kernel::detect()),
        call::open(Recipe::OCCUPANCY.blob(), Kernel::detect()),
    );
    let (room, thing) = (instance(room.scene, [0.0; 12]), instance(thing.scene, [0.0; 12]));
    assert!(open(&request_of(&[thing, room])).is_ok());
    for wrong in [[room, thing], [room, room]] {
        let (status, said) = open(&request_of(&wrong)).map(|_| ()).expect_err("refused");
        assert!(status == Status::Options && said.starts_with("instances[0]"), "{status:?}: {said}");
    }
}

#[test]
fn threads_with_a_worker_each_see_the_same() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::detect());
    let two = [instance(opened.scene, [0.0; 12]), instance(opened.scene, placed(0.8, [0.3, 0.1, 0.2]))];
    let (worker, _memory) = open(&request_of(&two)).expect("a worker");
    let expected = picture(worker).1;
    let address = opened.scene as usize;
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let scene = address as *const ffi::Scene;
                let two = [instance(scene, [0.0; 12]), instance(scene, placed(0.8, [0.3, 0.1, 0.2]))];
                let (worker, _memory) = open(&request_of(&two)).expect("a worker");
                for _ in 0..3 {
                    assert!(picture(worker).1 == expected);
                }
            });
        }
    });
}

unsafe extern "C-unwind" fn panics(_: *mut c_void, _: u64, _: u64) -> i32 {
    std::panic::resume_unwind(Box::new(()))
}

#[test]
fn a_worker_whose_call_panicked_is_of_no_more_use_but_its_scene_is() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::detect());
    let (worker, _memory) = open(&call::request(opened.scene, null(), RGB)).expect("a worker");
    let expected = picture(worker).1;
    let mut pixels = vec![[9.0f32; 4]; COUNT];
    let target = call::target(plane(pixels.as_mut_ptr().cast(), PixelFormat::RgbaF32));
    let camera = call::camera(&scenes::camera(SIDE, SIDE));
    let frame = ffi::Frame { progress: Some(panics), ..call::whole_frame(&camera, &target) };
    // SAFETY: everything lives until the call returns.
    let status = unsafe { ffi::nerf_render(worker, &frame, null_mut(), null_mut(), 0) };
    assert_eq!(status, Status::Panic);
    assert_eq!(picture(worker).0, Status::Busy);
    let (another, _memory) = open(&call::request(opened.scene, null(), RGB)).expect("a worker");
    assert!(picture(another).1 == expected);
}

/// Verifies that densities and colours may be fields of the structures that contain the points.
#[test]
fn points_and_their_answers_may_lie_in_one_structure() {
    #[repr(C)]
    #[derive(Clone, Copy)]
    struct Point {
        position: [f32; 3],
        sigma: f32,
        rgb: [f32; 3],
        dir: [f32; 3],
    }
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::detect());
    let (worker, _memory) = open(&call::request(opened.scene, null(), RGB)).expect("a worker");
    let at = |i: usize| [-0.9 + 0.02 * i as f32, -0.4 + 0.01 * i as f32, 0.9 - 0.02 * i as f32];
    let blank = Point { position: [0.0; 3], sigma: -1.0, rgb: [-1.0; 3], dir: [0.0, 0.0, -1.0] };
    let mut points: Vec<Point> = (0..90).map(|i| Point { position: at(i), ..blank }).collect();
    let first = points.as_mut_ptr().cast::<u8>();
    let stride = size_of::<Point>();
    let floats = |offset: usize| ffi::Floats { data: first.wrapping_add(offset).cast(), stride };
    let to = |offset: usize, format| ffi::Plane {
        pixel_stride: stride,
        ..plane(first.wrapping_add(offset).cast(), format)
    };
    let asked = ffi::Points {
        struct_size: size_of::<ffi::Points>(),
        count: points.len(),
        positions: floats(0),
        dirs: floats(28),
        sigma: to(12, PixelFormat::F32),
        rgb: to(16, PixelFormat::RgbF32),
    };
    // SAFETY: everything lives until the call returns.
    let status = unsafe { ffi::nerf_query(worker, &asked, null_mut(), null_mut(), 0) };
    assert_eq!(status, Status::Ok);
    let (positions, dirs): (Vec<_>, Vec<_>) = (0..90).map(|i| (at(i), [0.0, 0.0, -1.0f32])).unzip();
    let (mut sigma, mut rgb) = (vec![-1.0f32; 90], vec![[-1.0f32; 3]; 90]);
    let mut room = opened.workspace(None, RGB);
    // SAFETY: as above.
    let status = unsafe {
        call::query(
            opened.scene,
            null(),
            90,
            positions.as_ptr().cast(),
            dirs.as_ptr().cast(),
            sigma.as_mut_ptr(),
            rgb.as_mut_ptr().cast(),
            room.at(),
            room.size(),
            null_mut(),
            null_mut(),
            0,
        )
    };
    assert_eq!(status, Status::Ok);
    for (i, point) in points.iter().enumerate() {
        assert!(point.sigma == sigma[i] && point.rgb == rgb[i] && point.position == at(i), "point {i}");
    }
    assert!(sigma.iter().filter(|sigma| **sigma > 0.0).count() > 5);
    // A row of densities that runs into the colours is refused.
    let wrong = ffi::Points { sigma: to(16, PixelFormat::F32), ..asked };
    // SAFETY: as above.
    let status = unsafe { ffi::nerf_query(worker, &wrong, null_mut(), null_mut(), 0) };
    assert_eq!(status, Status::Overlap);
}
