//! Tests of the gradients of the loss with respect to rays.

use super::*;
use crate::model::engine::RayQuestion;
use nerf_core::space::Contraction;

/// Returns rays from outside the box, with samples at `distances`. Some samples lie outside the ball that is not
/// contracted.
fn rays_through(question: &RayQuestion, origins: &[Vec3], dirs: &[Vec3], distances: &[f32]) -> Batch {
    let mut batch = batch_of(origins.len(), 77);
    (batch.positions, batch.deltas) = (Vec::new(), Vec::new());
    for ((ray, origin), dir) in batch.rays.iter_mut().zip(origins).zip(dirs) {
        let points = distances.iter().map(|t| question.contraction.contract(*origin + *dir * *t).to_array());
        batch.positions.extend(points);
        batch.deltas.extend(distances.iter().map(|t| 0.1 + 0.02 * t));
        (ray.dir, ray.samples) = (dir.to_array(), distances.len() as u32);
    }
    batch.origins = origins.iter().map(|origin| origin.to_array()).collect();
    batch.question = Some(*question);
    batch
}

#[test]
fn gradients_by_rays_are_finite_differences() {
    for (name, model) in [
        ("a layer, no direction", model(table(2, 19), 1, 0, 16)),
        ("no layer", model(table(2, 19), 0, 3, 20)),
        ("no layer, no colour layer", model(table(2, 19), 0, 3, 0)),
        ("a layer", model(table(2, 6), 1, 3, 16)),
    ] {
        check_against_differences(name, &model);
    }
}

fn check_against_differences(name: &str, model: &Model) {
    let (middle, distances) = (Vec3::new(0.25, 1.5, 0.25), [1.1, 1.5, 1.95, 2.4, 2.9]);
    let bounds = Contraction::cube(middle, 0.6);
    let contraction = Contraction::new(&bounds, 1).unwrap();
    let question = RayQuestion { contraction, blur: 0.0 };
    let draw = |i: u64| uniform(9, i) as f32 - 0.5;
    let triple = |i: u64| Vec3::new(draw(3 * i), draw(3 * i + 1), draw(3 * i + 2));
    let origins: Vec<Vec3> = (1..9).map(|i| middle + 2.0 * triple(i).normalize()).collect();
    let towards = |(i, origin): (u64, &Vec3)| (middle + 0.4 * triple(100 + i) - *origin).normalize();
    let dirs: Vec<Vec3> = (0..).zip(&origins).map(towards).collect();
    let mut engine = engine_over(bounds, model, BARE, 4);
    let p = wide(&engine.parameters());
    engine.ask(&rays_through(&question, &origins, &dirs, &distances)).unwrap();
    assert_eq!(wide(&engine.parameters()), p);
    let found: Vec<RayGradient> = engine.ray_gradients().copied().collect();
    let rays: Vec<u32> = found.iter().map(|gradient| gradient.ray).collect();
    assert_eq!(rays, (0..8).collect::<Vec<_>>());
    // Central differences, and the difference between the slopes on the two sides, which is large if a sample changes
    // its cell.
    let differences = |gradient: &RayGradient, axis: usize, of_origin: bool| {
        let at = |h: f32| {
            let (mut origins, mut dirs) = (origins.clone(), dirs.clone());
            let moved = if of_origin { &mut origins } else { &mut dirs };
            moved[gradient.ray as usize][axis] += h;
            oracle::loss(model, &bounds, &p, &rays_through(&question, &origins, &dirs, &distances)).loss
        };
        let [low, here, high] = [-2e-4, 0.0, 2e-4].map(at);
        ((high - low) / 4e-4, (high + low - 2.0 * here).abs() / 2e-4)
    };
    let mut rows = Vec::new();
    for gradient in &found {
        for (of_origin, values) in [(true, gradient.by_origin), (false, gradient.by_dir)] {
            for axis in 0..3 {
                let (expected, bend) = differences(gradient, axis, of_origin);
                rows.push((expected, (expected - f64::from(values[axis])).abs(), bend));
            }
        }
    }
    let largest = rows.iter().fold(0.0f64, |most, row| most.max(row.0.abs()));
    let smooth: Vec<_> = rows.iter().filter(|row| row.2 < 0.02 * largest).collect();
    let error = smooth.iter().fold(0.0, |most, row| worse(most, row.1));
    println!("{name}: {error:.1e} of {largest:.1e}, {} of {}", smooth.len(), rows.len());
    assert!(
        smooth.len() > 40 && error < 0.01 * largest,
        "{name}: {error} of {largest}, {} smooth",
        smooth.len()
    );
}
