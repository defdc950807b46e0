//! Programs, data and rights that a test needs and a machine may lack.
//!
//! Tests that need more than Rust and a C and C++ compiler, another tool, target or minutes, run with `NERF_TESTS=all`. A test that is
//! not asked for, or lacks what it needs, is left out, which is said past the capture of its output, once a test program; one
//! that is asked for with the environment variable CI set fails instead. `NERF_SKIPPED` names a file that gets a line of each
//! test left out: its program, the folder it runs in and its name, with tabs between them. `.ci/run` runs these once their
//! tools are there.
//!
//! The tests of nerf-train have this file as a module of their own.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;

/// What may be missing, and what is not tested without it.
const NEEDS: &[(&str, &str)] = &[
    ("/dev/full", "devices that are full"),
    ("Embree 3", "rays beside Embree's"),
    ("OpenMP", "rays on OpenMP's threads"),
    ("a build of each effect", "each effect, and unbounded space, alone"),
    ("abidiff", "the C ABI against its baseline"),
    ("abidw", "the C ABI against its baseline"),
    ("arm-none-eabi-gcc", "firmware on an emulated microcontroller"),
    ("assimp", "meshes in another reader"),
    ("chromium", "pages in a browser"),
    ("clang", "C hosts, packages and layouts by a second compiler"),
    ("clang++", "C++ hosts and packages by a second compiler"),
    ("cmake", "packages that CMake installs, the viewer with a window"),
    ("colmap", "poses by COLMAP itself"),
    ("ffmpeg", "MP4s"),
    ("g++", "C++ hosts by GCC by name"),
    ("gcc", "packages by GCC by name"),
    ("grep", "pages for a browser"),
    ("gzip", "pages for a browser"),
    ("make", "packages that CMake installs, the viewer with a window"),
    ("mount", "disks that are full or read-only"),
    ("npm", "the web element from its package"),
    ("numpy", "the package for Python"),
    ("pkg-config", "packages that pkg-config finds"),
    ("pytest", "the package for Python"),
    ("python3", "the package for Python, pages beside a fit, the web element"),
    ("qemu-system-arm", "firmware on an emulated microcontroller"),
    ("right to mount", "disks that are full or read-only"),
    ("runtime of AddressSanitizer", "hosts under AddressSanitizer"),
    ("runtime of ThreadSanitizer", "hosts under ThreadSanitizer"),
    ("sdl2-config", "the viewer with a window"),
    ("sed", "pages for a browser"),
    ("target wasm32-unknown-unknown", "pages for a browser"),
    ("valgrind", "hosts under valgrind"),
];

/// What tests use wherever it is, `NERF_TESTS=all` or not: of the system, or of the compilers that all of them need.
const UNASKED: &[&str] = &["/dev/full", "OpenMP", "g++", "gcc", "mount", "right to mount"];

/// Whether all of these programs are in `PATH`; each that is not is left out as by [`there_is`].
///
/// # Panics
/// As [`there_is`].
pub fn all_here(tools: &[&str]) -> bool {
    // All are asked, so that all are named.
    tools.iter().filter(|tool| !there_is(tool, in_path(tool))).count() == 0
}

/// Whether a test is to use what it needs: it was found, and asked for by `NERF_TESTS=all` where it is not of those that are
/// used anyway. If not, says so and notes the test as left out.
///
/// # Panics
/// Where it was asked for and not found, and the environment variable CI is set: CI must not pass by leaving out.
pub fn there_is(what: &str, found: bool) -> bool {
    let need = NEEDS.iter().find(|(name, _)| *name == what);
    let (_, untested) = need.unwrap_or_else(|| panic!("expected a name in tools::NEEDS, found {what}"));
    if !UNASKED.contains(&what) && !everything() {
        note_left_out(&format!("{what} is used with NERF_TESTS=all; not tested: {untested}"));
        return false;
    }
    if !found {
        leave_out(what, untested);
    }
    found
}

/// A file or folder of the real scenes and networks: in `$NERF_DATA`, or in `../shared/data` beside the workspace; where
/// it is missing, the test is left out as by [`there_is`].
///
/// # Panics
/// As [`there_is`].
pub fn data(name: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let root = std::env::var_os("NERF_DATA").map_or_else(beside, PathBuf::from);
    let path = root.join(name);
    if !path.exists() {
        let missing = if root.is_dir() { &path } else { &root };
        leave_out(&format!("data in {}", missing.display()), "real scenes and networks");
        return None;
    }
    Some(path)
}

fn leave_out(missing: &str, untested: &str) {
    let line = format!("no {missing}; not tested: {untested}");
    assert!(std::env::var_os("CI").is_none(), "CI is set, and there is {line}");
    note_left_out(&line);
}

/// Whether tests are asked for that need another tool or target: `NERF_TESTS=all`.
fn everything() -> bool {
    std::env::var_os("NERF_TESTS").is_some_and(|value| value == "all")
}

fn note_left_out(why: &str) {
    say_skipped(why);
    if let Some(file) = std::env::var_os("NERF_SKIPPED") {
        note(Path::new(&file));
    }
}

/// Adds the test that runs to the file of those left out.
fn note(file: &Path) {
    let program = std::env::current_exe().expect("a path");
    let folder = std::env::current_dir().expect("a folder");
    let thread = std::thread::current();
    let test = thread.name().filter(|name| *name != "main").expect("the thread of a test has its name");
    let line = format!("{}\t{}\t{test}\n", program.display(), folder.display());
    let opened = std::fs::File::options().append(true).create(true).open(file);
    // At once: programs may add lines at the same time.
    opened.and_then(|mut file| file.write_all(line.as_bytes())).expect("NERF_SKIPPED can be written");
}

/// Says on stderr what is left out and why, once a program.
pub fn say_skipped(why: &str) {
    static SAID: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    if SAID.lock().expect("nothing panics in there").insert(why.into()) {
        // Not eprintln!, which a test that passes keeps to itself.
        let _ = writeln!(std::io::stderr(), "skipped: {why}");
    }
}

/// Whether a program is in one of the folders of `PATH`.
fn in_path(program: &str) -> bool {
    let name = format!("{program}{}", std::env::consts::EXE_SUFFIX);
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path).any(|folder| folder.join(&name).is_file())
}

/// Whether `command --version` works.
pub fn runs(command: &[&str]) -> bool {
    let output = Command::new(command[0]).args(&command[1..]).arg("--version").output();
    output.is_ok_and(|output| output.status.success())
}

/// Whether tests are to take the minutes that the whole of what they check takes: `NERF_LONG=1`.
pub fn long() -> bool {
    std::env::var_os("NERF_LONG").is_some_and(|value| value == "1")
}
