//! Concurrent calls with one worker, from its own progress callback and from threads. CI also runs these tests under
//! AddressSanitizer and ThreadSanitizer.

use nerf_core::Kernel;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Opened, plane};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::{self, Recipe};
use std::ffi::c_void;
use std::ptr::{null, null_mut};

/// Side of the image, pixels; small, since Miri runs these tests.
const SIDE: u32 = 5;
const COUNT: usize = (SIDE * SIDE) as usize;
const RGB: u32 = ffi::NERF_OUTPUT_RGB;
const UNTOUCHED: [f32; 4] = [9.0; 4];
const THREADS: usize = 4;

/// Handle of a worker that threads share.
#[derive(Clone, Copy)]
struct Shared(*mut ffi::Worker);
// SAFETY: a worker that is at work says so to every other thread: the contract under test.
unsafe impl Send for Shared {}
// SAFETY: as above.
unsafe impl Sync for Shared {}

/// Runs `work` on [`THREADS`] threads at the same time; a panic in `work` ends the program.
///
/// Uses pthread directly: ThreadSanitizer sees when these threads begin and end, but does not see it for threads of the
/// standard library, which is compiled without ThreadSanitizer.
fn on_threads<F: Fn() + Sync>(work: &F) {
    extern "C" fn run<F: Fn()>(work: *mut c_void) -> *mut c_void {
        // SAFETY: `on_threads` passes its own, which outlives the thread.
        unsafe { (*work.cast::<F>())() };
        null_mut()
    }
    let argument = (&raw const *work).cast_mut().cast();
    // SAFETY: `work` may be called by several threads (`Sync`), and each thread ends before this returns.
    unsafe {
        let mut threads = [std::mem::zeroed::<libc::pthread_t>(); THREADS];
        for thread in &mut threads {
            assert_eq!(libc::pthread_create(thread, null(), run::<F>, argument), 0);
        }
        for thread in threads {
            assert_eq!(libc::pthread_join(thread, null_mut()), 0);
        }
    }
}

/// Opens a worker with tiles of four pixels, so that an image has several tiles.
fn open(opened: &Opened) -> (Shared, Guarded) {
    let options = ffi::RenderOptions { batch_rays: 4, samples: 8, ..call::render_options() };
    let mut memory = opened.workspace(Some(&options), RGB);
    let (request, mut handle) = (call::request(opened.scene, &options, RGB), null_mut());
    let (at, size) = (memory.at(), memory.size());
    // SAFETY: everything lives until the call returns, the memory as long as the worker.
    let status = unsafe { ffi::nerf_worker_open(&request, at, size, &mut handle, null_mut(), 0) };
    assert_eq!(status, Status::Ok);
    (Shared(handle), memory)
}

fn picture(Shared(worker): Shared, progress: ffi::Progress, user: *mut c_void) -> (Status, Vec<[f32; 4]>) {
    let mut pixels = vec![UNTOUCHED; COUNT];
    let target = call::target(plane(pixels.as_mut_ptr().cast(), PixelFormat::RgbaF32));
    let camera = call::camera(&scenes::camera(SIDE, SIDE));
    let frame = ffi::Frame { progress, user, ..call::whole_frame(&camera, &target) };
    // SAFETY: the worker is intact, and everything lives until the call returns.
    let status = unsafe { ffi::nerf_render(worker, &frame, null_mut(), null_mut(), 0) };
    (status, pixels)
}

/// Makes every kind of call with a busy worker. Verifies that each is refused and writes nothing.
fn refused(worker: Shared) {
    let (status, pixels) = picture(worker, None, null_mut());
    assert!(status == Status::Busy && pixels.iter().all(|pixel| *pixel == UNTOUCHED), "{status:?}");
    let (mut needed, mut message) = (7, call::Message::default());
    let Shared(worker) = worker;
    let text = message.0.as_mut_ptr();
    // SAFETY: the worker is intact, and what is NULL is not looked at before that.
    let found = unsafe {
        [
            ffi::nerf_render_picture(worker, null(), null_mut(), null_mut(), 0),
            ffi::nerf_render_rays(worker, null(), null_mut(), null_mut(), 0),
            ffi::nerf_sample_rays(worker, null(), null_mut(), null_mut(), 0),
            ffi::nerf_query(worker, null(), null_mut(), null_mut(), 0),
            ffi::nerf_explain(worker, null(), null_mut(), 0, &mut needed, text, 256),
        ]
    };
    assert_eq!((found, needed), ([Status::Busy; 5], 7));
    assert!(message.text().starts_with("worker: expected one that no other call works with"));
}

/// State of a progress callback, with the worker that calls it.
struct Watch {
    worker: Shared,
    threads: bool,
    calls: usize,
}

unsafe extern "C-unwind" fn ask_again(user: *mut c_void, _: u64, _: u64) -> i32 {
    // SAFETY: the test passes a watch.
    let watch = unsafe { &mut *user.cast::<Watch>() };
    watch.calls += 1;
    refused(watch.worker);
    if watch.threads {
        let worker = watch.worker;
        on_threads(&|| refused(worker));
    }
    0
}

/// Renders an image whose callback calls the worker again, also from threads if `threads` is true.
fn watched(threads: bool) {
    let opened = call::open(Recipe::TINY.blob(), Kernel::detect());
    let (worker, _memory) = open(&opened);
    let mut watch = Watch { worker, threads, calls: 0 };
    let (status, pixels) = picture(worker, Some(ask_again), (&raw mut watch).cast());
    assert!(status == Status::Ok && watch.calls > 4, "{status:?} after {} calls", watch.calls);
    // Free again, and none of that left a trace.
    assert_eq!(picture(worker, None, null_mut()), (Status::Ok, pixels));
}

#[test]
fn a_worker_in_its_own_callback_is_busy() {
    watched(false);
}

#[test]
fn a_worker_at_work_is_busy_for_threads() {
    watched(true);
}

/// Verifies that each thread that gets the worker renders the whole image, and that the next thread sees the worker's
/// state in order.
#[test]
fn threads_that_share_a_worker_find_it_busy_or_draw_the_picture() {
    let opened = call::open(Recipe::TINY.blob(), Kernel::detect());
    let (worker, _memory) = open(&opened);
    let (status, expected) = picture(worker, None, null_mut());
    assert_eq!(status, Status::Ok);
    let draw = || {
        let mut drawn = 0;
        while drawn < 5 {
            match picture(worker, None, null_mut()) {
                (Status::Ok, pixels) => {
                    assert!(pixels == expected);
                    drawn += 1;
                }
                (status, pixels) => {
                    assert!(status == Status::Busy && pixels.iter().all(|pixel| *pixel == UNTOUCHED));
                }
            }
        }
    };
    on_threads(&draw);
}
