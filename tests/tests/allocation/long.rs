//! Long runs of frames through the C interface: memory does not grow, and no image changes.
//!
//! CI renders 1,000 frames of a scene with random weights. `NERF_LONG=1` renders 100,000 frames, of the scene in the
//! file `NERF_LONG_BLOB` if set:
//! `NERF_LONG=1 NERF_LONG_BLOB=out/demo/demo.nerf cargo test --release -p nerf-tests --test allocation long --
//! --nocapture`

use crate::LIVE;
use nerf_core::Kernel;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, plane};
use nerf_testing::memory::Guarded;
use nerf_testing::paths;
use nerf_testing::scenes::{Recipe, kernels};
use nerf_testing::tools;
use std::ffi::{CString, c_void};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::ptr::{null, null_mut};
use std::sync::atomic::{AtomicU64, Ordering};

const SIDE: u32 = 32;
const PIXELS: usize = (SIDE * SIDE) as usize;
const THREADS: usize = 2;
/// Number of views around the scene, which are rendered in turns.
const POSES: usize = 20;
/// Number of frames after which the file is opened again, with the next kernel.
const OPEN_FRAMES: usize = 25;
/// Number of different requests for a frame: default options, four presets, few samples, and every output with effects.
const REQUESTS: usize = 7;
/// Sequence of the requests in a run; cheap requests are the most frequent.
const TURNS: [usize; 12] = [5, 4, 5, 3, 5, 0, 5, 4, 6, 2, 5, 1];
const EVERYTHING: u32 = 63;

/// Environment variable with the path of the scene file, set only in child processes.
const CHILD: &str = "NERF_LONG_CHILD";

#[test]
fn frames_and_openings_without_end_take_no_more_memory_and_change_no_bit() {
    let long = tools::long();
    let checks = if long { [1_000, 10_000, 100_000] } else { [250, 500, 1_000] };
    if let Some(file) = std::env::var_os(CHILD) {
        return draw_and_measure(Path::new(&file), checks);
    }
    // In a process of its own, where nobody else takes memory.
    let directory = paths::temporary();
    let noise = directory.path().join("noise.nerf");
    std::fs::write(&noise, Recipe::TINY_PROPOSAL.blob()).expect("a temporary file");
    let file = std::env::var_os("NERF_LONG_BLOB").filter(|_| long).map_or(noise, PathBuf::from);
    let mut child = Command::new(std::env::current_exe().expect("this program"));
    child.args(["--exact", "--nocapture", "--test-threads=1"]);
    child.arg("long::frames_and_openings_without_end_take_no_more_memory_and_change_no_bit");
    // One heap for all threads: one of its own is never trimmed to the end.
    child.env(CHILD, file).env("MALLOC_ARENA_MAX", "1");
    let output = child.output().expect("this program again");
    let said = String::from_utf8_lossy(&output.stdout);
    print!("{said}");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(said.contains("resident"), "the child has measured nothing: {said}");
}

/// Memory use of a process.
#[derive(Clone, Copy, Debug)]
struct Memory {
    /// Bytes that are allocated and not freed.
    live: isize,
    /// Resident memory, KiB, counted page by page, unlike the figure in `status`.
    resident: u64,
    /// Resident memory that belongs to no file, KiB: excludes code, which is loaded on first use.
    own: u64,
    /// Largest resident memory so far, KiB.
    peak: u64,
}

impl Memory {
    fn now() -> Self {
        // Resident is then what is in use, and not what the allocator keeps for later.
        #[cfg(target_env = "gnu")]
        // SAFETY: gives free pages back, whoever else allocates.
        unsafe {
            libc::malloc_trim(0)
        };
        let field = |file: &str, name: &str| {
            let text = std::fs::read_to_string(file).expect("Linux");
            let line = text.lines().find(|line| line.starts_with(name)).expect(name);
            line.split_whitespace().nth(1).and_then(|kib| kib.parse().ok()).expect("a number")
        };
        let pages = |name: &str| field("/proc/self/smaps_rollup", name);
        let (resident, own, peak) =
            (pages("Rss:"), pages("Anonymous:"), field("/proc/self/status", "VmHWM:"));
        Self { live: LIVE.load(Ordering::Relaxed), resident, own, peak }
    }
}

fn draw_and_measure(file: &Path, checks: [usize; 3]) {
    let damaged = damaged(file);
    let files = [file, damaged.1.as_path(), Path::new("/nowhere/absent.nerf")].map(as_c);
    // The picture of each view, request and kernel: 0 until it has been drawn once.
    let seen: Vec<AtomicU64> =
        (0..POSES * REQUESTS * Kernel::all().count()).map(|_| AtomicU64::new(0)).collect();
    let run = |frames: std::ops::Range<usize>| {
        std::thread::scope(|scope| {
            let worker = |thread| {
                let (files, seen, frames) = (&files, &seen, frames.clone());
                scope.spawn(move || draw(files, seen, frames.skip(thread).step_by(THREADS)))
            };
            let workers: Vec<_> = (0..THREADS).map(worker).collect();
            // A scope ends with its threads' work; their own memory is freed when they have ended, too.
            workers.into_iter().for_each(|worker| worker.join().expect("a thread"));
        });
        Memory::now()
    };
    // Every stretch takes memory in the same way, threads, scenes and workspaces of its own; the first is long enough
    // for every request and kernel.
    let mut from = 0;
    let seen_at = checks.map(|until| {
        let memory = run(from..until);
        let Memory { live, resident, own, peak } = memory;
        println!(
            "{until} frames: {live} bytes allocated, {resident} KiB resident, {own} without code, at most {peak}"
        );
        from = until;
        memory
    });
    let drawn = seen.iter().filter(|hash| hash.load(Ordering::Relaxed) != 0).count();
    println!("{drawn} different requests, each drawn {} times", checks[2] / drawn);
    assert!(drawn > POSES && checks[2] > 2 * drawn, "{drawn} requests prove nothing");
    let [early, middle, end] = seen_at;
    assert_eq!((early.live, middle.live), (end.live, end.live), "bytes that were allocated and never freed");
    // A few pages, where a byte for each of 100,000 frames would be 24 of them.
    assert!(end.own <= early.own + 16, "{early:?}, {end:?}");
}

/// Writes a copy of the file with its last byte changed. Returns the folder and path of the copy.
fn damaged(file: &Path) -> (tempfile::TempDir, PathBuf) {
    let mut bytes = std::fs::read(file).expect("the scene's file");
    *bytes.last_mut().expect("bytes") ^= 1;
    let directory = paths::temporary();
    let path = directory.path().join("damaged.nerf");
    std::fs::write(&path, bytes).expect("a temporary file");
    (directory, path)
}

fn as_c(path: &Path) -> CString {
    CString::new(path.as_os_str().as_bytes()).expect("a path without NULs")
}

/// Opens a scene file, and verifies that the status is `expected`.
fn open(path: &CString, kernel: Kernel, expected: Status) -> *const ffi::Scene {
    let (options, mut scene) = (call::open_options(kernel), null());
    // SAFETY: everything lives until the call returns.
    let status = unsafe { ffi::nerf_scene_open_file(path.as_ptr(), &options, &mut scene, null_mut(), 0) };
    assert_eq!(status, expected, "{path:?}");
    scene
}

/// Returns the options of a request; `None` for default options (NULL).
fn request(scene: *const ffi::Scene, number: usize) -> Option<ffi::RenderOptions> {
    let mut options = call::render_options();
    match number {
        0 => return None,
        1..=4 => {
            // SAFETY: the scene is open and the options live until the call returns.
            let status =
                unsafe { ffi::nerf_quality_preset(scene, number as u32, &mut options, null_mut(), 0) };
            assert_eq!(status, Status::Ok);
        }
        5 => (options.samples, options.transmittance_cut, options.colour_cut) = (32, 0.05, 0.01),
        _ => {
            (options.samples, options.transmittance_cut, options.normal_blur) = (16, 0.1, 1.0);
            (options.effects.jitter, options.effects.anti_aliasing) = (1, 2);
            (options.effects.aperture_radius, options.effects.focus_distance) = (0.02, 4.0);
            options.effects.tone_map = ffi::ToneMap::Filmic as u32;
        }
    }
    Some(options)
}

/// Returns a camera on a circle around the origin, looking at the origin.
fn view(pose: usize) -> ffi::Camera {
    let (sin, cos) = (std::f32::consts::TAU * pose as f32 / POSES as f32).sin_cos();
    let pose = Pose::look_at([4.0 * sin, 1.5, 4.0 * cos].into(), [0.0; 3].into(), [0.0, 1.0, 0.0].into());
    let camera = Camera::new(Intrinsics::centred(SIDE, SIDE, 45.0), Lens::NONE, pose.expect("a pose"));
    call::camera(&camera.expect("a camera"))
}

unsafe extern "C-unwind" fn stop(_: *mut c_void, _: u64, _: u64) -> i32 {
    1
}

/// Renders the frames of one thread.
fn draw(files: &[CString; 3], seen: &[AtomicU64], frames: impl Iterator<Item = usize>) {
    // Portable instructions are the slowest, and unpacked weights take memory.
    let mut vectors: Vec<Kernel> = kernels().filter(|kernel| *kernel != Kernel::IN_PLACE).collect();
    if vectors.is_empty() {
        vectors.push(Kernel::IN_PLACE);
    }
    let mut opened: Option<(*const ffi::Scene, usize, Guarded)> = None;
    // r, g, b, opacity, z_depth, normal
    let mut picture = vec![[0.0f32; 8]; PIXELS];
    for (turn, frame) in frames.enumerate() {
        if turn % OPEN_FRAMES == 0 {
            if let Some((scene, ..)) = opened.take() {
                // SAFETY: nobody uses it any more.
                unsafe { ffi::nerf_scene_close(scene) };
            }
            let kernel = turn / OPEN_FRAMES % vectors.len();
            open(&files[1], vectors[kernel], Status::BlobChecksum);
            open(&files[2], vectors[kernel], Status::File);
            let scene = open(&files[0], vectors[kernel], Status::Ok);
            let most = (0..REQUESTS).map(|i| workspace_size(scene, request(scene, i).as_ref())).max();
            opened = Some((scene, kernel, Guarded::new(most.expect("requests"), 0)));
        }
        let (scene, kernel, workspace) = opened.as_mut().expect("a scene");
        let (pose, asked) = (frame % POSES, TURNS[frame / POSES % TURNS.len()]);
        let options = request(*scene, asked);
        picture.fill([-7.0; 8]);
        let mut ask = |size, progress, picture: &mut [[f32; 8]]| {
            render(
                *scene,
                &view(pose),
                options.as_ref(),
                asked == 6,
                picture,
                (workspace.at(), size),
                progress,
            )
        };
        if turn % OPEN_FRAMES == 1 {
            assert_eq!(ask(64, None, &mut picture), Status::Memory);
            assert_eq!(
                ask(workspace_size(*scene, options.as_ref()), Some(stop), &mut picture),
                Status::Cancelled
            );
        }
        assert_eq!(ask(workspace_size(*scene, options.as_ref()), None, &mut picture), Status::Ok);
        let hash = hash(&picture);
        let first = &seen[(*kernel * REQUESTS + asked) * POSES + pose];
        let before = first.compare_exchange(0, hash, Ordering::Relaxed, Ordering::Relaxed).err();
        assert!(before.is_none_or(|before| before == hash), "frame {frame} is not what it was");
    }
    if let Some((scene, ..)) = opened {
        // SAFETY: as above.
        unsafe { ffi::nerf_scene_close(scene) };
    }
}

/// Returns the memory size of a worker for every output, bytes.
fn workspace_size(scene: *const ffi::Scene, options: Option<&ffi::RenderOptions>) -> usize {
    let options = options.map_or(null(), |options| options as *const _);
    let (mut size, mut align) = (0, 0);
    // SAFETY: the scene is open and the places live until the call returns.
    let status =
        unsafe { call::worker_size(scene, options, EVERYTHING, &mut size, &mut align, null_mut(), 0) };
    assert_eq!((status, align), (Status::Ok, 64));
    size
}

fn render(
    scene: *const ffi::Scene,
    camera: &ffi::Camera,
    options: Option<&ffi::RenderOptions>,
    everything: bool,
    picture: &mut [[f32; 8]],
    (workspace, size): (*mut c_void, usize),
    progress: ffi::Progress,
) -> Status {
    let first = picture.as_mut_ptr().cast::<f32>();
    let channel = |at: usize, format| {
        let pixel_stride = size_of::<[f32; 8]>();
        ffi::Plane { pixel_stride, ..plane(first.wrapping_add(at).cast(), format) }
    };
    let mut target = call::target(channel(0, PixelFormat::RgbF32));
    target.opacity = channel(3, PixelFormat::F32);
    if everything {
        (target.z_depth, target.normals) = (channel(4, PixelFormat::F32), channel(5, PixelFormat::Vec3F32));
    }
    let options = options.map_or(null(), |options| options as *const _);
    let (mut counters, none) = (call::counters(), null_mut());
    // SAFETY: everything lives until the call returns; the planes are channels of `picture`.
    let status = unsafe {
        call::render(
            scene,
            camera,
            options,
            null(),
            &target,
            workspace,
            size,
            progress,
            none,
            &mut counters,
            null_mut(),
            0,
        )
    };
    let all = if everything { 2 } else { 1 };
    assert!(status != Status::Ok || counters.rays == all * PIXELS as u64, "{counters:?}");
    status
}

/// Returns the FNV-1a hash of the bits of an image; never 0.
fn hash(picture: &[[f32; 8]]) -> u64 {
    let words = picture.iter().flatten().map(|x| u64::from(x.to_bits()));
    words.fold(0xcbf2_9ce4_8422_2325, |hash: u64, word| (hash ^ word).wrapping_mul(0x0100_0000_01b3)).max(1)
}
