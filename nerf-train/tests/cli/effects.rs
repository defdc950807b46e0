//! Effects on the command line.

use crate::made::Folder;
use crate::{blob, fails, ok};
use nerf_train::data::pictures::rgb::Picture;

const VIEW: [&str; 4] = ["--width", "24", "--focal", "30"];

/// The picture of the fitted blob with these flags.
fn seen(folder: &Folder, name: &str, more: &[&str]) -> Picture {
    let file = folder.path(&format!("{name}.png"));
    ok([&["render", blob().1.as_str(), "-o", &file][..], &VIEW, more].concat());
    Picture::read(&file).expect("a picture")
}

#[test]
fn an_effect_is_seen_and_what_asks_for_nothing_is_not() {
    let folder = Folder::new();
    let plain = seen(&folder, "plain", &[]);
    for (name, flags) in [
        ("one", &["--antialias", "1"][..]),
        ("pinhole", &["--aperture", "0", "--focus", "4"]),
        ("no tone", &["--exposure", "0", "--tone-map", "none"]),
    ] {
        assert_eq!(seen(&folder, name, flags).rgb, plain.rgb, "{name}");
    }
    for (name, flags) in [
        ("antialias", &["--antialias", "4"][..]),
        ("jitter", &["--jitter", "1"]),
        ("lens", &["--aperture", "0.5", "--focus", "1", "--antialias", "8"]),
        ("dark", &["--exposure", "-1.5"]),
        ("film", &["--tone-map", "filmic"]),
        ("linear", &["--linear"]),
    ] {
        assert_ne!(seen(&folder, name, flags).rgb, plain.rgb, "{name}");
    }
    let sum = |picture: &Picture| picture.rgb.iter().flatten().sum::<f32>();
    let (darker, lighter) = (["--exposure", "-1"], ["--exposure", "1"]);
    assert!(sum(&seen(&folder, "darker", &darker)) < sum(&plain));
    assert!(sum(&seen(&folder, "lighter", &lighter)) > sum(&plain));
}

#[test]
fn an_evaluation_and_a_study_take_no_jitter() {
    let (folder, file) = blob();
    for command in ["eval", "study"] {
        fails([command, file, &folder.path("scene.npz"), "--jitter", "1"], &["--jitter"]);
    }
}

#[test]
fn explain_names_each_effect_that_is_on() {
    let said =
        ok(["explain", &blob().1, "--antialias", "3", "--aperture", "0.1", "--focus", "4", "--jitter", "7"]);
    for line in [
        "anti-aliasing      on, 3 rays a pixel",
        "depth of field     on, aperture radius 0.1, in focus at 4",
        "jitter             on, seed 7",
        "tone               off: not asked for",
    ] {
        assert!(said.contains(line), "{line}: {said}");
    }
}

#[test]
fn effects_that_cannot_be_are_refused_naming_the_flag() {
    let folder = Folder::new();
    let (file, blob) = (folder.path("a.png"), blob().1.as_str());
    let refused = |flags: &[&str], words: &[&str]| {
        fails([&["render", blob, "-o", &file][..], &VIEW, flags].concat(), words);
    };
    refused(&["--antialias", "0"], &["--antialias", "1..=256"]);
    refused(&["--antialias", "257"], &["--antialias", "1..=256"]);
    refused(&["--aperture", "0.1"], &["--focus"]);
    refused(&["--focus", "4"], &["--aperture"]);
    refused(&["--aperture=-1", "--focus", "4"], &["--aperture", "found -1"]);
    refused(&["--aperture", "1", "--focus", "0"], &["--focus", "found 0"]);
    refused(&["--exposure", "40"], &["--exposure", "found 40"]);
    refused(&["--tone-map", "nice"], &["--tone-map", "reinhard"]);
    for tone in [&["--linear"][..], &["--exposure", "1"], &["--tone-map", "filmic"]] {
        refused(&[&["--transparent"], tone].concat(), &["--transparent", tone[0]]);
    }
    assert!(!std::path::Path::new(&file).exists());
}
