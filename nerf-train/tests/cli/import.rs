//! `import`: networks from elsewhere through the command line.

use crate::checkpoint::{Checkpoint, Shape, npy};
use crate::{blob, fails, ok, ran};
use nerf_core::blob::Blob;
use nerf_core::network::{Role, unpack};
use std::path::Path;

/// The fitted blob's network in nerf-pytorch's names, with a feature layer that changes nothing.
fn checkpoint_of(blob: &Blob<'_>) -> Checkpoint {
    let mut parameters = vec![0.0; blob.architecture().parameters()];
    unpack(blob.weights(), &mut parameters);
    let mut made = Checkpoint::default();
    let mut put = |name: &str, outputs: usize, weight: Vec<f64>, bias: Vec<f64>| {
        made.0.insert(format!("{name}.weight"), (vec![outputs, weight.len() / outputs], weight));
        made.0.insert(format!("{name}.bias"), (vec![outputs], bias));
    };
    let width = blob.architecture().trunk_width();
    let identity = (0..width * width).map(|i| if i % (width + 1) == 0 { 1.0 } else { 0.0 });
    put("feature_linear", width, identity.collect(), vec![0.0; width]);
    for layer in blob.layers() {
        let values = |from: usize, count: usize| parameters[from..][..count].iter().map(|&v| f64::from(v));
        let name = match layer.role {
            Role::Trunk(i) => format!("pts_linears.{i}"),
            Role::Density => "alpha_linear".into(),
            Role::Colour(i) => format!("views_linears.{i}"),
            Role::Rgb => "rgb_linear".into(),
        };
        let weight = values(layer.weights, layer.macs()).collect();
        put(&name, layer.outputs, weight, values(layer.bias, layer.outputs).collect());
    }
    made
}

#[test]
fn a_network_that_goes_out_and_comes_back_is_the_same() {
    let (folder, file) = blob();
    let data = folder.path("scene.npz");
    let bytes = std::fs::read(file).expect("a blob");
    let fitted = Blob::open(&bytes).expect("a blob");
    let scene = fitted.scene().expect("a scene");
    let path = folder.path("out.npz");
    checkpoint_of(&fitted).prefixed("module.").npz(Path::new(&path), "<f4");
    let occupancy = fitted.occupancy().expect("an occupancy grid");
    let sides = occupancy.resolution().map(usize::from);
    let cells: Vec<f64> =
        (0..sides.iter().product()).map(|i| f64::from(u8::from(occupancy.bit(i)))).collect();
    let grid_file = folder.file("out_grid.npy", npy("|b1", &sides, &cells));
    let comma = |values: &[f32]| values.iter().map(f32::to_string).collect::<Vec<_>>().join(",");
    let numbers = [scene.near, scene.far].map(|distance| distance.to_string());
    let (samples, bounds) = (scene.samples().to_string(), comma(&[scene.min, scene.max].concat()));
    let back = folder.path("back.nerf");
    let args = ["import", &path, "-o", &back, "--occupancy", &grid_file, "--angle-scale", "pi"];
    let settings = ["--near", &numbers[0], "--far", &numbers[1], "--box", &bounds, "--position-levels", "4"];
    let args = [&args[..], &settings[..]].concat();
    let with = |more: &[&str]| ok([&args[..], more].concat());
    let text = with(&["--samples", &samples]);
    for (field, value) in [
        ("prefix", "module."),
        ("angle_scale", "pi"),
        ("samples_per_ray", &*samples),
        ("occupancy_required", "yes"),
        ("blob", &back),
    ] {
        assert!(crate::has(&text, field, value), "{field}: {text}");
    }
    let bytes = std::fs::read(&back).expect("a blob");
    let imported = Blob::open(&bytes).expect("a blob");
    assert_eq!(imported.weights(), fitted.weights());
    assert_eq!(imported.architecture(), fitted.architecture());
    assert!(imported.scene().expect("a scene").occupancy_required);
    assert!(imported.provenance().made_by.contains("imported from out.npz"));
    for (cell, live) in cells.iter().enumerate() {
        assert_eq!(imported.occupancy().expect("an occupancy grid").bit(cell), *live == 1.0);
    }
    // Said otherwise, it is not.
    let json = |more: &[&str]| -> serde_json::Value {
        serde_json::from_str(&with(&[more, &["--json", "--quiet"]].concat())).expect("an object")
    };
    let object = json(&["--occupancy-optional", "--samples", "8"]);
    assert_eq!((&object["occupancy_required"], &object["samples_per_ray"]), (&false.into(), &8.into()));

    // Checked on every third pixel, over what is behind the scene.
    let object = json(&["--samples", &samples, "--check", &data]);
    let psnr = object["check_psnr_db"].as_f64().expect("a number");
    let whole = ok(["eval", &back, &data, "--json", "--quiet"]);
    let whole: serde_json::Value = serde_json::from_str(&whole).expect("an object");
    let expected = whole["val_psnr_db"].as_f64().expect("a number");
    assert!((psnr - expected).abs() < 1.5, "{psnr}, {expected}");
    assert_eq!(object["check_views"].as_u64(), Some(2));
    assert!(object["quantisation_loss_db"].as_f64().is_some_and(|db| db.abs() < 0.01), "{object}");
    assert!(object["occupancy_gain_db"].is_number() && object["suspicious"].is_boolean());
    assert_eq!(
        object["trained_parameters"].as_u64().expect("n"),
        imported.architecture().parameters() as u64 + 272
    );
    let described = ok(["inspect", &back]);
    assert!(described.contains("mean over 2 views, every third pixel"), "{described}");
    let one = json(&["--samples", &samples, "--check", &data, "--view", "1"]);
    assert_eq!(one["check_views"].as_u64(), Some(1));
}

#[test]
fn weights_that_become_f16_subnormals_are_counted() {
    let (folder, _) = blob();
    let (data, path, output) =
        (folder.path("scene.npz"), folder.path("subnormal.npz"), folder.path("subnormal.nerf"));
    for expected in [0, 300] {
        let mut made = Shape::small().checkpoint(6);
        // The first layer's 180 weights, and 120 of the second's.
        let layers = [("pts_linears.0.weight", 0), ("pts_linears.1.weight", 180)];
        for (name, before) in layers {
            let weights = &mut made.0.get_mut(name).expect("a tensor").1;
            let count = weights.len().min(expected - before.min(expected));
            weights[..count].fill(1e-6);
        }
        made.npz(Path::new(&path), "<f4");
        let args = ["import", &path, "-o", &output, "--occupancy-resolution", "8", "--check", &data];
        let object = ok(args.into_iter().chain(["--json", "--quiet"]));
        let object: serde_json::Value = serde_json::from_str(&object).expect("an object");
        assert_eq!(object["subnormal_weights"].as_u64(), Some(expected as u64), "{object}");
        // So many there are in the blob.
        let bytes = std::fs::read(&output).expect("a blob");
        let imported = Blob::open(&bytes).expect("a blob");
        let halves = imported.weights().chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]));
        let found = halves.filter(|half| half.classify() == std::num::FpCategory::Subnormal).count();
        assert_eq!(found, expected);
    }
}

#[test]
fn what_shows_no_scene_is_said_to() {
    let (folder, _) = blob();
    let data = folder.path("scene.npz");
    // Opaque and white all over.
    let mut white = Shape::small().checkpoint(1);
    white.0.get_mut("alpha_linear.bias").expect("a tensor").1[0] = 1000.0;
    white.0.get_mut("rgb_linear.bias").expect("a tensor").1.fill(1000.0);
    let path = folder.path("white.safetensors");
    white.safetensors(Path::new(&path), safetensors::Dtype::F32);
    let output = folder.path("white.nerf");
    let mut command =
        crate::command(["import", &path, "-o", &output, "--check", &data, "--occupancy-resolution", "8"]);
    let ran = ran(&mut command);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for word in ["warning", "no picture of the scene", "--angle-scale", "--axes", "--order", "--background"] {
        assert!(ran.err.contains(word), "expected `{word}` in: {}", ran.err);
    }
    assert!(crate::has(&ran.out, "suspicious", "yes"), "{}", ran.out);
    assert!(Path::new(&output).exists());
    // Nothing anywhere: no occupancy grid, and that is said.
    let mut empty = Shape::small().checkpoint(1);
    empty.0.get_mut("alpha_linear.bias").expect("a tensor").1[0] = -1000.0;
    let path = folder.path("empty.safetensors");
    empty.safetensors(Path::new(&path), safetensors::Dtype::F32);
    let mut command =
        crate::command(["import", &path, "-o", &output, "--occupancy-resolution", "8", "--quiet"]);
    let ran = crate::ran(&mut command);
    assert!(ran.code == Some(0) && ran.err.contains("nowhere above the threshold"), "{}", ran.err);
}

#[test]
fn wrong_arguments_and_files_leave_nothing_behind() {
    let (folder, file) = blob();
    let (data, output) = (folder.path("scene.npz"), folder.path("refused.nerf"));
    let path = folder.path("small.npz");
    Shape::small().checkpoint(2).npz(Path::new(&path), "<f4");
    let occupancy = folder.file("flat.npy", npy("|b1", &[2, 2], &[1.0; 4]));
    for (args, words) in [
        (&["nowhere.npz"][..], &["nowhere.npz", "no such file"][..]),
        (&[file], &["scene.nerf", ".npz or .safetensors"]),
        (&[&data], &["scene.npz", "pts_linears.0.weight"]),
        (&[&path, "--prefix", "other."], &["small.npz", "pts_linears"]),
        (&[&path, "--position-levels", "10"], &["small.npz", "pts_linears.0.weight", "63 (10 levels)"]),
        (&[&path, "--near", "5", "--far", "4"], &["near, far", "near 5, far 4"]),
        (&[&path, "--box", "0,0,0,0,1,1"], &["box"]),
        (&[&path, "--box", "0,0,1"], &["--box", "6 numbers"]),
        (&[&path, "--samples", "5000"], &["samples", "4096", "5000"]),
        (&[&path, "--coarse-samples", "8"], &["--coarse"]),
        (&[&path, "--coarse-prefix", "a."], &["--coarse"]),
        (&[&path, "--coarse", &path, "--coarse-samples", "0"], &["coarse_samples", "4096"]),
        (&[&path, "--coarse", "nowhere.npz"], &["nowhere.npz", "no such file"]),
        (&[&path, "--coarse", &data], &["scene.npz", "pts_linears.0.weight"]),
        (&[&path, "--angle-scale", "2"], &["--angle-scale", "2"]),
        (&[&path, "--order", "mine"], &["--order", "halves-by-input"]),
        (&[&path, "--background", "beige"], &["--background", "beige"]),
        (&[&path, "--occupancy", &occupancy], &["flat.npy", "[x, y, z]", "[2, 2]"]),
        (&[&path, "--occupancy", &occupancy, "--no-occupancy"], &["--occupancy", "--no-occupancy"]),
        (&[&path, "--occupancy-optional"], &["--occupancy"]),
        (&[&path, "--view", "1"], &["--check"]),
        (&[&path, "--check", &data, "--view", "9"], &["--view", "0 to 1", "9"]),
        (&[&path, "--check", "nowhere"], &["nowhere"]),
        (&[&path, "--box", "-1e5,-1,-1,1e5,1,1"], &["scene box"]),
    ] {
        fails([&["import", "-o", &output], args].concat(), words);
        assert!(!Path::new(&output).exists(), "{args:?}");
    }
    let mut wide = Shape::small().checkpoint(2);
    wide.0.get_mut("pts_linears.0.bias").expect("a tensor").1[3] = 70_000.0;
    wide.npz(Path::new(&path), "<f4");
    fails(["import", &path, "-o", &output], &["Trunk(0)", "65504", "70000"]);
    fails(["import", &path, "-o", &folder.path("")], &["folder"]);
    assert!(!Path::new(&output).exists());
}

#[test]
fn a_coarse_network_becomes_the_proposal_and_is_measured_with_it() {
    let (folder, _) = blob();
    let data = folder.path("scene.npz");
    let path = |name: &str| folder.path(name);
    let (fine, coarse, output) = (path("fine.npz"), path("coarse.npz"), path("both.nerf"));
    Shape::small().checkpoint(3).npz(Path::new(&fine), "<f4");
    Shape { trunk: vec![9, 7], ..Shape::small() }.checkpoint(4).npz(Path::new(&coarse), "<f4");
    let args = ["import", &fine, "--coarse", &coarse, "-o", &output, "--occupancy-resolution", "8"];
    let text = ok(args.into_iter().chain(["--coarse-samples", "10", "--samples", "20"]));
    for (field, samples) in [("coarse_samples_per_ray", "10"), ("samples_per_ray", "20")] {
        assert!(crate::has(&text, field, samples), "{field}: {text}");
    }
    let described = ok(["inspect", &output]);
    assert!(crate::has(&described, "proposal_samples_per_ray", "10"), "{described}");
    let json = |args: &[&str]| -> serde_json::Value {
        serde_json::from_str(&ok(args.iter().copied().chain(["--json", "--quiet"]))).expect("an object")
    };
    let [on, off] = [
        json(&["eval", &output, &data, "--every", "2", "--exact"]),
        json(&["eval", &output, &data, "--every", "2", "--exact", "--no-proposal"]),
    ];
    let number = |object: &serde_json::Value, name| object[name].as_f64().expect("a number");
    assert!(number(&on, "proposal_evaluations_per_ray") > 0.0);
    assert_eq!(number(&off, "proposal_evaluations_per_ray"), 0.0);
    assert!(number(&on, "macs") > number(&off, "macs"));
    // As the original has it where nothing is said.
    ok(args);
    let described = ok(["inspect", &output]);
    for (field, samples) in [("proposal_samples_per_ray", "64"), ("samples_per_ray", "128")] {
        assert!(crate::has(&described, field, samples), "{field}: {described}");
    }
}
