//! The caller's own rays through the C interface, and limits: compared with frames and with Rust, and refused
//! arguments.

use nerf_core::Kernel;
use nerf_core::camera;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Message, NO_PLANE, Opened, plane};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::{self, Recipe};
use std::ptr::{null, null_mut};

const SIDE: u32 = 20;
const COUNT: usize = (SIDE * SIDE) as usize;
const EVERYTHING: u32 = 63;

/// A host's own structure of a ray, with other fields between those of the ray.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
struct Mine {
    id: u32,
    origin: [f32; 3],
    t_max: f32,
    dir: [f32; 3],
    more: [u32; 2],
    t_min: f32,
    random: f32,
}

/// A host's own structure of a ray's result.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
struct Hit {
    rgba: [f32; 4],
    between: u32,
    ray_distance: f32,
    z_depth: f32,
    median: f32,
    normal: [f32; 3],
    opacity: f32,
}

const BLANK: Hit = Hit {
    rgba: [9.0; 4],
    between: 77,
    ray_distance: 9.0,
    z_depth: 9.0,
    median: 9.0,
    normal: [9.0; 3],
    opacity: 9.0,
};

struct Worker {
    handle: *mut ffi::Worker,
    memory: Guarded,
}

fn open(opened: &Opened, options: &ffi::RenderOptions, outputs: u32) -> Worker {
    let mut memory = opened.workspace(Some(options), outputs);
    let (mut handle, request) = (null_mut(), call::request(opened.scene, options, outputs));
    // SAFETY: everything lives until the call returns, scene and memory as long as the worker is used.
    let status =
        unsafe { ffi::nerf_worker_open(&request, memory.at(), memory.size(), &mut handle, null_mut(), 0) };
    assert_eq!(status, Status::Ok);
    Worker { handle, memory }
}

fn target(hits: &mut [Hit]) -> ffi::Target {
    let first = hits.as_mut_ptr().cast::<u8>();
    let at = |offset: usize, format| ffi::Plane {
        pixel_stride: size_of::<Hit>(),
        ..plane(first.wrapping_add(offset).cast(), format)
    };
    ffi::Target {
        opacity: at(std::mem::offset_of!(Hit, opacity), PixelFormat::F32),
        ray_distance: at(std::mem::offset_of!(Hit, ray_distance), PixelFormat::F32),
        z_depth: at(std::mem::offset_of!(Hit, z_depth), PixelFormat::F32),
        median_distance: at(std::mem::offset_of!(Hit, median), PixelFormat::F32),
        normals: at(std::mem::offset_of!(Hit, normal), PixelFormat::Vec3F32),
        ..call::target(at(0, PixelFormat::RgbaF32))
    }
}

fn rays(mine: &[Mine], axis: &[f32; 3], target: &ffi::Target) -> ffi::Rays {
    let first = mine.as_ptr().cast::<u8>();
    let at =
        |offset: usize| ffi::Floats { data: first.wrapping_add(offset).cast(), stride: size_of::<Mine>() };
    ffi::Rays {
        struct_size: size_of::<ffi::Rays>(),
        count: mine.len(),
        origins: at(std::mem::offset_of!(Mine, origin)),
        dirs: at(std::mem::offset_of!(Mine, dir)),
        t_min: at(std::mem::offset_of!(Mine, t_min)),
        t_max: at(std::mem::offset_of!(Mine, t_max)),
        random: at(std::mem::offset_of!(Mine, random)),
        axis: axis.as_ptr(),
        target,
    }
}

/// Returns rays without random numbers, as `nerf_render_rays` takes them.
fn without_numbers(mine: &[Mine], axis: &[f32; 3], target: &ffi::Target) -> ffi::Rays {
    ffi::Rays { random: ffi::Floats { data: null(), stride: 0 }, ..rays(mine, axis, target) }
}

fn seen() -> camera::Camera {
    scenes::camera(SIDE, SIDE)
}

fn mine() -> Vec<Mine> {
    let camera = seen();
    let of = |i: u32| {
        let ray = camera.ray((i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5);
        let (origin, dir) = (ray.origin.to_array(), ray.dir.to_array());
        let random = (i as f32 + 0.5) / COUNT as f32;
        Mine { id: i, origin, t_max: f32::INFINITY, dir, more: [5; 2], t_min: 0.0, random }
    };
    (0..SIDE * SIDE).map(of).collect()
}

type Call = unsafe extern "C" fn(
    *mut ffi::Worker,
    *const ffi::Rays,
    *mut ffi::Counters,
    *mut std::ffi::c_char,
    usize,
) -> Status;

fn trace(worker: &Worker, call: Call, rays: &ffi::Rays) -> (Status, String, ffi::Counters) {
    let (mut counters, mut message) = (call::counters(), Message::default());
    // SAFETY: the worker is intact, and everything the rays point to lives until the call returns.
    let status = unsafe { call(worker.handle, rays, &mut counters, message.0.as_mut_ptr(), 256) };
    assert_eq!(message.text().is_empty(), status == Status::Ok, "{}", message.text());
    assert!(worker.memory.surroundings_are_intact());
    (status, message.text(), counters)
}

fn frame(worker: &Worker, target: &ffi::Target) -> Status {
    let camera = call::camera(&seen());
    let frame = call::whole_frame(&camera, target);
    // SAFETY: as above.
    unsafe { ffi::nerf_render(worker.handle, &frame, null_mut(), null_mut(), 0) }
}

#[test]
fn rays_of_a_camera_are_its_frame_in_any_order_and_number_with_any_stride() {
    for recipe in [Recipe::OCCUPANCY, Recipe::PLAIN, Recipe::PROPOSAL, Recipe::DEFERRED] {
        for kernel in Kernel::all() {
            let opened = call::open(recipe.blob(), kernel);
            let worker = open(&opened, &call::render_options(), EVERYTHING);
            let mut expected = vec![BLANK; COUNT];
            assert_eq!(frame(&worker, &target(&mut expected)), Status::Ok);
            let (mut mine, axis) = (mine(), seen().pose().forward().to_array());
            let mut found = vec![BLANK; COUNT];
            let (status, said, work) =
                trace(&worker, ffi::nerf_render_rays, &without_numbers(&mine, &axis, &target(&mut found)));
            assert_eq!((status, said.as_str(), work.rays), (Status::Ok, "", COUNT as u64));
            assert!(found == expected && found.iter().all(|hit| hit.between == 77), "{kernel}");
            // The other way round, and seventeen at a time.
            mine.reverse();
            for part in mine.chunks(17) {
                let mut found = vec![BLANK; part.len()];
                trace(&worker, ffi::nerf_render_rays, &without_numbers(part, &axis, &target(&mut found)));
                for (mine, found) in part.iter().zip(&found) {
                    assert_eq!(*found, expected[mine.id as usize], "{kernel}");
                }
            }
            // Opacity by itself is the same opacity.
            let shadow = open(&opened, &call::render_options(), ffi::NERF_OUTPUT_OPACITY);
            let mut alone = vec![9.0f32; COUNT];
            let planes = ffi::Target {
                opacity: plane(alone.as_mut_ptr().cast(), PixelFormat::F32),
                ..call::target(NO_PLANE)
            };
            let (status, _, work) =
                trace(&shadow, ffi::nerf_render_rays, &without_numbers(&mine, &axis, &planes));
            assert_eq!((status, work.colour_evaluations), (Status::Ok, 0));
            for (mine, opacity) in mine.iter().zip(alone) {
                assert_eq!(opacity, expected[mine.id as usize].opacity, "{kernel}");
            }
        }
    }
}

#[test]
fn a_limit_of_a_pixel_is_the_end_of_its_ray() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::detect());
    let worker = open(&opened, &call::render_options(), EVERYTHING);
    let axis = seen().pose().forward().to_array();
    let mut mine = mine();
    let limit = |i: usize| if i.is_multiple_of(7) { f32::INFINITY } else { 1.5 + 0.01 * i as f32 };
    let (mut along, mut depth) = (vec![0.0f32; 2 * COUNT], vec![0.0f32; COUNT]);
    for (i, ray) in mine.iter_mut().enumerate() {
        ray.t_max = limit(i);
        along[2 * i] = limit(i);
        let cosine = ray.dir.iter().zip(&axis).map(|(a, b)| a * b).sum::<f32>();
        depth[i] = limit(i) * cosine;
    }
    let mut expected = vec![BLANK; COUNT];
    trace(&worker, ffi::nerf_render_rays, &without_numbers(&mine, &axis, &target(&mut expected)));
    let whole = {
        let mut whole = vec![BLANK; COUNT];
        assert_eq!(frame(&worker, &target(&mut whole)), Status::Ok);
        whole
    };
    assert!(whole.iter().zip(&expected).any(|(whole, cut)| whole.opacity > cut.opacity + 0.1));
    // A plane of distances with gaps gives the same bits, one of depths the same up to rounding.
    let mut found = vec![BLANK; COUNT];
    let mut planes = target(&mut found);
    planes.limit_ray_distance =
        ffi::Plane { pixel_stride: 8, ..plane(along.as_mut_ptr().cast(), PixelFormat::F32) };
    assert_eq!(frame(&worker, &planes), Status::Ok);
    assert_eq!(found, expected);
    let mut by_depth = vec![BLANK; COUNT];
    let mut planes = target(&mut by_depth);
    planes.limit_z_depth = plane(depth.as_mut_ptr().cast(), PixelFormat::F32);
    assert_eq!(frame(&worker, &planes), Status::Ok);
    for (found, expected) in by_depth.iter().zip(&expected) {
        assert!((found.opacity - expected.opacity).abs() < 1e-4, "{found:?}, {expected:?}");
    }
    // Rectangles read the limits of their own pixels: a plane begins with the rectangle's.
    let part = ffi::Rect { x: 3, y: 5, width: 9, height: 7 };
    let first = (part.y * SIDE + part.x) as usize;
    let mut cut = vec![BLANK; COUNT];
    let mut planes = target(&mut cut);
    for plane in [
        &mut planes.rgb,
        &mut planes.opacity,
        &mut planes.ray_distance,
        &mut planes.z_depth,
        &mut planes.median_distance,
        &mut planes.normals,
    ] {
        plane.row_stride = size_of::<Hit>() as isize * SIDE as isize;
    }
    planes.limit_ray_distance = ffi::Plane {
        pixel_stride: 8,
        row_stride: 8 * SIDE as isize,
        ..plane(along[2 * first..].as_mut_ptr().cast(), PixelFormat::F32)
    };
    let camera = call::camera(&seen());
    let mut asked = call::whole_frame(&camera, &planes);
    asked.rect = &part;
    // SAFETY: as above.
    assert_eq!(unsafe { ffi::nerf_render(worker.handle, &asked, null_mut(), null_mut(), 0) }, Status::Ok);
    for y in 0..part.height {
        for x in 0..part.width {
            let (from, to) = ((y * SIDE + x) as usize, first + (y * SIDE + x) as usize);
            assert_eq!(cut[from], expected[to], "({x}, {y})");
        }
    }
    // Both at once are refused, as is one on rays; so is another format. The planes are the whole frame's again: the
    // part's would reach into whatever lies behind them.
    let mut planes = target(&mut found);
    planes.limit_ray_distance =
        ffi::Plane { pixel_stride: 8, ..plane(along.as_mut_ptr().cast(), PixelFormat::F32) };
    planes.limit_z_depth = plane(depth.as_mut_ptr().cast(), PixelFormat::F32);
    assert_eq!(frame(&worker, &planes), Status::Target);
    planes.limit_z_depth = NO_PLANE;
    for (plane, named) in [(0, "target.limit_ray_distance"), (1, "target.limit_z_depth")] {
        let mut planes = target(&mut found);
        let limits = [&mut planes.limit_ray_distance, &mut planes.limit_z_depth];
        // Of whatever format: it has no place there.
        *limits.into_iter().nth(plane).unwrap() = call::plane(depth.as_mut_ptr().cast(), PixelFormat::RgbF32);
        let (status, said, _) =
            trace(&worker, ffi::nerf_render_rays, &without_numbers(&mine, &axis, &planes));
        assert_eq!(status, Status::Target);
        assert_eq!(said, format!("{named}: expected NULL for rays, each of which ends at its own t_max"));
    }
    planes.limit_ray_distance.format = PixelFormat::RgbF32 as u32;
    assert_eq!(frame(&worker, &planes), Status::Target);
}

#[test]
fn collisions_are_those_of_the_opacity() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::detect());
    let worker = open(&opened, &call::render_options(), EVERYTHING);
    let (mine, axis) = (mine(), seen().pose().forward().to_array());
    let (mut seen, mut drawn) = (vec![BLANK; COUNT], vec![BLANK; COUNT]);
    trace(&worker, ffi::nerf_render_rays, &without_numbers(&mine, &axis, &target(&mut seen)));
    let (status, ..) = trace(&worker, ffi::nerf_sample_rays, &rays(&mine, &axis, &target(&mut drawn)));
    assert_eq!(status, Status::Ok);
    let mut hits = 0;
    for ((mine, seen), drawn) in mine.iter().zip(&seen).zip(&drawn) {
        if (seen.opacity - mine.random).abs() < 1e-5 {
            continue;
        }
        let hit = seen.opacity > mine.random;
        hits += usize::from(hit);
        assert_eq!((drawn.opacity, drawn.rgba[3]), if hit { (1.0, 1.0) } else { (0.0, 0.0) });
        assert_eq!(drawn.ray_distance.is_finite() && drawn.z_depth.is_finite(), hit);
        assert_eq!(drawn.median, drawn.ray_distance);
        // Over nothing.
        assert!(hit || drawn.rgba == [0.0; 4]);
    }
    assert!(hits > COUNT / 20 && hits < COUNT, "{hits} of {COUNT} prove nothing");
}

#[test]
fn what_is_no_ray_is_refused_with_its_index_and_nothing_is_written() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let worker = open(&opened, &call::render_options(), EVERYTHING);
    let axis = [0.0, 0.0, -1.0f32];
    type Spoil = fn(&mut Mine);
    let spoils: [Spoil; 9] = [
        |ray| ray.dir = [0.0; 3],
        |ray| ray.dir[1] = f32::NAN,
        |ray| ray.dir = [0.0, 0.0, 2.0],
        |ray| ray.origin[2] = f32::INFINITY,
        |ray| ray.t_min = -1.0,
        |ray| ray.t_min = f32::NAN,
        |ray| (ray.t_min, ray.t_max) = (2.0, 1.0),
        |ray| ray.t_min = f32::INFINITY,
        |ray| ray.t_max = f32::NAN,
    ];
    for spoil in spoils {
        let (mut mine, mut hits) = (mine(), vec![BLANK; COUNT]);
        spoil(&mut mine[300]);
        spoil(&mut mine[17]);
        let planes = target(&mut hits);
        let both = [
            (ffi::nerf_render_rays as Call, without_numbers(&mine, &axis, &planes)),
            (ffi::nerf_sample_rays, rays(&mine, &axis, &planes)),
        ];
        for (call, asked) in both {
            let (status, said, work) = trace(&worker, call, &asked);
            assert_eq!((status, work.rays), (Status::Ray, 0), "{said}");
            assert!(said.starts_with("rays[17]: expected"), "{said}");
        }
        assert!(hits.iter().all(|hit| *hit == BLANK));
    }
    let (mut mine, mut hits) = (mine(), vec![BLANK; COUNT]);
    let planes = target(&mut hits);
    mine[40].random = 1.5;
    let (status, said, _) = trace(&worker, ffi::nerf_sample_rays, &rays(&mine, &axis, &planes));
    assert!(status == Status::Ray && said.starts_with("random[40]"), "{said}");
    let (status, said, _) = trace(&worker, ffi::nerf_render_rays, &rays(&mine, &axis, &planes));
    assert!(status == Status::Ray && said.starts_with("rays.random: expected NULL"), "{said}");
    assert!(hits.iter().all(|hit| *hit == BLANK));
    // What a number just below 1 is in f32.
    mine[40].random = (1.0f64 - 1e-9) as f32;
    assert_eq!(mine[40].random, 1.0);
    assert_eq!(trace(&worker, ffi::nerf_sample_rays, &rays(&mine, &axis, &planes)).0, Status::Ok);
    assert_ne!(hits[40], BLANK);

    let refused = |expected: Status, text: &str, spoil: &dyn Fn(&mut ffi::Rays, &mut ffi::Target)| {
        let mut hits = vec![BLANK; COUNT];
        let mut planes = target(&mut hits);
        let mut all = without_numbers(&mine, &axis, &planes);
        spoil(&mut all, &mut planes);
        all.target = &planes;
        let (status, said, _) = trace(&worker, ffi::nerf_render_rays, &all);
        assert!(status == expected && said.contains(text), "{text}: {status:?}, {said}");
        assert!(hits.iter().all(|hit| *hit == BLANK), "{text}");
    };
    refused(Status::Direction, "axis", &|rays, _| rays.axis = [0.0f32, 0.0, 2.0].as_ptr());
    refused(Status::NullPointer, "rays.axis", &|rays, _| rays.axis = null());
    refused(Status::NullPointer, "rays.origins", &|rays, _| rays.origins.data = null());
    refused(Status::NullPointer, "rays.dirs", &|rays, _| rays.dirs.data = null());
    refused(Status::Target, "rays.dirs: expected a stride of at least 12", &|rays, _| rays.dirs.stride = 8);
    refused(Status::Alignment, "rays.t_max", &|rays, _| rays.t_max.stride = 6);
    refused(Status::Overflow, "rays.origins", &|rays, _| rays.origins.stride = usize::MAX / 2 - 3);
    refused(Status::Target, "target.rgb: expected a stride of at least 16", &|_, planes| {
        planes.rgb.pixel_stride = 12;
    });
    refused(Status::Overlap, "target.rgb: overlaps rays.origins", &|rays, planes| {
        planes.rgb = plane(rays.origins.data.cast_mut().cast(), PixelFormat::RgbF32);
    });
    refused(Status::Overlap, "the worker's memory", &|_, planes| {
        planes.rgb.data = worker.handle.cast();
    });
    // None at all are fine.
    let mut none = without_numbers(&mine[..0], &axis, &planes);
    (none.origins.data, none.dirs.data) = (null(), null());
    assert_eq!(trace(&worker, ffi::nerf_render_rays, &none).0, Status::Ok);
}

#[test]
fn effects_of_a_camera_and_planes_that_were_not_asked_for_are_refused() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let (mine, axis) = (mine(), [0.0, 0.0, -1.0f32]);
    let mut options = call::render_options();
    options.effects.anti_aliasing = 4;
    let worker = open(&opened, &options, EVERYTHING);
    let mut hits = vec![BLANK; COUNT];
    let planes = target(&mut hits);
    let (status, said, _) = trace(&worker, ffi::nerf_render_rays, &without_numbers(&mine, &axis, &planes));
    assert!(status == Status::Options && said.contains("anti-aliasing"), "{said}");
    let worker = open(&opened, &call::render_options(), ffi::NERF_OUTPUT_RGB);
    let (status, said, _) = trace(&worker, ffi::nerf_render_rays, &without_numbers(&mine, &axis, &planes));
    assert!(status == Status::Target && said.contains("target.opacity"), "{said}");
    assert!(hits.iter().all(|hit| *hit == BLANK));
}

/// Verifies that linear RGBA of rays, composited over the background, gives the linear RGB of the same rays.
#[test]
fn linear_light_is_premultiplied() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::detect());
    let mut options = call::render_options();
    options.effects.linear = 1;
    (options.background_set, options.background) = (1, [0.2, 0.5, 0.9]);
    let worker = open(&opened, &options, ffi::NERF_OUTPUT_RGB);
    let (mine, axis) = (mine(), [0.0, 0.0, -1.0f32]);
    let (mut rgba, mut rgb) = (vec![[9.0f32; 4]; COUNT], vec![[9.0f32; 3]; COUNT]);
    let over_nothing = call::target(plane(rgba.as_mut_ptr().cast(), PixelFormat::RgbaF32));
    let over = call::target(plane(rgb.as_mut_ptr().cast(), PixelFormat::RgbF32));
    // In turns, with one worker.
    for _ in 0..2 {
        for planes in [&over_nothing, &over] {
            assert_eq!(
                trace(&worker, ffi::nerf_render_rays, &without_numbers(&mine, &axis, planes)).0,
                Status::Ok
            );
        }
    }
    let light = options
        .background
        .map(|c: f32| if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) });
    for (rgba, rgb) in rgba.iter().zip(&rgb) {
        for c in 0..3 {
            assert!((rgba[c] + (1.0 - rgba[3]) * light[c] - rgb[c]).abs() < 3e-6);
        }
    }
}
