//! The original authors' network against outputs of their own code.

use super::{ask, kernels, read, wide};
use crate::tools::data;
use serde::Deserialize;

#[derive(Deserialize)]
struct Samples {
    z_vals: Vec<f32>,
    examples: Vec<Example>,
}

/// A ray; its direction is not normalised, what the network is given is.
#[derive(Deserialize)]
struct Example {
    ray_o: [f32; 3],
    ray_d: [f32; 3],
    viewdir_unit: [f32; 3],
    coarse_sigma: Vec<f64>,
    coarse_rgb: Vec<[f64; 3]>,
    fine_sigma: Vec<f64>,
    fine_rgb: Vec<[f64; 3]>,
}

/// The larger of `worst` and |a − b| / max(1, |b|); infinite where that is no number, which `max` would leave out.
fn worse(worst: f64, a: f32, b: f64) -> f64 {
    let error = (f64::from(a) - b).abs() / b.abs().max(1.0);
    if error.is_nan() { f64::INFINITY } else { worst.max(error) }
}

#[test]
fn the_original_network_answers_as_the_original_code_did() {
    let Some(nets) = data("nets") else { return };
    let text = std::fs::read_to_string(nets.join("tf_reference_samples.json")).expect("the samples");
    let samples: Samples = serde_json::from_str(&text).expect("samples");
    let (mut points, mut dirs) = (Vec::new(), Vec::new());
    for ray in &samples.examples {
        for &z in &samples.z_vals {
            points.push(std::array::from_fn(|axis| ray.ray_o[axis] + ray.ray_d[axis] * z));
            dirs.push(ray.viewdir_unit);
        }
    }
    assert_eq!(points.len(), 15);
    for which in ["coarse", "fine"] {
        let expected: Vec<(f64, [f64; 3])> = samples
            .examples
            .iter()
            .flat_map(|ray| match which {
                "coarse" => ray.coarse_sigma.iter().copied().zip(ray.coarse_rgb.iter().copied()),
                _ => ray.fine_sigma.iter().copied().zip(ray.fine_rgb.iter().copied()),
            })
            .collect();
        for ending in ["npz", "safetensors"] {
            let imported = read(&nets.join(format!("lego_200k_{which}.{ending}")), &wide());
            for kernel in kernels() {
                let worst = ask(&imported, &wide(), kernel, &points, &dirs).map(|answers| {
                    let mut worst = [0.0f64; 2];
                    for (&(sigma, rgb), &(expected_sigma, expected_rgb)) in answers.iter().zip(&expected) {
                        worst[0] = worse(worst[0], sigma, expected_sigma);
                        // Where nothing is, no colour is asked for.
                        if sigma > 0.0 {
                            for (found, expected) in rgb.into_iter().zip(expected_rgb) {
                                worst[1] = worse(worst[1], found, expected);
                            }
                        }
                    }
                    worst
                });
                println!(
                    "{which}.{ending}, {}: worst error sigma {:.1e}, rgb {:.1e}; with f16 weights {:.1e}, {:.1e}",
                    kernel, worst[0][0], worst[0][1], worst[1][0], worst[1][1]
                );
                assert!(
                    worst[0].iter().all(|&error| error <= 1e-4),
                    "{which}.{ending}, {kernel:?}: {worst:?}"
                );
            }
        }
    }
}
