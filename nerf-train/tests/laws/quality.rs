//! What a blob promises of its own grid and weights.

use crate::{fit, scene, tiny};
use nerf_core::blob::{Blob, Content, SceneFacts};
use nerf_core::kernels::Tier;
use nerf_core::network::Role;
use nerf_core::plan::{Batch, Outputs, Plan, PlanError, Quality};
use nerf_train::dataset::View;
use nerf_train::eval::measure;
use nerf_train::export::{Contents, ExportError, export};
use nerf_train::train::finish::Outcome;

fn psnr_db<'v>(
    outcome: &Outcome,
    views: impl IntoIterator<Item = &'v View>,
    quality: &Quality,
) -> Option<f64> {
    measure(&outcome.bytes, None, Tier::detect(), quality, outcome.background, views, |_, _, _, _| {})
        .ok()?
        .psnr_db()
}

#[test]
fn a_grid_that_matters_is_part_of_the_model() {
    let dataset = scene();
    let mut careful = tiny(600);
    (careful.grid.threshold, careful.grid.resolution) = (0.001, 24);
    for (name, config) in [
        ("hardly fitted", tiny(20)),
        ("fitted", tiny(600)),
        ("fitted, careful grid", careful),
        ("fitted without hull", tiny(600).without_hull()),
    ] {
        let outcome = fit(&dataset, &config).expect("a blob");
        let blob = Blob::open(&outcome.bytes).expect("a blob");
        let scene = blob.scene().expect("a scene");
        println!(
            "{name}: {:.4} dB on held-out views, grid loss {:.4} dB, required {}, {:.3} live",
            outcome.scores.psnr_db().unwrap_or(f64::NAN),
            outcome.grid_loss_db,
            scene.grid_required,
            outcome.occupancy
        );
        assert_eq!(scene.grid_required, outcome.grid_required);
        let without = Quality { skip_grid: false, ..Quality::default() };
        let plan = Plan::new(&blob, &without, Outputs::ALL, Batch::for_tier(Tier::detect()));
        if outcome.grid_required {
            assert_eq!(plan.err(), Some(PlanError::GridRequired));
            continue;
        }
        assert!(outcome.grid_loss_db.abs() <= 0.1);
        for (split, views) in [("train", &dataset.train), ("val", &dataset.val)] {
            let (on, off) =
                (psnr_db(&outcome, views, &Quality::default()), psnr_db(&outcome, views, &without));
            let change = on.expect("views") - off.expect("views");
            println!("{name}, {split}: {change:.4} dB");
            assert!(change.abs() <= 0.1, "{name}, {split}: {change} dB");
        }
    }
}

#[test]
fn a_weight_beyond_f16_is_refused_naming_layer_and_index() {
    let outcome = fit(&scene(), &tiny(2)).expect("a blob");
    let blob = Blob::open(&outcome.bytes).expect("a blob");
    let architecture = blob.architecture();
    let facts = SceneFacts { grid_required: false, ..blob.scene().expect("a scene").clone() };
    let export = |parameters: &[f32]| {
        export(&Contents {
            architecture,
            parameters,
            content: Content::Scene(facts.clone()),
            grid: None,
            provenance: blob.provenance().clone(),
        })
    };
    let whole = vec![65504.0; architecture.parameters()];
    assert!(export(&whole).is_ok());
    for layer in &architecture.layers() {
        for (index, found) in [(0, 65505.0), (1, -65519.0), (layer.inputs() * layer.outputs, 1e30)] {
            let mut parameters = whole.clone();
            parameters[layer.weights + index] = found;
            let error = export(&parameters).expect_err("beyond f16");
            assert_eq!(error, ExportError::Weight { role: layer.role, index, found });
        }
        let mut parameters = whole.clone();
        parameters[layer.bias] = f32::NAN;
        assert!(export(&parameters).is_err());
    }
    let mut parameters = whole.clone();
    parameters[0] = f32::INFINITY;
    let text = export(&parameters).expect_err("infinite").to_string();
    assert!(text.contains("Trunk(0)") && text.contains("parameter 0") && text.contains("inf"), "{text}");
    assert!(matches!(architecture.layers().iter().next().map(|l| l.role), Some(Role::Trunk(0))));
}
