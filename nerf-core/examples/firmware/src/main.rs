//! Draws a radiance field on a microcontroller, and reports time, memory and number of samples.
//!
//! The scene is in flash, and its f16 weights are read in place. RAM holds the workspace and the stack. See the
//! README of this crate, and the script `run`, which builds, runs and checks the program.
#![no_std]
#![no_main]

#[cfg(target_arch = "arm")]
mod board;
#[cfg_attr(not(target_arch = "arm"), allow(dead_code, reason = "what is only linked shows nothing"))]
mod picture;

use core::hint::black_box;
use core::panic::PanicInfo;
use nerf_core::memory::Line;
use picture::{Checksums, View, draw};

/// Blob of the scene. Read through `black_box`, so that the compiler cannot use its content for optimisation.
static SCENE: &[u8] = include_bytes!(env!("NERF_SCENE"));
/// Number of 64-byte lines of workspace: the result of `Renderer::workspace_lines` for the scene and view. With fewer
/// lines, drawing returns an error.
const LINES: usize = match (cfg!(feature = "large"), cfg!(feature = "effects")) {
    (false, false) => 26,
    (false, true) => 38,
    (true, _) => 57,
};
const VIEW: View = View {
    side: if cfg!(feature = "large") { 2 } else { 32 },
    math: if cfg!(feature = "libm") {
        1
    } else if cfg!(feature = "micromath") {
        2
    } else {
        0
    },
    effects: cfg!(feature = "effects"),
};

/// Code that may panic, for a test of the link check: the index is hidden from the compiler by `black_box`.
#[cfg(feature = "panic")]
fn may_panic() -> u8 {
    SCENE[black_box(0)]
}

/// Entry point on targets for which the program is linked but not run. The image is drawn to checksums and not
/// displayed.
#[cfg(not(target_arch = "arm"))]
#[unsafe(no_mangle)]
extern "C" fn _start() -> ! {
    let mut workspace = [Line::UNINIT; LINES];
    let mut checksums = Checksums::NONE;
    let drawn = draw(black_box(SCENE), VIEW, &mut workspace, &mut |pixel| checksums.add(VIEW, pixel));
    loop {
        black_box((&drawn, &checksums));
    }
}

#[cfg(target_arch = "arm")]
#[cortex_m_rt::entry]
fn main() -> ! {
    static mut WORKSPACE: [Line; LINES] = [Line::UNINIT; LINES];
    use picture::shade;

    let mut console = board::Console::open();
    #[cfg(feature = "panic")]
    black_box(may_panic());
    let mut checksums = Checksums::NONE;
    // One row of characters: colour on the left, depth on the right.
    const SIDE: usize = VIEW.side as usize;
    let (mut row, mut x) = ([b' '; 2 * SIDE + 3], 0);
    let mut put = |pixel: &nerf_core::volume::Pixel| {
        checksums.add(VIEW, pixel);
        let [r, g, b] = pixel.rgb;
        let near = if pixel.opacity > 0.5 { 1.45 - 0.25 * pixel.z_depth } else { 0.0 };
        for (place, value) in [(x, 0.3 * r + 0.6 * g + 0.1 * b), (SIDE + 2 + x, near)] {
            if let Some(character) = row.get_mut(place) {
                *character = shade(value);
            }
        }
        x += 1;
        if x == SIDE {
            x = 0;
            if let Some(end) = row.last_mut() {
                *end = b'\n';
            }
            console.write(&row);
        }
    };
    board::start_clock();
    let drawn = draw(black_box(SCENE), VIEW, WORKSPACE, &mut put);
    let ticks = board::ticks();
    match &drawn {
        Ok(work) => {
            if VIEW.effects {
                checksums.depth.add(work.density.to_bits());
            }
            console.bits("colour", checksums.colour.value());
            console.bits("depth", checksums.depth.value());
            console.number("samples", work.samples);
            console.number("ticks", ticks.into());
            console.number("workspace", work.workspace as u64);
            console.number("stack", board::stack_used() as u64);
        }
        Err(why) => console.line("error:", why.as_bytes()),
    }
    board::exit(drawn.is_ok())
}

/// Panic handler. Calls a function that is not defined, so that a build in which a panic is reachable does not link.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    unsafe extern "C" {
        safe fn nerf_panicked() -> !;
    }
    nerf_panicked()
}
