//! Building the library and programs that link it, as a host would.

use crate::paths;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// What `cargo build --release -p nerf-render-ffi` leaves.
#[derive(Clone, Debug)]
pub struct Libraries {
    /// `libnerf_render.a`
    pub archive: PathBuf,
    /// `libnerf_render.so`
    pub shared: PathBuf,
}

/// The libraries, built once per test program.
pub fn libraries() -> Libraries {
    static BUILT: OnceLock<Libraries> = OnceLock::new();
    BUILT.get_or_init(|| build(&[])).clone()
}

/// The libraries without any output or effect that is a feature, built once per test program; they lie in
/// a folder of their own.
pub fn lean_libraries() -> Libraries {
    static BUILT: OnceLock<Libraries> = OnceLock::new();
    let into = paths::workspace().join("target/lean");
    let into = into.to_str().expect("a path in UTF-8");
    let more = ["--no-default-features", "--features", "std", "--target-dir", into];
    BUILT.get_or_init(|| build(&more)).clone()
}

fn build(more: &[&str]) -> Libraries {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| env!("CARGO").into());
    let mut command = Command::new(cargo);
    command.current_dir(paths::workspace());
    command.args(["build", "--release", "--offline", "-p", "nerf-render-ffi", "--message-format=json"]);
    command.args(more);
    let output = run(&mut command);
    let names: Vec<PathBuf> = String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .filter(|message| message["target"]["name"] == "nerf_render")
        .flat_map(|message| message["filenames"].as_array().cloned().unwrap_or_default())
        .filter_map(|name| name.as_str().map(PathBuf::from))
        .collect();
    let with = |extension: &str| names.iter().find(|name| name.extension().is_some_and(|e| e == extension));
    Libraries {
        archive: with("a").expect("cargo built a static library").clone(),
        shared: with("so").expect("cargo built a shared library").clone(),
    }
}

/// A language of hosts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Language {
    /// C11.
    C,
    /// C++17.
    Cpp,
}

/// Compiles `source`, without a single warning, and links the static library.
pub fn program(language: Language, source: &Path, into: &Path, more: &[&str]) -> PathBuf {
    program_with(&libraries(), language, source, into, more)
}

/// The same with other libraries.
pub fn program_with(
    libraries: &Libraries,
    language: Language,
    source: &Path,
    into: &Path,
    more: &[&str],
) -> PathBuf {
    let program = into.join(source.file_stem().expect("a file name"));
    let (variable, default, standard) = match language {
        Language::C => ("CC", "cc", "-std=c11"),
        Language::Cpp => ("CXX", "c++", "-std=c++17"),
    };
    let mut command = Command::new(std::env::var_os(variable).unwrap_or_else(|| default.into()));
    command.args([standard, "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]);
    command.arg("-I").arg(paths::workspace().join("include"));
    command.arg("-o").arg(&program).arg(source).arg(&libraries.archive);
    command.args(["-lpthread", "-ldl", "-lm"]).args(more);
    run(&mut command);
    program
}

/// Runs a command that must succeed.
pub fn run(command: &mut Command) -> Output {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}\n{text}", output.status);
    output
}
