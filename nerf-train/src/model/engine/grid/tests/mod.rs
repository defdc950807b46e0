//! Tests of the grid engine, on small grids.

mod oracle;
mod rays;
mod smoothness;

use super::*;
use crate::model::config::{Preset, TableConfig};
use crate::model::engine::model::uniform;
use crate::model::engine::{BatchError, BatchRay, Dense, Part, ReferenceEngine, Surface};
use crate::model::picture_config::{FieldConfig, FieldPreset};
use crate::model::quantise::{Quantised, TableStorage, values_of};
use glam::Vec3;
use half::f16;
use nerf_core::encoding::{AngleScale, DirectionEncoding, PositionEncoding, SinusoidalEncoding};
use nerf_core::network::Shading;
use nerf_core::space::Contraction;
use rayon::prelude::*;

/// Returns a box with unequal sides that is not centred at 0.
fn bounds() -> SceneBox {
    SceneBox::new(Vec3::new(-1.0, 0.5, -0.25), Vec3::new(1.5, 2.5, 0.75)).unwrap()
}

/// Returns a model with the grid `table`, whose density is about 1 per world unit at the start.
fn model(table: TableConfig, depth: usize, degree: u8, colour: usize) -> Model {
    let mut config = Preset::Grid.config();
    let n = &mut config.network;
    (n.grid, n.depth, n.width, n.direction_levels, n.colour_width) = (Some(table), depth, 16, degree, colour);
    let bounds = bounds();
    Model { density_bias: 0.0, ..config.model_of(bounds.max - bounds.min) }
}

/// Returns a grid of 3, 6 and 12 cells along the longest side. In the box [`bounds`], its levels have 24, 126 and 858
/// vertices.
fn table(features: u8, log2_entries: u8) -> TableConfig {
    TableConfig {
        levels: 3,
        features,
        log2_entries,
        coarsest: 3,
        finest: 12,
        storage: TableStorage::F16,
        most_bytes: None,
    }
}

fn models() -> [(&'static str, Model); 8] {
    [
        ("all dense", model(table(2, 19), 1, 2, 16)),
        ("two levels hashed", model(table(2, 6), 1, 3, 16)),
        ("4 features, two layers", model(table(4, 8), 2, 2, 20)),
        ("1 feature, no direction", model(table(1, 5), 1, 0, 16)),
        ("16 entries, no colour layer", model(table(2, 4), 1, 2, 0)),
        ("no layer", model(table(2, 6), 0, 3, 20)),
        ("no layer, 4 features, no direction", model(table(4, 8), 0, 0, 16)),
        ("two layers, no colour layer", model(table(1, 8), 2, 2, 0)),
    ]
}

/// Returns models of 2D fields with dense and with hashed levels.
fn pictures() -> [(&'static str, Model); 3] {
    let field = |table, layers| {
        let config = FieldPreset::Grid.config();
        FieldConfig { grid: Some(table), layers, width: 16, ..config }.model([50, 40])
    };
    [
        ("picture, all dense", field(table(2, 19), 1)),
        ("picture, two levels hashed, 4 features", field(table(4, 5), 2)),
        ("picture, 1 feature, 16 entries", field(table(1, 4), 1)),
    ]
}

/// Constants of Adam with which the first moment is the last gradient.
const BARE: Adam = Adam { betas: [0.0, 0.99], epsilon: 1e-15, weight_decay: 0.0, hashed_every: 1 };

/// Returns an engine with table values U(±0.5), large enough to affect the loss. They are exact in f16, which the
/// engine reads.
fn engine(model: &Model, adam: Adam, seed: u64) -> GridEngine {
    engine_over(bounds(), model, adam, seed)
}

fn engine_over(bounds: SceneBox, model: &Model, adam: Adam, seed: u64) -> GridEngine {
    let mut engine = GridEngine::new(model, bounds, adam, seed).unwrap();
    let mut state = engine.state();
    for (i, value) in state.parameters[model.layer_parameters()..].iter_mut().enumerate() {
        *value = f16::from_f32(uniform(seed + 1, i as u64) as f32 - 0.5).to_f32();
    }
    engine.restore(&state).unwrap();
    engine
}

/// Returns the loss and its gradient, in the order of the parameters. With the constants [`BARE`], a step at rate 0
/// leaves the gradient in the first moments.
fn gradients(engine: &mut GridEngine, batch: &Batch) -> (StepLoss, Vec<f32>) {
    assert_eq!(engine.adam.betas[0], 0.0);
    let mut state = engine.state();
    state.moment1.fill(0.0);
    engine.restore(&state).unwrap();
    let loss = engine.step(batch, 0.0).unwrap();
    (loss, engine.state().moment1)
}

/// Returns random rays of 0 to 5 samples, whose compositing weights are all above the gate.
fn batch_of(rays: usize, seed: u64) -> Batch {
    let mut counter = 0;
    let mut next = || {
        counter += 1;
        uniform(seed, counter) as f32
    };
    let mut batch = Batch::default();
    let (min, extent) = (bounds().min.to_array(), (bounds().max - bounds().min).to_array());
    for ray in 0..rays {
        let mut triple = || [next(), next(), next()];
        let (dir, rgb, background) = (triple().map(|x| x - 0.5), triple(), triple());
        let length = dir.iter().map(|x| x * x).sum::<f32>().sqrt();
        let samples = (ray * 5 % 6) as u32;
        batch.rays.push(BatchRay { dir: dir.map(|x| x / length), rgb, background, samples });
        for _ in 0..samples {
            let at = [next(), next(), next()];
            batch.positions.push(std::array::from_fn(|axis| min[axis] + at[axis] * extent[axis]));
            batch.deltas.push(0.1 + 0.2 * next());
        }
    }
    batch
}

/// Adds to the batch: known surfaces of half of the rays, gains of three photographs, and weights of the rays.
fn exposed_towards_surfaces(mut batch: Batch) -> Batch {
    let towards = batch.rays.len().div_ceil(2);
    batch.surfaces =
        (0..towards).map(|i| Surface { at: (i % 5) as f32 / 4.0, weight: 0.3 + (i % 3) as f32 }).collect();
    let samples: u32 = batch.rays[..towards].iter().map(|ray| ray.samples).sum();
    // Some samples are further from the surface than `Surface::CLIP`.
    batch.along = (0..samples).map(|i| (i % 7) as f32 / 6.0).collect();
    batch.views = (0..batch.rays.len() as u32).map(|i| i % 3).collect();
    batch.gains = batch.views.iter().map(|&view| GAINS[view as usize]).collect();
    batch.weights = (0..batch.rays.len()).map(|i| [0.5, 1.0, 0.0, 1.0][i % 4]).collect();
    batch
}

/// Adds lines, subject to the smoothness loss, to the batch. Neighbouring pixels have similar colours.
fn on_lines(mut batch: Batch) -> Batch {
    let (middle, rays) = (Vec3::new(0.25, 1.5, 0.25), batch.rays.len() as u32);
    batch.origins = batch.rays.iter().map(|ray| (middle - 4.0 * Vec3::from(ray.dir)).to_array()).collect();
    batch.rays.iter_mut().for_each(|ray| ray.rgb = ray.rgb.map(|c| 0.4 + 0.1 * c));
    // The second line is left out, to test that lines need not follow each other.
    batch.lines = (0..rays / LINE as u32).filter(|line| *line != 1).map(|line| line * LINE as u32).collect();
    batch.smoothness = Some((0.3, Contraction::new(&Contraction::cube(middle, 1.0), 1).unwrap()));
    batch
}

/// Gains of the photographs of [`exposed_towards_surfaces`].
const GAINS: [[f32; 3]; 3] = [[0.7, 0.8, 0.9], [1.0; 3], [1.2, 1.3, 1.1]];

#[test]
fn gradients_of_log_gains_are_finite_differences() {
    let (name, model) = &models()[0];
    let batch = exposed_towards_surfaces(batch_of(12, 51));
    let mut engine = engine(model, BARE, 4);
    gradients(&mut engine, &batch);
    let (p, found) = (wide(&engine.parameters()), engine.gain_gradients(3));
    for (view, channel) in (0..3).flat_map(|view| (0..3).map(move |channel| (view, channel))) {
        let at = |h: f32| {
            let mut batch = batch.clone();
            for (gain, &of) in batch.gains.iter_mut().zip(&batch.views) {
                if of as usize == view {
                    gain[channel] *= h.exp();
                }
            }
            oracle::loss(model, &bounds(), &p, &batch).loss
        };
        let expected = (at(1e-3) - at(-1e-3)) / 2e-3;
        let error = (expected - f64::from(found[view][channel])).abs();
        assert!(error < 1e-5, "{name}, photograph {view}, channel {channel}: {expected}, {found:?}");
    }
    // A ray shows only a background of 1.5, beyond white. On a photograph clipped at white, this is no error.
    let mut white = |rgb| {
        let mut batch = batch_of(1, 5);
        (batch.rays[0].rgb, batch.rays[0].background, batch.rays[0].samples) = ([rgb; 3], [1.5; 3], 0);
        (batch.positions, batch.deltas) = (Vec::new(), Vec::new());
        (batch.views, batch.gains) = (vec![0], vec![[2.0; 3]]);
        engine.step(&batch, 0.0).unwrap().mse
    };
    assert_eq!((white(1.0), white(0.5)), (0.0, 1.0));
}

/// Returns random pixels of a 2D field: rays of 0 or 1 samples.
fn pixels(rays: usize, seed: u64) -> Batch {
    let mut batch = batch_of(rays, seed);
    batch.rays.iter_mut().for_each(|ray| ray.samples = ray.samples.min(1));
    let samples: u32 = batch.rays.iter().map(|ray| ray.samples).sum();
    batch.positions.truncate(samples as usize);
    batch.deltas.truncate(samples as usize);
    batch
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|v| v.to_bits()).collect()
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

/// Returns the larger of two errors; NaN counts as the largest.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || a > b { a } else { b }
}

/// Returns dL/dp of one parameter by central differences of the oracle's loss. Also returns half of the difference
/// between the slopes on the two sides, which is the error of dL/dp at a kink of a ReLU.
fn difference(model: &Model, p: &[f64], batch: &Batch, index: usize) -> (f64, f64) {
    let at = |h: f64| {
        let mut p = p.to_vec();
        p[index] += h;
        let found = oracle::loss(model, &bounds(), &p, batch);
        found.loss + found.distortion + found.surfaces + found.smoothness
    };
    let [low, here, high] = [-1e-5, 0.0, 1e-5].map(at);
    ((high - low) / 2e-5, (high + low - 2.0 * here).abs() / 2e-5)
}

/// Returns groups of parameters, as ranges: the weights of each layer, and each level of the tables. Errors are
/// relative to the largest gradient of a group.
fn groups(model: &Model) -> Vec<std::ops::Range<usize>> {
    let grid = model.architecture.position.grid().unwrap();
    let features = usize::from(grid.features);
    let first = model.layer_parameters();
    let weights = model.layers().into_iter().map(|d| d.weights..d.bias);
    let levels = grid
        .levels()
        .map(|level| first + level.first * features..first + (level.first + level.entries) * features);
    weights.chain(levels).collect()
}

/// Returns the largest error of the gradients against finite differences, relative to the largest gradient of the
/// parameter's group ([`groups`]). Tests each group's largest gradients, and parameters spread over the group. Asserts
/// that the gate leaves out no sample.
fn worst_of_differences(name: &str, model: &Model, engine: &mut GridEngine, batch: &Batch) -> f64 {
    let (loss, found) = gradients(engine, batch);
    let p = wide(&engine.parameters());
    let total = oracle::loss(model, &bounds(), &p, batch);
    assert!(total.least_weight > 2e-3 && total.least_transmittance > 2e-3, "{name}: a sample is left out");
    assert_eq!((loss.evaluated, loss.kept), (batch.positions.len(), batch.positions.len()), "{name}");
    assert!((loss.mse - total.loss).abs() < 1e-6, "{name}: {loss:?} {}", total.loss);
    let mut worst = 0.0;
    for group in groups(model) {
        let mut order: Vec<usize> = group.clone().collect();
        order.sort_by(|&a, &b| found[b].abs().total_cmp(&found[a].abs()));
        let largest = f64::from(found[order[0]].abs());
        assert!(largest > 1e-7, "{name}: no gradient in {group:?}");
        let spread = (0..8).map(|i| group.start + i * (group.len() - 1) / 7);
        let places: Vec<usize> = order[..8.min(order.len())].iter().copied().chain(spread).collect();
        let error = |&index: &usize| {
            let (expected, bend) = difference(model, &p, batch, index);
            ((expected - f64::from(found[index])).abs() - bend).max(0.0) / largest
        };
        worst = places.par_iter().map(error).collect::<Vec<f64>>().into_iter().fold(worst, worse);
    }
    worst
}

#[test]
fn gradients_of_tables_and_layers_are_finite_differences() {
    for (name, model) in models() {
        // 150 rays: several chunks, hence several accumulators.
        for (rays, seed) in [(2, 5), (12, 21), (150, 22)] {
            let mut engine = engine(&model, BARE, 4);
            let worst = worst_of_differences(name, &model, &mut engine, &batch_of(rays, seed));
            println!("{name}, {rays} rays: {worst:.1e}");
            assert!(worst < 2e-4, "{name}, {rays} rays: {worst}");
            // Another seed: with the one above, a kink of a ReLU lies between the two points of a difference.
            let batch = Batch { distortion: 0.1, ..batch_of(rays, 30 + seed) };
            let worst = worst_of_differences(name, &model, &mut engine, &batch);
            println!("{name}, {rays} rays, distortion: {worst:.1e}");
            assert!(worst < 2e-4, "{name}, {rays} rays, distortion: {worst}");
            let batch = exposed_towards_surfaces(batch_of(rays, 30 + seed));
            let worst = worst_of_differences(name, &model, &mut engine, &batch);
            println!("{name}, {rays} rays, surfaces and gains: {worst:.1e}");
            assert!(worst < 2e-4, "{name}, {rays} rays, surfaces and gains: {worst}");
            let batch = on_lines(batch_of(rays, 30 + seed));
            let worst = worst_of_differences(name, &model, &mut engine, &batch);
            println!("{name}, {rays} rays, lines: {worst:.1e}");
            assert!(worst < 2e-4, "{name}, {rays} rays, lines: {worst}");
        }
    }
    for (name, model) in pictures() {
        for (rays, seed) in [(12, 24), (150, 27), (700, 26)] {
            let worst = worst_of_differences(name, &model, &mut engine(&model, BARE, 4), &pixels(rays, seed));
            println!("{name}, {rays} pixels: {worst:.1e}");
            assert!(worst < 2e-4, "{name}, {rays} pixels: {worst}");
        }
    }
}

#[test]
fn gradients_are_scaled_sample_by_sample() {
    for (name, model) in models() {
        let batch = batch_of(12, 21);
        let found = |scales: Vec<f32>| {
            gradients(&mut engine(&model, BARE, 4), &Batch { gradient_scales: scales, ..batch.clone() })
        };
        let samples = batch.positions.len();
        let (loss, whole) = found(Vec::new());
        let (half_loss, half) = found(vec![0.5; samples]);
        assert_eq!(loss, half_loss, "{name}");
        // The colour branch is evaluated once per ray: `gradient_scales` do not apply to its gradients.
        let branch = |i: usize| {
            let of_branch = |d: &&Dense| matches!(d.part, Part::Colour(_) | Part::Rgb);
            model.layers().iter().filter(of_branch).any(|d| (d.weights..d.bias).contains(&i))
        };
        let halved = |(i, g): (usize, &f32)| if branch(i) { *g } else { 0.5 * g };
        let halved: Vec<f32> = whole.iter().enumerate().map(halved).collect();
        assert!(bits(&half) == bits(&halved), "{name}");
        // The gradients of some samples and of all others add up to the whole gradient.
        let some: Vec<f32> = (0..samples).map(|i| (i % 2) as f32).collect();
        let others = some.iter().map(|s| 1.0 - s).collect();
        let ((_, some), (_, others)) = (found(some), found(others));
        let largest = whole.iter().fold(0.0f32, |most, g| most.max(g.abs()));
        for (i, g) in whole.iter().enumerate() {
            let sum = if branch(i) { 0.5 * (some[i] + others[i]) } else { some[i] + others[i] };
            assert!((sum - g).abs() < 1e-5 * largest, "{name}: {} and {}, not {g}", some[i], others[i]);
        }
        assert!(some.iter().zip(&others).any(|(a, b)| *a != 0.0 && *b != 0.0 && a != b), "{name}");
    }
}

#[test]
fn of_a_ray_through_a_2d_field_only_the_first_sample_is_seen() {
    let (_, model) = &pictures()[0];
    let mut batch = batch_of(12, 24);
    let mut first = Batch { rays: batch.rays.clone(), ..Batch::default() };
    let mut at = 0;
    for ray in &mut first.rays {
        if ray.samples > 0 {
            first.positions.push(batch.positions[at]);
            first.deltas.push(1.0);
        }
        at += ray.samples as usize;
        ray.samples = ray.samples.min(1);
    }
    // The lengths of bins have no effect in a 2D field.
    batch.deltas.fill(0.0);
    let (loss, found) = gradients(&mut engine(model, BARE, 4), &batch);
    assert_eq!((loss.evaluated, loss.kept), (10, 10));
    assert_eq!((loss, found), gradients(&mut engine(model, BARE, 4), &first));
}

#[test]
fn every_instruction_set_has_the_same_gradients_within_rounding() {
    let (name, model) = &models()[1];
    for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
        let mut engine = engine(model, BARE, 4);
        engine.set_isa(isa);
        let worst = worst_of_differences(name, model, &mut engine, &batch_of(12, 23));
        assert!(worst < 2e-4, "{}: {worst}", isa.name());
    }
}

/// Returns a reference engine with the state of `engine`.
fn by_tape(engine: &GridEngine) -> GridReferenceEngine {
    let mut tape = GridReferenceEngine::new(&engine.model, bounds(), BARE, 0).unwrap();
    tape.restore(&engine.state()).unwrap();
    tape
}

#[test]
fn gradients_of_tables_and_layers_are_those_of_the_tape() {
    for (name, model) in models() {
        let plain = batch_of(150, 22);
        let count = plain.positions.len();
        let scales = (0..count).map(|i| 0.1 + (i % 7) as f32).collect();
        // Some samples weigh less than `ROULETTE_WEIGHT`, and some rays end early.
        let deltas =
            plain.deltas.iter().enumerate().map(|(i, d)| d * [1.0, 5e-3, 100.0][i % 23 % 3]).collect();
        let faint = Batch {
            deltas,
            roulette: Some((3, 4)),
            distortion: 0.1,
            gradient_scales: scales,
            ..plain.clone()
        };
        let gated = Batch { roulette: None, ..faint.clone() };
        for (case, batch) in [
            ("plain", plain.clone()),
            ("distortion", Batch { distortion: 0.1, ..plain.clone() }),
            ("surfaces and gains", exposed_towards_surfaces(plain.clone())),
            ("lines", on_lines(plain)),
            ("faint", faint),
            ("gated", gated),
        ] {
            for rounded in [false, true] {
                let mut fused = engine(&model, BARE, 4);
                if rounded {
                    fused.round_tables(TableStorage::Int8.into());
                }
                let mut tape = by_tape(&fused);
                let (expected_loss, expected) = gradients(&mut fused, &batch);
                let loss = tape.step(&batch, 0.0).unwrap();
                let found = tape.state().moment1;
                for (a, b) in tape.gain_gradients(3).iter().zip(fused.gain_gradients(3)) {
                    let apart = a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
                    assert!(apart, "{name}, {case}: {a:?}, {b:?}");
                }
                let errors = |engine: &dyn Engine| {
                    let mut errors: Vec<(u32, [f32; 3])> = engine.errors().copied().collect();
                    errors.sort_by_key(|&(ray, _)| ray);
                    errors
                };
                let (a, b) = (errors(&tape), errors(&fused));
                assert_eq!((a.len(), b.len()), (batch.views.len(), batch.views.len()), "{name}, {case}");
                for ((ray, a), (other, b)) in a.iter().zip(&b) {
                    let apart = a.iter().zip(b).any(|(a, b)| (a - b).abs() > 1e-5);
                    assert!(ray == other && !apart, "{name}, {case}, rays {ray}, {other}: {a:?}, {b:?}");
                }
                assert!((loss.mse - expected_loss.mse).abs() < 1e-6, "{name}, {case}: {loss:?}");
                assert_eq!((loss.kept, loss.dead), (expected_loss.kept, false), "{name}, {case}");
                assert_eq!(loss.kept < count, matches!(case, "faint" | "gated"), "{name}, {case}");
                let mut worst = 0.0;
                for group in groups(&model) {
                    let most = expected[group.clone()].iter().fold(0.0f32, |most, g| most.max(g.abs()));
                    for (a, b) in found[group.clone()].iter().zip(&expected[group]) {
                        worst = worse(worst, f64::from((a - b).abs() / most));
                    }
                }
                println!("{name}, {case}, rounded: {rounded}: {worst:.1e}");
                assert!(worst < 1e-4, "{name}, {case}, rounded: {rounded}: {worst}");
            }
        }
    }
}

#[test]
fn the_tape_refuses_what_it_does_not_train() {
    let refused = |model: &Model| GridReferenceEngine::new(model, bounds(), BARE, 0).err();
    assert_eq!(refused(&pictures()[0].1), Some(EngineError::NoDensity));
    let (_, model) = &models()[0];
    assert_eq!(refused(&Model { density_scale: 2.0, ..model.clone() }), Some(EngineError::NotPlain));
    let mut by_sample = model.clone();
    by_sample.architecture.shading = Shading::PerSample;
    assert_eq!(refused(&by_sample), Some(EngineError::NotPlain));
    assert_eq!(GridEngine::new(&by_sample, bounds(), BARE, 0).err(), Some(EngineError::NotPlain));
    let mut tape = by_tape(&engine(model, BARE, 4));
    let state = tape.state();
    let short = OptimiserState { moment2: vec![0.0], ..state.clone() };
    assert!(matches!(tape.restore(&short), Err(EngineError::Parameters { field: "moment2", .. })));
    // With a target as large as f32 allows, the step fails, and the state does not change.
    let mut batch = batch_of(12, 21);
    batch.rays[1].rgb = [f32::MAX; 3];
    assert_eq!(tape.step(&batch, 1e-3), Err(EngineError::Diverged { step: 1 }));
    assert_eq!(tape.state(), state);
}

/// Compares gradients with those of dfdx's tape, for a sinusoidal network that computes the same function. Three
/// choices make the functions equal. Grid and sinusoidal encoding return the position itself. Spherical harmonics of
/// degree 2 are the scaled direction and a constant, which the sinusoidal network adds to a bias. A ray has at most one
/// sample, so that colour per ray is colour per sample.
#[test]
fn gradients_of_the_layers_are_those_of_autodiff() {
    let unit = SceneBox::new(Vec3::ZERO, Vec3::ONE).unwrap();
    for (depth, colour) in [(1, 16), (2, 24), (1, 0)] {
        let table = TableConfig {
            levels: 1,
            features: 4,
            log2_entries: 5,
            coarsest: 1,
            finest: 1,
            storage: TableStorage::F16,
            most_bytes: None,
        };
        let model = model(table, depth, 2, colour);
        let mut plain = model.clone();
        let identity = SinusoidalEncoding { inputs: 3, levels: 0, scale: AngleScale::Pi, identity: true };
        plain.architecture.position = PositionEncoding::Sinusoidal(identity);
        plain.architecture.direction = Some(DirectionEncoding::Sinusoidal(identity));
        plain.architecture.shading = Shading::PerSample;

        let mut engine = GridEngine::new(&model, unit, BARE, 9).unwrap();
        let mut state = engine.state();
        for (i, value) in state.parameters[model.layer_parameters()..].iter_mut().enumerate() {
            let (entry, feature) = (i / 4, i % 4);
            *value = if feature < 3 { (entry >> feature & 1) as f32 } else { 0.0 };
        }
        engine.restore(&state).unwrap();

        // The constant Y_0^0 is added to the bias; Y_1^{-1,0,1} = -k y, k z, -k x.
        let (constant, k) = (0.282_094_79f32, 0.488_602_51f32);
        let dir_of = [(1, 1, -k), (2, 2, k), (3, 0, -k)];
        let mut parameters = vec![0.0; plain.parameters()];
        let pairs: Vec<(Dense, Dense)> = model.layers().into_iter().zip(plain.layers()).collect();
        for (ours, theirs) in &pairs {
            for o in 0..ours.outputs {
                let (from, to) = (ours.weights + o * ours.inputs(), theirs.weights + o * theirs.inputs());
                let row = &state.parameters[from..from + theirs.main];
                parameters[to..to + theirs.main].copy_from_slice(row);
                parameters[theirs.bias + o] = state.parameters[ours.bias + o];
                if ours.extra > 0 {
                    parameters[theirs.bias + o] += constant * state.parameters[from + ours.main];
                    for (harmonic, axis, scale) in dir_of {
                        parameters[to + theirs.main + axis] =
                            scale * state.parameters[from + ours.main + harmonic];
                    }
                }
            }
        }
        let mut batch = pixels(300, 31);
        for (i, position) in batch.positions.iter_mut().enumerate() {
            *position = std::array::from_fn(|axis| uniform(32, (3 * i + axis) as u64) as f32);
        }
        let mut reference = ReferenceEngine::with_parameters(&plain, BARE, &parameters).unwrap();
        let (expected_loss, expected) = reference.gradients(&batch).unwrap();
        let (loss, found) = gradients(&mut engine, &batch);
        assert_eq!(loss.kept, batch.positions.len(), "a sample is left out");
        assert!((loss.mse - expected_loss.mse).abs() < 1e-6, "{loss:?} {expected_loss:?}");
        let mut worst = 0.0;
        for (ours, theirs) in &pairs {
            let (mut largest, mut error) = (0.0f64, 0.0);
            let mut compare = |found: f32, expected: f32| {
                largest = largest.max(f64::from(expected.abs()));
                error = worse(error, f64::from((found - expected).abs()));
            };
            for o in 0..ours.outputs {
                let (from, to) = (ours.weights + o * ours.inputs(), theirs.weights + o * theirs.inputs());
                (0..theirs.main).for_each(|i| compare(found[from + i], expected[to + i]));
                if ours.extra > 0 {
                    compare(found[from + ours.main], constant * expected[theirs.bias + o]);
                    for (harmonic, axis, scale) in dir_of {
                        compare(
                            found[from + ours.main + harmonic],
                            scale * expected[to + theirs.main + axis],
                        );
                    }
                }
                // The engine trains no biases.
                assert_eq!(found[ours.bias + o], 0.0);
            }
            worst = worse(worst, error / largest);
        }
        println!("{depth} layers, {colour} channels of colour: {worst:.1e}");
        assert!(worst < 1e-4, "{depth} layers, {colour} channels of colour: {worst}");
    }
}

/// Returns rays whose samples all lie at `x`: every sample reads the same eight entries of a level.
fn constant_position(rays: usize, x: [f32; 3]) -> Batch {
    let mut batch = batch_of(rays, 41);
    batch.positions.fill(x);
    batch
}

#[test]
fn an_entry_that_every_sample_touches_has_one_sum_for_any_number_of_threads() {
    for (name, model) in models() {
        let batch = constant_position(800, [0.3, 1.1, 0.2]);
        let worst = worst_of_differences(name, &model, &mut engine(&model, BARE, 4), &batch);
        println!("{name}: {worst:.1e}");
        assert!(worst < 2e-4, "{name}: {worst}");
        let after = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| bits(&gradients(&mut engine(&model, BARE, 4), &batch).1))
        };
        let one = after(1);
        assert!(one == after(2) && one == after(3) && one == after(5), "{name}");
    }
}

#[test]
fn corners_of_a_cell_that_share_an_entry_add_up() {
    // A cell has four pairs of corners that are neighbours in x. With one hash value, all pairs read the same two
    // entries. With two hash values, each pair reads one of two pairs of entries.
    for log2_entries in [0, 1] {
        let table = TableConfig {
            levels: 1,
            features: 2,
            log2_entries,
            coarsest: 6,
            finest: 6,
            storage: TableStorage::F16,
            most_bytes: None,
        };
        let model = model(table, 1, 2, 16);
        for batch in [constant_position(2, [0.3, 1.1, 0.2]), batch_of(40, 42)] {
            let mut engine = engine(&model, BARE, 4);
            let worst = worst_of_differences("shared entries", &model, &mut engine, &batch);
            println!("2^{log2_entries} entries: {worst:.1e}");
            assert!(worst < 2e-4, "2^{log2_entries} entries: {worst}");
        }
    }
}

#[test]
fn positions_on_faces_corners_and_outside_of_the_box_have_finite_gradients_within_the_tables() {
    let (min, max) = (bounds().min.to_array(), bounds().max.to_array());
    for (name, model) in models() {
        let mut batch = batch_of(60, 43);
        for (i, position) in batch.positions.iter_mut().enumerate() {
            let places = |axis: usize| {
                [
                    min[axis],
                    max[axis],
                    min[axis].next_down(),
                    max[axis].next_up(),
                    0.5 * (min[axis] + max[axis]),
                    1e30,
                    -1e30,
                ]
            };
            *position = std::array::from_fn(|axis| places(axis)[i / 7usize.pow(axis as u32) % 7]);
        }
        let (loss, found) = gradients(&mut engine(&model, BARE, 4), &batch);
        assert!(loss.mse.is_finite() && found.iter().all(|g| g.is_finite()), "{name}: {loss:?}");
        assert_eq!(found.len(), model.parameters());
    }
}

#[test]
fn samples_below_the_gate_or_behind_what_is_opaque_have_no_gradient() {
    let (_, model) = &models()[0];
    let ray = BatchRay { dir: [0.0, 0.0, 1.0], rgb: [0.9, 0.1, 0.4], background: [0.0; 3], samples: 3 };
    let places = [[0.0, 1.0, 0.0], [1.0, 2.0, 0.5], [-0.8, 0.7, 0.6]];
    let touched = |deltas: [f32; 3]| {
        let batch = Batch {
            rays: vec![ray],
            positions: places.to_vec(),
            deltas: deltas.to_vec(),
            ..Batch::default()
        };
        gradients(&mut engine(model, BARE, 4), &batch)
    };
    let alone = |place: [f32; 3], delta: f32| {
        let ray = BatchRay { samples: 1, ..ray };
        let batch =
            Batch { rays: vec![ray], positions: vec![place], deltas: vec![delta], ..Batch::default() };
        gradients(&mut engine(model, BARE, 4), &batch).1
    };
    let tables = model.layer_parameters();
    let entries = |gradient: &[f32]| -> Vec<usize> {
        (tables..gradient.len()).filter(|&i| gradient[i] != 0.0).collect()
    };
    // The second sample's weight of some 1e-4 is below the gate of 1e-3.
    let (loss, found) = touched([0.3, 1e-4, 30.0]);
    assert_eq!((loss.evaluated, loss.kept), (3, 2));
    let mut expected = [entries(&alone(places[0], 0.3)), entries(&alone(places[2], 0.3))].concat();
    expected.sort_unstable();
    expected.dedup();
    assert_eq!(entries(&found), expected);
    let (loss, found) = touched([30.0, 0.3, 0.3]);
    // The first sample is opaque, but a ray's transmittance is tested only after eight samples are evaluated.
    assert_eq!((loss.evaluated, loss.kept), (3, 1));
    assert_eq!(entries(&found), entries(&alone(places[0], 30.0)));
}

#[test]
fn faint_samples_that_are_drawn_stand_for_those_that_are_not() {
    let (_, model) = &models()[0];
    let ray = BatchRay { dir: [0.0, 0.0, 1.0], rgb: [0.9, 0.1, 0.4], background: [0.0; 3], samples: 1 };
    let positions = vec![[0.0, 1.0, 0.0]];
    let mut batch = Batch { rays: vec![ray], positions, deltas: vec![2e-3], ..Batch::default() };
    let mut engine = engine(model, BARE, 4);
    let (loss, all) = gradients(&mut engine, &batch);
    assert_eq!(loss.kept, 1, "the test means a sample above the gate");
    let mut kept = 0;
    let mut mean = vec![0.0; all.len()];
    for step in 0..2000 {
        batch.roulette = Some((7, step));
        let (loss, found) = gradients(&mut engine, &batch);
        kept += loss.kept;
        mean.iter_mut().zip(found).for_each(|(mean, found)| *mean += found / 2000.0);
    }
    assert!((200..1800).contains(&kept), "{kept} of 2000");
    let largest = all.iter().fold(0.0f32, |most, g| most.max(g.abs()));
    let off = mean.iter().zip(&all).fold(0.0f32, |most, (mean, all)| most.max((mean - all).abs()));
    // Five standard deviations of the mean, if at least a third of the draws keep the sample.
    assert!(largest > 0.0 && off < 0.16 * largest, "{off} of {largest}");
}

#[test]
fn rays_without_samples_and_batches_of_nothing_move_nothing() {
    let (_, model) = &models()[0];
    let mut engine = engine(model, Adam::default(), 1);
    let before = engine.state();
    assert_eq!(engine.step(&Batch::default(), 1e-2).unwrap(), StepLoss::default());
    let mut batch = batch_of(50, 1);
    batch.rays.iter_mut().for_each(|ray| ray.samples = 0);
    batch.positions.clear();
    batch.deltas.clear();
    let squares = batch.rays.iter().flat_map(|r| (0..3).map(|k| (r.background[k] - r.rgb[k]).powi(2)));
    let expected = squares.map(f64::from).sum::<f64>() / 150.0;
    let loss = engine.step(&batch, 1e-2).unwrap();
    assert!((loss.mse - expected).abs() < 1e-7 && !loss.dead && loss.evaluated == 0);
    assert_eq!(OptimiserState { steps: 0, ..engine.state() }, before);
}

/// Returns one ray with one sample, at `x`.
fn touch(x: [f32; 3]) -> Batch {
    let ray = BatchRay { dir: [0.6, 0.0, 0.8], rgb: [0.9, 0.1, 0.4], background: [0.2; 3], samples: 1 };
    Batch { rays: vec![ray], positions: vec![x], deltas: vec![0.5], ..Batch::default() }
}

#[test]
fn an_entry_keeps_value_and_moments_while_it_is_not_touched() {
    // The level of 12 cells is dense, and the two samples are so far apart that they share no entry.
    let table = TableConfig {
        levels: 1,
        features: 2,
        log2_entries: 19,
        coarsest: 12,
        finest: 12,
        storage: TableStorage::F16,
        most_bytes: None,
    };
    let model = model(table, 1, 2, 16);
    let (here, there) = (touch([-0.9, 0.6, -0.2]), touch([1.4, 2.4, 0.7]));
    let adam = Adam::default();
    let mut engine = engine(&model, adam, 3);
    let first = model.layer_parameters();
    let start = engine.state();
    engine.step(&here, 1e-2).unwrap();
    let once = engine.state();
    let touched: Vec<usize> = (first..model.parameters()).filter(|&i| once.moment2[i] != 0.0).collect();
    assert_eq!(touched.len(), 16, "eight corners of two features");
    // Adam's first step has the length of the learning rate for any gradient g, since the corrected moments are g and
    // g².
    for &i in &touched {
        let moved = start.parameters[i] - once.parameters[i];
        assert!((moved.abs() - 1e-2).abs() < 1e-5 && moved.signum() == once.moment1[i].signum(), "{moved}");
    }
    for _ in 0..300 {
        engine.step(&there, 1e-4).unwrap();
    }
    let idle = engine.state();
    assert_eq!(idle.steps, 301);
    for &i in &touched {
        assert_eq!(
            [idle.parameters[i], idle.moment1[i], idle.moment2[i]],
            [once.parameters[i], once.moment1[i], once.moment2[i]]
        );
    }
    engine.step(&here, 1e-2).unwrap();
    let again = engine.state();
    let [beta1, beta2] = adam.betas;
    let corrected = |moment: f32, beta: f64| f64::from(moment) / (1.0 - beta.powi(302));
    for &i in &touched {
        // The moments continue from their last values; their correction counts all steps.
        let g = (f64::from(again.moment1[i]) - beta1 * f64::from(idle.moment1[i])) / (1.0 - beta1);
        let v = beta2 * f64::from(idle.moment2[i]) + (1.0 - beta2) * g * g;
        assert!((f64::from(again.moment2[i]) - v).abs() < 1e-4 * v, "{} {v}", again.moment2[i]);
        let step = 1e-2 * corrected(again.moment1[i], beta1) / corrected(again.moment2[i], beta2).sqrt();
        let moved = f64::from(idle.parameters[i]) - f64::from(again.parameters[i]);
        assert!((moved - step).abs() < 1e-6, "{moved} {step}");
    }
    // Entries that no sample has read keep their initial values.
    let untouched = (first..model.parameters()).filter(|&i| again.moment2[i] == 0.0);
    let mut count = 0;
    for i in untouched {
        assert_eq!((again.parameters[i], again.moment1[i]), (start.parameters[i], 0.0));
        count += 1;
    }
    assert_eq!(count, model.table_values() - 32);
}

#[test]
fn threads_do_not_change_a_bit() {
    let of_scenes = [batch_of(1500, 1), batch_of(65, 2), batch_of(900, 3)];
    // 9,000 pixels are more than sixteen chunks.
    let of_pictures = [pixels(9000, 1), pixels(65, 2), pixels(9000, 3)];
    let scenes = models().map(|(name, model)| (name, model, &of_scenes));
    let pictures = pictures().map(|(name, model)| (name, model, &of_pictures));
    for (name, model, batches) in scenes.into_iter().chain(pictures) {
        let after = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut engine = engine(&model, Adam { hashed_every: 2, ..Adam::default() }, 7);
                let losses = batches.each_ref().map(|batch| engine.step(batch, 1e-2).unwrap());
                (losses, bits(&engine.parameters()))
            })
        };
        let one = after(1);
        assert!(one == after(2) && one == after(3) && one == after(5), "{name}");
    }
}

#[test]
fn hashed_levels_move_in_turns_by_the_sum_of_their_gradients() {
    let (name, model) = &models()[1];
    let adam = Adam { hashed_every: 4, ..Adam::default() };
    let mut fused = engine(model, adam, 1);
    let mut tape = GridReferenceEngine::new(model, bounds(), adam, 0).unwrap();
    tape.restore(&fused.state()).unwrap();
    let grid = model.architecture.position.grid().unwrap();
    let hashed: Vec<bool> = grid.levels().map(|level| level.mask.is_some()).collect();
    assert_eq!(hashed, [false, true, true]);
    let levels = &groups(model)[model.layers().len()..];
    for step in 1..10u64 {
        let before = fused.state().parameters;
        let batch = batch_of(60, step);
        fused.step(&batch, 1e-3).unwrap();
        tape.step(&batch, 1e-3).unwrap();
        let after = fused.state();
        for (l, range) in levels.iter().enumerate() {
            let moved = before[range.clone()] != after.parameters[range.clone()];
            assert_eq!(moved, !hashed[l] || (step + l as u64).is_multiple_of(4), "step {step}, level {l}");
        }
        let apart =
            |a: &[f32], b: &[f32]| a.iter().zip(b).fold(0.0f32, |most, (a, b)| most.max((a - b).abs()));
        let expected = tape.state();
        assert!(apart(&expected.waiting, &after.waiting) < 1e-5, "{name}, step {step}");
        assert!(apart(&expected.moment1, &after.moment1) < 1e-5, "{name}, step {step}");
        // Rounding decides the sign of a gradient near 0, and the length of Adam's first steps is the learning rate.
        let far =
            expected.parameters.iter().zip(&after.parameters).filter(|(a, b)| (*a - *b).abs() > 1e-5).count();
        assert!(far < after.parameters.len() / 100, "{name}, step {step}: {far}");
    }
    let short = OptimiserState { waiting: vec![0.0], ..fused.state() };
    assert!(matches!(fused.restore(&short), Err(EngineError::Parameters { field: "waiting", .. })));
}

#[test]
fn weight_decay_shrinks_the_colour_branch_alone() {
    let (_, model) = &models()[1];
    let decayed = |weight_decay| {
        let mut engine = engine(model, Adam { weight_decay, ..Adam::default() }, 1);
        let before = engine.state().parameters;
        engine.step(&batch_of(60, 1), 1e-2).unwrap();
        (before, engine.state().parameters)
    };
    let ((before, without), (_, with)) = (decayed(0.0), decayed(0.5));
    for layer in model.layers() {
        let is_colour = matches!(layer.part, Part::Colour(_) | Part::Rgb);
        for i in layer.weights..layer.bias {
            let expected = if is_colour { without[i] - 1e-2 * 0.5 * before[i] } else { without[i] };
            assert!((with[i] - expected).abs() <= 1e-6 * before[i].abs(), "{:?}: {i}", layer.part);
        }
    }
    let tables = model.layer_parameters();
    assert_eq!(bits(&without[tables..]), bits(&with[tables..]));
}

#[test]
fn resuming_gives_the_bits_of_not_stopping() {
    let (_, model) = &models()[1];
    let batches: Vec<_> = (0..6).map(|seed| batch_of(60, seed)).collect();
    // First number: index of the first step with tables rounded to int8. Step 1 is before the checkpoint, step 4 is
    // after it, and step 6 is after the run. Second number: `hashed_every`.
    for (rounded_from, hashed_every) in [(6, 1), (1, 1), (4, 1), (6, 4), (4, 3)] {
        let adam = Adam { hashed_every, ..Adam::default() };
        let mut whole = engine(model, adam, 1);
        let mut half = OptimiserState::default();
        for (i, batch) in batches.iter().enumerate() {
            if i == 3 {
                half = whole.state();
            }
            if i >= rounded_from {
                whole.round_tables(TableStorage::Int8.into());
            }
            whole.step(batch, 1e-2).unwrap();
        }
        let mut resumed = engine(model, adam, 99);
        resumed.restore(&half).unwrap();
        for (i, batch) in batches.iter().enumerate().skip(3) {
            if i >= rounded_from {
                resumed.round_tables(TableStorage::Int8.into());
            }
            resumed.step(batch, 1e-2).unwrap();
        }
        assert_eq!(resumed.state(), whole.state(), "{rounded_from}");
        assert_eq!(bits(&resumed.parameters()), bits(&whole.parameters()), "{rounded_from}");
        assert_eq!(whole.table_scales().is_empty(), rounded_from == 6);
    }
}

/// Checks that the f16 tables which the next step reads have the values of tables exported as int8.
#[test]
fn rounded_tables_are_those_of_a_blob() {
    for (name, model) in models() {
        let mut engine = engine(&model, Adam::default(), 1);
        (0..3).for_each(|seed| _ = engine.step(&batch_of(60, seed), 1e-2).unwrap());
        engine.round_tables(TableStorage::Int8.into());
        let scales = engine.table_scales().to_vec();
        for seed in 3..6 {
            engine.step(&batch_of(60, seed), 1e-2).unwrap();
            engine.round_tables(TableStorage::Int8.into());
            assert_eq!(engine.table_scales(), scales, "{name}: scales stay");
            let values = &engine.state.parameters[engine.layers.parameters()..];
            let stored = Quantised::new(&engine.grid, values, TableStorage::Int8, &scales).unwrap();
            let of_blob = values_of(&engine.grid, stored.stored());
            let read = engine.halves.as_chunks().0.iter().map(|&bytes| f16::from_le_bytes(bytes));
            assert!(read.eq(of_blob.iter().map(|&value| f16::from_f32(value))), "{name}");
            assert_ne!(of_blob, values, "{name}: what is trained is not rounded");
        }
    }
}

#[test]
fn a_step_that_diverges_changes_nothing() {
    let (_, model) = &models()[1];
    let good = batch_of(40, 1);
    // Targets so far off that the gradient's square overflows, and parameters with which the loss is not finite.
    let mut far = good.clone();
    far.rays.iter_mut().for_each(|ray| ray.rgb = [1e30; 3]);
    let start = engine(model, Adam::default(), 1).state();
    let mut endless = start.clone();
    endless.parameters.iter_mut().for_each(|p| *p *= 1e30);
    for (what, state, batch) in [("far targets", &start, &far), ("huge parameters", &endless, &good)] {
        let mut engine = engine(model, Adam::default(), 1);
        engine.restore(state).unwrap();
        assert_eq!(engine.step(batch, 1e-2), Err(EngineError::Diverged { step: 1 }), "{what}");
        assert_eq!(&engine.state(), state, "{what}");
        // The buffers keep nothing of the failed step.
        engine.restore(&start).unwrap();
        let mut fresh = GridEngine::new(model, bounds(), Adam::default(), 1).unwrap();
        fresh.restore(&start).unwrap();
        assert_eq!(engine.step(&good, 1e-2).unwrap(), fresh.step(&good, 1e-2).unwrap(), "{what}");
        assert_eq!(engine.state(), fresh.state(), "{what}");
    }
}

#[test]
fn extreme_densities_and_bins_have_finite_gradients() {
    let (_, model) = &models()[0];
    let bias = model.layers().iter().find(|d| d.part == Part::Density).unwrap().bias;
    for raw in [-1e4, -100.0, -1.0, 0.0, 19.9, 20.0, 20.1, 1e4, 1e30] {
        let mut engine = engine(model, BARE, 4);
        let mut state = engine.state();
        state.parameters[bias] = raw;
        engine.restore(&state).unwrap();
        let mut batch = batch_of(60, 3);
        for (i, delta) in batch.deltas.iter_mut().enumerate() {
            *delta = [0.0, 1e-30, 1e-3, 1.0, 1e10, 1e20][i % 6];
        }
        let (loss, found) = gradients(&mut engine, &batch);
        assert!(loss.mse.is_finite() && loss.mse <= 1.0, "{raw}: {loss:?}");
        assert!(found.iter().all(|g| g.is_finite()), "{raw}");
        // If every density is almost 0, the loss reports it, so that the run can be started anew.
        assert_eq!(loss.dead, raw < -99.0, "{raw}: {loss:?}");
        // Every density is at its limit, whose derivative is 0.
        assert!(raw < 1e3 || found[bias] == 0.0, "{raw}: {}", found[bias]);
    }
}

#[test]
fn wrong_input_is_refused_by_name() {
    let (_, model) = &models()[0];
    let mut engine = engine(model, Adam::default(), 1);
    let before = engine.state();
    let good = batch_of(8, 1);
    let non_finite = |field, index| EngineError::Batch(BatchError::NonFinite { field, index });
    type Change = fn(&mut Batch);
    let cases: [(Change, EngineError); 7] = [
        (|b| b.positions[3][1] = f32::NAN, non_finite("positions", 3)),
        (|b| b.positions[3][1] = f32::INFINITY, non_finite("positions", 3)),
        (|b| b.rays[2].dir[0] = f32::INFINITY, non_finite("rays", 2)),
        (|b| b.rays[2].rgb[2] = f32::NAN, non_finite("rays", 2)),
        (|b| b.deltas[1] = -1.0, non_finite("deltas", 1)),
        (|b| b.deltas[1] = f32::NAN, non_finite("deltas", 1)),
        (|b| b.empty = vec![[0.0, f32::NAN, 0.0]], non_finite("empty", 0)),
    ];
    for (change, expected) in cases {
        let mut bad = good.clone();
        change(&mut bad);
        assert_eq!(engine.step(&bad, 1e-2), Err(expected));
    }
    let mut short = good.clone();
    short.deltas.pop();
    let found = engine.step(&short, 1e-2);
    assert!(matches!(found, Err(EngineError::Batch(BatchError::Length { field: "deltas", .. }))));
    for rate in [f64::NAN, f64::INFINITY, -1e-3] {
        assert!(matches!(engine.step(&good, rate), Err(EngineError::Rate { .. })));
    }
    let with = |change: &dyn Fn(&mut OptimiserState)| {
        let mut state = before.clone();
        change(&mut state);
        state
    };
    let bad = |field, index| EngineError::NonFinite { field, index };
    assert_eq!(engine.restore(&with(&|s| s.moment2[7] = -1.0)), Err(bad("moment2", 7)));
    assert_eq!(engine.restore(&with(&|s| s.parameters[9] = f32::NAN)), Err(bad("parameters", 9)));
    let found = engine.restore(&with(&|s| _ = s.moment1.pop()));
    assert!(matches!(found, Err(EngineError::Parameters { field: "moment1", .. })));
    assert_eq!(engine.restore(&with(&|s| s.scales = vec![0.0; 3])), Err(bad("scales", 0)));
    let found = engine.restore(&with(&|s| s.scales.push(1.0)));
    assert!(matches!(found, Err(EngineError::Parameters { field: "scales", .. })));
    let found = engine.restore(&with(&|s| s.steps = u64::MAX));
    assert!(matches!(found, Err(EngineError::Steps { .. })));
    assert_eq!(engine.state(), before);
    let sinusoidal = Preset::Small.config().model();
    assert_eq!(GridEngine::new(&sinusoidal, bounds(), BARE, 1).err(), Some(EngineError::NoGrid));
}
