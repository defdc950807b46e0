//! Tests of the fused and the reference engine, on small networks.

mod extremes;
mod gradients;
mod model;
mod oracle;
mod volume;

use super::model::uniform;
use super::*;
use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
use nerf_core::network::{Architecture, DensityActivation, Shading, TrunkLayer};

/// Returns a sinusoidal encoding of 3 inputs, whose first outputs are the inputs.
fn encoding(levels: u8, scale: AngleScale) -> SinusoidalEncoding {
    SinusoidalEncoding { inputs: 3, levels, scale, identity: true }
}

fn trunk(depth: usize, width: u16, skip: Option<usize>) -> impl Iterator<Item = TrunkLayer> {
    (0..depth).map(move |i| TrunkLayer { width, skip: Some(i) == skip })
}

/// Returns a model of 4 layers of 32 channels, without skip connection or feature layer. Its bias keeps initial
/// densities above 0.
fn plain() -> Model {
    let architecture = Architecture {
        position: encoding(6, AngleScale::Pi).into(),
        direction: Some(encoding(2, AngleScale::Pi).into()),
        trunk: trunk(4, 32, None).collect(),
        density: Some(DensityActivation::Relu),
        colour: [16].into_iter().collect(),
        shading: Shading::PerSample,
    };
    Model { density_bias: 0.3, ..Model::plain(architecture) }
}

/// Returns a model of 3 layers of 24 channels, with skip connection, feature layer, two colour layers and scaled
/// density.
fn classic() -> Model {
    let mut model = plain();
    model.architecture.position = encoding(5, AngleScale::One).into();
    model.architecture.trunk = trunk(3, 24, Some(2)).collect();
    model.architecture.colour = [20, 12].into_iter().collect();
    Model { feature: true, density_scale: 10.0, density_bias: 2.0, ..model }
}

/// Returns a model whose colour does not depend on the direction. Its feature layer feeds the output layer.
fn without_direction() -> Model {
    let mut model = plain();
    model.architecture.direction = None;
    model.architecture.colour.clear();
    Model { feature: true, density_bias: 0.5, ..model }
}

/// Returns a model with softplus density, and with layer widths that are not whole vectors.
fn softplus() -> Model {
    let mut model = plain();
    model.architecture.density = Some(DensityActivation::ShiftedSoftplus);
    model.architecture.trunk = trunk(2, 19, Some(1)).collect();
    model.architecture.colour = [7].into_iter().collect();
    Model { density_scale: 3.0, ..model }
}

/// Returns a model of a 2D field: two inputs, no density.
fn field() -> Model {
    let mut model = plain();
    model.architecture.position = SinusoidalEncoding { inputs: 2, ..encoding(4, AngleScale::Pi) }.into();
    model.architecture.direction = None;
    model.architecture.density = None;
    model
}

fn models() -> [(&'static str, Model); 5] {
    [
        ("plain", plain()),
        ("classic", classic()),
        ("without direction", without_direction()),
        ("softplus", softplus()),
        ("field", field()),
    ]
}

/// Returns random rays with 0 to 20 samples each (1 in a 2D field), and random points for `Batch::empty`.
fn batch_of(model: &Model, rays: usize, empty: usize, seed: u64) -> Batch {
    let mut counter = 0;
    let mut next = || {
        counter += 1;
        uniform(seed, counter) as f32
    };
    let mut batch = Batch { empty_weight: 0.3, ..Batch::default() };
    for ray in 0..rays {
        let mut triple = || [next(), next(), next()];
        let (dir, rgb, background) = (triple().map(|x| x - 0.5), triple(), triple());
        let length = dir.iter().map(|x| x * x).sum::<f32>().sqrt();
        let samples = match model.architecture.density {
            Some(_) => (ray * 8 % 21) as u32,
            None => 1,
        };
        batch.rays.push(BatchRay { dir: dir.map(|x| x / length), rgb, background, samples });
        for _ in 0..samples {
            batch.positions.push([next(), next(), next()].map(|x| 2.0 * x - 1.0));
            batch.deltas.push(0.2 * next());
        }
    }
    for _ in 0..empty {
        batch.empty.push([next(), next(), next()].map(|x| 4.0 * x - 2.0));
    }
    batch
}

/// Returns the larger of two errors. NaN counts as the largest, whereas `f64::max` ignores it.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || a > b { a } else { b }
}

/// Returns the largest absolute value among `gradients`, at least `floor`; NaN if one of them is NaN.
fn largest(gradients: &[f32], floor: f64) -> f64 {
    gradients.iter().fold(floor, |m, g| worse(m, f64::from(g.abs())))
}

fn fused(model: &Model, seed: u64) -> FusedEngine {
    FusedEngine::new(model, Adam::default(), seed).unwrap()
}

fn reference(model: &Model, seed: u64) -> ReferenceEngine {
    ReferenceEngine::new(model, Adam::default(), seed).unwrap()
}

type NewEngine = fn(&Model, &[f32]) -> Box<dyn Engine>;

/// Constructors of the fused and the reference engine from given parameters.
const ENGINES: [NewEngine; 2] = [
    |model, p| Box::new(FusedEngine::with_parameters(model, Adam::default(), p).unwrap()),
    |model, p| Box::new(ReferenceEngine::with_parameters(model, Adam::default(), p).unwrap()),
];

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|v| v.to_bits()).collect()
}

#[test]
fn threads_do_not_change_a_bit() {
    let model = classic();
    let batches = [batch_of(&model, 1500, 700, 1), batch_of(&model, 900, 0, 2)];
    let after = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut engine = fused(&model, 7);
            let losses = batches.each_ref().map(|batch| engine.step(batch, 1e-3).unwrap());
            (losses, bits(&engine.parameters()))
        })
    };
    let one = after(1);
    assert!(one == after(2) && one == after(5));
}

#[test]
fn resuming_gives_the_bits_of_not_stopping() {
    let model = classic();
    let batches: Vec<_> = (0..6).map(|seed| batch_of(&model, 60, 20, seed)).collect();
    for new in ENGINES {
        let start = |seed| new(&model, &model.initial_parameters(seed));
        let mut engine = start(1);
        let mut half = OptimiserState::default();
        for (i, batch) in batches.iter().enumerate() {
            if i == 3 {
                half = engine.state();
            }
            engine.step(batch, 1e-2).unwrap();
        }
        let mut resumed = start(99);
        resumed.restore(&half).unwrap();
        for batch in &batches[3..] {
            resumed.step(batch, 1e-2).unwrap();
        }
        assert_eq!(resumed.state(), engine.state());
        assert_eq!(resumed.state().steps, 6);
        assert_eq!(bits(&resumed.parameters()), bits(&engine.parameters()));
    }
}

#[test]
fn both_engines_walk_the_same_way() {
    let adam = Adam { weight_decay: 1e-3, epsilon: 1e-8, ..Adam::default() };
    for (name, model) in models() {
        let mut a = FusedEngine::new(&model, adam, 3).unwrap();
        let mut b = ReferenceEngine::new(&model, adam, 3).unwrap();
        for step in 0..5 {
            let batch = batch_of(&model, 40, 30, step);
            let (x, y) = (a.step(&batch, 1e-3).unwrap(), b.step(&batch, 1e-3).unwrap());
            assert!((x.mse - y.mse).abs() < 1e-5 * y.mse, "{name}: {x:?} {y:?}");
            assert!((x.empty - y.empty).abs() < 1e-4 * (y.empty + 1e-3), "{name}: {x:?} {y:?}");
        }
        // If a gradient is nearly 0, its rounding error decides the sign of Adam's step: few parameters may differ.
        let (a, b) = (a.parameters(), b.parameters());
        let far = a.iter().zip(&b[..]).filter(|(a, b)| (*a - *b).abs() > 2e-5).count();
        assert!(far * 200 <= a.len(), "{name}: {far} of {}", a.len());
    }
}

#[test]
fn fitting_two_discs_lowers_the_loss_tenfold() {
    let model = Model { density_scale: 10.0, density_bias: 2.0, ..plain() };
    let mut engine = fused(&model, 5);
    let mut first = 0.0;
    let mut last = 0.0;
    for step in 0..900 {
        let mut batch = batch_of(&model, 64, 64, 1000 + step);
        batch.positions.clear();
        batch.deltas.clear();
        for ray in &mut batch.rays {
            // Rays along −z through a plane; a red disc on the left, a blue one on the right.
            let (x, y) = (2.0 * ray.rgb[0] - 1.0, 2.0 * ray.rgb[1] - 1.0);
            let disc = |centre: f32| (x - centre).hypot(y) < 0.4;
            ray.dir = [0.0, 0.0, -1.0];
            ray.background = [1.0; 3];
            ray.rgb = match (disc(-0.5), disc(0.5)) {
                (true, _) => [0.9, 0.1, 0.1],
                (_, true) => [0.1, 0.1, 0.9],
                _ => [1.0; 3],
            };
            ray.samples = 8;
            batch.positions.extend((0..8).map(|k| [x, y, 0.4 - 0.1 * k as f32]));
            batch.deltas.extend([0.1; 8]);
        }
        batch.empty.iter_mut().for_each(|p| p[2] = 1.5);
        batch.empty_weight = 0.01;
        let loss = engine.step(&batch, 3e-3).unwrap();
        if step == 0 {
            first = loss.mse;
        }
        last = 0.9 * if step < 20 { loss.mse } else { last } + 0.1 * loss.mse;
        assert!(!loss.dead);
    }
    println!("mse {first} -> {last}");
    assert!(last < 0.1 * first, "{first} -> {last}");
}

#[test]
fn a_step_that_diverges_changes_nothing() {
    let model = plain();
    let batch = batch_of(&model, 30, 5, 1);
    for new in ENGINES {
        let huge: Vec<f32> = model.initial_parameters(1).iter().map(|p| p * 1e30).collect();
        let mut engine = new(&model, &huge);
        let before = engine.state();
        assert_eq!(engine.step(&batch, 1e-3), Err(EngineError::Diverged { step: 1 }));
        assert_eq!(engine.state(), before);
        // Buffers keep nothing of the failed step: the next step is that of a fresh engine.
        let mut sane = OptimiserState { parameters: model.initial_parameters(1), ..before };
        sane.steps = 4;
        engine.restore(&sane).unwrap();
        let mut fresh = new(&model, &sane.parameters);
        fresh.restore(&sane).unwrap();
        assert_eq!(engine.step(&batch, 1e-3).unwrap(), fresh.step(&batch, 1e-3).unwrap());
        assert_eq!(engine.state(), fresh.state());
    }
}

#[test]
fn wrong_input_is_refused_by_name() {
    let model = plain();
    let mut engine = fused(&model, 1);
    let good = batch_of(&model, 8, 3, 1);
    let mut short = good.clone();
    short.deltas.pop();
    assert!(matches!(
        engine.step(&short, 1e-3),
        Err(EngineError::Batch(BatchError::Length { field: "deltas", .. }))
    ));
    let mut bad = good.clone();
    bad.positions[3][1] = f32::NAN;
    let expected = BatchError::NonFinite { field: "positions", index: 3 };
    assert_eq!(engine.step(&bad, 1e-3), Err(EngineError::Batch(expected)));
    assert!(matches!(engine.step(&good, f64::NAN), Err(EngineError::Rate { .. })));
    let mut state = engine.state();
    state.moment2[7] = -1.0;
    let expected = EngineError::NonFinite { field: "moment2", index: 7 };
    assert_eq!(engine.restore(&state), Err(expected));
    state.moment1.pop();
    assert!(matches!(engine.restore(&state), Err(EngineError::Parameters { field: "moment1", .. })));
    let model = Model { density_scale: 0.0, ..model };
    assert!(matches!(FusedEngine::new(&model, Adam::default(), 1), Err(EngineError::Model(_))));
}

#[test]
fn adam_is_that_of_dfdx() {
    use dfdx::optim::Optimizer;
    use dfdx::prelude::*;
    let model = field();
    let initial = model.initial_parameters(1);
    let count = initial.len();
    let mut ours = optimiser::Optimiser::new(&model.layers(), Adam::default(), &initial).unwrap();
    let device = Cpu::default();
    let mut theirs: Tensor<Rank1<3>, f32, Cpu> = device.zeros();
    theirs.copy_from(&initial[..3]);
    let config = AdamConfig { lr: 1e-2, betas: [0.9, 0.99], eps: 1e-15, weight_decay: None };
    let mut adam = dfdx::optim::Adam::new(&theirs, config);
    for step in 0..4u64 {
        let gradient: Vec<f32> = (0..count as u64).map(|i| uniform(step, i) as f32 - 0.4).collect();
        let mut first = 0;
        for parameter in ours.parameters_mut() {
            let g = parameter.gradient_mut().unwrap();
            g.copy_from_slice(&gradient[first..][..g.len()]);
            first += g.len();
        }
        ours.apply(1e-2).unwrap();
        let mut gradients = Gradients::leaky();
        gradients.get_or_alloc_mut(&theirs).unwrap().copy_from_slice(&gradient[..3]);
        adam.update(&mut theirs, &gradients).unwrap();
    }
    assert_eq!(bits(&ours.values()[..3]), bits(&theirs.as_vec()));
}
