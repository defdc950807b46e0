//! Tests of the fused engine's gradients against dfdx's tape, and against finite differences in f64.

use super::oracle;
use super::*;

/// Returns the largest error of a gradient, relative to the largest gradient of its layer, over all layers.
fn worst_layer(model: &Model, found: &[f32], expected: &[f32]) -> f64 {
    let of_layer = |d: Dense| {
        let range = d.weights..d.weights + d.parameters();
        let pairs = found[range.clone()].iter().zip(&expected[range.clone()]);
        let error = pairs.fold(0.0, |m, (a, b)| worse(m, f64::from((a - b).abs())));
        error / largest(&expected[range], 1e-12)
    };
    model.layers().into_iter().map(of_layer).fold(0.0, worse)
}

#[test]
fn a_gradient_that_is_not_a_number_is_the_worst() {
    let model = plain();
    let expected = vec![1.0; model.parameters()];
    assert_eq!(worst_layer(&model, &expected, &expected), 0.0);
    for index in [0, 7, expected.len() - 1] {
        let mut broken = expected.clone();
        broken[index] = f32::NAN;
        assert!(worst_layer(&model, &broken, &expected).is_nan(), "{index}");
        assert!(worst_layer(&model, &expected, &broken).is_nan(), "{index}");
    }
}

#[test]
fn fused_gradients_are_those_of_autodiff() {
    for (name, model) in models() {
        // 3 rays fill less than a block, 40 several blocks (the last one in part), 200 several chunks.
        for (rays, empty) in [(3, 0), (40, 70), (200, 600), (0, 130)] {
            let batch = batch_of(&model, rays, empty, 11);
            let (loss, found) = fused(&model, 2).gradients(&batch).unwrap();
            let (reference_loss, expected) = reference(&model, 2).gradients(&batch).unwrap();
            let error = worst_layer(&model, &found, &expected);
            println!("{name}, {rays} rays, {empty} empty: {error:.1e}");
            assert!(error < 1e-4, "{name}, {rays} rays: {error}");
            assert!((loss.mse - reference_loss.mse).abs() <= 1e-6, "{loss:?} {reference_loss:?}");
            assert!(!loss.dead && !reference_loss.dead, "{name}: nothing was compared");
        }
    }
}

#[test]
fn fused_gradients_are_finite_differences() {
    for (name, model) in models() {
        let batch = batch_of(&model, 12, 20, 21);
        let mut engine = fused(&model, 4);
        let (loss, found) = engine.gradients(&batch).unwrap();
        let p: Vec<f64> = engine.parameters().iter().map(|&p| f64::from(p)).collect();
        let total = oracle::loss(&model, &p, &batch);
        let weighted = if model.architecture.density.is_some() { loss.empty * 0.3 } else { 0.0 };
        assert!((loss.mse + weighted - total).abs() < 1e-6, "{name}: {loss:?} {total}");
        let mut worst = 0.0f64;
        for d in model.layers() {
            let range = d.weights..d.weights + d.parameters();
            let largest = largest(&found[range], 1e-9);
            // Evenly spaced parameters, from the first weight to the last bias, and the first bias.
            let some = (0..9).map(|i| d.weights + i * (d.parameters() - 1) / 8);
            for index in some.chain([d.bias]) {
                let at = |h: f64| {
                    let mut p = p.clone();
                    p[index] += h;
                    oracle::loss(&model, &p, &batch)
                };
                let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
                worst = worse(worst, (difference - f64::from(found[index])).abs() / largest);
            }
        }
        println!("{name}: {worst:.1e}");
        assert!(worst < 2e-4, "{name}: {worst}");
    }
}

#[test]
fn rays_without_samples_show_their_background() {
    let model = classic();
    let mut batch = batch_of(&model, 50, 0, 1);
    batch.rays.iter_mut().for_each(|ray| ray.samples = 0);
    batch.positions.clear();
    batch.deltas.clear();
    let squares = batch.rays.iter().flat_map(|r| (0..3).map(|k| (r.background[k] - r.rgb[k]).powi(2)));
    let expected = squares.map(f64::from).sum::<f64>() / 150.0;
    let (a, gradients) = fused(&model, 1).gradients(&batch).unwrap();
    let (b, _) = reference(&model, 1).gradients(&batch).unwrap();
    assert!((a.mse - expected).abs() < 1e-7 && (b.mse - expected).abs() < 1e-7);
    assert!(gradients.iter().all(|&g| g == 0.0) && !a.dead);
}

#[test]
fn a_batch_of_nothing_is_no_error() {
    let mut engine = fused(&plain(), 1);
    let before = engine.parameters().into_owned();
    assert_eq!(engine.step(&Batch::default(), 1e-3).unwrap(), StepLoss::default());
    assert_eq!(bits(&engine.parameters()), bits(&before));
}

#[test]
fn empty_points_alone_lower_their_density() {
    let model = Model { density_bias: 3.0, ..plain() };
    let batch = batch_of(&model, 0, 300, 1);
    let mut engine = fused(&model, 1);
    let first = engine.step(&batch, 1e-3).unwrap();
    let colour = model.layers().iter().find(|d| matches!(d.part, Part::Colour(_))).unwrap().weights;
    for _ in 0..200 {
        engine.step(&batch, 3e-3).unwrap();
    }
    let last = engine.step(&batch, 1e-3).unwrap();
    assert!(first.empty > 1.0 && last.empty < 0.05 && !last.dead, "{first:?} {last:?}");
    assert_eq!(engine.parameters()[colour..], model.initial_parameters(1)[colour..]);
}

#[test]
fn opaque_walls_and_huge_bins_stay_finite() {
    // Sigma reaches its limit, and bins are up to 1e30 long.
    for scale in [1.0, 1e6, 1e12] {
        let model = Model { density_scale: scale, density_bias: 2.0 * scale, ..classic() };
        let mut batch = batch_of(&model, 60, 40, 3);
        for (i, delta) in batch.deltas.iter_mut().enumerate() {
            *delta = [0.0, 1e-30, 1e-3, 1.0, 1e10, 1e30][i % 6];
        }
        let (loss, gradients) = fused(&model, 1).gradients(&batch).unwrap();
        assert!(loss.mse.is_finite() && loss.mse < 1.0 && loss.empty <= 13.9, "{loss:?}");
        assert!(gradients.iter().all(|g| g.is_finite()));
    }
}

#[test]
fn a_dead_density_is_reported() {
    let model = Model { density_bias: -50.0, ..plain() };
    let batch = batch_of(&model, 30, 10, 1);
    assert!(fused(&model, 1).gradients(&batch).unwrap().0.dead);
    assert!(reference(&model, 1).gradients(&batch).unwrap().0.dead);
    assert!(!fused(&plain(), 1).gradients(&batch).unwrap().0.dead);
}

#[test]
fn portable_instructions_agree_with_the_fastest() {
    for (name, model) in models() {
        let batch = batch_of(&model, 40, 70, 5);
        let (_, expected) = fused(&model, 2).gradients(&batch).unwrap();
        let mut scalar = fused(&model, 2);
        scalar.set_isa(nerf_core::simd::Isa::Portable);
        let error = worst_layer(&model, &scalar.gradients(&batch).unwrap().1, &expected);
        assert!(error < 1e-4, "{name}: {error}");
    }
}
