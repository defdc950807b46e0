//! SIGINT, SIGTERM and SIGHUP at seeded moments of every long command: each is answered within two seconds, what the
//! command saves is whole, and nothing half-written stays behind.

use crate::checkpoint::Shape;
use crate::made::{Folder, scene};
use crate::program::program;
use crate::stopping::{Running, wait_for};
use crate::tools::all_here;
use crate::{blob, fit, interruptible, ok, write_picture};
use nerf_core::blob::Blob;
use nerf_core::sampling::{Purpose, uniform};
use nerf_train::data::demo;
use nerf_train::data::demo::DemoSpec;
use nerf_train::system::stop;
use nerf_train::train::checkpoint::Checkpoint;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// How soon a signal is answered.
const ANSWER: Duration = Duration::from_secs(2);

/// What the commands read.
struct Inputs {
    folder: Folder,
    /// Pictures of 24×24.
    data: String,
    /// Pictures of 200×200: validations and evaluations take a while.
    large: String,
    photo: String,
    blob: String,
    checkpoint: String,
    fifo: String,
}

impl Inputs {
    fn new() -> Self {
        let folder = Folder::in_memory();
        let spec = DemoSpec { train: 3, val: 2, size: 200, ..DemoSpec::default() };
        let large = folder.npz_of("large.npz", &demo::dataset(&spec).expect("a scene"), |_| {});
        let photo = folder.path("photo.png");
        let pixel = |x: u32, y: u32| image::Rgb([x as u8, if x > y { 200 } else { 30 }, (y / 2) as u8]);
        write_picture(image::ImageBuffer::from_fn(900, 600, pixel), &photo);
        let checkpoint = folder.path("network.npz");
        Shape::small().checkpoint(1).npz(Path::new(&checkpoint), "<f4");
        let fifo = folder.path("fifo.json");
        assert!(Command::new("mkfifo").arg(&fifo).status().expect("mkfifo").success());
        let data = folder.npz_of("data.npz", &scene(), |_| {});
        Self { data, large, photo, blob: blob().1.clone(), checkpoint, fifo, folder }
    }
}

/// A command, and the seconds from its start in which signals come; `NAN` for as long as it takes by itself.
type Row = (&'static str, f64, fn(&Inputs, &Folder) -> Vec<String>);

fn owned(parts: &[&[&str]]) -> Vec<String> {
    parts.concat().into_iter().map(str::to_owned).collect()
}

/// The long commands that depend on no external program. A span of `NAN` marks a command that resumes from a checkpoint.
const ROWS: &[Row] = &[
    ("fit", f64::NAN, |i, o| {
        let run = ["--steps", "500", "--validate-every", "25", "--checkpoint-every", "0.05"];
        owned(&[&fit(&i.data, &o.path("a.nerf"), &run)])
    }),
    ("fit, long validations and end", f64::NAN, |i, o| {
        let run = [
            "--steps",
            "12",
            "--validate-every",
            "4",
            "--set",
            "sampling.samples=32",
            "--width",
            "32",
            "--preset",
            "small",
        ];
        let data = ["fit", &i.large, "-o", &o.path("a.nerf"), "--report", &o.path("report"), "-q"];
        owned(&[&data, &run, &["--rays", "64", "--depth", "2", "--set", "occupancy.resolution=12"]])
    }),
    ("fit of a fifo", 0.5, |i, o| owned(&[&fit(&i.fifo, &o.path("a.nerf"), &[])])),
    ("image fit", 1.5, |i, o| {
        let run = ["--evaluate-every", "5", "--pixels", "500", "--steps", "1000000"];
        owned(&[&["image", "fit", &i.photo, "-o", &o.path("a.nerf"), "--preset", "classic"], &run])
    }),
    ("image fit, gone on with", f64::NAN, |i, o| {
        let run =
            ["--evaluate-every", "30", "--pixels", "500", "--steps", "120", "--checkpoint-every", "0.05"];
        owned(&[&["image", "fit", &i.photo, "-o", &o.path("a.nerf")], &run])
    }),
    ("image fit, a grid", 1.5, |i, o| {
        let run = ["--evaluate-every", "5", "--pixels", "500", "--steps", "1000000"];
        owned(&[&["image", "fit", &i.photo, "-o", &o.path("a.nerf")], &run])
    }),
    ("image fit, long steps", 3.0, |i, o| {
        let run = ["--evaluate-every", "3", "--pixels", "60000", "--steps", "1000000"];
        owned(&[&["image", "fit", &i.photo, "-o", &o.path("a.nerf"), "--preset", "classic"], &run])
    }),
    ("image fit, its end", 1.5, |i, o| {
        let run =
            ["--evaluate-every", "999", "--pixels", "500", "--steps", "3", "--report", &o.path("report")];
        owned(&[&["image", "fit", &i.photo, "-o", &o.path("a.nerf"), "--preset", "classic"], &run])
    }),
    ("image render", 1.0, |i, o| {
        let field = i.folder.path("field.nerf");
        if !Path::new(&field).exists() {
            ok(["image", "fit", &i.photo, "-o", &field, "-q", "--steps", "2", "--preset", "classic"]);
        }
        owned(&[&["image", "render", &field, "-o", &o.path("a.png"), "--width", "6000"]])
    }),
    ("render", 1.0, |i, o| {
        owned(&[&["render", &i.blob, "-o", &o.path("a.png"), "--width", "2000", "--antialias", "64"]])
    }),
    ("render, a GIF", 1.5, |i, o| {
        let more = ["--orbit", "100000", "--width", "96"];
        owned(&[&["render", &i.blob, "-o", &o.path("a.gif")], &more])
    }),
    ("render, frames", 1.5, |i, o| {
        let more = ["--orbit", "100000", "--width", "96", "--outputs", "rgb,z-depth"];
        owned(&[&["render", &i.blob, "-o", &o.path("frames/")], &more])
    }),
    ("eval", 1.0, |i, o| {
        let exact = ["--samples", "1024", "--transmittance-cut", "0", "--colour-cut", "0"];
        owned(&[&["eval", &i.blob, &i.large, "--report", &o.path("report")], &exact])
    }),
    ("audit", 1.0, |i, _| owned(&[&["audit", &i.blob, &i.large]])),
    ("study", 1.2, |i, o| {
        owned(&[&["study", &i.blob, &i.data, "--report", &o.path("report"), "-o", &o.path("a.nerf")]])
    }),
    ("sweep scene", 3.0, |i, o| {
        let lists = ["--steps", "60", "--levels", "2,3,4,5,6,7,8", "--width", "16,24,32", "--layers", "2"];
        owned(&[&["sweep", "scene", &i.data, "-o", &o.path("sweep")], &lists])
    }),
    ("sweep image", 3.0, |i, o| {
        let lists = ["--steps", "20", "--pixels", "500", "--levels", "2,4,6,8,10", "--width", "16,32,64"];
        owned(&[&["sweep", "image", &i.photo, "-o", &o.path("sweep"), "--layers", "2"], &lists])
    }),
    ("import --check", 1.0, |i, o| {
        let guesses = ["--samples", "512", "--angle-scale", "pi"];
        let (file, large) = (o.path("a.nerf"), &i.large);
        owned(&[&["import", &i.checkpoint, "-o", &file, "--check", large], &guesses])
    }),
    ("show", 1.0, |i, o| {
        let size = ["--rays", "5000"];
        owned(&[&["show", &i.large, "-o", &o.path("show")], &size])
    }),
    ("demo", 4.0, |i, o| {
        let toml = "[network]\nwidth = 16\ndepth = 2\n[sampling]\nsamples = 16\nrays = 64\n";
        let config = i.folder.file("demo.toml", toml);
        owned(&[&["demo", "--out", &o.path("demo"), "--steps", "400", "--config", &config]])
    }),
    ("inspect of a fifo", 0.3, |i, _| owned(&[&["inspect", &i.fifo]])),
];

/// Those that run ffmpeg.
const FILMS: &[Row] = &[("render, an MP4", 1.5, |i, o| {
    owned(&[&["render", &i.blob, "-o", &o.path("a.mp4"), "--orbit", "100000", "--width", "96"]])
})];

/// All files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

/// Whether a file is all of what its name says.
fn is_whole(path: &Path) -> bool {
    let bytes = fs::read(path).expect("a file");
    match path.extension().and_then(|extension| extension.to_str()).unwrap_or_default() {
        "nerf" => Blob::open(&bytes).is_ok(),
        "checkpoint" => Checkpoint::read(path).is_ok(),
        "png" => image::load_from_memory(&bytes).is_ok(),
        "json" => serde_json::from_slice::<serde_json::Value>(&bytes).is_ok(),
        "csv" => csv::Reader::from_reader(&bytes[..]).records().all(|row| row.is_ok()),
        "svg" => bytes.ends_with(b"</svg>\n") || bytes.ends_with(b"</svg>"),
        "md" | "html" => bytes.ends_with(b"\n") || bytes.ends_with(b">"),
        "gif" => bytes.ends_with(b";"),
        "mp4" => bytes.get(4..8) == Some(b"ftyp"),
        _ => false,
    }
}

/// Command lines of processes that were given a name in this folder.
pub fn processes_with(folder: &str) -> Vec<String> {
    let Ok(all) = fs::read_dir("/proc") else { return Vec::new() };
    let lines = all.filter_map(|entry| fs::read(entry.ok()?.path().join("cmdline")).ok());
    let lines = lines.map(|line| String::from_utf8_lossy(&line).replace('\0', " "));
    lines.filter(|line| line.contains(folder)).collect()
}

/// What a signal did to a command.
struct Answer {
    /// From the signal to the end.
    after: Duration,
    /// 0 if it was through, `None` if it had not begun to listen.
    code: Option<i32>,
    err: String,
}

/// Starts a command, sends it a signal after a while, and waits for its end.
fn signalled(args: &[String], wait: Duration, signal: &str) -> Answer {
    let mut running = Running::of(&mut interruptible(args));
    std::thread::sleep(wait);
    let sent = Instant::now();
    running.signal(signal);
    let output = running.output();
    let after = sent.elapsed();
    let err =
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let number = number_of(signal);
    let code = output.status.code();
    // By the system itself, before the first line of main.
    let early = code.is_none() && output.status.signal() == Some(number);
    assert!(
        early || code == Some(0) || code == Some(128 + number),
        "{args:?} {signal}: {:?} {err}",
        output.status
    );
    assert!(!err.contains("panicked"), "{args:?} {signal}: {err}");
    assert!(code != Some(128 + number) || err.contains("interrupted"), "{args:?} {signal}: {err}");
    Answer { after, code, err }
}

fn number_of(signal: &str) -> i32 {
    match signal {
        "INT" => 2,
        "TERM" => 15,
        _ => 1,
    }
}

/// Those that this process, and so what it starts, was not started to ignore.
fn signals() -> Vec<&'static str> {
    let answered: Vec<i32> = stop::answered().into_iter().map(|signal| signal as i32).collect();
    ["INT", "TERM", "HUP"].into_iter().filter(|signal| answered.contains(&number_of(signal))).collect()
}

/// `--resume`, where there is a checkpoint, gives these bytes.
fn goes_on_to(expected: &[u8], args: &[String], output: &Folder) {
    let resume = Path::new(&output.path("a.nerf.checkpoint")).exists();
    let resume = if resume { vec!["--resume".to_owned()] } else { Vec::new() };
    ok([args, &resume].concat());
    assert!(
        fs::read(output.path("a.nerf")).expect("a blob") == expected,
        "{args:?}, resumed: {}",
        resume.len()
    );
}

#[test]
fn a_signal_at_any_moment_of_any_command_is_answered_within_two_seconds() {
    are_answered(ROWS);
}

#[test]
fn a_signal_at_any_moment_of_a_film_is_answered_within_two_seconds() {
    if all_here(&["ffmpeg"]) {
        are_answered(FILMS);
    }
}

/// One moment of each command, 20 with `NERF_LONG`; `NERF_ROWS` chooses commands by a word of their names.
fn are_answered(rows: &[Row]) {
    let moments = if std::env::var_os("NERF_LONG").is_some() { 20 } else { 1 };
    let chosen = std::env::var("NERF_ROWS").unwrap_or_default();
    let (inputs, signals) = (Inputs::new(), signals());
    let mut late = Vec::new();
    let rows = rows.iter().enumerate().filter(|(_, (name, ..))| name.contains(&chosen));
    for (row, &(name, span, args)) in rows {
        let begun = Instant::now();
        let calm = span.is_nan().then(|| {
            let output = Folder::in_memory();
            ok(args(&inputs, &output));
            (begun.elapsed(), fs::read(output.path("a.nerf")).expect("a blob"))
        });
        let span = calm.as_ref().map_or(span, |(took, _)| took.as_secs_f64());
        let (mut longest, mut through, mut early) = (Duration::ZERO, 0, 0);
        for moment in 0..moments {
            let output = Folder::in_memory();
            let args = args(&inputs, &output);
            let share = uniform(7, Purpose::Jitter, row as u64, moment);
            let signal = signals[(row + moment as usize) % signals.len()];
            let wait = Duration::from_secs_f64(0.02 + span * f64::from(share));
            let answer = signalled(&args, wait, signal);
            longest = longest.max(answer.after);
            through += usize::from(answer.code == Some(0));
            early += usize::from(answer.code.is_none());
            if answer.after > ANSWER {
                late.push(format!("{name}: {signal} after {wait:?} took {:?}: {}", answer.after, answer.err));
            }
            for path in files(Path::new(&output.path("."))) {
                assert!(is_whole(&path), "{name}: {} after {signal} at {wait:?}", path.display());
            }
            let kept = answer.err.contains("holds the field");
            assert!(!kept || Path::new(&output.path("a.nerf")).exists(), "{name}: {}", answer.err);
            let children = processes_with(&output.path(""));
            assert!(children.is_empty(), "{name}: {children:?}");
            if let Some((_, expected)) = &calm {
                goes_on_to(expected, &args, &output);
            }
        }
        println!(
            "{name:<26} {moments} moments: longest answer {:.2} s; {through} through, {early} before main; {:.1} s",
            longest.as_secs_f64(),
            begun.elapsed().as_secs_f64()
        );
    }
    assert!(late.is_empty(), "{}", late.join("\n"));
}

#[test]
fn a_second_signal_loses_nothing_of_what_the_first_saves() {
    let (inputs, output) = (Inputs::new(), Folder::in_memory());
    let (file, report) = (output.path("a.nerf"), output.path("report"));
    let args = ["image", "fit", &inputs.photo, "-o", &file, "--report", &report, "--snapshots", "1"];
    let mut running = Running::start(&args);
    wait_for(&Path::new(&report).join("snapshots/step_000001.png"), &mut running);
    for signal in signals().into_iter().chain(signals()) {
        if running.is_running() {
            running.signal(signal);
        }
    }
    let ended = running.output();
    let err = String::from_utf8_lossy(&ended.stderr);
    // Of signals that come together any may be taken first.
    let codes: Vec<i32> = signals().into_iter().map(|signal| 128 + number_of(signal)).collect();
    assert!(ended.status.code().is_some_and(|code| codes.contains(&code)), "{:?} {err}", ended.status);
    assert!(err.contains("holds the field after step"), "{err}");
    assert!(is_whole(Path::new(&file)));
    assert!(
        !files(Path::new(&output.path("."))).iter().any(|path| path.extension().is_some_and(|e| e == "tmp"))
    );
}

#[test]
fn a_signal_is_an_error_object_for_a_program_that_follows() {
    let (_, file) = blob();
    let folder = Folder::new();
    let gif = folder.path("a.gif");
    let mut running =
        Running::start(&["render", file, "-o", &gif, "--orbit", "100000", "--json", "--width", "16"]);
    // Views are drawn once its temporary has 10,000 bytes; the film's beginning is there before the first view.
    let begun = Instant::now();
    let drawn = || {
        let files = std::fs::read_dir(folder.path(".")).expect("a folder").flatten();
        files.filter_map(|file| file.metadata().ok()).any(|file| file.len() > 10_000)
    };
    while !drawn() && begun.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(5));
    }
    running.signal("TERM");
    let ended = running.output();
    assert_eq!(ended.status.code(), Some(143));
    let said: serde_json::Value = serde_json::from_slice(&ended.stdout).expect("one object");
    assert!(said["error"].as_str().is_some_and(|error| error.contains("no film is left")), "{said}");
}

#[test]
fn a_sweep_that_is_interrupted_keeps_and_reports_its_finished_runs() {
    let (inputs, output) = (Inputs::new(), Folder::in_memory());
    let folder = output.path("sweep");
    let lists =
        ["--steps", "400", "--levels", "2,3,4,5,6,7,8", "--width", "16", "--layers", "2", "--rate", "0.01"];
    let args = [&["sweep", "scene", &inputs.data, "-o", &folder, "-q"], &lists[..]].concat();
    let mut running = Running::start(&args);
    wait_for(Path::new(&format!("{folder}/runs/L2_layers2_width16_rate0.01.json")), &mut running);
    running.signal("TERM");
    let ended = running.output();
    let err = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(143), "{err}");
    assert!(err.contains("the finished ones are kept"), "{err}");
    // On a machine that is busy the report may take too long; then that is said.
    let report = Path::new(&folder).join("report.md").exists();
    assert_eq!(report, err.contains("the report is written"), "{err}");
}

#[test]
fn a_signal_that_is_ignored_from_the_start_stays_ignored() {
    let folder = Folder::in_memory();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let checkpoint = format!("{file}.checkpoint");
    let args = fit(&data, &file, &["--steps", "400", "--checkpoint-every", "0"]);
    let mut shell = Command::new("sh");
    shell.args(["-c", "trap '' HUP; exec \"$0\" \"$@\""]).arg(program()).args(args);
    let mut running = Running::of(&mut shell);
    wait_for(Path::new(&checkpoint), &mut running);
    running.signal("HUP");
    let ended = running.output();
    assert_eq!(ended.status.code(), Some(0), "{}", String::from_utf8_lossy(&ended.stderr));
    assert!(is_whole(Path::new(&file)));
}
