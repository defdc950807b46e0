//! Fit, inspect, eval, render and demo on real files.

use crate::made::{Folder, names};
use crate::tools::there_is;
use crate::{blob, command, fails, fit, has, json, ok, ran, read_picture};
use std::path::Path;
use std::process::Stdio;

const FIELDS: &[&str] =
    &["val_psnr_db", "val_ssim", "views", "background", "train_seconds", "steps", "parameters", "blob_bytes"];

/// Weights of a blob that are f16 subnormals.
fn subnormal_weights(path: &str) -> u64 {
    let bytes = std::fs::read(path).expect("a blob");
    let blob = nerf_core::blob::Blob::open(&bytes).expect("a blob");
    let halves = blob.weights().chunks_exact(2).map(|half| u16::from_le_bytes([half[0], half[1]]));
    let count = halves.filter(|half| half & 0x7c00 == 0 && half & 0x03ff != 0).count() as u64;
    println!("{count} subnormal weights");
    count
}

#[test]
fn test_views_are_measured_where_there_are_no_others() {
    let folder = Folder::new();
    let (data, file) = (folder.blender("lego"), folder.path("a.nerf"));
    let [val, test] = ["val", "test"].map(|split| format!("{data}/transforms_{split}.json"));
    std::fs::rename(val, test).expect("a split");
    let loud = fit(&data, &file, &["--steps", "40"]).into_iter().filter(|argument| *argument != "-q");
    let said = ran(&mut command(loud)).err;
    assert!(said.contains("no validation views: the 2 test views are measured"), "{said}");
    let fitted: serde_json::Value =
        serde_json::from_str(&ok(fit(&data, &file, &["--steps", "40", "--json", "--restart"])))
            .expect("JSON");
    assert_eq!((fitted["val_split"].as_str(), fitted["views"].as_u64()), (Some("test"), Some(2)));
    let measured: serde_json::Value =
        serde_json::from_str(&ok(["eval", &file, &data, "--json", "--quiet"])).expect("JSON");
    assert_eq!((&measured["split"], &measured["val_psnr_db"]), (&"test".into(), &fitted["val_psnr_db"]));
}

#[test]
fn fit_inspect_eval_and_render_agree_on_blender_and_npz() {
    let folder = Folder::new();
    for (name, data) in [("blender", folder.blender("lego")), ("npz", folder.npz("lego.npz"))] {
        let (file, report) = (folder.path(&format!("{name}.nerf")), folder.path(&format!("{name}_report")));
        let said = ok(fit(&data, &file, &["--steps", "40", "--report", &report, "--snapshots", "0,20"]));
        assert!(has(&said, "views", "2") && has(&said, "blob", &file), "{said}");
        let fitted = json(format!("{report}/summary.json"));
        for field in FIELDS {
            assert!(!fitted[field].is_null(), "fit: {field}");
        }
        assert_eq!((fitted["steps"].as_u64(), fitted["views"].as_u64()), (Some(40), Some(2)));
        assert_eq!(fitted["background"], "black");
        let length = std::fs::metadata(&file).expect("a blob").len();
        assert_eq!(fitted["blob_bytes"].as_u64(), Some(length));
        assert_eq!(fitted["subnormal_weights"].as_u64(), Some(subnormal_weights(&file)), "{name}");
        for made in [
            "curve.csv",
            "curve.png",
            "curve.svg",
            "curve_steps.png",
            "curve_steps.svg",
            "data.json",
            "snapshots.png",
            "views.png",
        ] {
            assert!(Path::new(&report).join(made).is_file(), "{made}");
        }
        let snapshots = names(&Path::new(&report).join("snapshots"));
        assert_eq!(snapshots.len(), 4, "{snapshots:?}");

        let (steps, said) = (fitted["steps"].to_string(), ok(["inspect", &file]));
        for (field, value) in [("steps", &*steps), ("seed", "0"), ("background", "black"), ("kind", "scene")]
        {
            assert!(has(&said, field, value), "{field}: {said}");
        }
        for word in ["occupancy_resolution", "psnr_db", "parameters", "lego", "Trunk(0)"] {
            assert!(said.contains(word), "{word}: {said}");
        }

        let eval_report = folder.path(&format!("{name}_eval"));
        let said = ok(["eval", &file, &data, "-q", "--background", "black", "--report", &eval_report]);
        assert!(has(&said, "views", "2") && has(&said, "background", "black"), "{said}");
        let evaluated = json(format!("{eval_report}/summary.json"));
        for field in ["val_psnr_db", "val_ssim", "views", "background", "blob_bytes"] {
            assert_eq!(evaluated[field], fitted[field], "{name}: {field}");
        }
        assert_eq!(evaluated["steps"], fitted["steps"], "{name}");
        assert_eq!(names(Path::new(&eval_report)).len(), 4, "two views, a table, a summary");

        let white = folder.path(&format!("{name}_white"));
        ok([
            "eval",
            &file,
            &data,
            "-q",
            "--background",
            "255,255,255",
            "--split",
            "train",
            "--report",
            &white,
        ]);
        let white = json(format!("{white}/summary.json"));
        assert_eq!((white["background"].as_str(), white["views"].as_u64()), (Some("white"), Some(6)));
        assert!(white["val_psnr_db"].as_f64() != evaluated["val_psnr_db"].as_f64());
    }
}

#[test]
fn render_writes_every_output_of_a_pose_a_view_and_an_orbit() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    let still = folder.path("still.png");
    let pose = "1,0,0,0,0,0,-1,-3.2,0,1,0,0";
    let all = "rgb,opacity,ray-distance,z-depth,median-distance,normals";
    ok([
        "render",
        file,
        "-q",
        "-o",
        &still,
        "--pose",
        pose,
        "--width",
        "20",
        "--height",
        "10",
        "--outputs",
        all,
    ]);
    assert_eq!((read_picture(&still).width(), read_picture(&still).height()), (20, 10));
    let opacity = read_picture(folder.path("still_opacity.png"));
    assert!(matches!(opacity, image::DynamicImage::ImageLuma16(_)), "{:?}", opacity.color());
    for name in ["still_ray_distance.png", "still_z_depth.png", "still_median_distance.png"] {
        assert!(read_picture(folder.path(name)).width() >= 20, "{name}");
    }
    // The picture of normals has no legend, and the colours of unit vectors where it is not empty.
    let normals = read_picture(folder.path("still_normals.png")).into_rgb8();
    assert_eq!((normals.width(), normals.height()), (20, 10));
    let vector = |p: &image::Rgb<u8>| p.0.map(|c| f32::from(c) / 127.5 - 1.0);
    let length = |[x, y, z]: [f32; 3]| (x * x + y * y + z * z).sqrt();
    // One step of a byte is 1/127.5 of an axis.
    let unit = normals.pixels().filter(|p| (length(vector(p)) - 1.0).abs() < 0.01).count();
    let empty = normals.pixels().filter(|p| p.0 == [219; 3]).count();
    assert_eq!(unit + empty, 200, "{unit} normals, {empty} empty pixels");

    let shorthand = folder.path("shorthand.png");
    ok(["render", file, "-q", "-o", &shorthand, "--pose", pose, "--width", "20", "--outputs", "all"]);
    for name in ["shorthand_z_depth.png", "shorthand_median_distance.png", "shorthand_normals.png"] {
        assert!(Path::new(&folder.path(name)).is_file(), "{name}");
    }

    let view = folder.path("view.png");
    ok(["render", file, "-q", "-o", &view, "--data", &data, "--view", "1", "--bins", "own"]);
    assert_eq!(read_picture(&view).width(), 24);
    // The same view as eval's own picture of it, which takes the bins that the network was fitted on.
    let report = folder.path("eval_of_view");
    ok(["eval", file, &data, "-q", "--report", &report]);
    let of_eval = read_picture(format!("{report}/images_val_1.png"));
    assert!(read_picture(&view).into_rgb8() == of_eval.into_rgb8());

    let clear = folder.path("clear.png");
    ok(["render", file, "-q", "-o", &clear, "--width", "24", "--transparent"]);
    let image::DynamicImage::ImageRgba8(clear) = read_picture(&clear) else { panic!("no alpha") };
    assert!(clear.pixels().any(|p| p[3] == 0), "the corners are empty");

    let orbit = folder.path("orbit.gif");
    ok(["render", file, "-q", "-o", &orbit, "--orbit", "5", "--width", "16", "--outputs", "rgb,z-depth"]);
    for name in ["orbit.gif", "orbit_z_depth.gif"] {
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let file = std::fs::File::open(folder.path(name)).expect(name);
        let mut decoder = options.read_info(file).expect("a GIF");
        let mut frames = 0;
        while decoder.read_next_frame().expect("a frame").is_some() {
            frames += 1;
        }
        assert_eq!(frames, 5, "{name}");
    }

    // A name without extension gets no stray dot.
    let bare = folder.path("bare");
    ok(["render", file, "-q", "-o", &bare, "--width", "8", "--outputs", "rgb,opacity"]);
    assert!(Path::new(&folder.path("bare_opacity")).is_file(), "{:?}", folder.names());
}

#[test]
fn kernels_and_thread_counts_are_flags_that_change_no_result_file() {
    let folder = Folder::new();
    let data = folder.npz("data.npz");
    let blobs = ["1", "2", "3"].map(|threads| {
        let file = folder.path(&format!("{threads}.nerf"));
        ok(fit(&data, &file, &["--steps", "15", "--threads", threads]));
        std::fs::read(file).expect("a blob")
    });
    assert!(blobs[0] == blobs[1] && blobs[0] == blobs[2]);
    let scalar = folder.path("scalar.nerf");
    ok(fit(&data, &scalar, &["--steps", "2", "--kernel", "portable"]));
    fails(
        fit(&data, &scalar, &["--kernel", "mmx"]),
        &["--kernel", "expected one of this machine's: portable-f16, portable"],
    );
    fails(fit(&data, &scalar, &["--threads", "0"]), &["--threads"]);
}

#[test]
fn seed_preset_and_its_published_variants_work_end_to_end() {
    let folder = Folder::new();
    let data = folder.npz("data.npz");
    let base = [
        "--preset",
        "seed",
        "--width",
        "16",
        "--depth",
        "8",
        "--colour-width",
        "8",
        "--rays",
        "64",
        "--set",
        "occupancy.resolution=12",
        "--steps",
        "3",
    ];
    let variants: [&[&str]; 5] = [
        &[],
        &["--set", "sampling.samples=32"],
        &["--set", "sampling.jitter.width=0.02"],
        &["--set", "sampling.images=5", "--rays", "100"],
        &["--rate", "1e-3"],
    ];
    for (i, variant) in variants.into_iter().enumerate() {
        let file = folder.path(&format!("{i}.nerf"));
        // A flag but --set given twice is refused by clap, so a variant's own value replaces the base's.
        let again = |flag: &str| flag != "--set" && variant.contains(&flag);
        let kept: Vec<&str> =
            base.chunks_exact(2).filter(|pair| !again(pair[0])).flatten().copied().collect();
        ok([&["fit", &data, "-o", &file, "-q"], &kept[..], variant].concat());
        let said: serde_json::Value = serde_json::from_str(&ok(["inspect", &file, "--json"])).expect("JSON");
        assert_eq!(said["samples_per_ray"], if variant.contains(&"sampling.samples=32") { 32 } else { 64 });
        let layers = said["layers"].as_array().expect("a list");
        let skips = |layer: &serde_json::Value| layer["main_inputs"] == 16 && layer["extra_inputs"] == 63;
        assert!(layers.iter().any(skips), "{said}");
        ok(["eval", &file, &data, "-q"]);
    }
}

#[test]
fn without_validation_views_the_summary_keeps_its_fields() {
    let folder = Folder::new();
    let data = folder.npz_with("data.npz", |arrays| arrays.retain(|a| !a.key.ends_with("_val")));
    let (file, report) = (folder.path("a.nerf"), folder.path("report"));
    let said = ok(fit(&data, &file, &["--steps", "3", "--report", &report]));
    assert!(has(&said, "views", "0"), "{said}");
    let summary = json(format!("{report}/summary.json"));
    for field in FIELDS {
        assert!(summary.get(field).is_some(), "{field}");
    }
    assert_eq!(summary["views"], 0);
    assert_eq!(summary["steps"], 3);
    for field in ["val_psnr_db", "val_worst_psnr_db", "last_watched_psnr_db", "val_stopped_rising_step"] {
        assert!(summary[field].is_null(), "{field}");
    }
    assert!(!Path::new(&report).join("snapshots.png").exists(), "nothing to show");
    fails(["eval", &file, &data], &[&data, "`val`", "no views"]);
}

#[test]
fn demo_measures_its_distances() {
    let folder = Folder::new();
    let out = folder.path("demo");
    let said = ok(["demo", "--out", &out, "--steps", "3", "--json"]);
    let summary = json(format!("{out}/summary.json"));
    assert_eq!(serde_json::from_str::<serde_json::Value>(&said).expect("one object"), summary);
    for field in FIELDS.iter().chain(&["z_depth_median_relative_error"]) {
        assert!(summary.get(field).is_some(), "{field}");
    }
    for name in ["demo.nerf", "views.png", "orbit.gif", "curve.png", "curve.csv"] {
        assert!(Path::new(&out).join(name).is_file(), "{name}");
    }
}

#[test]
fn toml_files_set_what_flags_do() {
    let folder = Folder::new();
    let data = folder.npz("data.npz");
    let text = "seed = 3\n[network]\nwidth = 24\n[occupancy]\nresolution = 12\n[optimiser]\nsteps = 4\n";
    let (config, file) = (folder.file("run.toml", text), folder.path("a.nerf"));
    let flags = ["fit", &data, "-o", &file, "-q", "--depth", "2", "--config", &config];
    let inspected = || {
        let said: serde_json::Value = serde_json::from_str(&ok(["inspect", &file, "--json"])).expect("JSON");
        ["steps", "seed"]
            .map(|field| said[field].as_u64())
            .into_iter()
            .chain([said["layers"][0]["outputs"].as_u64()])
            .flatten()
            .collect::<Vec<_>>()
    };
    ok(flags);
    assert_eq!(inspected(), [4, 3, 24]);
    // A flag replaces the file's value.
    ok([&flags[..], &["--width", "8", "--steps", "2", "--restart"]].concat());
    assert_eq!(inspected(), [2, 3, 8]);
    // The file's preset replaces the flag's default.
    let seed = folder.file("seed.toml", "preset = \"seed\"\n[optimiser]\nsteps = 1\n");
    let more = ["--width", "8", "--rays", "16", "--colour-width", "4", "--restart"];
    ok([&["fit", &data, "-o", &file, "-q", "--config", &seed], &more[..]].concat());
    assert!(has(&ok(["inspect", &file]), "samples_per_ray", "64"));
}

#[test]
fn settings_out_of_range_are_refused_naming_the_field() {
    let folder = Folder::new();
    let (data, file) = (folder.npz("data.npz"), folder.path("a.nerf"));
    let cases = [
        ("colour = 1", "colour"),
        ("[network]\nwidht = 16", "widht"),
        ("[optimizer]\nrate = 0.1", "optimizer"),
        ("[network]\nwidth = \"wide\"", "width"),
        ("[network]\nwidth = 0", "network.width"),
        ("[network]\nwidth = -1", "width"),
        ("[network]\ndepth = 1000", "network.depth"),
        ("[network]\nskip_after = 4", "network.skip_after"),
        ("[network]\nposition_levels = 40", "network.position_levels"),
        ("[network]\ndensity = \"tanh\"", "tanh"),
        ("[network]\ndensity_scale = nan", "network.density_scale"),
        ("[network]\ndensity_bias = inf", "network.density_bias"),
        ("[sampling]\nsamples = 5000", "sampling.samples"),
        ("[sampling]\nrays = 0", "sampling.rays"),
        // As many positions would take tens of gigabytes.
        ("[sampling]\nrays = 1000000\nsamples = 4096", "sampling.rays"),
        ("[sampling]\njitter = { width = -1.0 }", "sampling.jitter"),
        ("[sampling]\nnear = 6.0\nfar = 2.0", "near"),
        ("[sampling]\nnear = -1.0", "near"),
        ("[sampling]\nscene_box = [1.0, 0.0, 0.0, -1.0, 1.0, 1.0]", "box"),
        ("[occupancy]\nresolution = 513", "occupancy.resolution"),
        ("[occupancy]\nevery = 0", "occupancy.every"),
        ("[occupancy]\nthreshold = nan", "occupancy.threshold"),
        ("[occupancy]\nempty_weight = nan", "occupancy.empty_weight"),
        ("[occupancy]\nempty_weight = -1.0", "occupancy.empty_weight"),
        ("[optimiser]\nsteps = 0", "optimiser.steps"),
        ("[optimiser]\nrate = 0.0", "optimiser.rate"),
        ("[optimiser]\nrate = inf", "optimiser.rate"),
        ("[optimiser]\nfinal_share = 2.0", "optimiser.final_share"),
        ("[optimiser]\nbeta2 = 1.0", "optimiser.beta2"),
        ("[optimiser]\nepsilon = 0.0", "optimiser.epsilon"),
        ("[optimiser]\nepsilon = 1e-60", "optimiser.epsilon"),
        ("[optimiser]\nepsilon = nan", "optimiser.epsilon"),
        ("[optimiser]\naverage = 1.0", "optimiser.average"),
        ("preset = \"best\"", "best"),
        ("width = [", "run.toml"),
    ];
    for (text, field) in cases {
        let config = folder.file("run.toml", text);
        fails(["fit", &data, "-o", &file, "-q", "--config", &config], &[field]);
    }
    for (flags, field) in [
        (["--steps", "0"], "optimiser.steps"),
        (["--checkpoint-every", "nan"], "--checkpoint-every"),
        (["--checkpoint-every=-1", "--no-hull"], "--checkpoint-every"),
        (["--threads", "0"], "--threads"),
        (["--width", "100000"], "network.width"),
        (["--rate", "nan"], "optimiser.rate"),
        (["--set=sampling.jitter.width=-0.5", "--no-hull"], "jitter"),
        (["--set", "network.widht=8"], "--set: unknown field `widht`"),
        (["--set", "network.width"], "PATH=VALUE"),
        (["--max-seconds", "0"], "--max-seconds"),
        (["--max-seconds", "nan"], "--max-seconds"),
        (["--preset", "best"], "--preset"),
        (["--near", "9"], "near"),
        (["--config", "nowhere.toml"], "nowhere.toml"),
    ] {
        fails([&["fit", &data, "-o", &file, "-q"], &flags[..]].concat(), &[field]);
    }
    assert_eq!(folder.names(), ["data.npz", "run.toml"], "nothing is left of a refused run");
}

#[test]
fn closed_and_full_outputs_are_no_panic() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    let full = || std::fs::File::options().write(true).open("/dev/full");
    if !there_is("/dev/full", full().is_ok()) {
        return;
    }
    let commands: [&[&str]; 4] = [
        &["inspect", file],
        &["eval", file, &data, "-q"],
        &["render", file, "-q", "-o", &folder.path("to_nowhere.png"), "--width", "4"],
        &[
            "fit",
            &data,
            "-o",
            &folder.path("closed.nerf"),
            "--steps",
            "2",
            "--width",
            "8",
            "--depth",
            "1",
            "--restart",
        ],
    ];
    for args in commands {
        // A result that nobody gets is an error; what is only said may get lost.
        let result = ran(command(args).stdout(full().expect("/dev/full")));
        assert_eq!(result.code, Some(1), "{args:?}: {}", result.err);
        assert!(result.err.contains("standard output"), "{args:?}: {}", result.err);
        let result = ran(command(args).stderr(full().expect("/dev/full")));
        assert_eq!(result.code, Some(0), "{args:?}");
        // A reader that has seen enough, as `| head -1`, is no failure.
        let mut child =
            command(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the command starts");
        drop(child.stdout.take());
        let output = child.wait_with_output().expect("it ends");
        let err = String::from_utf8_lossy(&output.stderr);
        assert!(!err.contains("panicked") && output.status.success(), "{args:?}: {}: {err}", output.status);
    }
}
