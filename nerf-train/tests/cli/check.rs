//! `check`: what it says of a data set, its page, and what `fit` makes of it.

use crate::made::Folder;
use crate::program::trainer;
use crate::{fails, fit_grid, ok};
use nerf_train::data::demo::{self, DemoSpec};
use serde_json::Value;
use std::path::{Path, PathBuf};

fn checked(data: &str) -> Value {
    serde_json::from_str(&ok(["check", data, "--json", "-q"])).expect("JSON")
}

/// A capture of the panel, where it is there.
fn real(name: &str) -> Option<PathBuf> {
    let data =
        std::env::var_os("NERF_DATA").map_or_else(|| trainer().join("../../shared/data"), PathBuf::from);
    let folder = data.join("real").join(name);
    if !folder.is_dir() {
        eprintln!("skipped: no data");
    }
    folder.is_dir().then_some(folder)
}

fn group(found: &Value, index: usize) -> Vec<&str> {
    let names = found["groups"][index].as_array().expect("a group");
    names.iter().map(|name| name.as_str().expect("a name")).collect()
}

#[test]
fn the_page_and_the_summary_are_written_and_nothing_of_the_users_is() {
    let folder = Folder::new();
    let data = folder.npz("scene.npz");
    let before = std::fs::read(&data).expect("bytes");
    let said = ok(["check", &data, "-o", &folder.path("out"), "-q"]);
    assert!(
        said.contains("check: 8 photographs") && said.contains("cannot be judged before the fit"),
        "{said}"
    );
    let page = std::fs::read_to_string(folder.path("out/check.html")).expect("a page");
    assert!(page.contains("cannot be judged before the fit"), "{page:.300}");
    assert!(
        std::fs::read_to_string(folder.path("out/summary.json")).expect("JSON").contains("\"folded\": null")
    );
    assert_eq!(std::fs::read(&data).expect("bytes"), before);
    fails(["check", &data, "-o", "check.html"], &["-o", "folder"]);
    fails(["check", &folder.path("none")], &["none"]);
}

#[test]
fn fit_says_the_same_and_refuses_a_group_that_is_not_there() {
    let folder = Folder::new();
    let (data, blob) = (folder.npz("scene.npz"), folder.path("a.nerf"));
    let fitted: Value =
        serde_json::from_str(&ok(fit_grid(&data, &blob, &["--steps", "20", "--json"]))).expect("JSON");
    assert!(fitted["folded"].is_null() && fitted["left_out"] == serde_json::json!([]), "{fitted}");
    assert!(fitted["train_psnr_db"].as_f64().expect("dB") > 3.0, "{fitted}");
    let no_group = ["--steps", "20", "--group", "1"];
    fails(fit_grid(&data, &folder.path("b.nerf"), &no_group), &["--group", "no groups"]);
    assert!(!Path::new(&folder.path("b.nerf")).exists());
}

#[test]
fn the_folded_can_falls_into_its_two_sides_and_the_unfolded_one_does_not() {
    let Some(can) = real("can") else { return };
    let found = checked(can.to_str().expect("UTF-8"));
    assert_eq!(found["folded"], true);
    let name = |i: &usize| format!("{i:04}.jpg");
    let sides: [Vec<String>; 2] =
        [(14..35).chain(53..71).collect::<Vec<_>>(), (0..14).chain(35..53).collect()]
            .map(|side| side.iter().map(name).collect());
    for (index, side) in sides.iter().enumerate() {
        let group = group(&found, index);
        let right = side.iter().filter(|name| group.contains(&name.as_str())).count();
        assert!(right + 2 >= side.len() && group.len() <= side.len() + 2, "{group:?}");
    }
    for name in ["can_unfolded", "cup_colmap", "mouse"] {
        let found = checked(real(name).expect("beside the can").to_str().expect("UTF-8"));
        assert_eq!(
            (&found["folded"], &found["groups"]),
            (&Value::Bool(false), &serde_json::json!([])),
            "{name}"
        );
    }
}

#[test]
fn photographs_that_were_exchanged_are_found() {
    let Some(cup) = real("cup_colmap") else { return };
    let folder = Folder::new();
    let copy = folder.path("cup");
    let copied = std::process::Command::new("cp").arg("-r").arg(&cup).arg(&copy).status().expect("cp");
    assert!(copied.success());
    let images = Path::new(&copy).join("images");
    let entries = std::fs::read_dir(cup.join("images")).expect("a folder");
    let mut names: Vec<_> = entries.map(|entry| entry.expect("an entry").file_name()).collect();
    names.sort();
    // A file that cannot be written to is replaced, not written to.
    for k in 19..38 {
        for (to, from) in [(k, k + 30), (k + 30, k)] {
            let to = images.join(&names[to]);
            std::fs::remove_file(&to).expect("removed");
            std::fs::copy(cup.join("images").join(&names[from]), &to).expect("copied");
        }
    }
    let found = checked(&copy);
    assert_eq!(found["folded"], true);
    let exchanged = |i: usize| (19..38).contains(&i) || (49..68).contains(&i);
    let groups = [0, 1].map(|index| group(&found, index));
    let wrong = names.iter().enumerate().filter(|(i, name)| {
        let group = &groups[usize::from(exchanged(*i))];
        !group.contains(&name.to_str().expect("UTF-8"))
    });
    assert!(wrong.count() <= 3, "{groups:?}");
}

#[test]
fn photographs_that_the_others_do_not_predict_are_listed_and_left_out() {
    let folder = Folder::new();
    // Of 48 photographs one has its object in other colours, before the black background of all.
    let spec = DemoSpec { train: 46, val: 2, size: 24, ..DemoSpec::default() };
    let mut scene = demo::dataset(&spec).expect("a scene");
    let shown = scene.train[5].pixels.iter_mut().filter(|[.., alpha]| *alpha > 127);
    shown.for_each(|[r, g, b, _]| [*r, *g, *b] = [255 - *r, 255 - *g, 255 - *b]);
    let data = folder.npz_of("scene.npz", &scene, |_| {});
    let (out, list) = (folder.path("out"), folder.path("out/unpredicted.txt"));
    let said = ok(["check", &data, "-o", &out, "--cross-validate=120", "--json", "-q"]);
    let found: Value = serde_json::from_str(&said).expect("JSON");
    let found = &found["cross_validation"];
    let held_out: Vec<(&str, f64)> = found["held_out"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|score| (score["view"].as_str().expect("a name"), score["psnr_db"].as_f64().expect("dB")))
        .collect();
    assert_eq!((held_out.len(), &found["steps"]), (48, &Value::from(120)));
    assert!(held_out.is_sorted_by(|a, b| a.1 <= b.1), "{held_out:?}");
    let text = std::fs::read_to_string(&list).expect("a list");
    let names: Vec<&str> = text.lines().collect();
    assert!((1..=14).contains(&names.len()), "{names:?}");
    assert_eq!(found["unpredicted"], serde_json::json!(names));
    assert!(names.iter().zip(&held_out).all(|(name, (worst, _))| name == worst), "{names:?}");
    assert_eq!(names[0], "images_train[5]", "{held_out:?}");

    // A fit without them is another one, and a name that is not there is none.
    let (all, some) = (folder.path("all.nerf"), folder.path("some.nerf"));
    ok(fit_grid(&data, &all, &["--steps", "20"]));
    let mut args = fit_grid(&data, &some, &["--steps", "20", "--leave-out", &list]);
    args.retain(|arg| *arg != "-q");
    let fitted = crate::run(args);
    let said = format!("{} photographs left out", names.len());
    assert!(fitted.code == Some(0) && fitted.err.contains(&said), "{}", fitted.err);
    assert_ne!(std::fs::read(&all).expect("a blob"), std::fs::read(&some).expect("a blob"));
    let left_out = |list: &str, words: &[&str]| {
        let none = folder.path("none.nerf");
        fails(fit_grid(&data, &none, &["--steps", "20", "--leave-out", list]), words);
        assert!(!Path::new(&none).exists());
    };
    let strange = folder.file("strange.txt", "images_train[3]\nnobody\n");
    left_out(&strange, &["strange.txt", "expected names of photographs", "nobody"]);
    let every: Vec<String> = (0..46).map(|view| format!("images_train[{view}]")).collect();
    left_out(&folder.file("every.txt", every.join("\n")), &["every.txt", "left", "the names of all"]);
    left_out(&folder.file("binary.txt", [255, 254]), &["binary.txt"]);
    left_out(&folder.path("absent.txt"), &["absent.txt"]);
    // What is read is never written to.
    let input = folder.file("list.nerf", &text);
    fails(fit_grid(&data, &input, &["--leave-out", &input]), &["--leave-out", "-o"]);
    assert_eq!(std::fs::read_to_string(&input).expect("a list"), text);

    let few = folder.npz("few.npz");
    fails(["check", &few, "-o", &out, "--cross-validate"], &["--cross-validate", "at least 16", "found 8"]);
    fails(["check", &data, "--cross-validate"], &["--output"]);
    fails(["check", &data, "-o", &out, "--cross-validate=0"], &["steps"]);
}
