//! Ctrl-C, kill −9 and going on.

use crate::made::{Folder, scene};
use crate::{command, fails, fit, ok};
use nerf_train::train::checkpoint::Checkpoint;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

fn start(args: &[&str]) -> Child {
    command(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the command starts")
}

fn wait_for(path: &Path, child: &mut Child) {
    let start = Instant::now();
    while !path.exists() {
        assert!(child.try_wait().expect("a status").is_none(), "it ended before it wrote {}", path.display());
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
    let mut child = start(&args);
    wait_for(Path::new(&checkpoint), &mut child);
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill");
    assert!(sent.success());
    let output = child.wait_with_output().expect("it ends");
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{err}");
    assert!(err.contains("--resume") && err.contains(&checkpoint) && err.contains("step"), "{err}");
    assert_eq!(folder.names(), ["a.nerf.checkpoint", "data.npz"], "no half-written blob");
    let step = Checkpoint::read(Path::new(&checkpoint)).expect("whole").progressed.step;
    assert!(step > 0 && err.contains(&format!("after step {step};")), "{step}: {err}");
    // As it says; a limit on steps that is reached ends the run with its blob.
    ok(fit(&data, &file, &["--steps", "1", "--resume"]));
    assert!(ok(["inspect", &file]).contains(&format!("{step} steps")));
}

#[test]
fn ctrl_c_leaves_nothing_of_a_film() {
    let (_, file) = crate::blob();
    let folder = Folder::new();
    let gif = folder.path("orbit.gif");
    let mut child = start(&["render", file, "-o", &gif, "--orbit", "100000", "--width", "16"]);
    // Its temporary shows that it is at work.
    let begun = Instant::now();
    while folder.names().is_empty() && begun.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(5));
    }
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill");
    assert!(sent.success() && child.try_wait().expect("a status").is_none());
    let output = child.wait_with_output().expect("it ends");
    let err = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(130) && err.contains("of 100000 views"), "{err}");
    assert_eq!(folder.names(), [""; 0]);
}

#[test]
fn kill_9_at_any_moment_and_resume_gives_the_undisturbed_blob() {
    let folder = Folder::new();
    let data = folder.npz("data.npz");
    let (calm, killed) = (folder.path("calm.nerf"), folder.path("killed.nerf"));
    let checkpoint = folder.path("killed.nerf.checkpoint");
    let steps = ["--steps", "250"];
    ok(fit(&data, &calm, &steps));
    let mut resumes = 0;
    for wait in [3u64, 31, 57, 11, 83, 23, 41, 67] {
        let mut args = fit(&data, &killed, &steps);
        args.extend(["--checkpoint-every", "0"]);
        if Path::new(&checkpoint).exists() {
            args.push("--resume");
            resumes += 1;
        }
        let mut child = start(&args);
        // Some before the first checkpoint, most while one is being written.
        while wait > 20 && !Path::new(&checkpoint).exists() && child.try_wait().expect("a status").is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_millis(wait));
        child.kill().expect("SIGKILL");
        child.wait().expect("it ends");
        if Path::new(&checkpoint).exists() {
            Checkpoint::read(Path::new(&checkpoint)).expect("a whole checkpoint");
        }
    }
    assert!(resumes > 2, "killed before the first checkpoint all but {resumes} times");
    ok([&fit(&data, &killed, &steps)[..], &["--resume"]].concat());
    assert!(std::fs::read(calm).expect("a blob") == std::fs::read(killed).expect("a blob"));
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
    std::fs::write(&checkpoint, &before.0[..before.0.len() / 2]).expect("written");
    fails(fit(&data, &file, &["--steps", "5", "--resume"]), &["a.nerf.checkpoint", "damaged"]);
    std::fs::write(&checkpoint, b"something else").expect("written");
    fails(fit(&data, &file, &["--steps", "5", "--resume"]), &["a.nerf.checkpoint"]);
    assert!(before.1 == std::fs::read(&file).expect("a blob"));
}
