//! The firmware example: an emulated microcontroller renders the host's image, within limits of memory and code size.

use nerf_core::memory::Line;
use nerf_testing::build::run;
use nerf_testing::paths;
use nerf_testing::scenes::Recipe;
use nerf_testing::tools::all_here;
use std::process::Command;

#[allow(dead_code, reason = "shared with the firmware, which shows the picture")]
#[path = "../../../nerf-core/examples/firmware/src/picture.rs"]
mod picture;

use picture::{Checksums, View, draw};

/// Scene with a network of the original NeRF's size: 8 trunk layers of 256 units with a skip layer.
const LARGE: Recipe = Recipe { trunk: (8, 256), skip: true, seed: 11, ..Recipe::PLAIN };

/// Returns the checksums of the host's portable instructions, formatted as the firmware prints them.
fn host(blob: &[u8], view: View) -> String {
    let mut workspace = [Line::UNINIT; 128];
    let mut sums = Checksums::NONE;
    let mut bits = Vec::new();
    let mut put = |pixel: &nerf_core::Pixel| {
        sums.add(view, pixel);
        bits.extend(pixel.rgb.iter().flat_map(|c| c.to_le_bytes()));
    };
    let work = draw(blob, view, &mut workspace, &mut put).expect("a picture");
    assert!(work.samples > 0, "a picture of something");
    if view.effects {
        assert!(work.density > 0.0, "an answer of something");
        sums.depth.add(work.density.to_bits());
    }
    // The firmware's own arithmetic of checksums is the field's.
    assert_eq!(sums.colour.value(), crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bits));
    format!("{:08x} | {:08x}", sums.colour.value(), sums.depth.value())
}

#[test]
fn a_microcontroller_draws_the_hosts_bits_within_its_budgets_and_without_a_panic() {
    if !all_here(&["qemu-system-arm", "arm-none-eabi-gcc"]) {
        return;
    }
    let folder = paths::workspace().join("nerf-core/examples/firmware");
    let small = std::fs::read(folder.join("scene.nerf")).expect("the scene");
    let grid = std::fs::read(folder.join("grid.nerf")).expect("the scene with a grid");
    let (large, temporary) = (LARGE.blob(), paths::temporary());
    let large_file = temporary.path().join("large.nerf");
    std::fs::write(&large_file, &large).expect("a temporary file");
    // Beside what cargo test builds, so that it is there the next time.
    let own = std::env::current_exe().expect("a path");
    let target = own.ancestors().nth(3).expect("cargo's target directory").join("firmware");

    // The script holds every row to its budget, and fails where something links that may panic.
    let mut script = Command::new(folder.join("run"));
    script.args([
        "polynomial",
        "libm",
        "micromath",
        "effects",
        "grid",
        "large",
        "c",
        "c-grid",
        "c-rays",
        "c-all",
        "panic",
    ]);
    script.env("NERF_LARGE", &large_file).env("CARGO_TARGET_DIR", target);
    let said = String::from_utf8(run(&mut script).stdout).expect("UTF-8");
    println!("{said}");

    let plain = View { side: 32, math: 0, effects: false };
    for (name, blob, view) in [
        ("polynomial", &small, plain),
        ("libm", &small, View { math: 1, ..plain }),
        ("micromath", &small, View { math: 2, ..plain }),
        ("effects", &small, View { effects: true, ..plain }),
        ("grid", &grid, plain),
        ("large", &large, View { side: 2, ..plain }),
        ("c", &small, plain),
        ("c-grid", &grid, plain),
        ("c-rays", &small, plain),
        ("c-all", &small, plain),
    ] {
        let row = said.lines().find(|line| line.starts_with(&format!("| {name} |")));
        let row = row.unwrap_or_else(|| panic!("no row {name}"));
        assert!(row.ends_with(&format!("| {} |", host(blob, view))), "{name}: {row}");
    }
    assert!(said.contains("a program that may panic: not linked"));
}
