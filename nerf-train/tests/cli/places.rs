//! Names and sizes are checked before the work, and what was not named is not replaced.

use crate::made::Folder;
use crate::tools::all_here;
use crate::{blob, command, fails, fit, ok, ran, run};
use nerf_core::blob::{Content, PictureFacts, Provenance};
use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
use nerf_core::network::{Architecture, Shading, TrunkLayer};
use nerf_train::model::export::Contents;
use nerf_train::model::export::Tables;
use nerf_train::model::export::export;
use std::path::Path;

const ENDLESS: &[&str] = &["--steps", "1000000000"];

#[test]
fn names_that_mean_another_format_are_refused_with_those_that_are_accepted() {
    let (shared, file) = blob();
    let (data, folder) = (shared.path("scene.npz"), Folder::new());
    for name in ["v.exr", "v.xyz", "v.jpg", "v.nerf", "v.PNG.tiff"] {
        let output = folder.path(name);
        if name != "v.exr" {
            fails(["render", file, "-o", &output], &["-o", ".png or .exr", name]);
        }
        fails(["image", "render", file, "-o", &output], &["-o", ".png", name]);
        fails(["render", file, "--orbit", "2", "-o", &output], &["-o", ".gif", ".mp4", name]);
    }
    for name in ["x.png", "x.npz", "x.checkpoint"] {
        let output = folder.path(name);
        fails(fit(&data, &output, ENDLESS), &["-o", ".nerf", name]);
        fails(["image", "fit", &data, "-o", &output], &["-o", ".nerf", name]);
        fails(["import", &data, "-o", &output], &["-o", ".nerf", name]);
        fails(["study", file, &data, "-o", &output], &["-o", ".nerf", name]);
    }
    let report = folder.path("r.png");
    fails(["eval", file, &data, "--report", &report], &["--report", "folder", "r.png"]);
    fails(["show", &data, "-o", &report], &["-o", "folder", "r.png"]);
    fails(["demo", "--out", &report], &["--out", "folder", "r.png"]);
    fails(["sweep", "scene", &data, "-o", &report, "--width", "8,16"], &["-o", "folder", "r.png"]);
    assert!(folder.names().is_empty(), "{:?}", folder.names());
}

#[test]
fn folders_and_names_too_long_are_refused_before_the_work() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    let before = folder.names();
    let new = folder.path("new/");
    fails(fit(&data, &new, ENDLESS), &["-o", "new/", "folder"]);
    fails(["render", file, "-o", &new], &["-o", "new/", "folder"]);
    // The name itself fits in 255 bytes, that of the checkpoint beside it does not.
    let long = folder.path(&format!("{}.nerf", "n".repeat(245)));
    fails(fit(&data, &long, ENDLESS), &["the checkpoint beside -o", "at most 255 bytes", "found 261"]);
    let long = folder.path(&format!("{}.png", "n".repeat(245)));
    fails(["render", file, "-o", &long, "--outputs", "rgb,z-depth"], &["z_depth beside -o", "255"]);
    fails(["render", file, "-o", &folder.path(&format!("{}.png", "n".repeat(300)))], &["-o", "255"]);
    assert_eq!(folder.names(), before);
    if Path::new("/proc/version").exists() {
        fails(fit(&data, "/proc/a.nerf", ENDLESS), &["-o", "/proc"]);
        fails(["render", file, "-o", "/proc/a.png"], &["-o", "/proc"]);
    }
}

#[test]
fn a_checkpoint_is_replaced_only_where_that_is_said() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let checkpoint = folder.path("a.nerf.checkpoint");
    ok(fit(&data, &file, &["--steps", "3"]));
    let before = (std::fs::read(&checkpoint).expect("one"), std::fs::read(&file).expect("a blob"));
    fails(fit(&data, &file, &["--steps", "5"]), &["a.nerf.checkpoint", "--resume", "--restart"]);
    assert!(before == (std::fs::read(&checkpoint).expect("one"), std::fs::read(&file).expect("a blob")));
    fails(fit(&data, &file, &["--resume", "--restart"]), &["--resume", "--restart"]);
    ok(fit(&data, &file, &["--steps", "5", "--resume"]));
    assert!(crate::has(&ok(["inspect", &file]), "steps", "5"));
    ok(fit(&data, &file, &["--steps", "4", "--restart"]));
    assert!(crate::has(&ok(["inspect", &file]), "steps", "4"));
    // Somebody else's file of that name is one, too.
    std::fs::write(&checkpoint, "notes").expect("written");
    fails(fit(&data, &file, &["--steps", "5"]), &["a.nerf.checkpoint"]);
    assert_eq!(std::fs::read(&checkpoint).expect("left"), b"notes");
}

/// A grey picture that says that it has `side` × `side` pixels.
fn grey(side: u32) -> Vec<u8> {
    let architecture = Architecture {
        position: SinusoidalEncoding { inputs: 2, levels: 0, scale: AngleScale::Pi, identity: true }.into(),
        direction: None,
        trunk: [TrunkLayer { width: 4, skip: false }].into_iter().collect(),
        density: None,
        colour: [].into_iter().collect(),
        shading: Shading::PerSample,
    };
    let provenance = Provenance { data: "grey", made_by: "test", trained_parameters: 27, ..Provenance::NONE };
    let contents = Contents {
        architecture: &architecture,
        parameters: &[0.0; 27],
        tables: Tables::None,
        content: Content::Picture(PictureFacts { width: side, height: side }),
        occupancy: None,
        provenance,
    };
    export(&contents).expect("a blob").bytes
}

#[test]
fn requests_that_fit_no_memory_are_refused_with_the_size() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    let grey = folder.file("grey.nerf", grey(65_535));
    assert!(std::fs::metadata(&grey).expect("a blob").len() < 1024);
    let (picture, film) = (folder.path("huge.png"), folder.path("huge.gif"));
    fails(["image", "render", &grey, "-o", &picture], &["65535x65535", "GB of memory", "--width"]);
    for width in ["300000", "4294967295", "60000"] {
        fails(["render", file, "-o", &picture, "--width", width], &[width]);
        fails(["render", file, "-o", &film, "--width", width, "--orbit", "2"], &[width]);
    }
    fails(["render", file, "-o", &film, "--orbit", "10000000000"], &["--orbit", "1000000", "10000000000"]);
    fails(["render", file, "-o", &film, "--orbit", "18446744073709551615"], &["--orbit"]);
    let ranges = ["--orbit", "1000000", "--width", "4000", "--outputs", "z-depth"];
    fails([&["render", file, "-o", &film][..], &ranges].concat(), &["1000000 frames", "of memory"]);
    fails(["fit", &data, "-o", &folder.path("huge.nerf"), "--width", "300000"], &["width", "300000"]);
    assert!(!Path::new(&picture).exists() && !Path::new(&film).exists());
}

#[test]
fn threads_beyond_any_use_are_capped_with_a_word() {
    let (_, file) = blob();
    for threads in ["4097", "10000000000"] {
        let ran = run(["inspect", file, "--threads", threads]);
        assert!(
            ran.code == Some(0) && ran.err.contains("--threads") && ran.err.contains(threads),
            "{}",
            ran.err
        );
    }
    fails(["inspect", file, "--threads", "0"], &["--threads"]);
}

#[test]
fn files_that_were_not_named_are_replaced_only_if_they_are_our_own() {
    let (_, file) = blob();
    let folder = Folder::new();
    let read = |name: &str| std::fs::read(folder.path(name)).expect("a file");
    let stranger = |name: &str| {
        if let Some(parent) = Path::new(&folder.path(name)).parent() {
            std::fs::create_dir_all(parent).expect("a folder");
        }
        std::fs::write(folder.path(name), "a stranger's").expect("written");
    };
    let tiny = ["--width", "8", "-q"];
    let render = |name: &str, more: &[&str]| {
        let output = folder.path(name);
        ran(&mut command([&["render", file, "-o", &output], &tiny[..], more].concat()))
    };
    let refused = |name: &str, more: &[&str], stranger: &str| {
        let ran = render(name, more);
        assert!(ran.code == Some(1) && ran.err.contains(stranger), "{name}: {}", ran.err);
        assert!(ran.err.contains("did not make it"), "{name}: {}", ran.err);
        assert_eq!(read(stranger), b"a stranger's");
    };
    let twice = |name: &str, more: &[&str]| {
        for _ in 0..2 {
            let ran = render(name, more);
            assert_eq!(ran.code, Some(0), "{name}: {}", ran.err);
        }
    };
    let orbit = ["--orbit", "2"];
    stranger("film_z_depth.gif");
    refused("film.gif", &["--orbit", "2", "--outputs", "rgb,z-depth"], "film_z_depth.gif");
    assert!(!Path::new(&folder.path("film.gif")).exists());
    twice("own.gif", &["--orbit", "2", "--outputs", "rgb,z-depth"]);
    if all_here(&["ffmpeg"]) {
        twice("own.mp4", &["--orbit", "2", "--outputs", "rgb,z-depth"]);
    }
    stranger("view_z_depth.png");
    refused("view.png", &["--outputs", "rgb,z-depth"], "view_z_depth.png");
    twice("still.png", &["--outputs", "rgb,z-depth,opacity"]);
    stranger("holiday/frame_0001.png");
    refused("holiday/", &orbit, "holiday/frame_0001.png");
    // What is called otherwise is not in the way.
    stranger("frames/beach.png");
    twice("frames", &["--orbit", "2", "--transparent"]);
    assert_eq!(read("frames/beach.png"), b"a stranger's");
    // What is named is replaced.
    stranger("named.png");
    twice("named.png", &[]);
}

#[test]
fn views_whose_names_are_alike_have_files_of_their_own() {
    let (folder, file) = blob();
    let data = folder.blender("alike");
    let list = format!("{data}/transforms_train.json");
    let mut text = std::fs::read_to_string(&list).expect("a list");
    let names = ["照片/一", "照片/二", "a/x", "a_x", "A_X", "views"];
    for (i, name) in names.iter().enumerate() {
        let place = Path::new(&data).join(format!("{name}.png"));
        std::fs::create_dir_all(place.parent().expect("a folder")).expect("a folder");
        std::fs::rename(format!("{data}/train/r_{i}.png"), place).expect("moved");
        text = text.replace(&format!("./train/r_{i}"), name);
    }
    std::fs::write(&list, text).expect("written");
    let report = folder.path("alike_report");
    ok(["eval", file, &data, "-q", "--split", "train", "--report", &report]);
    let expected = [
        "A_X_3.png",
        "a_x.png",
        "a_x_2.png",
        "summary.json",
        "views.csv",
        "views_2.png",
        "照片_一.png",
        "照片_二.png",
    ];
    assert_eq!(crate::made::names(Path::new(&report)), expected);
    // A view has the same name whichever others are taken.
    let third = folder.path("alike_third");
    ok(["eval", file, &data, "-q", "--split", "train", "--every", "3", "--report", &third]);
    assert_eq!(
        crate::made::names(Path::new(&third)),
        ["a_x_2.png", "summary.json", "views.csv", "照片_一.png"]
    );
}
