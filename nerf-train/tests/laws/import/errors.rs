//! Checkpoints and occupancy grids that are refused, and what is said of them.

use super::made::{Checkpoint, Shape, npy};
use super::wide;
use nerf_train::measure::import::Identity;
use nerf_train::measure::import::Settings;
use nerf_train::measure::import::Tensors;
use nerf_train::measure::import::network;
use nerf_train::measure::import::occupancy;
use safetensors::Dtype;
use std::path::Path;

/// The error of importing a file.
fn error_of(file: &Path, settings: &Settings) -> anyhow::Error {
    let tensors = match Tensors::read(file, None) {
        Ok(tensors) => tensors,
        Err(error) => return error,
    };
    network(&tensors, settings).expect_err("an error")
}

fn assert_says(error: &anyhow::Error, words: &[&str]) {
    // The whole chain, as the command prints it.
    let text = format!("{error:#}");
    words.iter().for_each(|word| assert!(text.contains(word), "expected `{word}` in: {text}"));
}

/// The small network after a change, as both formats.
fn assert_refused(change: impl Fn(&mut Checkpoint), settings: &Settings, words: &[&str]) {
    let folder = tempfile::tempdir().expect("a folder");
    let mut checkpoint = Shape::small().checkpoint(1);
    change(&mut checkpoint);
    let files = [
        checkpoint.npz(&folder.path().join("made.npz"), "<f4"),
        checkpoint.safetensors(&folder.path().join("made.safetensors"), Dtype::F32),
    ];
    for file in files {
        let error = error_of(&file, settings);
        assert_says(&error, words);
        assert_says(&error, &["made."]);
    }
}

fn set(name: &'static str, shape: &'static [usize]) -> impl Fn(&mut Checkpoint) {
    move |checkpoint| {
        let length = shape.iter().product();
        checkpoint.0.insert(name.into(), (shape.to_vec(), vec![0.5; length]));
    }
}

#[test]
fn missing_and_unexpected_tensors_are_named() {
    for (name, shape) in [
        ("pts_linears.0.weight", "[width, encoded position]"),
        ("pts_linears.1.weight", "[width, 12] or, where [PE(x), h] enters, [width, 27]"),
        ("pts_linears.1.bias", "[8]"),
        ("alpha_linear.weight", "[1, 10]"),
        ("feature_linear.bias", "[10]"),
        ("views_linears.0.weight", "[width, 10 + encoded direction]"),
        ("rgb_linear.bias", "[3]"),
    ] {
        let remove = |checkpoint: &mut Checkpoint| drop(checkpoint.0.remove(name));
        assert_refused(remove, &wide(), &[name, shape, "no such tensor"]);
    }
    for name in ["pts_linears.0.scale", "rgb_linear.1.weight", "step", "pts_linears.x.weight"] {
        assert_refused(set(name, &[2, 3]), &wide(), &[name, "expected no such tensor", "[2, 3]"]);
    }
    // Both kinds of heads.
    let both = |checkpoint: &mut Checkpoint| {
        set("output_linear.weight", &[4, 10])(checkpoint);
        set("output_linear.bias", &[4])(checkpoint);
    };
    assert_refused(both, &wide(), &["alpha_linear.bias", "expected no such tensor"]);
}

#[test]
fn wrong_shapes_are_named_with_what_was_expected() {
    for (name, shape, expected) in [
        ("pts_linears.0.weight", &[12][..], "[width, encoded position]"),
        ("pts_linears.0.weight", &[0, 15], "1 to 512 rows"),
        ("pts_linears.0.weight", &[513, 15], "1 to 512 rows"),
        ("pts_linears.0.weight", &[12, 16], "6 for each level"),
        ("pts_linears.1.weight", &[8, 26], "[width, 12] or, where [PE(x), h] enters, [width, 27]"),
        ("pts_linears.2.weight", &[10, 8, 1], "[width, 8]"),
        ("pts_linears.2.bias", &[9], "[10]"),
        ("pts_linears.2.bias", &[10, 1], "[10]"),
        ("views_linears.0.weight", &[6, 9], "[width, 10 + encoded direction]"),
        ("views_linears.0.weight", &[6, 15], "6 for each level"),
        ("alpha_linear.weight", &[1, 11], "[1, 10]"),
        ("feature_linear.weight", &[10, 9], "[10, 10]"),
        ("rgb_linear.weight", &[3, 7], "[3, 6]"),
        // Rows before the bias, which would be short of them, too.
        ("alpha_linear.weight", &[2, 10], "[1, 10]"),
        ("feature_linear.weight", &[9, 10], "[10, 10]"),
        ("rgb_linear.weight", &[4, 6], "[3, 6]"),
    ] {
        assert_refused(set(name, shape), &wide(), &[expected]);
        if !expected.contains("levels") {
            assert_refused(set(name, shape), &wide(), &[name]);
        }
    }
    let encoded = |checkpoint: &mut Checkpoint| {
        set("pts_linears.0.weight", &[12, 3 + 6 * 17])(checkpoint);
        set("pts_linears.1.weight", &[8, 12])(checkpoint);
    };
    assert_refused(encoded, &wide(), &["position encoding", "1 to 16 levels", "found 17"]);
    let deep = |layers: &'static str, index: usize| {
        move |checkpoint: &mut Checkpoint| {
            checkpoint.0.insert(format!("{layers}.{index}.weight"), (vec![1], vec![0.0]));
        }
    };
    assert_refused(deep("pts_linears", 16), &wide(), &["pts_linears", "at most 16 layers", "found 17"]);
    assert_refused(deep("views_linears", 4), &wide(), &["views_linears", "at most 4 layers", "found 5"]);
    assert_refused(deep("pts_linears", usize::MAX), &wide(), &["pts_linears", "at most 16 layers"]);
    let many = |checkpoint: &mut Checkpoint| {
        checkpoint.0.extend((0..100).map(|i| (format!("rgb_linear.{i}"), (vec![1], vec![0.0]))));
    };
    assert_refused(many, &wide(), &["at most 64 tensors", "found 114"]);
}

#[test]
fn flags_that_the_file_contradicts_are_refused() {
    let same = |_: &mut Checkpoint| {};
    let settings = Settings { position_levels: Some(10), ..wide() };
    assert_refused(
        same,
        &settings,
        &["pts_linears.0.weight", "63 (10 levels)", "encoded position", "found 15"],
    );
    let settings = Settings { direction_levels: Some(4), ..wide() };
    assert_refused(
        same,
        &settings,
        &["views_linears.0.weight", "27 (4 levels)", "encoded direction", "found 9"],
    );
    let settings = Settings { identity: Some(Identity::None), ..wide() };
    assert_refused(same, &settings, &["pts_linears.0.weight", "identity none", "found 15"]);
    let without = set("pts_linears.0.weight", &[12, 12]);
    let settings = Settings { identity: Some(Identity::First), ..wide() };
    assert_refused(without, &settings, &["pts_linears.0.weight", "identity first", "found 12"]);
}

#[test]
fn numbers_that_are_none_are_refused_naming_their_place() {
    for (value, word) in [(f64::NAN, "NaN"), (f64::INFINITY, "inf"), (f64::NEG_INFINITY, "-inf")] {
        let spoil = |checkpoint: &mut Checkpoint| {
            checkpoint.0.get_mut("pts_linears.1.weight").expect("a tensor").1[7] = value;
        };
        assert_refused(spoil, &wide(), &["pts_linears.1.weight", "finite", word, "index 7"]);
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let mut large = Shape::small().checkpoint(1);
    large.0.get_mut("rgb_linear.bias").expect("a tensor").1[2] = 1e300;
    let file = large.npz(&path("large.npz"), "<f8");
    assert_says(&error_of(&file, &wide()), &["large.npz", "rgb_linear.bias", "inf", "index 2"]);
    let whole = Shape::small().checkpoint(1);
    let file = whole.npz(&path("whole.npz"), "<i4");
    assert_says(&error_of(&file, &wide()), &["whole.npz", "alpha_linear.bias", "f2, f4 or f8", "i4"]);
    let file = whole.safetensors(&path("whole.safetensors"), Dtype::I32);
    assert_says(&error_of(&file, &wide()), &["whole.safetensors", "alpha_linear.bias", "BF16", "I32"]);
    let file = whole.npz_twice(&path("twice.npz"), "<f4", Some("rgb_linear.bias"));
    let words = ["twice.npz: rgb_linear.bias: expected one tensor of this name, found two"];
    assert_says(&error_of(&file, &wide()), &words);
}

#[test]
fn files_that_are_no_network_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let checkpoint = Shape::small().checkpoint(1);
    for (name, bytes) in [
        ("cut.npz", std::fs::read(checkpoint.npz(&path("a.npz"), "<f4")).expect("read")),
        ("cut.safetensors", {
            let file = checkpoint.safetensors(&path("a.safetensors"), Dtype::F32);
            std::fs::read(file).expect("read")
        }),
    ] {
        for length in [0, 7, 100, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(path(name), &bytes[..length]).expect("written");
            assert_says(&error_of(&path(name), &wide()), &[name]);
        }
        assert_says(&error_of(&path("nowhere").join(name), &wide()), &[name, "no such file"]);
    }
    for name in ["network.pth", "network"] {
        assert_says(&error_of(&path(name), &wide()), &[name, ".npz or .safetensors"]);
    }
    let mut other = Checkpoint::default();
    let file = other.npz(&path("empty.npz"), "<f4");
    assert_says(&error_of(&file, &wide()), &["pts_linears.0.weight", "found none"]);
    other.0.insert("mlp.0.weight".into(), (vec![2, 2], vec![0.0; 4]));
    let file = other.npz(&path("other.npz"), "<f4");
    assert_says(&error_of(&file, &wide()), &["pts_linears.0.weight", "only mlp.0.weight"]);
    let mut two = checkpoint.prefixed("a.");
    two.0.extend(checkpoint.prefixed("b.").0);
    let file = two.npz(&path("two.npz"), "<f4");
    assert_says(&error_of(&file, &wide()), &["one network", "`a.`, `b.`", "--prefix"]);
    assert!(Tensors::read(&file, Some("b.")).is_ok());
    let error = Tensors::read(&file, Some("c.")).expect_err("none");
    assert_says(&error, &["two.npz", "a.alpha_linear.bias", "more"]);
}

#[test]
fn occupancies_are_read_x_slowest_and_refused_naming_the_fault() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("occupancy.npy");
    let write = |dtype: &str, shape: &[usize], values: &[f64]| {
        std::fs::write(&file, npy(dtype, shape, values)).expect("written");
        occupancy::read(&file, &wide())
    };
    let mut values = vec![0.0; 24];
    // (1, 2, 3) of 2 × 3 × 4.
    values[(3 + 2) * 4 + 3] = 1.0;
    values[1] = 1.0;
    for dtype in ["|b1", "|u1", "<f4"] {
        let cells = write(dtype, &[2, 3, 4], &values).expect("an occupancy grid");
        assert_eq!(cells.resolution(), [2, 3, 4]);
        assert_eq!(cells.bits(), [2, 0, 128], "{dtype}");
        assert_eq!(cells.bounds().max.to_array(), [8.0; 3]);
    }
    for (dtype, shape, values, words) in [
        ("|b1", &[6, 4][..], &values, ["shape [x, y, z]", "[6, 4]"]),
        ("|b1", &[0, 3, 4], &vec![], ["sides of 1 to 512", "[0, 3, 4]"]),
        ("|b1", &[513, 1, 1], &vec![1.0; 513], ["sides of 1 to 512", "[513, 1, 1]"]),
        ("|u1", &[1, 1, 2], &vec![0.0, 2.0], ["zeros and ones", "2 at index 1"]),
        ("<f4", &[1, 1, 2], &vec![f64::NAN, 1.0], ["zeros and ones", "NaN at index 0"]),
        ("|b1", &[1, 1, 2], &vec![0.0, 0.0], ["one occupied cell", "none"]),
    ] {
        let error = write(dtype, shape, values).expect_err("no occupancy grid");
        assert_says(&error, &["occupancy.npy", words[0], words[1]]);
    }
    std::fs::write(&file, &npy("|b1", &[2, 3, 4], &values)[..90]).expect("written");
    assert_says(&occupancy::read(&file, &wide()).expect_err("cut"), &["occupancy.npy"]);
    let missing = occupancy::read(Path::new("nowhere.npy"), &wide()).expect_err("missing");
    assert_says(&missing, &["nowhere.npy", "no such file"]);
}

#[test]
fn settings_out_of_range_name_their_flag() {
    assert!(wide().check().is_ok());
    let base = wide;
    for (field, wrong) in [
        ("near, far", Settings { near: 6.0, far: 2.0, ..base() }),
        ("near, far", Settings { near: -1.0, ..base() }),
        ("near, far", Settings { far: f32::INFINITY, ..base() }),
        ("box", Settings { scene_box: [1.0, 0.0, 0.0, -1.0, 1.0, 1.0], ..base() }),
        ("box", Settings { scene_box: [f32::NAN, 0.0, 0.0, 1.0, 1.0, 1.0], ..base() }),
        ("samples", Settings { samples: Some(0), ..base() }),
        ("samples", Settings { samples: Some(4097), ..base() }),
        ("coarse_samples", Settings { coarse_samples: 0, ..base() }),
        ("coarse_samples", Settings { coarse_samples: 4097, ..base() }),
        ("background", Settings { background: [0.0, 0.0, 1.5], ..base() }),
        ("occupancy_resolution", Settings { occupancy_resolution: 513, ..base() }),
        ("occupancy_threshold", Settings { occupancy_threshold: f32::NAN, ..base() }),
    ] {
        match wrong.check() {
            Err(error) => assert!(error.to_string().starts_with(&format!("{field}: expected ")), "{error}"),
            Ok(()) => panic!("{field} is accepted"),
        }
    }
}
