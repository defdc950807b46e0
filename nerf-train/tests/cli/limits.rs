//! Limits in seconds and in steps, also of runs that are taken up again.

use crate::made::Folder;
use crate::{command, fails, fit, ok, ran, write_picture};
use std::path::Path;

#[test]
fn huge_limits_of_time_are_no_limit() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    ok(fit(&data, &file, &["--steps", "2", "--max-seconds", "1e300"]));
}

#[test]
fn a_run_by_time_ends_in_time() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let start = std::time::Instant::now();
    ok(fit(&data, &file, &["--max-seconds", "2"]));
    assert!(start.elapsed().as_secs_f64() < 4.0, "{:?}", start.elapsed());
    assert!(Path::new(&file).is_file());
}

#[test]
fn a_limit_that_leaves_no_time_to_train_is_refused_and_leaves_nothing() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let words =
        ["--max-seconds 0.001: expected time for at least 20 steps", "reading", "ask for --max-seconds"];
    fails(fit(&data, &file, &["--max-seconds", "0.001"]), &words);
    let report = folder.path("report");
    let args = ["--preset", "small", "--max-seconds", "0.001", "--report", &report];
    fails([&["fit", &data, "-o", &file, "-q"], &args[..]].concat(), &words);
    let photo = folder.path("photo.png");
    write_picture(image::RgbImage::from_pixel(12, 8, image::Rgb([9, 90, 200])), &photo);
    fails(["image", "fit", &photo, "-o", &file, "-q", "--max-seconds", "0.001"], &words);
    assert!(!folder.names().iter().any(|name| name.starts_with("a.nerf")), "{:?}", folder.names());
    // Few steps that were asked for are made.
    ok(fit(&data, &file, &["--steps", "1", "--max-seconds", "60"]));
}

#[test]
fn seconds_of_a_run_that_is_taken_up_are_the_commands_own() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let steps = |more: &[&str]| {
        let said = ok(fit(&data, &file, &[&["--max-seconds", "1.5", "--json"], more].concat()));
        let said: serde_json::Value = serde_json::from_str(&said).expect("one object");
        said["steps"].as_u64().expect("a count")
    };
    let (first, both) = (steps(&[]), steps(&["--resume"]));
    assert!(both > first + first / 10, "{first} and {both} steps");
    let before = std::fs::read(&file).expect("a blob");
    fails(
        fit(&data, &file, &["--max-seconds", "0.001", "--resume"]),
        &["at least 1 step", "found time for 0"],
    );
    assert!(std::fs::read(&file).expect("a blob") == before);
}

#[test]
fn a_run_that_is_taken_up_with_all_steps_done_says_so() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let args = |steps: &'static str| -> Vec<&str> {
        fit(&data, &file, &["--steps", steps, "--resume"]).into_iter().filter(|arg| *arg != "-q").collect()
    };
    ok(fit(&data, &file, &["--steps", "5"]));
    let line = "nothing was done: the checkpoint has all 5 steps";
    let again = ran(&mut command(args("5")));
    assert!(again.code == Some(0) && again.err.contains(line), "{}", again.err);
    let on = ran(&mut command(args("6")));
    assert!(on.code == Some(0) && !on.err.contains("nothing was done"), "{}", on.err);
}
