//! Arguments that the C interface refuses; a refused call writes nothing.

use nerf_core::Kernel;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Message, Opened, plane};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::{Recipe, camera, kernels};
use std::ffi::c_void;
use std::ptr::{null, null_mut};

const SIDE: u32 = 20;
const PICTURE: usize = (SIDE * SIDE) as usize * 3;

/// Valid arguments of a render, of which a test makes one invalid.
struct Case {
    opened: Opened,
    camera: ffi::Camera,
    options: ffi::RenderOptions,
    rect: Option<ffi::Rect>,
    target: ffi::Target,
    counters: ffi::Counters,
    workspace: Guarded,
    picture: Guarded,
    message: Message,
}

impl Case {
    fn new(recipe: Recipe, kernel: Kernel) -> Self {
        let opened = call::open(recipe.blob(), kernel);
        let options = call::render_options();
        let workspace = opened.workspace(Some(&options), ffi::NERF_OUTPUT_RGB);
        let mut picture = Guarded::new(PICTURE, 0);
        Self {
            camera: call::camera(&camera(SIDE, SIDE)),
            rect: None,
            target: call::target(plane(picture.at(), PixelFormat::RgbU8)),
            counters: call::counters(),
            message: Message::default(),
            opened,
            options,
            workspace,
            picture,
        }
    }

    fn render(&mut self) -> Status {
        let (at, size) = (self.workspace.at(), self.workspace.size());
        self.render_in(at, size)
    }

    fn render_in(&mut self, workspace: *mut c_void, size: usize) -> Status {
        let rect = self.rect.as_ref().map_or(null(), |rect| rect as *const ffi::Rect);
        let text = self.message.0.as_mut_ptr();
        // SAFETY: every pointer is NULL or lives in `self`; wrong ones must be refused unread.
        unsafe {
            call::render(
                self.opened.scene,
                &self.camera,
                &self.options,
                rect,
                &self.target,
                workspace,
                size,
                None,
                null_mut(),
                &mut self.counters,
                text,
                256,
            )
        }
    }

    /// Verifies that a refused call wrote nothing, and that the scene still renders.
    fn refused(mut self, found: Status, expected: Status, what: &str) {
        assert_eq!(found, expected, "{what}: {}", self.message.text());
        assert!(!self.message.text().is_empty(), "{what}: no message");
        assert!(self.picture.is_untouched(), "{what}: something was written");
        assert_eq!(self.counters.rays, 0, "{what}: counters were written");
        let fresh = Self::new(Recipe::OCCUPANCY, Kernel::IN_PLACE);
        let Self { camera, options, target, .. } = fresh;
        self.opened.scene = self.opened.memory.at().cast_const().cast();
        (self.camera, self.options, self.rect) = (camera, options, None);
        self.target = ffi::Target { rgb: plane(self.picture.at(), PixelFormat::RgbU8), ..target };
        self.counters = call::counters();
        assert_eq!(self.render(), Status::Ok, "{what}: the scene has come to harm");
        assert!(self.picture.surroundings_are_intact() && self.workspace.surroundings_are_intact());
    }
}

/// Flags of all outputs, or-ed.
const EVERYTHING: u32 = 63;

/// Renders with one argument made invalid by `spoil`, and verifies the status.
fn refuses(expected: Status, what: &str, spoil: impl FnOnce(&mut Case)) {
    let mut case = Case::new(Recipe::OCCUPANCY, Kernel::IN_PLACE);
    // Enough for any planes.
    case.workspace = case.opened.workspace(Some(&case.options), EVERYTHING);
    spoil(&mut case);
    let found = case.render();
    case.refused(found, expected, what);
}

#[test]
fn exact_sizes_pass_one_byte_less_fails_and_canaries_live() {
    for kernel in kernels() {
        let mut case = Case::new(Recipe::SKIP, kernel);
        assert_eq!(case.render(), Status::Ok, "{}", case.message.text());
        assert_eq!((case.message.text(), case.counters.rays), (String::new(), u64::from(SIDE * SIDE)));
        for memory in [&case.picture, &case.workspace, &case.opened.memory] {
            assert!(memory.surroundings_are_intact());
        }
        let mut case = Case::new(Recipe::SKIP, kernel);
        let (at, size) = (case.workspace.at(), case.workspace.size());
        let found = case.render_in(at, size - 1);
        case.refused(found, Status::Memory, "workspace of size - 1");
        let mut case = Case::new(Recipe::SKIP, kernel);
        let at = case.workspace.at();
        let found = case.render_in(at, 0);
        case.refused(found, Status::Memory, "workspace of size 0");

        let (blob, options) = (Recipe::SKIP.blob(), call::open_options(kernel));
        let exact = call::open(blob.clone(), kernel).memory.size();
        for (size, misaligned, expected) in [(exact - 1, 0, Status::Memory), (0, 0, Status::Memory)]
            .into_iter()
            .chain((1..64).map(|m| (exact, m, Status::Alignment)))
        {
            let (mut memory, mut scene) = (Guarded::new(size, misaligned), null());
            let (bytes, length) = (blob.as_ptr().cast(), blob.len());
            // SAFETY: everything lives until the call returns.
            let found = unsafe {
                ffi::nerf_scene_open(bytes, length, &options, memory.at(), size, &mut scene, null_mut(), 0)
            };
            assert_eq!(found, expected, "{size} bytes, misaligned by {misaligned}");
            assert!(memory.is_untouched() && scene.is_null());
        }
    }
}

#[test]
fn misaligned_workspaces_fail() {
    for offset in 1..64 {
        let mut case = Case::new(Recipe::OCCUPANCY, Kernel::IN_PLACE);
        let mut elsewhere = Guarded::new(case.workspace.size(), offset);
        let found = case.render_in(elsewhere.at(), elsewhere.size());
        assert!(elsewhere.is_untouched());
        case.refused(found, Status::Alignment, "misaligned workspace");
    }
}

#[test]
fn blobs_open_at_any_alignment() {
    let blob = Recipe::TINY.blob();
    for offset in 0..64 {
        let mut copy = Guarded::new(blob.len(), offset);
        // SAFETY: `copy` has room for the blob.
        unsafe { copy.at().cast::<u8>().copy_from_nonoverlapping(blob.as_ptr(), blob.len()) };
        let (mut size, mut align) = (0, 0);
        let at = copy.at();
        // SAFETY: everything lives until the call returns.
        let found =
            unsafe { ffi::nerf_scene_memory(at, blob.len(), null(), &mut size, &mut align, null_mut(), 0) };
        assert_eq!(found, Status::Ok);
    }
}

#[test]
fn null_in_each_argument_is_refused() {
    refuses(Status::NullPointer, "scene", |case| case.opened.scene = null());
    let mut case = Case::new(Recipe::OCCUPANCY, Kernel::IN_PLACE);
    let found = case.render_in(null_mut(), 1 << 20);
    case.refused(found, Status::NullPointer, "workspace");
    refuses(Status::Target, "no plane", |case| case.target.rgb.data = null_mut());

    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let (mut size, mut align, mut scene) = (0usize, 0usize, null());
    let (blob, length) = (opened.blob.as_ptr().cast::<c_void>(), opened.blob.len());
    let (camera, target) = (call::camera(&camera(4, 4)), call::target(call::NO_PLANE));
    let mut memory = Guarded::new(1 << 18, 0);
    let (at, room) = (memory.at(), memory.size());
    // SAFETY: every pointer is NULL or lives until the calls return.
    let found = unsafe {
        [
            ffi::nerf_scene_memory(null(), length, null(), &mut size, &mut align, null_mut(), 0),
            ffi::nerf_scene_memory(blob, length, null(), null_mut(), &mut align, null_mut(), 0),
            ffi::nerf_scene_memory(blob, length, null(), &mut size, null_mut(), null_mut(), 0),
            ffi::nerf_scene_open(null(), length, null(), at, room, &mut scene, null_mut(), 0),
            ffi::nerf_scene_open(blob, length, null(), null_mut(), room, &mut scene, null_mut(), 0),
            ffi::nerf_scene_open(blob, length, null(), at, room, null_mut(), null_mut(), 0),
            ffi::nerf_scene_describe(null(), null_mut()),
            ffi::nerf_scene_describe(opened.scene, null_mut()),
            call::worker_size(null(), null(), 1, &mut size, &mut align, null_mut(), 0),
            call::worker_size(opened.scene, null(), 1, null_mut(), &mut align, null_mut(), 0),
            call::worker_size(opened.scene, null(), 1, &mut size, null_mut(), null_mut(), 0),
            call::render(
                opened.scene,
                null(),
                null(),
                null(),
                &target,
                at,
                room,
                None,
                null_mut(),
                null_mut(),
                null_mut(),
                0,
            ),
            call::render(
                opened.scene,
                &camera,
                null(),
                null(),
                null(),
                at,
                room,
                None,
                null_mut(),
                null_mut(),
                null_mut(),
                0,
            ),
        ]
    };
    assert_eq!(found, [Status::NullPointer; 13]);
    assert_eq!((size, align, scene.is_null()), (0, 0, true));
}

#[test]
fn structures_of_wrong_size_are_refused_and_larger_ones_need_zeros() {
    for wrong in [0, 1, 8, usize::MAX] {
        refuses(Status::StructSize, "camera", |case| case.camera.struct_size = wrong);
        refuses(Status::StructSize, "options", |case| case.options.struct_size = wrong);
        refuses(Status::StructSize, "target", |case| case.target.struct_size = wrong);
        refuses(Status::StructSize, "counters", |case| case.counters.struct_size = wrong);
    }
    refuses(Status::StructSize, "camera of size - 1", |case| case.camera.struct_size -= 1);
    refuses(Status::StructSize, "4097", |case| case.camera.struct_size = 4097);
    refuses(Status::Reserved, "camera", |case| case.camera.reserved = 1);
    refuses(Status::Reserved, "options", |case| case.options.reserved = 1);
    refuses(Status::Reserved, "plane", |case| case.target.rgb.reserved = 1);

    #[repr(C)]
    struct Later<T> {
        known: T,
        tail: [u8; 24],
    }
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let mut later = Later { known: call::render_options(), tail: [0; 24] };
    later.known.struct_size = size_of::<Later<ffi::RenderOptions>>();
    let (mut size, mut align) = (0, 0);
    let mut ask = |options: &Later<ffi::RenderOptions>| {
        let options = (options as *const Later<_>).cast();
        // SAFETY: everything lives until the call returns.
        unsafe { call::worker_size(opened.scene, options, 1, &mut size, &mut align, null_mut(), 0) }
    };
    assert_eq!(ask(&later), Status::Ok);
    later.tail[23] = 1;
    assert_eq!(ask(&later), Status::Reserved);

    // SAFETY: numbers and pointers have no invalid bytes.
    let mut info: Later<ffi::SceneInfo> = unsafe { std::mem::zeroed() };
    (info.known.struct_size, info.tail) = (size_of::<Later<ffi::SceneInfo>>(), [7; 24]);
    // SAFETY: `info` is as long as it says.
    let found = unsafe { ffi::nerf_scene_describe(opened.scene, (&raw mut info).cast()) };
    assert_eq!((found, info.tail), (Status::Ok, [0; 24]));
    assert_eq!(info.known.struct_size, size_of::<Later<ffi::SceneInfo>>());
}

#[test]
fn settings_outside_their_range_are_refused() {
    refuses(Status::Options, "samples", |case| case.options.samples = 4097);
    refuses(Status::Options, "samples beyond u16", |case| case.options.samples = 65537);
    for cut in [1.0, f32::NAN, f32::INFINITY] {
        refuses(Status::Options, "cut", |case| case.options.transmittance_cut = cut);
        refuses(Status::Options, "colour cut", |case| case.options.colour_cut = cut);
    }
    refuses(Status::Options, "ignore_occupancy", |case| case.options.ignore_occupancy = 2);
    refuses(Status::Options, "maths", |case| case.options.maths = 4);
    refuses(Status::Options, "background_set", |case| case.options.background_set = 2);
    refuses(Status::Options, "background", |case| {
        (case.options.background_set, case.options.background) = (1, [0.0, f32::NAN, 0.0]);
    });
    refuses(Status::Options, "batch_rays", |case| case.options.batch_rays = 257);
    refuses(Status::Options, "batch_samples", |case| case.options.batch_samples = 65);
    refuses(Status::Camera, "fx", |case| case.camera.fx = 0.0);
    refuses(Status::Camera, "c2w", |case| case.camera.c2w[0] = f32::NAN);
    refuses(Status::Camera, "0x0", |case| case.camera.width = 0);
    let mut case = Case::new(Recipe::OCCUPANCY_REQUIRED, Kernel::IN_PLACE);
    case.options.ignore_occupancy = 1;
    let found = case.render();
    case.refused(found, Status::OccupancyRequired, "occupancy grid required");

    let opened = call::open(Recipe::PICTURE.blob(), Kernel::IN_PLACE);
    let (mut size, mut align) = (0, 0);
    // SAFETY: everything lives until the call returns.
    let found = unsafe { call::worker_size(opened.scene, null(), 1, &mut size, &mut align, null_mut(), 0) };
    // A picture has a worker, too, and no plan to refuse.
    assert_eq!(found, Status::Ok);
    // SAFETY: as above.
    let found = unsafe { call::worker_size(opened.scene, null(), 64, &mut size, &mut align, null_mut(), 0) };
    assert_eq!(found, Status::Options);
    let blob = Recipe::TINY.blob();
    let mut options = call::open_options(Kernel::IN_PLACE);
    let bytes = blob.as_ptr().cast();
    // No kernel has the first number; the second is none of this machine's.
    let (last, foreign) = (ffi::Kernel::Neon as u32, ffi::Kernel::Simd128 as u32);
    for (kernel, status) in [(last + 1, Status::Options), (foreign, Status::Kernel)] {
        options.kernel = kernel;
        // SAFETY: as above.
        let found = unsafe {
            ffi::nerf_scene_memory(bytes, blob.len(), &options, &mut size, &mut align, null_mut(), 0)
        };
        assert_eq!(found, status);
    }
}

#[test]
fn rectangles_outside_are_refused_and_empty_ones_write_nothing() {
    let side = SIDE;
    for (x, y, width, height) in
        [(0, 0, side + 1, 1), (1, 0, side, 1), (0, side, 1, 1), (u32::MAX, 0, 2, 1), (0, side + 1, 0, 0)]
    {
        refuses(Status::Rect, "outside", |case| case.rect = Some(ffi::Rect { x, y, width, height }));
    }
    for (width, height) in [(0, 0), (0, 5), (5, 0)] {
        let mut case = Case::new(Recipe::OCCUPANCY, Kernel::IN_PLACE);
        case.rect = Some(ffi::Rect { x: 3, y: 3, width, height });
        assert_eq!(case.render(), Status::Ok);
        assert!(case.picture.is_untouched() && case.counters.rays == 0);
    }
}

#[test]
fn planes_that_do_not_fit_are_refused() {
    let row = 3 * SIDE as usize;
    refuses(Status::Target, "pixel stride", |case| case.target.rgb.pixel_stride = 2);
    refuses(Status::Target, "row stride", |case| case.target.rgb.row_stride = row as isize - 1);
    refuses(Status::Target, "row stride upwards", |case| case.target.rgb.row_stride = 1 - row as isize);
    refuses(Status::Target, "format 0", |case| case.target.rgb.format = 0);
    refuses(Status::Target, "format 7", |case| case.target.rgb.format = 7);
    refuses(Status::Target, "normals as colour", |case| {
        case.target.rgb.format = PixelFormat::Vec3F32 as u32;
    });
    refuses(Status::Target, "colour as normals", |case| {
        case.target.rgb.format = PixelFormat::RgbF32 as u32;
        case.target.normals = case.target.rgb;
    });
    refuses(Status::Target, "normals as a distance", |case| {
        case.target.median_distance = plane(case.target.rgb.data, PixelFormat::Vec3F32);
    });
    refuses(Status::Target, "f32 as colour", |case| case.target.rgb.format = PixelFormat::F32 as u32);
    refuses(Status::Target, "colour as distance", |case| case.target.z_depth = case.target.rgb);
    refuses(Status::Overflow, "rows", |case| case.target.rgb.row_stride = isize::MAX / 2);
    refuses(Status::Overflow, "columns", |case| case.target.rgb.pixel_stride = usize::MAX / 2);
    refuses(Status::Overflow, "below zero", |case| case.target.rgb.row_stride = isize::MIN / 32);
    let float = PixelFormat::RgbF32 as u32;
    refuses(Status::Alignment, "data", |case| {
        case.target.rgb.format = float;
        case.target.rgb.data = case.target.rgb.data.wrapping_byte_add(2);
    });
    refuses(Status::Alignment, "pixel stride", |case| {
        (case.target.rgb.format, case.target.rgb.pixel_stride) = (float, 13);
    });
    refuses(Status::Overlap, "workspace", |case| case.target.rgb.data = case.workspace.at());
    refuses(Status::Overlap, "blob", |case| case.target.rgb.data = case.opened.blob.as_ptr() as *mut _);
    refuses(Status::Overlap, "scene", |case| case.target.rgb.data = case.opened.memory.at());
    refuses(Status::Overlap, "upwards into the workspace", |case| {
        let stride = case.workspace.size() as isize;
        case.target.rgb.data =
            case.workspace.at().wrapping_byte_offset(stride * i32::try_from(SIDE - 1).unwrap() as isize);
        case.target.rgb.row_stride = -stride;
    });
    let mut case = Case::new(Recipe::OCCUPANCY, Kernel::new(nerf_core::Isa::Avx2, nerf_core::Storage::F32));
    let memory = case.opened.memory.at();
    let size = case.opened.memory.size();
    let found = case.render_in(memory, size);
    case.refused(found, Status::Overlap, "workspace in the scene's memory");
}

#[test]
fn messages_are_cut_at_the_capacity() {
    for capacity in 0..64 {
        let mut message = Message::default();
        let (mut size, mut align) = (0, 0);
        let text = message.0.as_mut_ptr();
        let blob = b"no blob";
        let bytes = blob.as_ptr().cast();
        // SAFETY: everything lives until the call returns, and the message is longer than `capacity`.
        let found = unsafe {
            ffi::nerf_scene_memory(bytes, blob.len(), null(), &mut size, &mut align, text, capacity)
        };
        assert_eq!(found, Status::BlobMagic);
        let full = "not a .nerf blob: the first bytes are not its magic";
        if capacity > 0 {
            assert_eq!(message.text(), full[..full.len().min(capacity - 1)]);
        }
        assert!(message.0[capacity..].iter().all(|&c| c == 0x55), "capacity {capacity}");
    }
}
