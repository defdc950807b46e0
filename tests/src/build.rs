//! Building the library and programs that link it, as a host would.

use crate::paths;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Paths of the C library: static and shared.
#[derive(Clone, Debug)]
pub struct Libraries {
    /// `libnerf_render.a`
    pub archive: PathBuf,
    /// `libnerf_render.so`
    pub shared: PathBuf,
}

/// Returns the libraries that cargo built beside this test program, and hence from the same sources. Their core also
/// has the feature `train`, which does not change the C interface; `.ci/run` and the package tests build without this
/// feature.
pub fn libraries() -> Libraries {
    // Beside the executable that runs: target/release/deps/test-0123.
    let own = std::env::current_exe().expect("a path");
    let beside = own.parent().expect("a folder");
    let built = |name: &str| {
        let file = beside.join(name);
        assert!(file.exists(), "{}: expected the library beside the test program", file.display());
        file
    };
    Libraries { archive: built("libnerf_render.a"), shared: built("libnerf_render.so") }
}

/// Returns the path of the cargo that runs the tests, or else the name to find in `PATH`. `env!("CARGO")` is not used:
/// a cargo at another path, as in `.ci/run`, would compile this crate and all its tests again.
fn cargo() -> OsString {
    std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into())
}

/// Builds a package with only the features in `arguments`. Returns the files that cargo reports.
///
/// `folder`: name of the target directory; builds in different folders do not wait for each other. The profile has no
/// slow optimisation across crates. The build uses one codegen unit, since inlining across units changes more code than
/// an effect has. The build is not incremental, since incremental builds keep unused functions. Debug information is
/// limited to line tables.
pub fn build_alone(folder: &str, arguments: &[&str]) -> Vec<PathBuf> {
    let mut command = Command::new(cargo());
    command.current_dir(paths::workspace());
    command.env("CARGO_PROFILE_DEV_DEBUG", "line-tables-only").env("CARGO_PROFILE_DEV_OPT_LEVEL", "1");
    command.env("CARGO_PROFILE_DEV_CODEGEN_UNITS", "1").env("CARGO_INCREMENTAL", "0");
    command.args(["build", "--offline", "--no-default-features", "--message-format=json"]);
    // Beside the executable that runs: target/release/deps/test-0123.
    let own = std::env::current_exe().expect("a path");
    let target = own.ancestors().nth(3).expect("cargo's target directory");
    files(command.args(arguments).arg("--target-dir").arg(target.join("features").join(folder)))
}

/// A sanitizer, which checks every memory access of a program.
#[derive(Clone, Copy, Debug)]
pub enum Sanitizer {
    /// AddressSanitizer: accesses out of bounds, uses after free, leaks.
    Address,
    /// ThreadSanitizer: unsynchronised accesses by several threads.
    Thread,
}

impl Sanitizer {
    /// Returns the sanitizer's name for compilers, and the name of its runtime.
    fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Address => ("address", "asan"),
            Self::Thread => ("thread", "tsan"),
        }
    }

    /// Returns the path of the sanitizer's runtime in the Rust toolchain; `None` if the toolchain has no such runtime.
    pub fn runtime(self) -> Option<PathBuf> {
        let libraries = output(Command::new("rustc").args(["--print", "target-libdir"]));
        let ending = format!("_rt.{}.a", self.names().1);
        let mut files = std::fs::read_dir(libraries.trim()).ok()?.filter_map(|file| Some(file.ok()?.path()));
        files.find(|file| file.to_string_lossy().ends_with(&ending))
    }
}

/// Runs a command that must succeed, and returns its standard output.
fn output(command: &mut Command) -> String {
    String::from_utf8_lossy(&run(command).stdout).into_owned()
}

/// Compiles `source` and links the library, both under a sanitizer. Returns the path of the program.
///
/// The library's own code is instrumented, the standard library's is not. The host's code uses the Rust toolchain's
/// runtime, too. `RUSTC_BOOTSTRAP` is set because the sanitizer flags of rustc are not stable yet.
pub fn sanitized_program(sanitizer: Sanitizer, language: Language, source: &Path, into: &Path) -> PathBuf {
    let (name, runtime) = sanitizer.names();
    let about = output(Command::new("rustc").arg("-vV"));
    let host = about.lines().find_map(|line| line.strip_prefix("host: ")).expect("a host");
    let runtime_archive = sanitizer.runtime().expect("a runtime");
    // The folder that `.ci/run` uses, too.
    let own = std::env::current_exe().expect("a path");
    let target = own.ancestors().nth(3).expect("cargo's target directory").join(runtime);
    let mut command = Command::new("cargo");
    // With this crate, so that the core has the features of the tests that `.ci/run` builds under the sanitizer.
    command.args(["build", "--offline", "--lib", "--target", host]);
    command.args(["-p", "nerf-render-ffi", "-p", "nerf-testing"]);
    command.current_dir(paths::workspace()).env("RUSTC_BOOTSTRAP", "1");
    let allowed = if runtime == "tsan" { " -Cunsafe-allow-abi-mismatch=sanitizer" } else { "" };
    command.env("RUSTFLAGS", format!("-Zsanitizer={name}{allowed}"));
    run(command.arg("--target-dir").arg(&target));
    let archive = target.join(host).join("debug/libnerf_render.a");

    let object = into.join(format!("{runtime}.o"));
    let program = into.join(runtime);
    let (compiler, standard) = language.compiler();
    let mut command = Command::new(&compiler);
    command.arg(standard).args(["-g", "-c", &format!("-fsanitize={name}")]);
    command.arg("-I").arg(paths::workspace().join("include"));
    run(command.arg(source).arg("-o").arg(&object));
    let mut command = Command::new(&compiler);
    command.arg(&object).arg(&archive).arg("-Wl,--whole-archive").arg(&runtime_archive);
    run(command.args(["-Wl,--no-whole-archive", "-lpthread", "-ldl", "-lm", "-lrt", "-o"]).arg(&program));
    program
}

/// Runs a cargo command, and returns the files that it produces for the packages of this workspace.
fn files(command: &mut Command) -> Vec<PathBuf> {
    let output = run(command);
    let root = paths::workspace();
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .filter(|message| {
            let manifest = message["manifest_path"].as_str();
            manifest.is_some_and(|manifest| Path::new(manifest).starts_with(&root))
        })
        .flat_map(|message| message["filenames"].as_array().cloned().unwrap_or_default())
        .filter_map(|name| name.as_str().map(PathBuf::from))
        .collect()
}

/// Programming language of a host program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Language {
    /// C11.
    C,
    /// C++17.
    Cpp,
}

impl Language {
    /// Returns the compiler, and its flag for the language standard.
    fn compiler(self) -> (OsString, &'static str) {
        let (variable, default, standard) = match self {
            Self::C => ("CC", "cc", "-std=c11"),
            Self::Cpp => ("CXX", "c++", "-std=c++17"),
        };
        (std::env::var_os(variable).unwrap_or_else(|| default.into()), standard)
    }
}

/// Compiles `source` and links the static library; warnings are errors. Returns the path of the program.
pub fn program(language: Language, source: &Path, into: &Path, more: &[&str]) -> PathBuf {
    program_with(&libraries(), language, source, into, more)
}

/// Compiles `source` and links the static one of `libraries`, as [`program`] does.
pub fn program_with(
    libraries: &Libraries,
    language: Language,
    source: &Path,
    into: &Path,
    more: &[&str],
) -> PathBuf {
    let program = into.join(source.file_stem().expect("a file name"));
    let (compiler, standard) = language.compiler();
    let mut command = Command::new(compiler);
    command.args([standard, "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]);
    command.arg("-I").arg(paths::workspace().join("include"));
    command.arg("-o").arg(&program).arg(source).arg(&libraries.archive);
    command.args(["-lpthread", "-ldl", "-lm"]).args(more);
    run(&mut command);
    program
}

/// Runs a command that must succeed, and returns its output.
pub fn run(command: &mut Command) -> Output {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}\n{text}", output.status);
    output
}
