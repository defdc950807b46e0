//! Calls of the C interface from Rust, as a C host makes them.

use crate::memory::Guarded;
use nerf_core::camera;
use nerf_core::camera::Projection;
use nerf_core::{Isa, Kernel, Storage};
use nerf_render as ffi;
use std::ffi::{CStr, c_char, c_void};
use std::ptr;

/// Buffer for an error message.
pub struct Message(pub [c_char; 256]);

impl Default for Message {
    fn default() -> Self {
        Self([0x55; 256])
    }
}

impl Message {
    /// Returns the text in the buffer.
    pub fn text(&self) -> String {
        let bytes: Vec<u8> = self.0.iter().map(|&c| c as u8).collect();
        CStr::from_bytes_until_nul(&bytes).expect("a NUL").to_string_lossy().into_owned()
    }
}

/// Returns options that open a scene with `kernel`.
pub fn open_options(kernel: Kernel) -> ffi::OpenOptions {
    let isa = match kernel.isa {
        Isa::Avx2 => ffi::Kernel::Avx2,
        Isa::Avx512 => ffi::Kernel::Avx512,
        Isa::Simd128 => ffi::Kernel::Simd128,
        Isa::Neon => ffi::Kernel::Neon,
        _ => ffi::Kernel::Portable,
    };
    let storage = match kernel.storage {
        Storage::F32 => ffi::Storage::F32,
        Storage::Bf16 => ffi::Storage::Bf16,
        _ => ffi::Storage::F16,
    };
    let struct_size = size_of::<ffi::OpenOptions>();
    ffi::OpenOptions { struct_size, kernel: isa as u32, storage: storage as u32, reserved: [0; 6] }
}

/// Returns options without cuts and without blur; everything else is the default.
pub fn render_options() -> ffi::RenderOptions {
    ffi::RenderOptions {
        struct_size: size_of::<ffi::RenderOptions>(),
        samples: 0,
        transmittance_cut: ffi::NERF_NONE,
        ignore_occupancy: 0,
        maths: 0,
        background_set: 0,
        background: [0.0; 3],
        batch_rays: 0,
        batch_samples: 0,
        colour_cut: ffi::NERF_NONE,
        normal_blur: ffi::NERF_NONE,
        ignore_proposal: 0,
        near_distance: 0.0,
        far_distance: 0.0,
        own_bins: 0,
        reserved: 0,
        effects: ffi::Effects {
            jitter: 0,
            anti_aliasing: 0,
            seed: 0,
            aperture_radius: 0.0,
            focus_distance: 0.0,
            exposure: 0.0,
            tone_map: 0,
            linear: 0,
            reserved: [0; 5],
        },
    }
}

/// Converts a camera to the C structure.
pub fn camera(camera: &camera::Camera) -> ffi::Camera {
    let (i, lens, rows) = (camera.intrinsics(), camera.lens(), camera.pose().to_rows());
    ffi::Camera {
        struct_size: size_of::<ffi::Camera>(),
        width: i.width,
        height: i.height,
        fx: i.fx,
        fy: i.fy,
        cx: i.cx,
        cy: i.cy,
        k1: lens.k1,
        k2: lens.k2,
        p1: lens.p1,
        p2: lens.p2,
        k3: lens.k3,
        k4: lens.k4,
        k5: lens.k5,
        k6: lens.k6,
        lens_model: u32::from(lens.projection == Projection::Fisheye),
        c2w: std::array::from_fn(|k| rows[k / 4][k % 4]),
        reserved: 0,
    }
}

/// A plane that is not requested.
pub const NO_PLANE: ffi::Plane =
    ffi::Plane { data: ptr::null_mut(), pixel_stride: 0, row_stride: 0, format: 0, reserved: 0 };

/// Returns a plane of contiguous pixels.
pub fn plane(data: *mut c_void, format: ffi::PixelFormat) -> ffi::Plane {
    ffi::Plane { data, format: format as u32, ..NO_PLANE }
}

/// Returns a target that has only a colour plane.
pub fn target(rgb: ffi::Plane) -> ffi::Target {
    let struct_size = size_of::<ffi::Target>();
    ffi::Target {
        struct_size,
        rgb,
        opacity: NO_PLANE,
        ray_distance: NO_PLANE,
        z_depth: NO_PLANE,
        median_distance: NO_PLANE,
        normals: NO_PLANE,
        limit_ray_distance: NO_PLANE,
        limit_z_depth: NO_PLANE,
    }
}

/// Returns the `NERF_OUTPUT_*` flags of the planes in `target`; only the colour flag if `target` is NULL, misaligned or
/// too short.
///
/// # Safety
/// `target` is NULL or misaligned, or points to a readable `struct_size` and at least this number of readable bytes.
pub unsafe fn outputs(target: *const ffi::Target) -> u32 {
    // SAFETY: the caller's promise.
    let whole = |target: *const ffi::Target| unsafe { (*target).struct_size } >= size_of::<ffi::Target>();
    if target.is_null() || !target.is_aligned() || !whole(target) {
        return ffi::NERF_OUTPUT_RGB;
    }
    // SAFETY: as above.
    let t = unsafe { &*target };
    let planes = [t.rgb, t.opacity, t.ray_distance, t.z_depth, t.median_distance, t.normals];
    planes.iter().enumerate().map(|(bit, plane)| u32::from(!plane.data.is_null()) << bit).sum()
}

/// Returns a request for a worker of one scene.
pub fn request(scene: *const ffi::Scene, options: *const ffi::RenderOptions, outputs: u32) -> ffi::Request {
    let struct_size = size_of::<ffi::Request>();
    ffi::Request {
        struct_size,
        scene,
        instances: ptr::null(),
        instance_count: 0,
        options,
        outputs,
        reserved: 0,
    }
}

/// Returns a frame that renders the whole image of a scene.
pub fn whole_frame(camera: *const ffi::Camera, target: *const ffi::Target) -> ffi::Frame {
    ffi::Frame {
        struct_size: size_of::<ffi::Frame>(),
        camera,
        rect: ptr::null(),
        target,
        width: 0,
        height: 0,
        progress: None,
        user: ptr::null_mut(),
    }
}

/// Returns an array of contiguous elements.
pub fn floats(data: *const f32) -> ffi::Floats {
    ffi::Floats { data, stride: 0 }
}

/// Calls `nerf_worker_size` for a worker of one scene.
///
/// # Safety
/// As `nerf_worker_size`.
#[allow(clippy::too_many_arguments, reason = "what the C function is given, and what it is made of")]
pub unsafe fn worker_size(
    scene: *const ffi::Scene,
    options: *const ffi::RenderOptions,
    outputs: u32,
    size: *mut usize,
    align: *mut usize,
    message: *mut c_char,
    capacity: usize,
) -> ffi::Status {
    // SAFETY: the caller's promise.
    unsafe { ffi::nerf_worker_size(&request(scene, options, outputs), size, align, message, capacity) }
}

/// Opens a worker in `memory` for the planes of the target, and renders one frame.
///
/// # Safety
/// As `nerf_worker_open` and `nerf_render`.
#[allow(clippy::too_many_arguments, reason = "what the C functions are given")]
pub unsafe fn render(
    scene: *const ffi::Scene,
    camera: *const ffi::Camera,
    options: *const ffi::RenderOptions,
    rect: *const ffi::Rect,
    target: *const ffi::Target,
    memory: *mut c_void,
    size: usize,
    progress: ffi::Progress,
    user: *mut c_void,
    counters: *mut ffi::Counters,
    message: *mut c_char,
    capacity: usize,
) -> ffi::Status {
    // SAFETY: the caller's promise.
    unsafe {
        let mut worker = ptr::null_mut();
        let request = request(scene, options, outputs(target));
        let status = ffi::nerf_worker_open(&request, memory, size, &mut worker, message, capacity);
        if status != ffi::Status::Ok {
            return status;
        }
        let frame = ffi::Frame { rect, progress, user, ..whole_frame(camera, target) };
        ffi::nerf_render(worker, &frame, counters, message, capacity)
    }
}

/// Opens a worker of a 2D field in `memory`, and renders one image.
///
/// # Safety
/// As `nerf_worker_open` and `nerf_render_picture`.
#[allow(clippy::too_many_arguments, reason = "what the C functions are given")]
pub unsafe fn render_picture(
    scene: *const ffi::Scene,
    width: u32,
    height: u32,
    options: *const ffi::RenderOptions,
    rect: *const ffi::Rect,
    target: *const ffi::Target,
    memory: *mut c_void,
    size: usize,
    progress: ffi::Progress,
    user: *mut c_void,
    counters: *mut ffi::Counters,
    message: *mut c_char,
    capacity: usize,
) -> ffi::Status {
    // SAFETY: the caller's promise.
    unsafe {
        let mut worker = ptr::null_mut();
        let request = request(scene, options, ffi::NERF_OUTPUT_RGB);
        let status = ffi::nerf_worker_open(&request, memory, size, &mut worker, message, capacity);
        if status != ffi::Status::Ok {
            return status;
        }
        let frame = ffi::Frame { rect, width, height, progress, user, ..whole_frame(ptr::null(), target) };
        ffi::nerf_render_picture(worker, &frame, counters, message, capacity)
    }
}

/// Returns a `nerf_pace_request` without a camera, a limit or a clock.
pub fn pace_request(
    scene: *const ffi::Scene,
    options: *const ffi::RenderOptions,
    outputs: u32,
) -> ffi::PaceRequest {
    let struct_size = size_of::<ffi::PaceRequest>();
    let (camera, user) = (ptr::null(), ptr::null_mut());
    ffi::PaceRequest {
        struct_size,
        scene,
        camera,
        options,
        outputs,
        limit_milliseconds: f32::INFINITY,
        clock: None,
        user,
    }
}

/// Calls `nerf_pace_workspace_size`.
///
/// # Safety
/// As `nerf_pace_workspace_size`.
#[allow(clippy::too_many_arguments, reason = "what the C function is given, and what it is made of")]
pub unsafe fn pace_workspace_size(
    scene: *const ffi::Scene,
    options: *const ffi::RenderOptions,
    outputs: u32,
    size: *mut usize,
    align: *mut usize,
    message: *mut c_char,
    capacity: usize,
) -> ffi::Status {
    let request = pace_request(scene, options, outputs);
    // SAFETY: the caller's promise.
    unsafe { ffi::nerf_pace_workspace_size(&request, size, align, message, capacity) }
}

/// Calls `nerf_pace_measure`.
///
/// # Safety
/// As `nerf_pace_measure`.
#[allow(clippy::too_many_arguments, reason = "what the C function is given, and what it is made of")]
pub unsafe fn pace_measure(
    scene: *const ffi::Scene,
    camera: *const ffi::Camera,
    options: *const ffi::RenderOptions,
    outputs: u32,
    limit_milliseconds: f32,
    clock: ffi::Clock,
    user: *mut c_void,
    workspace: *mut c_void,
    size: usize,
    pace: *mut ffi::Pace,
    message: *mut c_char,
    capacity: usize,
) -> ffi::Status {
    let request = pace_request(scene, options, outputs);
    let request = ffi::PaceRequest { camera, limit_milliseconds, clock, user, ..request };
    // SAFETY: the caller's promise.
    unsafe { ffi::nerf_pace_measure(&request, workspace, size, pace, message, capacity) }
}

/// Opens a worker for one scene, and calls `nerf_explain` for this worker.
///
/// # Safety
/// As `nerf_worker_open` and `nerf_explain`.
#[allow(clippy::too_many_arguments, reason = "what the C functions are given")]
pub unsafe fn explain(
    scene: *const ffi::Scene,
    options: *const ffi::RenderOptions,
    outputs: u32,
    counters: *const ffi::Counters,
    text: *mut c_char,
    room: usize,
    needed: *mut usize,
    message: *mut c_char,
    capacity: usize,
) -> ffi::Status {
    let (mut size, mut align, mut worker) = (0, 0, ptr::null_mut());
    // SAFETY: the caller's promise.
    unsafe {
        let status = worker_size(scene, options, outputs, &mut size, &mut align, message, capacity);
        if status != ffi::Status::Ok {
            return status;
        }
        let mut memory = Guarded::new(size, 0);
        let request = request(scene, options, outputs);
        let status = ffi::nerf_worker_open(&request, memory.at(), size, &mut worker, message, capacity);
        assert_eq!(status, ffi::Status::Ok);
        ffi::nerf_explain(worker, counters, text, room, needed, message, capacity)
    }
}

/// Opens a worker in `memory`, for colour unless `rgb` is NULL, and calls `nerf_query` once.
///
/// # Safety
/// As `nerf_worker_open` and `nerf_query`.
#[allow(clippy::too_many_arguments, reason = "what the C functions are given")]
pub unsafe fn query(
    scene: *const ffi::Scene,
    options: *const ffi::RenderOptions,
    count: usize,
    positions: *const f32,
    dirs: *const f32,
    sigma: *mut f32,
    rgb: *mut f32,
    memory: *mut c_void,
    size: usize,
    counters: *mut ffi::Counters,
    message: *mut c_char,
    capacity: usize,
) -> ffi::Status {
    // SAFETY: the caller's promise.
    unsafe {
        let mut worker = ptr::null_mut();
        let outputs = if rgb.is_null() { 0 } else { ffi::NERF_OUTPUT_RGB };
        let request = request(scene, options, outputs);
        let status = ffi::nerf_worker_open(&request, memory, size, &mut worker, message, capacity);
        if status != ffi::Status::Ok {
            return status;
        }
        let points = ffi::Points {
            struct_size: size_of::<ffi::Points>(),
            count,
            positions: floats(positions),
            dirs: floats(dirs),
            sigma: plane(sigma.cast(), ffi::PixelFormat::F32),
            rgb: plane(rgb.cast(), ffi::PixelFormat::RgbF32),
        };
        ffi::nerf_query(worker, &points, counters, message, capacity)
    }
}

/// Returns counters with `struct_size` set and all counts 0.
pub fn counters() -> ffi::Counters {
    ffi::Counters { struct_size: size_of::<ffi::Counters>(), ..nerf_core::render::Counters::default().into() }
}

/// Renders a whole image with the default options, without callback, counters or message.
///
/// # Safety
/// As `nerf_render`.
pub unsafe fn frame(
    scene: *const ffi::Scene,
    camera: &ffi::Camera,
    target: &ffi::Target,
    workspace: *mut c_void,
    size: usize,
) -> ffi::Status {
    let (options, rect, user) = (ptr::null(), ptr::null(), ptr::null_mut());
    let (counters, message) = (ptr::null_mut(), ptr::null_mut());
    // SAFETY: the caller's promise.
    unsafe { render(scene, camera, options, rect, target, workspace, size, None, user, counters, message, 0) }
}

/// An opened scene with the memory that it borrows.
pub struct Opened {
    /// Handle of the scene.
    pub scene: *const ffi::Scene,
    /// Memory in which the scene was opened.
    pub memory: Guarded,
    /// Bytes of the scene file.
    pub blob: Vec<u8>,
}

/// Opens a scene from the bytes of its file, in memory between canaries.
pub fn open(blob: Vec<u8>, kernel: Kernel) -> Opened {
    let (options, mut message) = (open_options(kernel), Message::default());
    let (mut size, mut align, mut scene) = (0, 0, ptr::null());
    let (bytes, text) = (blob.as_ptr().cast(), message.0.as_mut_ptr());
    // SAFETY: everything lives until the call returns, blob and memory as long as `Opened`.
    let status =
        unsafe { ffi::nerf_scene_memory(bytes, blob.len(), &options, &mut size, &mut align, text, 256) };
    assert_eq!(status, ffi::Status::Ok, "{}", message.text());
    assert_eq!(align, 64);
    let mut memory = Guarded::new(size, 0);
    let text = message.0.as_mut_ptr();
    // SAFETY: as above.
    let status = unsafe {
        ffi::nerf_scene_open(bytes, blob.len(), &options, memory.at(), size, &mut scene, text, 256)
    };
    assert_eq!(status, ffi::Status::Ok, "{}", message.text());
    assert_eq!(message.text(), "");
    assert!(memory.surroundings_are_intact());
    Opened { scene, memory, blob }
}

impl Opened {
    /// Allocates the memory of a worker for this scene; the memory has exactly the required size.
    pub fn workspace(&self, options: Option<&ffi::RenderOptions>, outputs: u32) -> Guarded {
        let options = options.map_or(ptr::null(), |options| options as *const _);
        let (mut size, mut align, none) = (0, 0, ptr::null_mut());
        // SAFETY: the scene is intact and the places live until the call returns.
        let status = unsafe { worker_size(self.scene, options, outputs, &mut size, &mut align, none, 0) };
        assert_eq!((status, align), (ffi::Status::Ok, 64));
        Guarded::new(size, 0)
    }

    /// Allocates the memory of a worker for this 2D field; the memory has exactly the required size.
    pub fn picture_workspace(&self, options: Option<&ffi::RenderOptions>) -> Guarded {
        let options = options.map_or(ptr::null(), |options| options as *const _);
        let (mut size, mut align, none) = (0, 0, ptr::null_mut());
        // SAFETY: the scene is intact and the places live until the call returns.
        let status =
            unsafe { worker_size(self.scene, options, ffi::NERF_OUTPUT_RGB, &mut size, &mut align, none, 0) };
        assert_eq!((status, align), (ffi::Status::Ok, 64));
        Guarded::new(size, 0)
    }
}
