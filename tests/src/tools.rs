//! Tools, data and permissions that a test needs and a machine may lack.
//!
//! Rust, a C compiler and a C++ compiler are always used. Tests that need another tool, another target or minutes of
//! time run only with `NERF_TESTS=all`. A test is skipped if it is not requested or lacks what it needs. Each reason
//! for skipping is printed once per test program, even if the output of tests is captured. If the environment variable
//! `CI` is set, a requested test that lacks something fails instead.
//!
//! `NERF_SKIPPED` names a file that receives one line per skipped test: test program, working folder and test name,
//! separated by tabs. `.ci/run` runs these tests once their tools are installed.
//!
//! The tests of nerf-train use this file as a module of their own.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;

/// Items that a machine may lack, each with a description of what is not tested without the item.
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

/// Items of [`NEEDS`] that tests use even without `NERF_TESTS=all`: parts of the system, and of compilers that all
/// tests need.
const UNASKED: &[&str] = &["/dev/full", "OpenMP", "g++", "gcc", "mount", "right to mount"];

/// Returns whether [`there_is`] allows the use of all these programs, searched in `PATH`.
///
/// # Panics
/// As [`there_is`].
pub fn all_here(tools: &[&str]) -> bool {
    // All are asked, so that all are named.
    tools.iter().filter(|tool| !there_is(tool, in_path(tool))).count() == 0
}

/// Returns whether a test can use the item `what` of `NEEDS`. The item must be `found`; unless the item is in
/// `UNASKED`, `NERF_TESTS=all` must be set, too. If the test cannot use the item, prints the reason and records the
/// test as skipped.
///
/// # Panics
/// If `what` is not in `NEEDS`, or if a requested item was not found and the environment variable `CI` is set: CI must
/// not pass by skipping tests.
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

/// Returns the path of a file or folder of the real scenes and networks, in `$NERF_DATA` or, by default, in
/// `../shared/data` beside the workspace. If the path is missing, records the test as skipped and returns `None`.
///
/// # Panics
/// If the path is missing and the environment variable `CI` is set.
pub fn data(name: &str) -> Option<PathBuf> {
    let beside = || workspace().with_file_name("shared").join("data");
    let root = std::env::var_os("NERF_DATA").map_or_else(beside, PathBuf::from);
    let path = root.join(name);
    if !path.exists() {
        let missing = if root.is_dir() { &path } else { &root };
        leave_out(&format!("data in {}", missing.display()), "real scenes and networks");
        return None;
    }
    Some(path)
}

/// Returns the folder of the workspace, found by its lock file: packages at several depths include this module.
pub fn workspace() -> &'static Path {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    own.ancestors().find(|folder| folder.join("Cargo.lock").exists()).unwrap_or(own)
}

fn leave_out(missing: &str, untested: &str) {
    let line = format!("no {missing}; not tested: {untested}");
    assert!(std::env::var_os("CI").is_none(), "CI is set, and there is {line}");
    note_left_out(&line);
}

/// Returns whether tests that need another tool or target are requested: `NERF_TESTS=all`.
fn everything() -> bool {
    std::env::var_os("NERF_TESTS").is_some_and(|value| value == "all")
}

fn note_left_out(why: &str) {
    say_skipped(why);
    if let Some(file) = std::env::var_os("NERF_SKIPPED") {
        note(Path::new(&file));
    }
}

/// Appends the running test to `file`, the list of skipped tests.
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

/// Prints to stderr why a test is skipped; each reason once per program.
pub fn say_skipped(why: &str) {
    static SAID: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    if SAID.lock().expect("nothing panics in there").insert(why.into()) {
        // Not eprintln!, which a test that passes keeps to itself.
        let _ = writeln!(std::io::stderr(), "skipped: {why}");
    }
}

/// Returns whether a program is in one of the folders of `PATH`.
fn in_path(program: &str) -> bool {
    let name = format!("{program}{}", std::env::consts::EXE_SUFFIX);
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path).any(|folder| folder.join(&name).is_file())
}

/// Returns whether `command --version` succeeds.
pub fn runs(command: &[&str]) -> bool {
    let output = Command::new(command[0]).args(&command[1..]).arg("--version").output();
    output.is_ok_and(|output| output.status.success())
}

/// Returns whether tests run their complete checks, which take minutes: `NERF_LONG=1`.
pub fn long() -> bool {
    std::env::var_os("NERF_LONG").is_some_and(|value| value == "1")
}
