//! C and C++ hosts under valgrind, AddressSanitizer and ThreadSanitizer: correct programs give no report, and
//! deliberate errors are found.
//!
//! The sanitizers instrument the code of this project and of the host, not the standard library's. ThreadSanitizer
//! therefore sees every access by the library and the host's own synchronisation (pthread is intercepted), but not
//! synchronisation inside the standard library. The library uses none: a scene never changes, and the one atomic, which
//! caches the features of the CPU, is in the library's own code.

use nerf_testing::build::{self, Language, Sanitizer, sanitized_program};
use nerf_testing::paths;
use nerf_testing::scenes::{Recipe, kernels};
use nerf_testing::tools::{all_here, there_is};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Runs the program with every watchable kernel on a scene with and one without an occupancy grid. Verifies that there
/// is no report.
fn is_clean(mut command: impl FnMut() -> Command, directory: &Path, watchable: impl Fn(&str) -> bool) {
    for (name, recipe) in [("plain.nerf", Recipe::PLAIN), ("occupancy.nerf", Recipe::OCCUPANCY)] {
        std::fs::write(directory.join(name), recipe.blob()).expect("a temporary file");
        for kernel in kernels().map(|kernel| kernel.to_string()).filter(|name| watchable(name)) {
            let output = run(command().env("NERF_KERNEL", &kernel).args(["good", name]), directory);
            assert!(output.status.success(), "{name}, {kernel}: {}", said(&output));
        }
    }
}

/// Runs the program with a deliberate error. Verifies that the error is reported, at a place in the library's own code.
fn is_found(command: &mut Command, directory: &Path, wrong: &str, report: &str, place: &str) {
    std::fs::write(directory.join("plain.nerf"), Recipe::PLAIN.blob()).expect("a temporary file");
    // Where there is no LLVM, binutils name the places.
    command.env("ASAN_OPTIONS", "allow_addr2line=1").env("NERF_KERNEL", "portable-f16");
    let output = run(command.args([wrong, "plain.nerf"]), directory);
    let text = said(&output);
    assert!(!output.status.success() && text.contains(report) && text.contains(place), "{wrong}: {text}");
}

fn run(command: &mut Command, directory: &Path) -> Output {
    command.current_dir(directory).output().expect("a program")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn watched() -> PathBuf {
    paths::workspace().join("tests/c/watched.c")
}

/// Runs a C++ example with three threads or three samples. Verifies that there is no report.
fn example_is_clean(mut command: Command, directory: &Path) {
    std::fs::write(directory.join("scene.nerf"), Recipe::OCCUPANCY.blob()).expect("a temporary file");
    let output = run(command.args(["scene.nerf", "out", "24", "20", "3"]), directory);
    assert!(output.status.success(), "{}", said(&output));
}

/// Returns the C++ examples that use threads, limits or collisions.
fn cpp_examples() -> [PathBuf; 4] {
    let folder = paths::workspace().join("nerf-render-ffi/examples/cpp");
    ["render.cpp", "hybrid.cpp", "path.cpp", "raster.cpp"].map(|name| folder.join(name))
}

#[test]
fn valgrind_has_nothing_to_report() {
    if !all_here(&["valgrind"]) {
        return;
    }
    let directory = paths::temporary();
    let valgrind = |program: &Path| {
        let mut command = Command::new("valgrind");
        command.args([
            "--quiet",
            "--error-exitcode=99",
            "--leak-check=full",
            "--errors-for-leak-kinds=definite",
        ]);
        command.arg(program);
        command
    };
    let program = build::program(Language::C, &watched(), directory.path(), &[]);
    // It has no AVX-512.
    is_clean(|| valgrind(&program), directory.path(), |kernel| !kernel.starts_with("avx512"));
    is_found(&mut valgrind(&program), directory.path(), "leak", "definitely lost", "nerf_scene_open_file");
    is_found(&mut valgrind(&program), directory.path(), "short", "Invalid write", "nerf_render");

    for example in cpp_examples() {
        let program = build::program(Language::Cpp, &example, directory.path(), &[]);
        let mut command = valgrind(&program);
        command.env("NERF_KERNEL", "portable-f16");
        example_is_clean(command, directory.path());
    }
}

#[test]
fn address_sanitizer_has_nothing_to_report() {
    if !there_is("runtime of AddressSanitizer", Sanitizer::Address.runtime().is_some()) {
        return;
    }
    let directory = paths::temporary();
    let program = sanitized_program(Sanitizer::Address, Language::C, &watched(), directory.path());
    is_clean(|| Command::new(&program), directory.path(), |_| true);
    is_found(&mut Command::new(&program), directory.path(), "leak", "LeakSanitizer", "nerf_scene_open_file");
    is_found(&mut Command::new(&program), directory.path(), "short", "heap-buffer-overflow", "nerf_core::");

    for example in cpp_examples() {
        let program = sanitized_program(Sanitizer::Address, Language::Cpp, &example, directory.path());
        example_is_clean(Command::new(program), directory.path());
    }
}

#[test]
fn thread_sanitizer_has_nothing_to_report() {
    if !there_is("runtime of ThreadSanitizer", Sanitizer::Thread.runtime().is_some()) {
        return;
    }
    let directory = paths::temporary();
    let program = sanitized_program(Sanitizer::Thread, Language::C, &watched(), directory.path());
    // The longest memory of accesses: a race with one it has forgotten is not reported.
    let under = |program: &Path| {
        let mut command = Command::new(program);
        command.env("TSAN_OPTIONS", "history_size=7:allow_addr2line=1");
        command
    };
    is_clean(|| under(&program), directory.path(), |_| true);
    is_found(&mut under(&program), directory.path(), "race", "data race", "nerf_render::target");

    for example in cpp_examples() {
        let program = sanitized_program(Sanitizer::Thread, Language::Cpp, &example, directory.path());
        example_is_clean(under(&program), directory.path());
    }
}
