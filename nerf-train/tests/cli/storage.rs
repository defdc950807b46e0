//! Disks that fill up or turn read-only during a run, limits of file sizes, and two processes with one output.

use crate::made::{Folder, names};
use crate::program::program;
use crate::stopping::{Running, wait_for};
use crate::tools;
use crate::{blob, command, fails, fit, ok, ran};
use nerf_train::train::checkpoint::Checkpoint;
use std::path::Path;
use std::process::Command;

/// A mounted file system of its own; unmounted when dropped.
struct Small(String);

impl Small {
    /// One of `size` bytes, as tmpfs writes them; `None` for a user who may not mount, which leaves the test out. What a
    /// limit of file sizes below shows is shown to every user, a disk that is full or read-only is not.
    fn mount(folder: &Folder, size: &str) -> Option<Self> {
        let place = folder.path("small");
        std::fs::create_dir(&place).expect("a folder");
        if mount(&["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs", &place]) {
            return Some(Self(place));
        }
        let _ = tools::all_here(&["mount"]) && tools::there_is("right to mount", false);
        None
    }

    fn remount(&self, options: &str) -> bool {
        mount(&["-o", &format!("remount,{options}"), &self.0])
    }

    fn path(&self, name: &str) -> String {
        format!("{}/{name}", self.0)
    }

    fn names(&self) -> Vec<String> {
        names(Path::new(&self.0))
    }
}

impl Drop for Small {
    fn drop(&mut self) {
        // Lazily: what is still open there must not keep it.
        let _ = Command::new("umount").args(["-l", &self.0]).status();
    }
}

fn mount(args: &[&str]) -> bool {
    Command::new("mount").args(args).output().is_ok_and(|output| output.status.success())
}

fn read(path: &str) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The step of a checkpoint, which must be whole.
fn step_of(checkpoint: &str) -> u32 {
    Checkpoint::read(Path::new(checkpoint)).expect("a whole checkpoint").state.progressed.step
}

#[test]
fn a_disk_that_fills_up_leaves_nothing_half_written() {
    let folder = Folder::in_memory();
    let data = folder.npz("data.npz");
    let Some(small) = Small::mount(&folder, "64k") else { return };
    // Checkpoint and blob are both larger than the disk.
    let file = small.path("a.nerf");
    let wide = ["fit", &data, "-o", &file, "-q", "--width", "128", "--depth", "4", "--steps", "3"];
    let err = fails([&wide[..], &["--rays", "16"]].concat(), &["a.nerf:", "No space left"]);
    assert_eq!(warnings(&err), 1, "{err}");
    assert_eq!(small.names(), [""; 0]);
    // Pictures that no longer fit.
    let (_, blob) = blob();
    let picture = small.path("a.png");
    std::fs::write(small.path("filling"), vec![1; 60 << 10]).expect("room for this");
    let args = ["render", blob, "-q", "-o", &picture, "--width", "200"];
    fails(args, &["a.png", "No space left"]);
    assert_eq!(small.names(), ["filling"]);
    // So every kind of export.
    for file in ["a.ply", "a.obj", "a.glb", "a.npz"] {
        let args = ["export", blob, "-q", "-o", &small.path(file), "--resolution", "24"];
        fails(args, &[file, "No space left"]);
        assert_eq!(small.names(), ["filling"]);
    }
}

/// How often a run said that it goes on without a checkpoint.
fn warnings(err: &str) -> usize {
    err.lines().filter(|line| line.contains("checkpoint") && line.contains("goes on")).count()
}

/// A run of 40 steps with a checkpoint and a validation after every one.
const STEPS: &[&str] = &["--steps", "40", "--validate-every", "1", "--checkpoint-every", "0"];

/// Its blob, and the size of its last checkpoint.
fn undisturbed(folder: &Folder, data: &str) -> (Vec<u8>, u64) {
    let file = folder.path("calm.nerf");
    ok(fit(data, &file, STEPS));
    let length = std::fs::metadata(format!("{file}.checkpoint")).expect("a checkpoint").len();
    (read(&file), length)
}

#[test]
fn a_disk_that_fills_up_in_training_leaves_the_last_checkpoint_and_the_run_goes_on() {
    let folder = Folder::in_memory();
    let data = folder.npz("data.npz");
    let (expected, length) = undisturbed(&folder, &data);
    // Room for one checkpoint, and not for the next one beside it; the blob still fits.
    let Some(small) = Small::mount(&folder, &(length * 3 / 2).to_string()) else { return };
    let (file, checkpoint) = (small.path("a.nerf"), small.path("a.nerf.checkpoint"));
    let through = ran(&mut command(fit(&data, &file, STEPS)));
    assert_eq!(through.code, Some(0), "{}", through.err);
    assert!(through.err.contains("a.nerf.checkpoint: No space left"), "{}", through.err);
    assert_eq!(warnings(&through.err), 1, "{}", through.err);
    assert_eq!(small.names(), ["a.nerf", "a.nerf.checkpoint"]);
    assert!(read(&file) == expected);
    let step = step_of(&checkpoint);
    assert!(step > 0 && step < 40, "{step}");
    // Elsewhere, or here when there is room.
    let elsewhere = folder.path("b.nerf");
    std::fs::copy(&checkpoint, format!("{elsewhere}.checkpoint")).expect("copied");
    assert!(small.remount("size=1m"));
    for file in [&elsewhere, &file] {
        ok([&fit(&data, file, STEPS)[..], &["--resume"]].concat());
        assert!(read(file) == expected, "{file}, from step {step}");
    }
}

#[test]
fn a_disk_that_turns_read_only_leaves_the_last_checkpoint_to_go_on_from() {
    let folder = Folder::in_memory();
    let data = folder.npz("data.npz");
    let Some(small) = Small::mount(&folder, "1m") else { return };
    let (file, checkpoint) = (small.path("a.nerf"), small.path("a.nerf.checkpoint"));
    let long = fit(&data, &file, &["--steps", "3000", "--validate-every", "3000", "--checkpoint-every", "0"]);
    let mut running = Running::start(&long);
    wait_for(Path::new(&checkpoint), &mut running);
    // Refused while a file is open for writing.
    let mut refused = 0;
    while !small.remount("ro") {
        refused += 1;
        assert!(running.is_running() && refused < 5000, "refused {refused} times");
    }
    // It goes on, and there is no place for its blob in the end.
    let output = running.output();
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{err}");
    assert!(err.contains("a.nerf.checkpoint: Read-only file system") && warnings(&err) == 1, "{err}");
    assert!(
        err.lines().any(|line| line.starts_with("error:") && line.contains("a.nerf: Read-only")),
        "{err}"
    );
    assert_eq!(small.names(), ["a.nerf.checkpoint"]);
    let step = step_of(&checkpoint);
    // A run that begins there is told before it reads its data.
    fails(fit("nowhere.npz", &file, &["--resume"]), &["Read-only file system"]);
    let (_, blob) = blob();
    fails(["render", blob, "-o", &small.path("a.png"), "--width", "4"], &["Read-only file system"]);
    assert!(small.remount("rw"));
    ok(fit(&data, &file, &["--steps", "1", "--resume"]));
    assert!(crate::has(&ok(["inspect", &file]), "steps", &step.to_string()));
}

/// The command under a limit of file sizes of so many KiB.
fn limited(kilobytes: u64, args: &[&str]) -> Command {
    let program = program();
    let mut shell = Command::new("bash");
    shell.args(["-c", &format!("ulimit -f {kilobytes}; exec \"$0\" \"$@\"")]).arg(program).args(args);
    shell
}

#[test]
fn a_short_write_leaves_the_last_checkpoint_and_the_run_goes_on() {
    let folder = Folder::in_memory();
    let data = folder.npz("data.npz");
    let (expected, length) = undisturbed(&folder, &data);
    let (file, checkpoint) = (folder.path("a.nerf"), folder.path("a.nerf.checkpoint"));
    // Each validation adds a point to the curve in the checkpoint: the last ones are cut short.
    let args = fit(&data, &file, STEPS);
    let output = ran(&mut limited((length - 1) / 1024, &args));
    assert_eq!(output.code, Some(0), "{}", output.err);
    assert!(output.err.contains("cannot write the file"), "{}", output.err);
    assert!(output.err.contains("a.nerf.checkpoint: File too large"), "{}", output.err);
    assert_eq!(warnings(&output.err), 1, "{}", output.err);
    assert_eq!(
        folder.names(),
        ["a.nerf", "a.nerf.checkpoint", "calm.nerf", "calm.nerf.checkpoint", "data.npz"]
    );
    assert!(read(&file) == expected);
    let step = step_of(&checkpoint);
    assert!(step > 0 && step < 40, "{step}");
    ok([&args[..], &["--resume"]].concat());
    assert!(read(&file) == expected, "from step {step}");
    // Of a blob and of a picture nothing is left.
    let (_, blob) = self::blob();
    for (name, args) in [
        ("b.png", vec!["render", blob, "-q", "--width", "200", "-o"]),
        ("b.gif", vec!["render", blob, "-q", "--width", "64", "--orbit", "4", "-o"]),
    ] {
        let path = folder.path(name);
        let output = ran(&mut limited(1, &[&args[..], &[&path]].concat()));
        assert!(output.code == Some(1) && output.err.contains(name), "{}", output.err);
        assert!(output.err.contains("File too large") && !Path::new(&path).exists(), "{}", output.err);
    }
    assert!(!folder.names().iter().any(|name| name.ends_with(".tmp")), "{:?}", folder.names());
}

/// Both at the same time, to their ends.
fn race(commands: [Vec<&str>; 2]) {
    let both = commands.each_ref().map(|args| Running::start(args));
    for (running, args) in both.into_iter().zip(&commands) {
        let output = running.output();
        let err = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{args:?}: {err}");
    }
}

#[test]
fn of_two_runs_with_one_output_one_wins_whole() {
    let folder = Folder::in_memory();
    let data = folder.npz("data.npz");
    let seeds = ["5", "6"];
    let run = |file: &'static str, seed: usize| {
        let more = ["--steps", "10", "--checkpoint-every", "0", "--seed", seeds[seed], "--restart"];
        (folder.path(file), more)
    };
    let alone = [0, 1].map(|seed| {
        let (file, more) = run("alone.nerf", seed);
        ok(fit(&data, &file, &more));
        read(&file)
    });
    assert!(alone[0] != alone[1]);
    let (file, _) = run("both.nerf", 0);
    let (mut blobs, mut checkpoints) = ([0; 2], [0; 2]);
    for _ in 0..5 {
        let of = |seed| fit(&data, &file, &run("both.nerf", seed).1).into_iter().map(str::to_owned).collect();
        let owned: [Vec<String>; 2] = [of(0), of(1)];
        race(owned.each_ref().map(|args| args.iter().map(String::as_str).collect()));
        let found = read(&file);
        blobs[alone.iter().position(|blob| *blob == found).expect("one of the two, whole")] += 1;
        // They share the checkpoint's name too, and no run goes on from the other's.
        let kept = Checkpoint::read(Path::new(&format!("{file}.checkpoint"))).expect("a whole checkpoint");
        let owner = usize::from(kept.config.contains("\"seed\":6"));
        checkpoints[owner] += 1;
        let resume =
            |seed: usize| [&fit(&data, &file, &run("both.nerf", seed).1[..6])[..], &["--resume"]].concat();
        fails(resume(1 - owner), &["both.nerf.checkpoint", "seed"]);
        assert!(read(&file) == found);
        ok(resume(owner));
        assert!(read(&file) == alone[owner]);
    }
    println!("blobs {blobs:?}, checkpoints {checkpoints:?}");
    let left = ["alone.nerf", "alone.nerf.checkpoint", "both.nerf", "both.nerf.checkpoint", "data.npz"];
    assert_eq!(folder.names(), left);
}

#[test]
fn of_two_pictures_with_one_name_one_wins_whole() {
    let (_, blob) = blob();
    let folder = Folder::in_memory();
    let render =
        |path: &str, width| ["render", blob, "-q", "-o", path, "--width", width].map(str::to_owned).to_vec();
    let path = folder.path("both.png");
    let alone = ["40", "41"].map(|width| {
        ok(render(&path, width));
        read(&path)
    });
    for _ in 0..5 {
        let commands = ["40", "41"].map(|width| render(&path, width));
        race(commands.each_ref().map(|args| args.iter().map(String::as_str).collect()));
        assert!(alone.contains(&read(&path)));
        assert_eq!(folder.names(), ["both.png"]);
    }
}
