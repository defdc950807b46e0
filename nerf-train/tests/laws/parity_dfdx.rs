//! nerf-core computes the network that dfdx does.

use nerf_core::Kernel;
use nerf_core::blob::{Blob, Content, Provenance, SceneFacts, SceneSampling};
use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
use nerf_core::memory::Line;
use nerf_core::network::{Architecture, DensityActivation, Shading, TrunkLayer};
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::Renderer;
use nerf_core::sampling::{Purpose, uniform};
use nerf_train::model::engine::Adam;
use nerf_train::model::engine::Model;
use nerf_train::model::engine::ReferenceEngine;
use nerf_train::model::export::Contents;
use nerf_train::model::export::Tables;
use nerf_train::model::export::export;

/// Points asked: whole blocks and a rest.
const POINTS: usize = 150;

fn encoding(levels: u8) -> SinusoidalEncoding {
    SinusoidalEncoding { inputs: 3, levels, scale: AngleScale::Pi, identity: true }
}

fn trunk(depth: usize, width: u16, skip: usize) -> impl Iterator<Item = TrunkLayer> {
    (0..depth).map(move |i| TrunkLayer { width, skip: i > 0 && i == skip })
}

fn models() -> Vec<(&'static str, Model)> {
    let mut plain = Model::plain(Architecture {
        position: encoding(10).into(),
        direction: Some(encoding(4).into()),
        trunk: trunk(4, 128, 0).collect(),
        density: Some(DensityActivation::Relu),
        colour: [64].into_iter().collect(),
        shading: Shading::PerSample,
    });
    plain.density_bias = 0.3;
    let with = |change: &dyn Fn(&mut Model)| {
        let mut model = plain.clone();
        change(&mut model);
        model
    };
    vec![
        (
            "seed: 8×64, skip after 4, feature",
            with(&|m| {
                m.architecture.trunk = trunk(8, 64, 4).collect();
                m.architecture.colour = [32].into_iter().collect();
                m.feature = true;
            }),
        ),
        ("small: 4×128, scaled density", with(&|m| (m.density_scale, m.density_bias) = (20.0, 2.0))),
        (
            "softplus, odd widths, skip into the last layer",
            with(&|m| {
                m.architecture.trunk = trunk(3, 19, 2).collect();
                m.architecture.colour = [7].into_iter().collect();
                m.architecture.density = Some(DensityActivation::ShiftedSoftplus);
            }),
        ),
        (
            "no direction, no colour layer, feature into the colours",
            with(&|m| {
                m.architecture.direction = None;
                m.architecture.colour.clear();
                m.feature = true;
            }),
        ),
        (
            "two colour layers behind a feature layer",
            with(&|m| {
                m.architecture.trunk = trunk(2, 33, 1).collect();
                m.architecture.colour = [20, 12].into_iter().collect();
                m.feature = true;
            }),
        ),
        (
            "one layer, no levels",
            with(&|m| {
                m.architecture.position = encoding(0).into();
                m.architecture.trunk = trunk(1, 16, 0).collect();
            }),
        ),
        ("L = 16", with(&|m| m.architecture.position = encoding(16).into())),
    ]
}

/// Repeatable values in [-1, 1).
fn noise(n: usize, seed: u32) -> Vec<f32> {
    let unit = |i| uniform(seed.into(), Purpose::Parameters, 0, i as u64);
    (0..n).map(|i| 2.0 * unit(i) - 1.0).collect()
}

/// Start values, made larger: signals of a fitted network's size, densities beyond 0.
fn parameters(model: &Model) -> Vec<f32> {
    let mut parameters = model.initial_parameters(7);
    parameters.iter_mut().for_each(|p| *p *= 2.0);
    parameters
}

fn blob(model: &Model, folded: &[f32]) -> Vec<u8> {
    let scene = SceneFacts {
        min: [-1.0; 3],
        max: [1.0; 3],
        near: 1.0,
        far: 5.0,
        sampling: SceneSampling::Bins(8),
        background: [0.0; 3],
        occupancy_required: false,
        viewpoint: None,
    };
    let provenance = Provenance { data: "noise", made_by: "test", ..Provenance::NONE };
    let contents = Contents {
        architecture: &model.architecture,
        parameters: folded,
        tables: Tables::None,
        content: Content::Scene(scene),
        occupancy: None,
        provenance,
    };
    export(&contents).expect("weights of ordinary size").bytes
}

fn points() -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let triples = |seed| noise(3 * POINTS, seed).chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
    let (positions, mut dirs): (Vec<_>, Vec<[f32; 3]>) = (triples(1), triples(2));
    for dir in &mut dirs {
        let length = dir.iter().map(|c| c * c).sum::<f32>().sqrt();
        *dir = dir.map(|c| c / length);
    }
    (positions, dirs)
}

type Answers = (Vec<f32>, Vec<[f32; 3]>);

fn ask_core(renderer: &Renderer<'_>) -> Answers {
    let plan = Plan::new(renderer.blob(), &Quality::EXACT, Outputs::ALL, Batch::FULL).expect("a plan");
    let (positions, dirs) = points();
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let (mut sigma, mut rgb) = (vec![f32::NAN; POINTS], vec![[f32::NAN; 3]; POINTS]);
    renderer.query(&plan, &positions, &dirs, &mut workspace, &mut sigma, &mut rgb).expect("an answer");
    (sigma, rgb)
}

fn ask_dfdx(model: &Model, parameters: &[f32]) -> Answers {
    let (positions, dirs) = points();
    let engine = ReferenceEngine::with_parameters(model, Adam::default(), parameters).expect("an engine");
    engine.forward(&positions, &dirs).expect("an answer")
}

/// |a − b| ≤ 1e-4 · max(1, |b|), channel by channel; and the answers say something.
fn assert_equal(found: &Answers, expected: &Answers, what: &str) {
    let flat = |a: &Answers| [a.0.clone(), a.1.iter().flatten().copied().collect()].concat();
    for (i, (a, b)) in flat(found).into_iter().zip(flat(expected)).enumerate() {
        assert!((a - b).abs() <= 1e-4 * b.abs().max(1.0), "{what}: value {i}: {a} instead of {b}");
    }
    let live = expected.0.iter().filter(|&&sigma| sigma > 0.0).count();
    assert!(live > POINTS / 20, "{what}: only {live} densities above 0 prove little");
}

fn kernels() -> impl Iterator<Item = Kernel> {
    Kernel::all().filter(|kernel| !kernel.rounds())
}

#[test]
fn forward_equals_dfdx_on_the_same_rounded_weights() {
    for (name, model) in models() {
        let bytes = blob(&model, &model.fold(parameters(&model).into()));
        let weights = Blob::open(&bytes).expect("a blob").weights();
        let halves = weights.chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]).to_f32());
        let expected = ask_dfdx(&Model::plain(model.architecture.clone()), &halves.collect::<Vec<_>>());
        for kernel in kernels() {
            let blob = Blob::open(&bytes).expect("a blob");
            let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
            let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
            assert_equal(&ask_core(&renderer), &expected, &format!("{name}, {}", kernel));
        }
    }
}

#[test]
fn folding_feature_layer_and_density_scale_changes_no_output() {
    for (name, model) in models() {
        let trained = parameters(&model);
        let (expected, folded) = (ask_dfdx(&model, &trained), model.fold((&trained[..]).into()));
        let bytes = blob(&model, &folded);
        for kernel in kernels() {
            let blob = Blob::open(&bytes).expect("a blob");
            let renderer = Renderer::with_parameters(blob, kernel, &folded, None).expect("a renderer");
            assert_equal(&ask_core(&renderer), &expected, &format!("{name}, {}", kernel));
        }
    }
}
