//! Tests of initial parameters, their order, and folding at export.

use super::oracle;
use super::*;
use glam::Vec3;
use nerf_core::simd::Isa;
use nerf_core::space::SceneBox;

#[test]
fn folding_keeps_the_outputs() {
    for (name, model) in models() {
        let parameters = model.initial_parameters(8);
        let folded = model.fold((&parameters[..]).into());
        assert_eq!(folded.len(), model.architecture.parameters());
        let exported = Model::plain(model.architecture.clone());
        let batch = batch_of(&model, 20, 0, 9);
        let dirs: Vec<_> =
            batch.rays.iter().flat_map(|r| std::iter::repeat_n(r.dir, r.samples as usize)).collect();
        let outputs = |model: &Model, p: &[f32]| {
            let engine = ReferenceEngine::with_parameters(model, Adam::default(), p).unwrap();
            engine.forward(&batch.positions, &dirs).unwrap()
        };
        let (sigma, rgb) = outputs(&model, &parameters);
        let (folded_sigma, folded_rgb) = outputs(&exported, &folded);
        let close =
            |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5 * (1.0 + a.abs()));
        assert!(close(&sigma, &folded_sigma), "{name}");
        assert!(close(rgb.as_flattened(), folded_rgb.as_flattened()), "{name}");
    }
}

#[test]
fn the_forward_pass_is_that_of_the_f64_oracle() {
    for (name, model) in models() {
        let p = model.initial_parameters(8);
        let batch = batch_of(&model, 20, 0, 9);
        let dirs = vec![[0.6, 0.0, 0.8]; batch.positions.len()];
        let engine = ReferenceEngine::with_parameters(&model, Adam::default(), &p).unwrap();
        let (sigma, rgb) = engine.forward(&batch.positions, &dirs).unwrap();
        let p: Vec<f64> = p.iter().map(|&p| f64::from(p)).collect();
        for (i, x) in batch.positions.iter().enumerate() {
            let (expected, colour) = oracle::evaluate(&model, &p, x, Some(&dirs[i]));
            if !sigma.is_empty() {
                assert!((f64::from(sigma[i]) - expected).abs() < 1e-5 * (1.0 + expected), "{name}");
            }
            assert!((0..3).all(|k| (f64::from(rgb[i][k]) - colour[k]).abs() < 2e-6), "{name}");
        }
    }
}

#[test]
fn layers_fill_the_parameter_vector_in_order() {
    let model = classic();
    let mut next = 0;
    for d in model.layers() {
        assert_eq!((d.weights, d.bias), (next, next + d.inputs() * d.outputs));
        next += d.parameters();
    }
    assert_eq!(next, model.parameters());
    let parts: Vec<_> = model.layers().iter().map(|d| d.part).collect();
    assert_eq!(parts[3..6], [Part::Density, Part::Feature, Part::Colour(0)]);
}

#[test]
fn start_values_are_those_of_the_recipe() {
    let model = Model { architecture: plain().architecture, ..classic() };
    let uniform = model.initial_parameters(1);
    assert_eq!(bits(&uniform), bits(&model.initial_parameters(1)));
    assert_ne!(bits(&uniform), bits(&model.initial_parameters(2)));
    for d in model.layers() {
        let bound = 1.0 / (d.inputs() as f32).sqrt();
        let weights = &uniform[d.weights..d.bias];
        assert!(weights.iter().all(|w| w.abs() <= bound));
        let shift = if d.part == Part::Density { 0.2 } else { 0.0 };
        assert!(uniform[d.bias..][..d.outputs].iter().all(|b| (b - shift).abs() <= bound));
        if weights.len() > 500 {
            let square = |w: &[f32]| w.iter().map(|w| w * w).sum::<f32>() / w.len() as f32;
            assert!((square(weights) * 3.0 / (bound * bound) - 1.0).abs() < 0.15);
        }
    }
}

#[test]
fn densities_for_a_grid_are_those_of_the_forward_pass() {
    for (name, model) in models().into_iter().filter(|(_, model)| model.architecture.density.is_some()) {
        let points = batch_of(&model, 0, 9000, 3).empty;
        let parameters = model.fold(model.initial_parameters(6).into());
        // Any box will do: sinusoidal encodings take positions as they are.
        let bounds = SceneBox::new(Vec3::ZERO, Vec3::ONE).expect("a box");
        let found =
            crate::model::field::densities(Isa::detect(), &model.architecture, &parameters, &bounds, &points);
        let (expected, _) = reference(&model, 6).forward(&points, &points).unwrap();
        let mut pairs = found.iter().zip(&expected);
        assert!(pairs.all(|(a, b)| (a - b).abs() < 1e-5 * (1.0 + b)), "{name}");
        assert!(expected.iter().any(|&s| s > 0.0), "{name}");
    }
}
