//! Both engines train the same field.

use crate::{by_tape, scene, tiny_grid, tiny_seed, tiny_unbounded};
use nerf_core::Kernel;
use nerf_train::data::Dataset;
use nerf_train::model::config::Config;
use nerf_train::model::config::Preset;
use nerf_train::train::Trainer;

/// Parameters at the start and after 20 steps, and the samples that were trained on.
fn trained(dataset: &Dataset, config: Config) -> ([Vec<f32>; 2], u64) {
    let mut trainer = Trainer::new(dataset, config, Kernel::detect()).expect("a trainer");
    let parameters = |trainer: &Trainer<'_>| trainer.checkpoint(0.0).optimiser.parameters;
    let start = parameters(&trainer);
    for step in 0..20 {
        trainer.step(f64::from(step) / 20.0).expect("a step");
    }
    ([start, parameters(&trainer)], trainer.progressed().samples)
}

/// ‖a − b‖₂.
fn distance(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn after_20_steps_both_engines_have_gone_to_the_same_place() {
    let dataset = scene();
    for (name, config, bound) in [
        ("small", Preset::Small.config(), 1.0),
        ("seed, narrow", tiny_seed(20), 1.0),
        ("grid", Preset::Grid.config(), 1.0),
        ("grid, five levels", tiny_grid(20), 1.0),
        ("grid without hull", tiny_grid(20).without_hull(), 1.0),
        ("unbounded grid", tiny_unbounded(20), 1.0),
    ] {
        let time = std::time::Instant::now();
        let ([start, fused], samples) = trained(&dataset, config.clone());
        let fused_time = time.elapsed();
        let ([start_of_tape, tape], samples_of_tape) = trained(&dataset, by_tape(config));
        assert!(start == start_of_tape, "{name}");
        let way = distance(&fused, &start);
        let apart = distance(&fused, &tape) / way;
        let most = fused.iter().zip(&tape).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let longest = fused.iter().zip(&start).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        println!(
            "{name}: {apart:.1e} of the way, most {most:.1e} of {longest:.1e}; {samples} and {samples_of_tape} samples; {fused_time:?} {:?}",
            time.elapsed()
        );
        assert!(apart < bound, "{name}: {apart:.1e} of the way");
    }
}
