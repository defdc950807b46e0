//! Run times of `fit --max-seconds S`, which should end within S + max(2 s, 5 % of S). Prints one row per run, and
//! marks runs that take longer.
//!
//! `cargo bench -p nerf-train --bench limits [-- S,S,… DATA…]` fits each DATA with each limit S, seconds.
//! Default: 10, 30 and 120 seconds, for the built-in scene and the real data in `$NERF_DATA`, or in `../shared/data` if
//! `$NERF_DATA` is unset. Needs an otherwise idle machine.

#[path = "../tests/cli/made.rs"]
#[allow(dead_code, reason = "the helpers of the command line's tests")]
mod made;

use made::Folder;
use nerf_train::data::demo;
use nerf_train::data::demo::DemoSpec;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

/// Paths of real data sets in the data folder; missing ones are skipped.
const REAL: [&str; 3] = ["lego_200x200.npz", "lego_200", "real/fox_ngp"];

fn main() {
    let arguments: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let folder = Folder::new();
    let seconds: Vec<f64> = match arguments.first() {
        Some(list) => list.split(',').map(|s| s.parse().expect("seconds")).collect(),
        None => vec![10.0, 30.0, 120.0],
    };
    let mut data: Vec<PathBuf> = arguments.iter().skip(1).map(PathBuf::from).collect();
    if data.is_empty() {
        let demo = demo::dataset(&DemoSpec::default()).expect("the built-in scene");
        data.push(folder.blender_of("demo", &demo).into());
        let real = std::env::var_os("NERF_DATA")
            .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
        data.extend(REAL.iter().map(|name| real.join(name)).filter(|path| path.exists()));
    }
    println!("| data | S | whole command, s | limit, s | last step after, s | val dB | worst dB | lattice |");
    println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    for data in &data {
        for &limit in &seconds {
            row(&folder, data, limit);
        }
    }
}

/// Runs one fit with a report, and prints its row.
fn row(folder: &Folder, data: &Path, limit: f64) {
    let (blob, report) = (folder.path("a.nerf"), folder.path("report"));
    let begun = Instant::now();
    let status = Command::new(env!("CARGO_BIN_EXE_nerf-train"))
        .args(["fit", data.to_str().expect("UTF-8"), "-o", &blob, "--report", &report, "--restart", "-q"])
        .args(["--max-seconds", &limit.to_string()])
        .stdout(Stdio::null())
        .status();
    let taken = begun.elapsed().as_secs_f64();
    assert!(status.expect("the command starts").success(), "{}", data.display());
    let summary = std::fs::read_to_string(Path::new(&report).join("summary.json")).expect("a summary");
    let summary: serde_json::Value = serde_json::from_str(&summary).expect("JSON");
    let number = |name: &str| summary[name].as_f64().unwrap_or(f64::NAN);
    let allowed = limit + (0.05 * limit).max(2.0);
    println!(
        "| {} | {limit} | {taken:.1}{} | {allowed:.1} | {:.1} | {:.2} | {:.2} | {} |",
        data.file_name().unwrap_or_default().to_string_lossy(),
        if taken > allowed { " (over)" } else { "" },
        number("train_seconds"),
        number("val_psnr_db"),
        number("val_worst_psnr_db"),
        summary["val_lattice"],
    );
}
