//! The library accesses only the memory that it is lent: everything that a host passes begins or ends at a page that
//! cannot be accessed.

use nerf_core::Kernel;
use nerf_core::memory::Line;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, plane};
use nerf_testing::fence::{Fenced, Flush};
use nerf_testing::scenes::{Recipe, camera, kernels};
use std::ffi::{c_char, c_void};
use std::os::unix::process::ExitStatusExt;
use std::process::Command;
use std::ptr::{null, null_mut};

const WIDTH: u32 = 19;
const HEIGHT: u32 = 13;
const PIXELS: usize = (WIDTH * HEIGHT) as usize;
const EVERYTHING: u32 = 63;
const POINTS: usize = 67;
/// Size of the message buffer, bytes; too small for most messages.
const SAID: usize = 9;

/// Environment variable that selects an access beyond the memory, set only in child processes.
const TRESPASS: &str = "NERF_TRESPASS";

#[test]
fn a_byte_beyond_a_fence_is_the_end() {
    let place = std::env::var(TRESPASS).unwrap_or_default();
    if !place.is_empty() {
        let flush = if place.starts_with("before") { Flush::Start } else { Flush::End };
        let mut fenced = Fenced::of(&[7u8; 100], flush);
        let none = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
        // SAFETY: reads two numbers. This process is to die, and nobody needs its core.
        assert_eq!(unsafe { libc::setrlimit(libc::RLIMIT_CORE, &none) }, 0);
        let beyond = fenced.first().wrapping_offset(if flush == Flush::Start { -1 } else { 100 });
        // SAFETY: none; the system ends this process here, which is what the parent waits for.
        unsafe {
            if place.ends_with("write") {
                beyond.write_volatile(0)
            } else {
                beyond.read_volatile();
            }
        }
        return;
    }
    for place in ["before, read", "before, write", "behind, read", "behind, write"] {
        let mut child = Command::new(std::env::current_exe().expect("this program"));
        child.args(["--exact", "fences::a_byte_beyond_a_fence_is_the_end"]).env(TRESPASS, place);
        // A sanitizer would make a report and an exit code of it.
        let output = child.env("ASAN_OPTIONS", "handle_segv=0").output().expect("this program again");
        assert_eq!(output.status.signal(), Some(libc::SIGSEGV), "{place}: {output:?}");
    }
}

/// Allocates lines of `bytes` bytes in total.
fn lines(bytes: usize, flush: Flush) -> Fenced<Line> {
    assert!(bytes.is_multiple_of(size_of::<Line>()));
    Fenced::filled(bytes / size_of::<Line>(), Line::UNINIT, flush)
}

/// A scene or 2D field, with all arguments that are passed to render it.
struct Lent {
    flush: Flush,
    scene: *const ffi::Scene,
    open: Fenced<ffi::OpenOptions>,
    options: Fenced<ffi::RenderOptions>,
    message: Fenced<c_char>,
    // Last: the scene borrows them.
    _memory: Fenced<Line>,
    blob: Fenced<u8>,
}

impl Lent {
    fn new(recipe: Recipe, kernel: Kernel, options: ffi::RenderOptions, flush: Flush) -> Self {
        let blob = Fenced::of(&recipe.blob(), flush);
        let open = Fenced::of(&[call::open_options(kernel)], flush);
        let mut message = Fenced::filled(SAID, 0x55, flush);
        let (mut sizes, mut scene) = (Fenced::filled(2, 0usize, flush), Fenced::filled(1, null(), flush));
        let (bytes, length, size) = (blob.as_ptr().cast(), blob.len(), sizes.first());
        let align = size.wrapping_add(1);
        // SAFETY: everything lives until the call returns.
        let status = unsafe {
            ffi::nerf_scene_memory(bytes, length, open.as_ptr(), size, align, message.first(), SAID)
        };
        assert_eq!(status, Status::Ok);
        let mut memory = lines(sizes[0], flush);
        let at = memory.first().cast();
        // SAFETY: as above, blob and memory as long as the scene.
        let status = unsafe {
            let (to, text) = (scene.first(), message.first());
            ffi::nerf_scene_open(bytes, length, open.as_ptr(), at, sizes[0], to, text, SAID)
        };
        assert_eq!(status, Status::Ok);
        let options = Fenced::of(&[options], flush);
        Self { flush, scene: scene[0], open, options, message, _memory: memory, blob }
    }

    /// Allocates a workspace of the size that `ask` returns.
    fn workspace(
        &mut self,
        ask: unsafe fn(*mut usize, *mut usize, &Self, *mut c_char) -> Status,
    ) -> Fenced<Line> {
        let mut sizes = Fenced::filled(2, 0usize, self.flush);
        let size = sizes.first();
        let text = self.message.first();
        // SAFETY: everything lives until the call returns.
        assert_eq!(unsafe { ask(size, size.wrapping_add(1), self, text) }, Status::Ok);
        lines(sizes[0], self.flush)
    }

    /// Renders every plane of a frame, and evaluates density and colour at points. Returns the bits of all results.
    fn frame(&mut self) -> Vec<u32> {
        let flush = self.flush;
        let mut workspace = self.workspace(|size, align, lent, text| {
            // SAFETY: the caller's promise.
            unsafe {
                call::worker_size(lent.scene, lent.options.as_ptr(), EVERYTHING, size, align, text, SAID)
            }
        });
        let size = workspace.len() * size_of::<Line>();
        let at = workspace.first().cast::<c_void>();
        let camera = Fenced::of(&[call::camera(&camera(2 * WIDTH, HEIGHT + 3))], flush);
        let rect = Fenced::of(&[ffi::Rect { x: 11, y: 2, width: WIDTH, height: HEIGHT }], flush);
        let mut floats = [1, 1, 1, 1, 3].map(|n| Fenced::filled(n * PIXELS, -7.0f32, flush));
        // Rows with a gap, which the last one has not.
        let row = 3 * WIDTH as usize + 5;
        let mut rgb = Fenced::filled(row * (HEIGHT as usize - 1) + row - 5, 0x77u8, flush);
        let mut found = Vec::new();
        let mut target = call::target(plane(rgb.first().cast(), PixelFormat::RgbU8));
        target.rgb.row_stride = row as isize;
        let planes = [
            &mut target.opacity,
            &mut target.ray_distance,
            &mut target.z_depth,
            &mut target.median_distance,
            &mut target.normals,
        ];
        for (to, floats) in planes.into_iter().zip(&mut floats) {
            let format = if floats.len() == PIXELS { PixelFormat::F32 } else { PixelFormat::Vec3F32 };
            *to = plane(floats.first().cast(), format);
        }
        let (target, mut counters) = (Fenced::of(&[target], flush), Fenced::of(&[call::counters()], flush));
        // SAFETY: everything lives until the call returns.
        let status = unsafe {
            call::render(
                self.scene,
                camera.as_ptr(),
                self.options.as_ptr(),
                rect.as_ptr(),
                target.as_ptr(),
                at,
                size,
                None,
                null_mut(),
                counters.first(),
                self.message.first(),
                SAID,
            )
        };
        assert_eq!(status, Status::Ok);
        found.extend(rgb.iter().map(|&byte| u32::from(byte)));
        found.extend(floats.iter().flat_map(|plane| plane.iter().map(|x| x.to_bits())));

        let point = |i: usize| [0.03 * i as f32 - 1.0, 0.5 - 0.01 * i as f32, 0.2];
        let positions = Fenced::of(&(0..POINTS).map(point).collect::<Vec<_>>(), flush);
        let dirs = Fenced::filled(POINTS, [0.6f32, 0.0, 0.8], flush);
        let (mut sigma, mut rgb) =
            (Fenced::filled(POINTS, -7.0, flush), Fenced::filled(3 * POINTS, -7.0, flush));
        // SAFETY: as above.
        let status = unsafe {
            call::query(
                self.scene,
                self.options.as_ptr(),
                POINTS,
                positions.as_ptr().cast(),
                dirs.as_ptr().cast(),
                sigma.first(),
                rgb.first(),
                at,
                size,
                counters.first(),
                self.message.first(),
                SAID,
            )
        };
        assert_eq!(status, Status::Ok);
        found.extend(sigma.iter().chain(rgb.iter()).map(|x: &f32| x.to_bits()));
        found
    }

    /// Renders a 2D field. Returns the bits of the colours.
    fn picture(&mut self) -> Vec<u32> {
        let mut workspace = self.workspace(|size, align, lent, text| {
            // SAFETY: the caller's promise.
            unsafe {
                call::worker_size(
                    lent.scene,
                    lent.options.as_ptr(),
                    ffi::NERF_OUTPUT_RGB,
                    size,
                    align,
                    text,
                    SAID,
                )
            }
        });
        let size = workspace.len() * size_of::<Line>();
        let mut rgb = Fenced::filled(4 * PIXELS, -7.0f32, self.flush);
        let target = call::target(plane(rgb.first().cast(), PixelFormat::RgbaF32));
        let target = Fenced::of(&[target], self.flush);
        // SAFETY: everything lives until the call returns.
        let status = unsafe {
            call::render_picture(
                self.scene,
                WIDTH,
                HEIGHT,
                self.options.as_ptr(),
                null(),
                target.as_ptr(),
                workspace.first().cast(),
                size,
                None,
                null_mut(),
                null_mut(),
                self.message.first(),
                SAID,
            )
        };
        assert_eq!(status, Status::Ok);
        rgb.iter().map(|x| x.to_bits()).collect()
    }

    /// Returns the message of a refused call, and numbers of the scene's description.
    fn words(&mut self) -> Vec<u8> {
        // SAFETY: numbers and pointers have no invalid bytes.
        let mut info: ffi::SceneInfo = unsafe { std::mem::zeroed() };
        info.struct_size = size_of::<ffi::SceneInfo>();
        let mut info = Fenced::of(&[info], self.flush);
        // SAFETY: the scene is intact, and everything lives until the calls return.
        let status = unsafe {
            [
                ffi::nerf_scene_describe(self.scene, info.first()),
                ffi::nerf_scene_memory(
                    self.blob.as_ptr().cast(),
                    self.blob.len() - 1,
                    self.open.as_ptr(),
                    null_mut(),
                    null_mut(),
                    self.message.first(),
                    SAID,
                ),
            ]
        };
        assert_eq!(status, [Status::Ok, Status::NullPointer]);
        // Where its texts lie is another matter.
        let said = self.message.iter().map(|&c| c as u8);
        let numbers = [info[0].parameters, info[0].density_macs, info[0].colour_macs, info[0].seed];
        said.chain(numbers.into_iter().flat_map(u64::to_le_bytes)).collect()
    }
}

/// Returns options with every effect and few samples.
fn effects() -> ffi::RenderOptions {
    let mut options = call::render_options();
    (options.samples, options.normal_blur, options.colour_cut) = (24, 1.0, 1e-3);
    (options.effects.jitter, options.effects.anti_aliasing, options.effects.seed) = (1, 2, 5);
    (options.effects.aperture_radius, options.effects.focus_distance) = (0.05, 3.0);
    (options.effects.exposure, options.effects.tone_map) = (0.5, ffi::ToneMap::Reinhard as u32);
    options
}

#[test]
fn scenes_and_all_that_is_passed_with_them_stay_between_the_fences() {
    let odd = Recipe { trunk: (3, 21), skip: true, levels: 5, ..Recipe::PLAIN };
    let plain = ffi::RenderOptions { normal_blur: 0.0, ..call::render_options() };
    let small = ffi::RenderOptions { batch_rays: 5, samples: 20, ..plain };
    let cases = [
        (Recipe::SKIP, plain),
        (Recipe::PROPOSAL, effects()),
        (odd, effects()),
        (Recipe::TINY, small),
        (Recipe::DEFERRED, effects()),
    ];
    for (kernel, (recipe, options)) in kernels().flat_map(|kernel| cases.map(|case| (kernel, case))) {
        let draw = |flush| {
            let mut lent = Lent::new(recipe, kernel, options, flush);
            (lent.frame(), lent.words())
        };
        let expected = draw(Flush::Neither);
        for flush in Flush::BOTH {
            assert!(draw(flush) == expected, "{kernel:?}, {recipe:?}, {flush:?}");
        }
    }
}

#[test]
fn pictures_and_all_that_is_passed_with_them_stay_between_the_fences() {
    for (kernel, recipe) in
        kernels().flat_map(|kernel| [Recipe::PICTURE, Recipe::TINY_PICTURE].map(|r| (kernel, r)))
    {
        let draw = |flush| Lent::new(recipe, kernel, call::render_options(), flush).picture();
        let expected = draw(Flush::Neither);
        for flush in Flush::BOTH {
            assert!(draw(flush) == expected, "{kernel:?}, {recipe:?}, {flush:?}");
        }
    }
}
