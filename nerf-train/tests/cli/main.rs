//! The command line from end to end, on scenes of 24×24 pixels.

#[allow(dead_code, reason = "shared with the tests that span the crates")]
#[path = "../../../tests/src/browser.rs"]
mod browser;
mod check;
#[path = "../laws/import/made.rs"]
mod checkpoint;
mod completions;
mod effects;
mod engines;
mod explain;
mod export;
mod exr;
mod faults;
mod fields;
mod floors;
mod grid_fit;
mod import;
mod inputs;
mod json;
mod limits;
mod made;
mod picture;
mod pipeline;
mod places;
#[cfg(unix)]
mod poses;
#[path = "../program.rs"]
mod program;
mod schema;
mod settings;
mod show;
#[cfg(unix)]
mod signals;
mod snapshots;
mod space;
mod stopping;
mod storage;
mod study;
#[allow(dead_code, reason = "shared with the tests that span the crates")]
#[path = "../../../tests/src/tools.rs"]
mod tools;
mod untrusted;
mod video;
mod views;

use image::DynamicImage;
use made::{Folder, write_picture};
use program::program;
use std::path::Path;
use std::process::{Command, Stdio};

/// A network of 2×16 and few samples: steps of a millisecond. So few steps bring view dependence nothing: it is kept
/// all the same.
const TINY: &[&str] = &[
    "--effect-threshold",
    "-1000",
    "--depth",
    "2",
    "--width",
    "16",
    "--set",
    "network.position_levels=4",
    "--set",
    "network.direction_levels=1",
    "--colour-width",
    "8",
    "--set",
    "sampling.samples=16",
    "--rays",
    "64",
    "--set",
    "sampling.live_samples=512",
    "--set",
    "occupancy.resolution=12",
];

/// Reads a picture. `image::open` would compile all decoders again.
fn read_picture(file: impl AsRef<Path>) -> DynamicImage {
    let file = file.as_ref();
    let bytes = std::fs::read(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    image::load_from_memory(&bytes).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

/// What a command left.
struct Ran {
    code: Option<i32>,
    out: String,
    err: String,
}

fn command<S: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = S>) -> Command {
    let mut command = Command::new(program());
    command.args(args).stdin(Stdio::null()).env_remove("NERF_KERNEL").env_remove("NERF_FFMPEG");
    command
}

/// As [`command`], with signals as a terminal has them: whoever runs the tests in the background may have them
/// ignored, which programs inherit.
fn interruptible<S: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = S>) -> Command {
    let mut command = Command::new("env");
    command.arg("--default-signal=INT,TERM,HUP").arg(program()).args(args);
    command.stdin(Stdio::null()).env_remove("NERF_KERNEL").env_remove("NERF_FFMPEG");
    command
}

/// Runs a command to its end; none may panic.
fn ran(command: &mut Command) -> Ran {
    let output = command.output().expect("the command starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let ran = Ran { code: output.status.code(), out: text(&output.stdout), err: text(&output.stderr) };
    assert!(!ran.err.contains("panicked") && !ran.err.contains("RUST_BACKTRACE"), "{command:?}: {}", ran.err);
    ran
}

fn run<S: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = S>) -> Ran {
    ran(&mut command(args))
}

/// Runs a command that must succeed; its stdout.
fn ok<S: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = S>) -> String {
    let mut command = command(args);
    let ran = ran(&mut command);
    assert_eq!(ran.code, Some(0), "{command:?}: {}", ran.err);
    ran.out
}

/// Runs a command that must fail with one clear message, which holds all of `words`.
fn fails<S: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = S>, words: &[&str]) -> String {
    let mut command = command(args);
    let ran = ran(&mut command);
    assert!(matches!(ran.code, Some(1 | 2)), "{command:?}: status {:?}: {}", ran.code, ran.err);
    assert_eq!(ran.err.matches("error:").count(), 1, "{command:?}: {}", ran.err);
    for word in words {
        assert!(ran.err.contains(word), "{command:?}: expected `{word}` in: {}", ran.err);
    }
    // Said once: a cause must not follow a message that already holds it.
    let parts: Vec<&str> = ran.err.trim().split(": ").collect();
    let repeated = (1..parts.len()).any(|i| parts[i].len() > 12 && parts[..i].contains(&parts[i]));
    assert!(!repeated, "{command:?}: {}", ran.err);
    ran.err
}

/// The arguments of a fit of a sinusoidal network, quiet and tiny: of the preset `small` unless `more` names one.
fn fit<'a>(data: &'a str, output: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let preset: &[&str] = if more.contains(&"--preset") { &[] } else { &["--preset", "small"] };
    [&["fit", data, "-o", output, "-q"], TINY, preset, more].concat()
}

/// A grid of few entries, as tiny.
const TINY_GRID: &[&str] = &[
    "--effect-threshold",
    "-1000",
    "--table",
    "8",
    "--grid-levels",
    "4",
    "--coarsest",
    "4",
    "--finest",
    "24",
    "--steps-across",
    "24",
    "--depth",
    "1",
    "--width",
    "16",
    "--colour-width",
    "16",
    "--set",
    "network.direction_levels=2",
    "--rays",
    "64",
    "--set",
    "sampling.live_samples=512",
    "--set",
    "occupancy.resolution=12",
];

/// The arguments of a fit of a grid, quiet and tiny.
fn fit_grid<'a>(data: &'a str, output: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["fit", data, "-o", output, "-q"], TINY_GRID, more].concat()
}

/// A blob of the built-in scene after 30 steps, made once.
fn blob() -> &'static (Folder, String) {
    static BLOB: std::sync::OnceLock<(Folder, String)> = std::sync::OnceLock::new();
    BLOB.get_or_init(|| {
        let folder = Folder::new();
        let (data, file) = (folder.npz("scene.npz"), folder.path("scene.nerf"));
        ok(fit(&data, &file, &["--steps", "30"]));
        (folder, file)
    })
}

/// Whether a result for people has this field with this value.
fn has(text: &str, field: &str, value: &str) -> bool {
    let fields = text.lines().filter_map(|line| line.split_once("  "));
    fields.into_iter().any(|(name, text)| name == field && text.trim() == value)
}

fn json(path: impl AsRef<Path>) -> serde_json::Value {
    let text = std::fs::read_to_string(path.as_ref()).expect("a summary");
    serde_json::from_str(&text).expect("JSON")
}
