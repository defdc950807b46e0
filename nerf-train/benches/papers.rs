//! Fits of NeRF-synthetic scenes, measured as in papers. Prints one row of figures per scene, and their mean.
//!
//! `cargo bench -p nerf-train --bench papers -- FOLDER [--seconds S] [FLAGS OF fit…]` fits the scene FOLDER or, if
//! FOLDER has no `transforms_train.json`, the scenes in its folders. Each fit takes S seconds (default: 300), with the
//! reading of the data. PSNR and SSIM are over white, on the validation views, or on the test views if there are no
//! validation views. Needs an otherwise idle machine.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

const PROGRAM: &str = env!("CARGO_BIN_EXE_nerf-train");

fn main() {
    let mut arguments: Vec<String> =
        std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    if arguments.is_empty() {
        println!("no FOLDER of scenes: nothing to measure");
        return;
    }
    let folder = PathBuf::from(arguments.remove(0));
    let seconds = match arguments.iter().position(|argument| argument == "--seconds") {
        Some(at) => arguments.drain(at..at + 2).next_back().expect("a number of seconds"),
        None => "300".into(),
    };
    let scenes = scenes(&folder);
    assert!(!scenes.is_empty(), "{}: expected transforms_train.json, or folders with one", folder.display());
    println!("| scene | views | PSNR, dB | worst | SSIM | fit, s | bytes |");
    println!("| --- | --- | ---: | ---: | ---: | ---: | ---: |");
    let rows: Vec<Row> = scenes.iter().map(|scene| Row::of(scene, &seconds, &arguments)).collect();
    let mean = |of: fn(&Row) -> f64| rows.iter().map(of).sum::<f64>() / rows.len() as f64;
    let (db, ssim, bytes) = (mean(|row| row.psnr_db), mean(|row| row.ssim), mean(|row| row.bytes));
    println!("| mean of {} | | {db:.2} | | {ssim:.3} | | {bytes:.0} |", rows.len());
    println!("\n{}, white background, fit --max-seconds {seconds} {}", rows[0].machine, arguments.join(" "));
}

/// Returns `folder` if it is a scene, else the scenes in `folder`, sorted by name.
fn scenes(folder: &Path) -> Vec<PathBuf> {
    let is_scene = |path: &Path| path.join("transforms_train.json").is_file();
    if is_scene(folder) {
        return vec![folder.into()];
    }
    let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut scenes: Vec<PathBuf> =
        entries.flatten().map(|entry| entry.path()).filter(|path| is_scene(path)).collect();
    scenes.sort();
    scenes
}

/// Figures of one scene.
struct Row {
    psnr_db: f64,
    ssim: f64,
    bytes: f64,
    /// Processor, kernel and number of threads, for the line below the table.
    machine: String,
}

impl Row {
    /// Fits and measures a scene, and prints its row.
    fn of(scene: &Path, seconds: &str, flags: &[String]) -> Self {
        let scratch = tempfile::tempdir().expect("a folder for the blob");
        let blob = scratch.path().join("scene.nerf");
        let sized: Vec<_> = flags.windows(2).filter(|flag| flag[0] == "--downscale").flatten().collect();
        let fitted = json(
            Command::new(PROGRAM)
                .arg("fit")
                .arg(scene)
                .arg("-o")
                .arg(&blob)
                .args(["--max-seconds", seconds])
                .args(flags),
        );
        let found = json(
            Command::new(PROGRAM)
                .arg("eval")
                .arg(&blob)
                .arg(scene)
                .args(["--background", "white"])
                .args(sized),
        );
        let number = |json: &Value, name: &str| json[name].as_f64().unwrap_or(f64::NAN);
        let row = Self {
            psnr_db: number(&found, "val_psnr_db"),
            ssim: number(&found, "val_ssim"),
            bytes: number(&fitted, "blob_bytes"),
            machine: format!(
                "{}, {}, {} threads",
                fitted["cpu"].as_str().unwrap_or("?"),
                fitted["kernel"].as_str().unwrap_or("?"),
                fitted["threads"]
            ),
        };
        println!(
            "| {} | {} {} | {:.2} | {:.2} | {:.3} | {:.0} | {:.0} |",
            scene.file_name().unwrap_or_default().to_string_lossy(),
            found["views"],
            found["split"].as_str().unwrap_or("?"),
            row.psnr_db,
            number(&found, "val_worst_psnr_db"),
            row.ssim,
            number(&fitted, "total_seconds"),
            row.bytes,
        );
        row
    }
}

/// Runs the program with `--json`, and returns the JSON object that it prints.
fn json(command: &mut Command) -> Value {
    let output = command.args(["--json", "--quiet"]).output().expect("the program runs");
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}
