//! Tests of derivatives at extreme values, against finite differences in f64; the worst errors are printed.

use super::volume::error_of;
use super::*;
use crate::model::engine::pass::activate;
use nerf_core::simd::{BLOCK, Isa};

/// Largest relative error of rounding to f32.
const ROUND: f64 = 1.0 / (1 << 24) as f64;

/// Returns the derivative of `f` at 0 by a central difference of step `h`, which has an error of −h⁴ f⁽⁵⁾ / 30.
fn slope(h: f64, f: impl Fn(f64) -> f64) -> f64 {
    (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
}

/// Returns the squared error of a ray by the plain formula: transmittance is a running product, and no sample is
/// skipped.
fn plain_error(ray: &BatchRay, tau: &[f64], colour: &dyn Fn(usize, usize) -> f64) -> f64 {
    let (mut shown, mut transmittance) = ([0.0; 3], 1.0);
    for (i, tau) in tau.iter().enumerate() {
        let alpha = -(-tau).exp_m1();
        for (k, shown) in shown.iter_mut().enumerate() {
            *shown += transmittance * alpha * colour(i, k);
        }
        transmittance *= (-tau).exp();
    }
    let of = |k: usize| shown[k] + transmittance * f64::from(ray.background[k]) - f64::from(ray.rgb[k]);
    (0..3).map(|k| of(k).powi(2)).sum()
}

/// Returns random densities, lengths and colours of a ray's samples; densities are from `sigmas`, lengths from
/// `lengths`.
fn drawn(samples: usize, seed: u64, sigmas: &[f32], lengths: &[f32]) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
    let of = |from: &[f32], i: usize| from[(uniform(seed, i as u64) * from.len() as f64) as usize];
    let sigma = (0..samples).map(|i| of(sigmas, 2 * i)).collect();
    let deltas = (0..samples).map(|i| of(lengths, 2 * i + 1)).collect();
    let colour = (0..samples.div_ceil(BLOCK) * 3 * BLOCK).map(|i| uniform(seed + 1, i as u64) as f32);
    (sigma, deltas, colour.collect())
}

/// Name, samples per ray, number of rays, and the values from which densities and lengths are drawn.
type Case<'a> = (&'a str, usize, u64, &'a [f32], &'a [f32]);

#[test]
fn derivatives_of_walls_and_haze_and_4096_samples_are_finite_differences() {
    let walls = [0.0f32, 1e-10, 0.3, 1.0, 1e3, SIGMA_LIMIT];
    let haze = [0.0f32, 1e-30, 1e-10, 1e-3, 0.1, 0.5];
    let lengths = [0.0f32, 1e-30, 1e-10, 1e-3, 0.1, 1.0, 1e10, 1e30];
    let even = [1.0f32 / 4096.0];
    // Step of the differences. A sum over n samples has a rounding error of up to n · 2^-53. A difference divides this
    // error by the step, which gives `noise`.
    let step = 1e-3;
    let cases: [Case<'_>; 6] = [
        ("walls", 3, 60, &walls, &lengths),
        ("haze", 3, 60, &haze, &lengths),
        ("long walls", 64, 20, &walls, &lengths),
        ("long haze", 64, 20, &haze, &lengths),
        ("4096 of haze", 4096, 2, &haze, &even),
        ("4096 with walls", 4096, 2, &walls, &even),
    ];
    for (name, samples, rays, sigmas, lengths) in cases {
        let (mut worst_tau, mut worst_colour) = (0.0f64, 0.0f64);
        let noise = 4.0 * samples as f64 * f64::EPSILON / step + 1e-10;
        for seed in 0..rays {
            let (sigma, deltas, colour) = drawn(samples, 10 * seed, sigmas, lengths);
            let ray = BatchRay { samples: samples as u32, ..super::volume::RAY };
            let (sum, d_sigma, d_colour) = error_of(&ray, &sigma, &deltas, &colour);
            let tau: Vec<f64> =
                sigma.iter().zip(&deltas).map(|(&s, &d)| f64::from(s) * f64::from(d)).collect();
            let place = |i: usize, k: usize| i / BLOCK * 3 * BLOCK + k * BLOCK + i % BLOCK;
            let of = |i: usize, k: usize| f64::from(colour[place(i, k)]);
            assert!((sum - plain_error(&ray, &tau, &of)).abs() < noise * step);
            for i in (0..samples).step_by(samples.div_ceil(16)) {
                let expected = slope(step, |h| {
                    let mut tau = tau.clone();
                    tau[i] += h;
                    plain_error(&ray, &tau, &of)
                });
                let delta = f64::from(deltas[i]);
                let error = (f64::from(d_sigma[i]) - expected * delta).abs();
                let bound = delta * (ROUND * expected.abs() + noise) + f64::from(f32::from_bits(1));
                assert!(error <= bound, "{name}, sample {i}, sigma {}, delta {delta}: {error}", sigma[i]);
                if delta > 0.0 {
                    worst_tau = worst_tau.max(error / delta);
                }
                let expected = slope(step, |h| {
                    plain_error(&ray, &tau, &|j, k| of(j, k) + if (j, k) == (i, 1) { h } else { 0.0 })
                });
                let error = (f64::from(d_colour[place(i, 1)]) - expected).abs();
                assert!(error <= ROUND * expected.abs() + noise, "{name}, sample {i}: {error}");
                worst_colour = worst_colour.max(error);
            }
        }
        println!("{name}: worst error of dL/dtau {worst_tau:.1e}, of dL/dcolour {worst_colour:.1e}");
    }
}

/// Returns sigma of a raw density in f64, without a clamp at `SIGMA_LIMIT`.
fn sigma_of(activation: DensityActivation, raw: f64) -> f64 {
    match activation {
        DensityActivation::Relu => raw.max(0.0),
        DensityActivation::Exponential => raw.min(20.0).exp(),
        // ln(1 + e^y) in two forms, so that `exp` does not overflow for large y.
        DensityActivation::ShiftedSoftplus => {
            let y = raw - 1.0;
            if y > 0.0 { y + (-y).exp().ln_1p() } else { y.exp().ln_1p() }
        }
    }
}

#[test]
fn densities_are_clamped_forward_and_backward_and_their_slopes_are_finite_differences() {
    let limit = f64::from(SIGMA_LIMIT);
    let dense = (-2000..2000).map(|i| i as f32 * 0.061);
    let far = [1e3, 1e4, 1e5, 9.9e5, 1.1e6, 1e10, 1e30, f32::MAX, f32::INFINITY, 0.0, f32::MIN_POSITIVE];
    for activation in [DensityActivation::Relu, DensityActivation::ShiftedSoftplus] {
        let (mut worst_value, mut worst_slope) = (0.0f64, 0.0f64);
        for raw in dense.clone().chain(far).chain(far.map(|raw| -raw)) {
            let (value, found) = activate(activation, raw);
            let x = f64::from(raw);
            let kink = activation == DensityActivation::Relu && x.abs() <= 2e-3;
            let expected = sigma_of(activation, x);
            assert!((0.0..=SIGMA_LIMIT).contains(&value) && (0.0..=1.0).contains(&found), "{raw}");
            if expected >= limit {
                assert_eq!((value, found), (SIGMA_LIMIT, 0.0), "{activation:?} {raw}");
                continue;
            }
            // In f32, exp(y) has a relative error of |y| roundings plus a few, and an absolute error of one subnormal.
            let relative = ((x - 1.0).abs().min(110.0) + 4.0) * ROUND;
            let close = |found: f32, expected: f64| {
                let error = (f64::from(found) - expected).abs();
                assert!(error <= relative * expected + 3e-45, "{activation:?} {raw}: {found}, {expected}");
                if expected > 1e-37 { error / expected } else { 0.0 }
            };
            worst_value = worst_value.max(close(value, expected));
            // Slope by differences, whose own error is `rounding`.
            let difference = slope(1e-3, |h| sigma_of(activation, x + h));
            if !kink && x.abs() < 1e3 {
                let rounding = 4.0 * f64::EPSILON * expected / 1e-3 + 1e-12 * difference;
                let error = (f64::from(found) - difference).abs();
                assert!(error <= relative * difference + rounding + 3e-45, "{activation:?} {raw}: {found}");
                if difference > 1e-37 {
                    worst_slope = worst_slope.max(error / difference);
                }
            }
        }
        println!("{activation:?}: relative error of sigma {worst_value:.1e}, of its slope {worst_slope:.1e}");
        // NaN is not clamped, so that it shows in the loss and the step is refused.
        assert!(activate(activation, f32::NAN).0.is_nan());
    }
    // For very negative raw densities, sigma and slope are exactly 0, and not NaN.
    for activation in [DensityActivation::Relu, DensityActivation::ShiftedSoftplus] {
        assert_eq!(activate(activation, -1e4), (0.0, 0.0));
        assert_eq!(activate(activation, f32::NEG_INFINITY), (0.0, 0.0));
    }
    assert_eq!(activate(DensityActivation::Relu, -0.0), (0.0, 0.0));
}

/// Returns the instruction sets of this machine.
fn isas() -> impl Iterator<Item = Isa> {
    Isa::ALL.into_iter().filter(|isa| isa.available())
}

#[test]
fn pre_activations_of_ten_thousand_give_finite_gradients_with_every_instruction_set() {
    for (name, model) in models() {
        let batch = batch_of(&model, 30, 20, 31);
        for isa in isas() {
            for (density, rgb) in [(1e4, 1e4), (1e4, -1e4), (-1e4, 1e4), (-1e4, -1e4), (1e12, 1e30)] {
                let mut parameters = model.initial_parameters(3);
                for layer in model.layers() {
                    match layer.part {
                        Part::Density => parameters[layer.bias] = density,
                        Part::Rgb => parameters[layer.bias..][..layer.outputs].fill(rgb),
                        _ => {}
                    }
                }
                let mut engine = FusedEngine::with_parameters(&model, Adam::default(), &parameters).unwrap();
                engine.set_isa(isa);
                let (loss, gradients) = engine.gradients(&batch).unwrap();
                assert!(loss.mse.is_finite() && loss.mse <= 1.0 && loss.empty <= 13.9, "{name}: {loss:?}");
                assert!(gradients.iter().all(|g| g.is_finite()), "{name}, {}: {density} {rgb}", isa.name());
                // The sigmoid is saturated: its derivative is 0.
                let colours = model.layers().into_iter().filter(|layer| layer.part == Part::Rgb);
                for layer in colours {
                    let own = &gradients[layer.weights..layer.weights + layer.parameters()];
                    assert!(own.iter().all(|&g| g == 0.0), "{name}, {}", isa.name());
                }
            }
        }
    }
}

#[test]
fn gradients_of_walls_and_haze_are_finite_differences_with_every_instruction_set() {
    let kinds: [(&str, f32, f32, [f32; 4]); 3] = [
        ("moderate", 1.0, 0.0, [0.05, 0.1, 0.2, 0.4]),
        ("walls", 1e3, 1e3, [0.0, 1e-3, 0.1, 10.0]),
        ("haze", 1e-3, 1e-3, [0.0, 1e-30, 0.1, 10.0]),
    ];
    for (kind, scale, bias, lengths) in kinds {
        let mut worst: Vec<(Isa, f64)> = isas().map(|isa| (isa, 0.0)).collect();
        for (name, model) in models() {
            let Some(DensityActivation::Relu) = model.architecture.density else { continue };
            let scaled = model.density_scale * scale;
            let model = Model { density_scale: scaled, density_bias: model.density_bias + bias, ..model };
            let mut batch = batch_of(&model, 12, 20, 21);
            batch.deltas.iter_mut().enumerate().for_each(|(i, delta)| *delta = lengths[i % 4]);
            let p: Vec<f64> = fused(&model, 4).parameters().iter().map(|&p| f64::from(p)).collect();
            let chosen = |d: &Dense| [d.weights, d.weights + d.parameters() / 2, d.bias];
            let difference = |index: usize| {
                let at = |h: f64| {
                    let mut p = p.clone();
                    p[index] += h;
                    oracle::loss(&model, &p, &batch)
                };
                (at(1e-6) - at(-1e-6)) / 2e-6
            };
            let expected: Vec<[f64; 3]> = model.layers().iter().map(|d| chosen(d).map(difference)).collect();
            for (isa, worst) in &mut worst {
                let mut engine = fused(&model, 4);
                engine.set_isa(*isa);
                let (_, found) = engine.gradients(&batch).unwrap();
                for (d, expected) in model.layers().iter().zip(&expected) {
                    let range = d.weights..d.weights + d.parameters();
                    let largest = largest(&found[range], 1e-6);
                    for (index, expected) in chosen(d).into_iter().zip(expected) {
                        let error = (f64::from(found[index]) - expected).abs() / largest;
                        assert!(error.is_finite(), "{kind}, {name}, {}", isa.name());
                        *worst = worse(*worst, error);
                    }
                }
            }
        }
        for (isa, worst) in worst {
            println!("{kind}, {}: worst error over a layer's largest gradient {worst:.1e}", isa.name());
            // Typical rounding error of five layers with sums of 700 f32 products each: 5 √700 · 2^-24 = 8e-6.
            assert!(worst < 1e-5, "{kind}, {}: {worst}", isa.name());
        }
    }
}
