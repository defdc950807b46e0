//! Ctrl-C, kill −9 and going on; signals at any moment of any command are in `signals.rs`.

use crate::made::{Folder, scene};
use crate::{fails, fit, fit_grid, interruptible, ok};
use nerf_core::blob::Blob;
use nerf_core::sampling::{Purpose, uniform};
use nerf_train::train::checkpoint::Checkpoint;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::time::{Duration, Instant};

/// A command at work; killed when dropped, so that a test that fails leaves nothing running.
pub struct Running(Option<Child>);

impl Running {
    pub fn start(args: &[&str]) -> Self {
        Self::of(&mut interruptible(args))
    }

    pub fn of(command: &mut Command) -> Self {
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        Self(Some(child.expect("the command starts")))
    }

    fn child(&mut self) -> &mut Child {
        self.0.as_mut().expect("taken only by `output`")
    }

    pub fn is_running(&mut self) -> bool {
        self.child().try_wait().expect("a status").is_none()
    }

    pub fn signal(&mut self, name: &str) {
        // By the shell, which is everywhere: the program `kill` is not.
        let script = format!("kill -{name} {}", self.child().id());
        assert!(Command::new("sh").args(["-c", &script]).status().expect("sh").success());
    }

    fn interrupt(&mut self) {
        self.signal("INT");
    }

    fn kill(&mut self) {
        self.child().kill().expect("SIGKILL");
    }

    fn wait(&mut self) -> ExitStatus {
        self.child().wait().expect("it ends")
    }

    /// What it leaves when it has ended.
    pub fn output(mut self) -> Output {
        self.0.take().expect("taken only here").wait_with_output().expect("it ends")
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

pub fn wait_for(path: &Path, running: &mut Running) {
    let start = Instant::now();
    while !path.exists() {
        assert!(running.is_running(), "it ended before it wrote {}", path.display());
        assert!(start.elapsed() < Duration::from_secs(60), "no {} after a minute", path.display());
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn ctrl_c_leaves_a_checkpoint_says_how_to_go_on_and_ends_with_130() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let checkpoint = folder.path("a.nerf.checkpoint");
    let args = fit(&data, &file, &["--steps", "1000000", "--checkpoint-every", "0"]);
    let mut running = Running::start(&args);
    wait_for(Path::new(&checkpoint), &mut running);
    running.interrupt();
    let output = running.output();
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{err}");
    assert!(err.contains("--resume") && err.contains(&checkpoint) && err.contains("step"), "{err}");
    assert_eq!(folder.names(), ["a.nerf.checkpoint", "data.npz"], "no half-written blob");
    let step = Checkpoint::read(Path::new(&checkpoint)).expect("whole").state.progressed.step;
    assert!(step > 0 && err.contains(&format!("after step {step};")), "{step}: {err}");
    // As it says; a limit on steps that is reached ends the run with its blob.
    ok(fit(&data, &file, &["--steps", "1", "--resume"]));
    assert!(crate::has(&ok(["inspect", &file]), "steps", &step.to_string()));
}

#[test]
fn ctrl_c_leaves_nothing_of_a_film() {
    let (_, file) = crate::blob();
    let folder = Folder::new();
    let gif = folder.path("orbit.gif");
    let mut running = Running::start(&["render", file, "-o", &gif, "--orbit", "100000", "--width", "16"]);
    // A few bytes are a probe of whether the disk can be written; more are frames, and by then views are counted.
    let size = || -> u64 {
        let entries = std::fs::read_dir(Path::new(&gif).parent().expect("a folder")).expect("a folder");
        entries.filter_map(|entry| entry.ok()?.metadata().ok()).map(|file| file.len()).sum()
    };
    let begun = Instant::now();
    while size() < 1000 {
        assert!(running.is_running() && begun.elapsed() < Duration::from_secs(60), "no frame after a minute");
        std::thread::sleep(Duration::from_millis(5));
    }
    running.interrupt();
    let output = running.output();
    let err = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(130) && err.contains("of 100000 views; no film"), "{err}");
    assert_eq!(folder.names(), [""; 0]);
}

#[test]
fn a_long_run_has_more_entries_and_steps_also_when_a_short_one_resumes_it() {
    let folder = Folder::in_memory();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let checkpoint = folder.path("a.nerf.checkpoint");
    let fit = |more: &[&str]| -> Vec<String> {
        [&["fit", &data, "-o", &file], more].concat().into_iter().map(str::to_owned).collect()
    };
    // What a long run that is interrupted says.
    let long = |more: &[&str]| {
        let _ = std::fs::remove_file(&checkpoint);
        let run = ["--steps", "15000", "--checkpoint-every", "0.1"];
        let mut running = Running::of(&mut interruptible(fit(&[&run, more].concat())));
        wait_for(Path::new(&checkpoint), &mut running);
        running.interrupt();
        let output = running.output();
        assert_eq!(output.status.code(), Some(130));
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    // What is set stays, and the grid follows from a limit on bytes.
    for (more, expected) in [
        (["--set", "network.grid.storage=\"f16\""], "2^17 entries a level as f16, 200 steps"),
        (["--set", "network.grid.log2_entries=16"], "2^16 entries a level as f16, 200 steps"),
        (["--steps-across", "150"], "2^17 entries a level as int8, 150 steps"),
        (["--max-bytes", "2m"], "2^16 entries a level as f16, 200 steps"),
        (["--threads", "2"], "2^17 entries a level as int8, 200 steps"),
    ] {
        let said = long(&more);
        assert!(said.contains(expected), "{more:?}: {said}");
        ok(fit(&[&["-q", "--steps", "1", "--resume"][..], &more].concat()));
    }
    let entries = || {
        let bytes = std::fs::read(&file).expect("a blob");
        let blob = Blob::open(&bytes).expect("a blob");
        let is_int8 = blob.tables().expect("tables").scales().is_some();
        (blob.architecture().position.grid().expect("a grid").log2_entries, is_int8)
    };
    assert_eq!(entries(), (17, true));
    ok(fit(&["-q", "--steps", "2", "--restart", "--checkpoint-every", "0"]));
    assert_eq!(entries(), (16, false));
}

#[test]
fn killed_at_20_random_moments_and_resumed_a_run_gives_the_undisturbed_blob() {
    killed_and_resumed(20, fit);
}

#[test]
fn a_grid_killed_at_8_random_moments_and_resumed_gives_the_undisturbed_blob() {
    killed_and_resumed(8, fit_grid);
}

/// The arguments of a fit of data to a file.
type FitArgs = for<'a> fn(&'a str, &'a str, &[&'a str]) -> Vec<&'a str>;

/// Kills `kills` runs and resumes each.
fn killed_and_resumed(kills: usize, fit: FitArgs) {
    let folder = Folder::in_memory();
    let data = folder.npz("data.npz");
    let (calm, file) = (folder.path("calm.nerf"), folder.path("killed.nerf"));
    let checkpoint = folder.path("killed.nerf.checkpoint");
    // A checkpoint after every step.
    let run = ["--steps", "200", "--validate-every", "10", "--checkpoint-every", "0"];
    let begun = Instant::now();
    ok(fit(&data, &calm, &run));
    let whole = begun.elapsed();
    let expected = std::fs::read(&calm).expect("a blob");
    let args = fit(&data, &file, &run);
    let at = |name: &str| Path::new(name).exists();
    let reached = || {
        let read = || Checkpoint::read(Path::new(&checkpoint)).expect("a whole checkpoint");
        if at(&checkpoint) { read().state.progressed.step } else { 0 }
    };
    let temporaries = || folder.names().iter().filter(|name| name.ends_with(".tmp")).count();

    let (mut attempt, mut ended, mut moments) = (0, 0, Vec::new());
    while moments.len() < kills {
        attempt += 1;
        assert!(attempt < 10 * kills as u64, "{ended} runs ended before they were killed: {moments:?}");
        let (before, left) = (reached(), temporaries());
        let resume: &[&str] = if at(&checkpoint) { &["--resume"] } else { &[] };
        let mut running = Running::start(&[&args[..], resume].concat());
        // A run that was killed after its last step ends undisturbed.
        let through = before == 200;
        if through {
            running.wait();
        }
        // Half at any moment, a quarter after a step of their own, a quarter after the last, where it is exported.
        let (from, longest) = [(200, 0.1), (0, 0.8), (before + 1, 0.4), (0, 0.8)][attempt as usize % 4];
        while !through && reached() < from && running.is_running() {
            std::thread::sleep(Duration::from_millis(1));
        }
        let share = longest * uniform(1, Purpose::Jitter, attempt, 0);
        std::thread::sleep(if through { Duration::ZERO } else { whole.mul_f32(share) });
        running.kill();
        let code = running.wait().code();
        assert!(matches!(code, None | Some(0)), "neither killed nor through: {code:?}");
        if code == Some(0) {
            // The next begins anew.
            ended += usize::from(!through);
            assert!(std::fs::read(&file).expect("a blob") == expected);
            std::fs::remove_file(&file).expect("removed");
            std::fs::remove_file(&checkpoint).expect("removed");
            continue;
        }
        let (after, writing) = (reached(), temporaries() > left);
        let whole_blob = at(&file).then(|| std::fs::read(&file).expect("a blob"));
        assert!(whole_blob.is_none_or(|blob| blob == expected), "half a blob");
        moments.push((before, after, writing));
    }
    println!("{ended} ended before; steps before, steps after, writing: {moments:?}");
    let under_way = moments.iter().filter(|&&(before, after, _)| before < after).count();
    assert!(under_way >= kills / 5, "only {under_way} were killed between their first and their last step");
    ok([&args[..], if at(&checkpoint) { &["--resume"] } else { &[] }].concat());
    assert!(std::fs::read(&file).expect("a blob") == expected);
    Checkpoint::read(Path::new(&checkpoint)).expect("whole");
    // What a killed process leaves behind besides is hidden.
    let names = folder.names();
    let visible: Vec<&String> = names.iter().filter(|name| !name.starts_with(".nerf-")).collect();
    let expected = ["calm.nerf", "calm.nerf.checkpoint", "data.npz", "killed.nerf", "killed.nerf.checkpoint"];
    assert_eq!(visible, expected);
}

#[test]
fn resuming_another_run_or_a_damaged_checkpoint_is_refused() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let checkpoint = folder.path("a.nerf.checkpoint");
    fails(fit(&data, &file, &["--steps", "5", "--resume"]), &["a.nerf.checkpoint"]);
    ok(fit(&data, &file, &["--steps", "5"]));
    let before = (std::fs::read(&checkpoint).expect("whole"), std::fs::read(&file).expect("a blob"));
    let intact = || {
        assert!(before.0 == std::fs::read(&checkpoint).expect("a checkpoint"));
        assert!(before.1 == std::fs::read(&file).expect("a blob"));
    };
    let words = ["a.nerf.checkpoint", "optimiser.rate"];
    fails(fit(&data, &file, &["--steps", "5", "--resume", "--rate", "0.001"]), &words);
    intact();
    fails(fit(&data, &file, &["--steps", "5", "--resume", "--seed", "1"]), &["a.nerf.checkpoint", "seed"]);
    intact();
    let blender = folder.blender("other");
    fails(fit(&blender, &file, &["--steps", "5", "--resume"]), &["a.nerf.checkpoint", "data"]);
    intact();
    // Another scene under the same name.
    let mut other = scene();
    other.train.reverse();
    std::fs::create_dir(folder.path("sub")).expect("a folder");
    let twin = folder.npz_with("sub/data.npz", |arrays| arrays[0].data.reverse());
    fails(fit(&twin, &file, &["--steps", "5", "--resume"]), &["a.nerf.checkpoint", "data"]);
    intact();
    // Damage is named with what to do, and left for whoever can mend it.
    let half = &before.0[..before.0.len() / 2];
    for (damaged, word) in [(half, "damaged"), (b"something else", "another kind"), (b"", "another kind")] {
        std::fs::write(&checkpoint, damaged).expect("written");
        let words = ["a.nerf.checkpoint", word, "--restart in place of --resume begins anew"];
        fails(fit(&data, &file, &["--steps", "5", "--resume"]), &words);
        assert!(std::fs::read(&checkpoint).expect("left") == damaged);
    }
    assert!(before.1 == std::fs::read(&file).expect("a blob"));
}
