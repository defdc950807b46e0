//! Second implementation of a grid field's loss, sample by sample in f64: tables, hash, layers and volume rendering.
//!
//! No sample is left out, and no ray ends early. If the engine leaves samples out, the two losses differ.

use crate::model::engine::{Batch, Dense, Model, Part, Surface};
use glam::DVec3;
use nerf_core::encoding::{DirectionEncoding, GridEncoding};
use nerf_core::space::SceneBox;

/// Returns the encoded position `x`, `[level · features + feature]`, from the table values `p`.
fn encode(grid: &GridEncoding, bounds: &SceneBox, p: &[f64], x: &[f32; 3]) -> Vec<f64> {
    let (axes, features) = (usize::from(grid.inputs), usize::from(grid.features));
    let (min, max) = (bounds.min.to_array(), bounds.max.to_array());
    let unit: [f64; 3] = std::array::from_fn(|axis| {
        let side = f64::from(max[axis] - min[axis]);
        ((f64::from(x[axis]) - f64::from(min[axis])) / side).clamp(0.0, 1.0)
    });
    let (mut out, mut first) = (Vec::new(), 0);
    for resolution in &grid.resolutions {
        let cells = resolution.map(u64::from);
        let vertices: u64 = cells.iter().map(|n| n + 1).product();
        let most = 1u64 << grid.log2_entries;
        let hashed = vertices > most;
        let at: [(u64, f64); 3] = std::array::from_fn(|axis| {
            if axis >= axes {
                return (0, 0.0);
            }
            let g = unit[axis] * cells[axis] as f64;
            let cell = g.floor().min(cells[axis] as f64 - 1.0);
            (cell as u64, g - cell)
        });
        let entry = |corner: [u64; 3]| {
            let [vx, vy, vz]: [u64; 3] = std::array::from_fn(|axis| at[axis].0 + corner[axis]);
            if !hashed {
                return (vz * (cells[1] + 1) + vy) * (cells[0] + 1) + vx;
            }
            let h = (vy as u32).wrapping_mul(2_654_435_761) ^ (vz as u32).wrapping_mul(805_459_861);
            u64::from(h ^ h >> 15) % most + vx
        };
        for feature in 0..features {
            let mut sum = 0.0;
            for corner in 0..1u64 << axes {
                let corner = [corner & 1, corner >> 1 & 1, corner >> 2];
                let weight: f64 = (0..axes)
                    .map(|axis| if corner[axis] == 1 { at[axis].1 } else { 1.0 - at[axis].1 })
                    .product();
                sum += weight * p[first + entry(corner) as usize * features + feature];
            }
            out.push(sum);
        }
        first += (if hashed { most + cells[0] } else { vertices }) as usize * features;
    }
    assert_eq!(first, p.len(), "tables of another grid");
    out
}

/// Returns `W [x, extra] + b`, after a ReLU if `relu`.
fn dense(d: &Dense, p: &[f64], x: &[f64], extra: &[f64], relu: bool) -> Vec<f64> {
    let input: Vec<f64> = x.iter().chain(extra).copied().collect();
    assert_eq!(input.len(), d.inputs());
    let rows = p[d.weights..d.bias].chunks_exact(d.inputs()).zip(&p[d.bias..]);
    let y = rows.map(|(row, b)| b + row.iter().zip(&input).map(|(w, x)| w * x).sum::<f64>());
    y.map(|y| if relu { y.max(0.0) } else { y }).collect()
}

/// Returns the spherical harmonics of the bands below `degree` (at most 3), from their definitions.
fn harmonics(degree: u8, dir: &[f32; 3]) -> Vec<f64> {
    use std::f64::consts::PI;
    let [x, y, z] = dir.map(f64::from);
    let (band1, band2) = ((0.75 / PI).sqrt(), 0.5 * (15.0 / PI).sqrt());
    let mut out = vec![0.5 * (1.0 / PI).sqrt()];
    out.extend([-band1 * y, band1 * z, -band1 * x]);
    out.extend([band2 * x * y, -band2 * y * z, 0.25 * (5.0 / PI).sqrt() * (3.0 * z * z - 1.0)]);
    out.extend([-band2 * x * z, 0.5 * band2 * (x * x - y * y)]);
    out.truncate(usize::from(degree).pow(2));
    out
}

/// Returns sigma (infinite in a 2D field) and the features that the colour branch reads.
fn evaluate(m: &Model, bounds: &SceneBox, p: &[f64], x: &[f32; 3]) -> (f64, Vec<f64>) {
    let (layers, tables) = p.split_at(m.layer_parameters());
    let mut h = encode(m.architecture.position.grid().unwrap(), bounds, tables, x);
    let mut sigma = f64::INFINITY;
    for d in m.layers() {
        match d.part {
            Part::Trunk(_) => h = dense(&d, layers, &h, &[], true),
            Part::Density => sigma = dense(&d, layers, &h, &[], false)[0].min(20.0).exp(),
            _ => {}
        }
    }
    (sigma, h)
}

/// Returns the colour of the features `h`, seen along `dir`.
fn branch(m: &Model, p: &[f64], h: &[f64], dir: &[f32; 3]) -> Vec<f64> {
    let mut h = h.to_vec();
    for d in m.layers().iter().filter(|d| matches!(d.part, Part::Colour(_) | Part::Rgb)) {
        let extra = match m.architecture.direction {
            Some(DirectionEncoding::SphericalHarmonics { degree }) if d.extra > 0 => harmonics(degree, dir),
            _ => Vec::new(),
        };
        h = dense(d, p, &h, &extra, d.part != Part::Rgb);
    }
    h.into_iter().map(|raw| 1.0 / (1.0 + (-raw).exp())).collect()
}

/// Returns `Σ_i weight_i values_i`; the first number of each pair in `weights` is the weight.
fn sum(weights: &[(f64, f64)], values: &[Vec<f64>]) -> Vec<f64> {
    let mut sum = vec![0.0; values[0].len()];
    for ((weight, _), values) in weights.iter().zip(values) {
        sum.iter_mut().zip(values).for_each(|(sum, x)| *sum += weight * x);
    }
    sum
}

/// Returns a ray's composited colour: opacity times the colour of the mean features.
fn shown(m: &Model, p: &[f64], weights: &[(f64, f64)], features: &[Vec<f64>], dir: &[f32; 3]) -> Vec<f64> {
    if features.is_empty() {
        return vec![0.0; 3];
    }
    let opacity: f64 = weights.iter().map(|(weight, _)| weight).sum();
    let mean: Vec<f64> = sum(weights, features).iter().map(|x| x / opacity).collect();
    branch(m, p, &mean, dir).iter().map(|colour| opacity * colour).collect()
}

/// Terms of a batch's loss, and extremes of its samples.
pub(super) struct Found {
    /// Mean over rays and channels of the squared error.
    pub loss: f64,
    /// Mean over rays of the distortion loss, times its weight.
    pub distortion: f64,
    /// Mean over rays of the depth loss of known surfaces.
    pub surfaces: f64,
    /// Smoothness loss, times its weight.
    pub smoothness: f64,
    /// Smallest compositing weight of a sample.
    pub least_weight: f64,
    /// Smallest transmittance in front of a sample.
    pub least_transmittance: f64,
}

/// Returns the smoothness loss of rays with the given disparities, times its weight.
fn smoothness(batch: &Batch, disparities: &[f64]) -> f64 {
    let Some((weight, _)) = batch.smoothness else { return 0.0 };
    let mut sum = 0.0;
    for first in batch.lines.iter().flat_map(|&line| [line as usize, line as usize + 1]) {
        let dirs = [0, 1, 2].map(|k| DVec3::from(batch.rays[first + k].dir.map(f64::from)));
        let sine = |i: usize, k: usize| dirs[i].cross(dirs[k]).length();
        let parts = [sine(1, 2), -sine(0, 2), sine(0, 1)];
        let residual: f64 = (0..3).map(|k| 2.0 * parts[k] * disparities[first + k] / sine(0, 2)).sum();
        let step = |k: usize, c: usize| {
            let [a, b] = [0, 1].map(|i| f64::from(batch.rays[first + k + i].rgb[c]));
            (a - b).abs()
        };
        let edge = (0..6).map(|i| step(i / 3, i % 3)).fold(0.0, f64::max);
        sum += (-20.0 * edge).exp() * ((residual * residual + 1e-4).sqrt() - 0.01);
    }
    f64::from(weight) * sum / batch.rays.len() as f64
}

pub(super) fn loss(m: &Model, bounds: &SceneBox, p: &[f64], batch: &Batch) -> Found {
    let mut found = Found {
        loss: 0.0,
        distortion: 0.0,
        surfaces: 0.0,
        smoothness: 0.0,
        least_weight: f64::INFINITY,
        least_transmittance: 1.0,
    };
    let (mut first, mut disparities) = (0, Vec::new());
    for (index, ray) in batch.rays.iter().enumerate() {
        let (mut transmittance, mut along) = (1.0f64, 0.0f64);
        let (mut weights, mut features) = (Vec::new(), Vec::new());
        for i in first..first + ray.samples as usize {
            let (sigma, h) = evaluate(m, bounds, p, &batch.positions[i]);
            let alpha = -(-sigma * f64::from(batch.deltas[i])).exp_m1();
            let weight = transmittance * alpha;
            found.least_weight = found.least_weight.min(weight);
            found.least_transmittance = found.least_transmittance.min(transmittance);
            features.push(h);
            transmittance *= 1.0 - alpha;
            if i > first {
                let [from, to] = [i - 1, i].map(|i| batch.positions[i].map(f64::from));
                along += (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum::<f64>().sqrt();
            }
            weights.push((weight, along));
        }
        if let Some(surface) = batch.surfaces.get(index) {
            let clip = f64::from(Surface::CLIP);
            let cost = |(i, (w, _)): (usize, &(f64, f64))| {
                w * f64::from(batch.along[first + i] - surface.at).abs().min(clip)
            };
            let costs: f64 = weights.iter().enumerate().map(cost).sum();
            found.surfaces += f64::from(surface.weight) * (costs + transmittance * clip);
        }
        if let Some((_, contraction)) = &batch.smoothness {
            let origin = DVec3::from(batch.origins[index].map(f64::from));
            let disparity = |(i, (w, _)): (usize, &(f64, f64))| {
                let point = contraction.in_world(batch.positions[first + i].into());
                let distance = (point.as_dvec3() - origin).dot(ray.dir.map(f64::from).into());
                w * f64::from(contraction.radius()) / distance
            };
            disparities.push(weights.iter().enumerate().map(disparity).sum::<f64>());
        }
        first += ray.samples as usize;
        for (w, s) in &weights {
            found.distortion += weights.iter().map(|(v, t)| w * v * (s - t).abs()).sum::<f64>();
        }
        let shown = shown(m, p, &weights, &features, &ray.dir);
        for (k, shown) in shown.into_iter().enumerate() {
            let gain = f64::from(batch.gains.get(index).map_or(1.0, |gain| gain[k]));
            let shown = gain * shown + transmittance * f64::from(ray.background[k]);
            let error = shown - f64::from(ray.rgb[k]);
            found.loss += f64::from(batch.weights.get(index).copied().unwrap_or(1.0)) * error * error;
        }
    }
    found.loss /= (3 * batch.rays.len()).max(1) as f64;
    found.distortion *= f64::from(batch.distortion) / batch.rays.len().max(1) as f64;
    found.surfaces /= batch.rays.len().max(1) as f64;
    found.smoothness = smoothness(batch, &disparities);
    found
}
