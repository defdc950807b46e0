//! Files that are missing, damaged or of another kind; places that cannot be written.

use crate::made::{Array, Folder, scene};
use crate::tools::there_is;
use crate::{blob, fails, fit, run};
use std::path::Path;

#[test]
fn bad_archives_are_refused_naming_file_and_key() {
    let folder = Folder::new();
    let file = folder.path("a.nerf");
    fails(fit("nowhere.npz", &file, &[]), &["nowhere.npz"]);
    let whole = std::fs::read(folder.npz("whole.npz")).expect("an archive");
    for length in [0, 10, whole.len() / 2, whole.len() - 10] {
        let cut = folder.file("cut.npz", &whole[..length]);
        fails(fit(&cut, &file, &[]), &["cut.npz"]);
    }
    let text = folder.file("text.npz", "no archive");
    fails(fit(&text, &file, &[]), &["text.npz"]);
    for key in ["images_train", "c2ws_train", "focal", "c2ws_val"] {
        let without = folder.npz_with("without.npz", |arrays| arrays.retain(|a| a.key != key));
        fails(fit(&without, &file, &[]), &["without.npz", key]);
    }
    let replaced = |key: &'static str, dtype, shape: &str, data: Vec<u8>| {
        folder.npz_with("replaced.npz", |arrays| {
            let place = arrays.iter().position(|a| a.key == key).expect("a key");
            arrays[place] = Array::new(key, dtype, shape, data);
        })
    };
    let f8 = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let singular: Vec<f64> = (0..96).map(|i| f64::from(u8::from(i % 16 == 15))).collect();
    let mut unknown = singular.clone();
    unknown[0] = f64::NAN;
    let cases: [(&'static str, &'static str, &str, Vec<u8>); 10] = [
        ("images_train", "|u1", "(6, 24, 24)", vec![0; 6 * 24 * 24]),
        ("images_train", "|u1", "(6, 24, 24, 2)", vec![0; 6 * 24 * 24 * 2]),
        ("images_train", "|u1", "(5, 24, 24, 3)", vec![0; 5 * 24 * 24 * 3]),
        ("images_train", "|u1", "(6, 24, 24, 3)", vec![0; 100]),
        ("images_train", "|u1", "(0, 24, 24, 3)", vec![]),
        ("c2ws_train", "<f8", "(6, 3, 3)", f8(&[0.0; 54])),
        ("c2ws_train", "<f8", "(6, 4, 4)", f8(&singular)),
        ("c2ws_train", "<f8", "(6, 4, 4)", f8(&unknown)),
        ("focal", "<f8", "(2,)", f8(&[30.0, 30.0])),
        ("focal", "<f8", "()", f8(&[0.0])),
    ];
    for (key, dtype, shape, data) in cases {
        let bad = replaced(key, dtype, shape, data);
        let message = fails(fit(&bad, &file, &[]), &["replaced.npz"]);
        let named = if key == "focal" && shape == "()" { "fx" } else { "_train" };
        assert!(message.contains(key) || message.contains(named), "{key}: {message}");
    }
    assert!(!Path::new(&file).exists() && !Path::new(&folder.path("a.nerf.checkpoint")).exists());
}

#[test]
fn bad_folders_are_refused_naming_file_and_view() {
    let folder = Folder::new();
    let (data, file) = (folder.blender("scene"), folder.path("a.nerf"));
    let picture = format!("{data}/train/r_3.png");
    let whole = std::fs::read(&picture).expect("a picture");
    for (what, bytes) in [
        ("empty", Vec::new()),
        ("truncated", whole[..whole.len() / 2].to_vec()),
        ("text", b"this is no picture".to_vec()),
    ] {
        std::fs::write(&picture, bytes).expect("written");
        let message = fails(fit(&data, &file, &[]), &["r_3.png"]);
        assert!(message.contains("picture"), "{what}: {message}");
    }
    // A picture that is not there is skipped and named.
    std::fs::remove_file(&picture).expect("removed");
    let fitted = folder.path("fitted.nerf");
    let args: Vec<&str> = fit(&data, &fitted, &["--steps", "2"]).into_iter().filter(|a| *a != "-q").collect();
    let result = run(args);
    assert!(result.code == Some(0) && result.err.contains("r_3"), "{}", result.err);
    std::fs::write(&picture, whole).expect("written");

    let json = format!("{data}/transforms_train.json");
    let text = std::fs::read_to_string(&json).expect("json");
    for (from, to, words) in [
        ("\"frames\"", "\"farmes\"", ["transforms_train.json", "frames"]),
        ("\"transform_matrix\"", "\"matrix\"", ["transforms_train.json", "transform_matrix"]),
        ("\"fl_x\"", "\"f\"", ["transforms_train.json", "fl_x"]),
        ("}", "", ["transforms_train.json", "line"]),
    ] {
        std::fs::write(&json, text.replace(from, to)).expect("written");
        fails(fit(&data, &file, &[]), &words);
    }
    let mut value: serde_json::Value = serde_json::from_str(&text).expect("json");
    value["frames"][1]["transform_matrix"] = serde_json::json!([[0, 0, 0, 1], [0, 0, 0, 1], [0, 0, 0, 1]]);
    std::fs::write(&json, value.to_string()).expect("written");
    fails(fit(&data, &file, &[]), &["transforms_train.json", "r_1"]);
    value["frames"] = serde_json::json!([]);
    std::fs::write(&json, value.to_string()).expect("written");
    fails(fit(&data, &file, &[]), &["scene", "at least one training view"]);
    let empty = folder.path("empty");
    std::fs::create_dir(&empty).expect("a folder");
    fails(fit(&empty, &file, &[]), &["transforms"]);
    assert!(!Path::new(&file).exists());
}

#[test]
fn near_beyond_far_is_refused_naming_both() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    for range in
        [["--near", "6", "--far", "2"], ["--near", "2", "--far", "2"], ["--near", "-1", "--far", "nan"]]
    {
        let args: Vec<String> = fit(&data, &file, &[]).into_iter().map(Into::into).collect();
        let flags = [format!("{}={}", range[0], range[1]), format!("{}={}", range[2], range[3])];
        fails(args.into_iter().chain(flags), &["near", "far"]);
    }
    let mut dataset = scene();
    (dataset.near, dataset.far) = (Some(5.0), Some(1.0));
    let data = folder.blender_of("inverted", &dataset);
    fails(fit(&data, &file, &[]), &["near", "far", "inverted"]);
}

#[test]
fn what_is_no_blob_is_refused_by_every_command() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    let whole = std::fs::read(file).expect("a blob");
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 4;
    let cases = [
        ("missing.nerf", None),
        ("empty.nerf", Some(Vec::new())),
        ("text.nerf", Some(b"this is no blob, only some text".to_vec())),
        ("cut.nerf", Some(whole[..whole.len() - 1].to_vec())),
        ("flipped.nerf", Some(flipped)),
        ("archive.nerf", Some(std::fs::read(&data).expect("an archive"))),
    ];
    let picture = folder.path("of_no_blob.png");
    for (name, bytes) in cases {
        let bad = folder.path(name);
        if let Some(bytes) = bytes {
            std::fs::write(&bad, bytes).expect("written");
        }
        fails(["inspect", &bad], &[name]);
        fails(["eval", &bad, &data], &[name]);
        fails(["render", &bad, "-o", &picture], &[name]);
    }
    fails(["inspect", &folder.path("")], &["cannot read"]);
    assert!(!Path::new(&picture).exists());
}

#[test]
fn bad_requests_of_a_picture_are_refused_naming_the_flag() {
    let (folder, file) = blob();
    let (data, picture) = (folder.path("scene.npz"), folder.path("refused.png"));
    let cases: [(&[&str], &str); 10] = [
        (&["--pose", "0,0,0,0,0,0,0,0,0,0,0,1"], "--pose"),
        (&["--pose", "nan,0,0,0,0,1,0,0,0,0,1,1"], "--pose"),
        (&["--pose", "1,2,3"], "--pose"),
        (&["--focal", "0"], "--focal"),
        (&["--focal", "nan"], "--focal"),
        (&["--width", "0"], "image size"),
        (&["--data", &data, "--view", "2"], "--view"),
        (&["--data", &data, "--split", "test"], "--view"),
        (&["--samples", "5000"], "samples"),
        (&["--transmittance-cut", "2"], "transmittance"),
    ];
    for (flags, word) in cases {
        fails([&["render", file, "-q", "-o", &picture], flags].concat(), &[word]);
        assert!(!Path::new(&picture).exists(), "{flags:?}");
    }
    fails(["eval", file, &data, "--background", "mauve"], &["--background"]);
    fails(["eval", file, &data, "--every", "0"], &["--every"]);
    fails(["eval", file, "nowhere.npz"], &["nowhere.npz"]);
}

#[test]
fn places_that_cannot_be_written_are_found_out_before_the_work() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    let plain = folder.file("plain", "a regular file");
    let below = format!("{plain}/below");
    let blob_below = format!("{plain}/below.nerf");
    let steps = ["--steps", "1000000000"];
    fails(fit(&data, &blob_below, &steps), &["plain"]);
    fails(
        fit(&data, &folder.path("b.nerf"), &[&steps[..], &["--report", &below]].concat()),
        &["plain/below"],
    );
    fails(["eval", file, &data, "--report", &below], &["plain/below"]);
    fails(["render", file, "-o", &format!("{below}/a.png"), "--width", "4"], &["plain/below"]);
    fails(["demo", "--out", &below], &["plain/below"]);
    // A folder of the blob's name.
    let taken = folder.path("taken.nerf");
    std::fs::create_dir(&taken).expect("a folder");
    fails(fit(&data, &taken, &steps), &["taken.nerf"]);
    let picture = folder.path("taken.png");
    std::fs::create_dir(&picture).expect("a folder");
    fails(["render", file, "-o", &picture, "--width", "4"], &["taken.png"]);
    let ahead = folder.path("c.nerf.checkpoint");
    std::fs::create_dir(&ahead).expect("a folder");
    fails(fit(&data, &folder.path("c.nerf"), &steps), &["c.nerf.checkpoint"]);
    assert_eq!(std::fs::read(&plain).expect("intact"), b"a regular file");
    assert!(
        !folder.names().iter().any(|name| name.ends_with(".tmp") || name == "b.nerf" || name == "c.nerf")
    );
}

#[cfg(unix)]
#[test]
fn a_full_device_is_reported_naming_the_file() {
    use std::os::unix::fs::symlink;
    if !there_is("/dev/full", Path::new("/dev/full").exists()) {
        return;
    }
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    let full = |name: &str| {
        let path = folder.path(name);
        if let Some(parent) = Path::new(&path).parent() {
            std::fs::create_dir_all(parent).expect("a folder");
        }
        symlink("/dev/full", &path).expect("a link");
        path
    };
    let space = "No space left on device";
    fails(fit(&data, &full("full.nerf"), &["--steps", "2"]), &["full.nerf", space]);
    full("full.nerf.checkpoint.nerf.checkpoint");
    let other = folder.path("full.nerf.checkpoint.nerf");
    // A checkpoint that cannot be written is a warning: the run goes on to its blob.
    let ran = run(fit(&data, &other, &["--steps", "2"]));
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for word in ["warning", "full.nerf.checkpoint.nerf.checkpoint", space, "goes on"] {
        assert!(ran.err.contains(word), "{}", ran.err);
    }
    assert!(Path::new(&other).exists());
    for (i, name) in
        ["summary.json", "curve.csv", "curve.png", "snapshots.png", "views.png"].into_iter().enumerate()
    {
        full(&format!("full{i}/{name}"));
        let report = folder.path(&format!("full{i}"));
        fails(
            fit(&data, &folder.path("r.nerf"), &["--steps", "2", "--restart", "--report", &report]),
            &[name, space],
        );
    }
    full("eval/summary.json");
    fails(["eval", file, &data, "-q", "--report", &folder.path("eval")], &["summary.json", space]);
    fails(["render", file, "-q", "-o", &full("full.png"), "--width", "40"], &["full.png", space]);
    fails(
        ["render", file, "-q", "-o", &full("full.gif"), "--width", "40", "--orbit", "2"],
        &["full.gif", space],
    );
}

#[test]
fn what_was_not_learned_and_what_was_started_anew_is_said() {
    let (folder, report) = (Folder::new(), Folder::new());
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let summary = || crate::json(report.path("summary.json"));
    let run = |more: &[&str]| {
        let ran =
            crate::run(fit(&data, &file, &[&["--restart", "--report", &report.path("")], more].concat()));
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        ran.err
    };
    // One step shows nothing yet.
    let said = run(&["--steps", "1"]);
    assert!(said.contains("nothing was learned: a flat colour has"), "{said}");
    let untrained = summary();
    assert_eq!(untrained["flat"], true);
    assert!(untrained["val_psnr_db"].as_f64() <= untrained["flat_psnr_db"].as_f64(), "{untrained}");
    let said = run(&["--steps", "400", "--rate", "0.01"]);
    assert_eq!((summary()["flat"].as_bool(), said.contains("nothing")), (Some(false), false));
    // Without a bias some seeds have no density anywhere.
    let config = folder.file("run.toml", "[network]\ndensity_bias = 0.0\n");
    let data = folder.blender("scene");
    let dying = "--preset seed --width 16 --colour-width 8 --rays 16 --set sampling.samples=4 --set occupancy.resolution=12 --steps 130";
    let restarted = (0..12).any(|seed| {
        let seed = format!("--seed={seed}");
        let files = [
            "fit",
            &data,
            "-o",
            &file,
            "-q",
            "--config",
            &config,
            "--report",
            &report.path(""),
            "--restart",
            &seed,
        ];
        let ran = crate::run(files.into_iter().chain(dying.split(' ')));
        ran.code == Some(0) && !crate::has(&ran.out, "reseeds", "0")
    });
    assert!(restarted, "none of these seeds was cured");
    let summary = summary();
    assert!(summary["reseeds"].as_u64().is_some_and(|times| (1..=3).contains(&times)), "{summary}");
}

#[test]
fn odd_but_valid_pictures_end_in_a_blob_or_a_message() {
    let folder = Folder::new();
    let made = |train, size| {
        let spec = nerf_train::data::demo::DemoSpec { train, val: 1, size, ..Default::default() };
        nerf_train::data::demo::dataset(&spec).expect("a scene")
    };
    let mut sizes = made(4, 12);
    sizes.train.extend(made(3, 7).train);
    let mut clear = made(4, 12);
    clear.train.iter_mut().chain(&mut clear.val).for_each(|view| view.pixels.fill([9, 8, 7, 0]));
    for (name, dataset) in [("one", made(1, 12)), ("pixels", made(5, 1)), ("sizes", sizes), ("clear", clear)]
    {
        let data = folder.blender_of(name, &dataset);
        for (i, more) in [
            &[][..],
            &["--rate", "0.1"],
            &["--preset", "seed", "--set", "network.skip_after=1", "--set", "network.density=softplus"],
        ]
        .into_iter()
        .enumerate()
        {
            let (file, report) =
                (folder.path(&format!("{name}{i}.nerf")), folder.path(&format!("{name}{i}")));
            let result = run(fit(&data, &file, &[&["--steps", "30", "--report", &report], more].concat()));
            if result.code == Some(0) {
                let picture = folder.path("picture.png");
                let said = run(["eval", &file, &data, "-q"]);
                assert_eq!(said.code, Some(0), "{name}: {}", said.err);
                assert!(!said.out.contains("NaN"), "{name}: {}", said.out);
                let drawn = run(["render", &file, "-q", "-o", &picture, "--width", "8"]);
                assert_eq!(drawn.code, Some(0), "{name}: {}", drawn.err);
            } else {
                println!("{name}, {more:?}: {}", result.err.trim());
                assert_eq!(result.code, Some(1), "{name}: {}", result.err);
                assert!(result.err.starts_with("error: ") && !Path::new(&file).exists(), "{}", result.err);
            }
        }
    }
}
