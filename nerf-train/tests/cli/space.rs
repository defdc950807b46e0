//! `--space`: scenes that end at a box, and unbounded scenes.

use crate::made::{Folder, scene};
use crate::{fails, fit, fit_grid, json, ok, run};
use nerf_core::blob::Blob;

/// The built-in scene in front of something that no border says the colour of.
fn photographs(folder: &Folder) -> String {
    let mut dataset = scene();
    for view in dataset.train.iter_mut().chain(&mut dataset.val) {
        for (i, pixel) in view.pixels.iter_mut().enumerate() {
            if pixel[3] == 0 {
                *pixel = [(i * 7 % 200) as u8, (i * 13 % 250) as u8, 90, 255];
            }
        }
    }
    folder.npz_of("photographs.npz", &dataset, |_| {})
}

/// The power of a file's contraction.
fn power(file: &str) -> Option<u8> {
    let bytes = std::fs::read(file).expect("a blob");
    let blob = Blob::open(&bytes).expect("a blob");
    blob.scene().expect("a scene").contraction().map(|contraction| contraction.power())
}

#[test]
fn photographs_have_unbounded_space_unless_told_otherwise() {
    let folder = Folder::new();
    let (data, file) = (photographs(&folder), folder.path("a.nerf"));
    let plain = folder.npz("plain.npz");
    let unbounded = "unbounded space, contracted around what the cameras look at";
    for (data, preset, more, expected, words) in [
        (&data, "grid", &[][..], Some(1), [unbounded, "do not say what is background"]),
        (&data, "grid", &["--space", "box"], None, ["space ends at a box", "as --space says"]),
        (&data, "grid", &["--box", "-2,-2,-2,2,2,2"], None, ["space ends at a box", "which is given"]),
        (&data, "grid", &["--dense"], None, ["space ends at a box", "skips empty space"]),
        (&data, "small", &[], None, ["space ends at a box", "a contraction needs a learned grid"]),
        (&plain, "grid", &[], None, ["space ends at a box", "the pictures say what is background"]),
        (&plain, "grid", &["--space", "contracted"], Some(1), [unbounded, "as --space says"]),
    ] {
        let base =
            ["fit", data, "-o", &file, "--preset", preset, "--steps", "2", "--rays", "64", "--restart"];
        let small: &[&str] = if preset == "grid" { &["--table", "8"] } else { &["--width", "16"] };
        let ran = run([&base[..], small, more].concat());
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        assert_eq!(power(&file), expected, "{preset} {more:?}");
        for word in words {
            assert!(ran.err.contains(word), "{preset} {more:?}: expected `{word}` in {}", ran.err);
        }
        assert_eq!(ok(["inspect", &file]).contains("unbounded"), expected.is_some());
    }
}

#[test]
fn an_unbounded_scene_is_fitted_rendered_and_shown() {
    let folder = Folder::new();
    let (data, file, report) = (photographs(&folder), folder.path("a.nerf"), folder.path("report"));
    ok(fit_grid(&data, &file, &["--steps", "60", "--near", "0.3", "--far", "50", "--report", &report]));
    assert_eq!(power(&file), Some(1));
    let bytes = std::fs::read(&file).expect("a blob");
    let facts = Blob::open(&bytes).expect("a blob").scene().cloned().expect("a scene");
    assert_eq!((facts.near, facts.far), (0.3, 50.0));
    assert!(json(format!("{report}/summary.json")).is_object());
    ok(["eval", &file, &data, "-q"]);
    let picture = folder.path("picture");
    ok(["render", &file, "-q", "-o", &picture, "--width", "12", "--outputs", "rgb,z-depth"]);
    let shown = folder.path("show");
    ok(["show", &data, "-o", &shown, "-q", "--preset", "grid", "--rays", "12"]);
    let summary = json(format!("{shown}/summary.json"));
    let (live, near) = (&summary["live_samples_shown"], summary["near_world_units"].as_f64());
    assert!(live.as_u64() > Some(0), "{summary}");
    // What is drawn ends at the cameras' surroundings.
    let far = summary["far_world_units"].as_f64().zip(near).map(|(far, near)| far / near);
    assert!(far.is_some_and(|times| (30.0..=50.0).contains(&times)), "{summary}");
}

#[test]
fn contractions_that_cannot_be_are_refused_by_name() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let contracted = ["--space", "contracted"];
    fails(fit(&data, &file, &contracted), &["sampling.contraction", "none without a learned grid"]);
    let boxed = [&contracted[..], &["--box", "-2,-2,-2,2,2,2"]].concat();
    fails(fit_grid(&data, &file, &boxed), &["sampling.contraction", "none beside a scene box"]);
    let dense = [&contracted[..], &["--dense"]].concat();
    fails(fit_grid(&data, &file, &dense), &["sampling.contraction", "none where occupancy.skip is false"]);
    fails(fit_grid(&data, &file, &["--space", "sphere"]), &["--space", "auto, box, contracted"]);
    for (text, words) in [
        ("[sampling]\ncontraction = 3", ["sampling.contraction", "1, 2 or 4"]),
        ("[sampling]\ncontraction = 4\nsteps_across = 820", ["sampling.steps_across", "2 to 819"]),
    ] {
        let settings = folder.file("run.toml", text);
        fails(["fit", &data, "-o", &file, "--config", &settings], &words);
    }
}
