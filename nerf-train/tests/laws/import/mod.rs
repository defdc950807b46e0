//! Networks from elsewhere: what is imported is the function that was trained.

mod coarse;
mod errors;
pub mod made;
mod oracle;
mod reference;

use made::{Checkpoint, Shape};
use nerf_core::Kernel;
use nerf_core::blob::{Blob, Content, Provenance};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::Renderer;
use nerf_train::measure::import::AngleFactor;
use nerf_train::measure::import::Identity;
use nerf_train::measure::import::Imported;
use nerf_train::measure::import::Order;
use nerf_train::measure::import::RawDensity;
use nerf_train::measure::import::Settings;
use nerf_train::measure::import::Tensors;
use nerf_train::measure::import::network;
use nerf_train::model::export::Contents;
use nerf_train::model::export::Tables;
use nerf_train::model::export::export;
use oracle::Oracle;
use safetensors::Dtype;
use std::path::Path;

/// Sigma and rgb at points.
type Answers = Vec<(f32, [f32; 3])>;

/// In a box that holds all points that are asked about.
fn wide() -> Settings {
    Settings { scene_box: [-8.0, -8.0, -8.0, 8.0, 8.0, 8.0], ..Settings::default() }
}

/// The answers of an imported network: with weights in f32, and as its blob has them.
fn ask(
    imported: &Imported,
    settings: &Settings,
    kernel: Kernel,
    points: &[[f32; 3]],
    dirs: &[[f32; 3]],
) -> [Answers; 2] {
    let parameters = imported.folded();
    let provenance = Provenance { data: "", made_by: "", ..Provenance::NONE };
    let exported = export(&Contents {
        architecture: &imported.model.architecture,
        parameters: &parameters,
        tables: Tables::None,
        content: Content::Scene(settings.facts(false, false)),
        occupancy: None,
        provenance,
    });
    let bytes = exported.expect("a blob").bytes;
    let blob = Blob::open(&bytes).expect("a blob");
    let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::FULL).expect("a plan");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let unrounded = Renderer::with_parameters(blob.clone(), kernel, &parameters, None).expect("enough");
    let rounded = Renderer::new(blob.clone(), kernel, &mut memory).expect("enough");
    [unrounded, rounded].map(|renderer| {
        let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
        let (mut sigma, mut rgb) = (vec![0.0; points.len()], vec![[0.0; 3]; points.len()]);
        renderer.query(&plan, points, dirs, &mut workspace, &mut sigma, &mut rgb).expect("answers");
        sigma.into_iter().zip(rgb).collect()
    })
}

fn kernels() -> [Kernel; 2] {
    [Kernel::IN_PLACE, Kernel::detect()]
}

fn read(path: &Path, settings: &Settings) -> Imported {
    let tensors = Tensors::read(path, None).expect("tensors");
    network(&tensors, settings).expect("a network")
}

/// Points and unit directions all over the box.
fn points() -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let at = |i: usize, p: f32| ((i as f32 + 1.0) * p).sin();
    let points = (0..50).map(|i| [1.7 * at(i, 0.7), 1.3 * at(i, 1.9), 2.1 * at(i, 3.1)]).collect();
    let dir = |i| glam::Vec3::new(at(i, 2.3), at(i, 0.4), at(i, 1.1)).normalize().to_array();
    (points, (0..50).map(dir).collect())
}

/// Whether `a` is within 1e-4 · max(1, |b|) of `b`.
fn close(a: f32, b: f64) -> bool {
    (f64::from(a) - b).abs() <= 1e-4 * b.abs().max(1.0)
}

/// The import of `checkpoint` against the formulas in f64, with every kernel.
fn assert_same(path: &Path, checkpoint: &Checkpoint, oracle: &Oracle, settings: &Settings, what: &str) {
    let imported = read(path, settings);
    let (points, dirs) = points();
    for kernel in kernels() {
        let [found, _] = ask(&imported, settings, kernel, &points, &dirs);
        let mut seen = 0;
        for ((p, d), (sigma, rgb)) in points.iter().zip(&dirs).zip(found) {
            let (expected_sigma, expected_rgb) = oracle.forward(checkpoint, *p, *d);
            assert!(close(sigma, expected_sigma), "{what}, {kernel:?}: {sigma}, {expected_sigma}");
            // Where nothing is there is no colour.
            if sigma > 0.0 {
                let same = rgb.iter().zip(expected_rgb).all(|(&a, b)| close(a, b));
                assert!(same, "{what}, {kernel:?}: {rgb:?}, {expected_rgb:?}");
                seen += 1;
            }
        }
        assert!(seen >= 5, "{what}: {seen} points of density");
    }
}

#[test]
fn what_is_imported_is_the_function_that_was_trained() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let small = Shape::small();
    let shapes = [
        ("small", small.clone()),
        ("no skip", Shape { skips: vec![], ..small.clone() }),
        ("two skips", Shape { skips: vec![0, 1], ..small.clone() }),
        ("one layer", Shape { trunk: vec![9], skips: vec![], ..small.clone() }),
        ("ten layers", Shape { trunk: vec![8; 10], skips: vec![4], ..small.clone() }),
        ("no directions", Shape { direction: None, ..small.clone() }),
        ("raw direction", Shape { direction: Some(3), ..small.clone() }),
        ("deep colours", Shape { views: vec![8, 7, 6], ..small.clone() }),
        ("ten and four levels", Shape { position: 63, direction: Some(27), ..small.clone() }),
        ("no identity", Shape { position: 12, direction: Some(6), ..small }),
    ];
    for (seed, (what, shape)) in shapes.into_iter().enumerate() {
        let checkpoint = shape.checkpoint(seed as u64);
        for angle in [AngleFactor::One, AngleFactor::Pi] {
            let settings = Settings { angle_scale: angle, ..wide() };
            let oracle = Oracle::of(&shape, &settings);
            let npz = checkpoint.npz(&path("a.npz"), "<f4");
            assert_same(&npz, &checkpoint, &oracle, &settings, what);
            let safe = checkpoint.safetensors(&path("a.safetensors"), Dtype::F32);
            assert_same(&safe, &checkpoint, &oracle, &settings, what);
        }
    }
}

#[test]
fn orders_places_of_the_identity_and_activations_are_as_told() {
    use clap::ValueEnum;
    let folder = tempfile::tempdir().expect("a folder");
    let shape = Shape { position: 3 + 6 * 3, direction: Some(3 + 6 * 2), ..Shape::small() };
    let checkpoint = shape.checkpoint(7);
    let npz = checkpoint.npz(&folder.path().join("a.npz"), "<f8");
    for &order in Order::value_variants() {
        for identity in [Identity::First, Identity::Last] {
            for &density in RawDensity::value_variants() {
                let settings = Settings { order, identity: Some(identity), density, ..wide() };
                let what = format!("{order:?}, {identity:?}, {density:?}");
                assert_same(&npz, &checkpoint, &Oracle::of(&shape, &settings), &settings, &what);
            }
        }
    }
}

#[test]
fn types_of_numbers_and_prefixes_do_not_matter() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let checkpoint = Shape::small().checkpoint(3);
    let whole = read(&checkpoint.npz(&path("whole.npz"), "<f4"), &wide()).folded();
    for dtype in ["<f2", "<f8"] {
        assert_eq!(read(&checkpoint.npz(&path("a.npz"), dtype), &wide()).folded(), whole, "{dtype}");
    }
    for dtype in [Dtype::F16, Dtype::BF16, Dtype::F32, Dtype::F64] {
        let file = checkpoint.safetensors(&path("a.safetensors"), dtype);
        assert_eq!(read(&file, &wide()).folded(), whole, "{dtype:?}");
    }
    for prefix in ["module.", "network_fine.", "model.network_fine.module."] {
        let file = checkpoint.prefixed(prefix).npz(&path("p.npz"), "<f4");
        let tensors = Tensors::read(&file, None).expect("tensors");
        assert_eq!((tensors.prefix.as_str(), tensors.others.len()), (prefix, 0));
        assert_eq!(network(&tensors, &wide()).expect("a network").folded(), whole);
    }
    // Of a coarse and a fine network the fine one; any by name.
    let mut both = checkpoint.prefixed("network_fine.");
    let coarse = Shape { trunk: vec![5], skips: vec![], ..Shape::small() }.checkpoint(4);
    both.0.extend(coarse.prefixed("network_fn.").0);
    let file = both.safetensors(&path("both.safetensors"), Dtype::F32);
    let tensors = Tensors::read(&file, None).expect("tensors");
    assert_eq!((tensors.prefix.as_str(), tensors.others), ("network_fine.", vec!["network_fn.".to_owned()]));
    assert_eq!(read(&file, &wide()).folded(), whole);
    let tensors = Tensors::read(&file, Some("network_fn.")).expect("tensors");
    let architecture = network(&tensors, &wide()).expect("a network").model.architecture;
    assert_eq!((architecture.trunk.len(), architecture.trunk[0].width), (1, 5));
}

#[test]
fn a_layer_that_no_output_depends_on_is_passed_over() {
    // nerf-pytorch makes views_linears.0, and a fifth output, also where it uses neither.
    let folder = tempfile::tempdir().expect("a folder");
    let shape = Shape { direction: None, ..Shape::small() };
    let mut checkpoint = shape.checkpoint(5);
    let plain = read(&checkpoint.npz(&folder.path().join("a.npz"), "<f4"), &wide());
    checkpoint.0.insert("views_linears.0.weight".into(), (vec![5, 10], vec![0.5; 50]));
    checkpoint.0.insert("views_linears.0.bias".into(), (vec![5], vec![0.5; 5]));
    for (name, row) in [("output_linear.weight", vec![9.0; 10]), ("output_linear.bias", vec![9.0])] {
        let (shape, values) = checkpoint.0.get_mut(name).expect("a tensor");
        shape[0] = 5;
        values.extend(row);
    }
    let idle = read(&checkpoint.npz(&folder.path().join("b.npz"), "<f4"), &wide());
    assert_eq!(idle.unused, ["views_linears.0.bias", "views_linears.0.weight"]);
    assert_eq!((plain.unused.len(), plain.folded()), (0, idle.folded()));
}
