//! Reference renderer in f64, one ray and one sample at a time.

use super::*;
use crate::camera::Ray;

/// A field that is evaluated in f64.
pub struct Oracle {
    pub shape: Architecture,
    /// Parameters in the blob's order.
    pub parameters: Vec<f32>,
    pub tables: Vec<f32>,
}

pub struct Sample {
    pub t: f64,
    pub sigma: f64,
    pub h: Vec<f64>,
}

impl Oracle {
    fn dense(&self, layer: &Layer, inputs: &[f64]) -> Vec<f64> {
        assert_eq!(inputs.len(), layer.inputs());
        let parameter = |i: usize| f64::from(self.parameters[i]);
        let row = |o: usize| {
            let weight = |i: usize| parameter(layer.weights + o * layer.inputs() + i);
            parameter(layer.bias + o) + inputs.iter().enumerate().map(|(i, x)| weight(i) * x).sum::<f64>()
        };
        (0..layer.outputs).map(row).collect()
    }

    /// Returns the grid encoding of `p`: trilinear interpolation in the box of [`SCENE`], one level after another.
    fn encode(&self, p: [f64; 3]) -> Vec<f64> {
        let grid = self.shape.position.grid().unwrap();
        let mut out = vec![];
        for level in grid.levels() {
            let place = [0, 1, 2].map(|axis| {
                let unit = ((p[axis] + 1.0) / 2.0).clamp(0.0, 1.0);
                let g = unit * f64::from(level.cells[axis]);
                let cell = (g as u64).min(u64::from(level.cells[axis]) - 1);
                (cell, g - cell as f64)
            });
            for feature in 0..2 {
                let corner = |corner: usize| {
                    let far = |axis: usize| corner >> axis & 1;
                    let weight =
                        |axis: usize| if far(axis) == 1 { place[axis].1 } else { 1.0 - place[axis].1 };
                    let [x, y, z] = [0, 1, 2].map(|axis| place[axis].0 + far(axis) as u64);
                    let [nx, ny, nz] = level.cells.map(u64::from);
                    let entry = if (nx + 1) * (ny + 1) * (nz + 1) <= 1 << grid.log2_entries {
                        (z * (ny + 1) + y) * (nx + 1) + x
                    } else {
                        let h = ((y * 2_654_435_761) ^ (z * 805_459_861)) & 0xffff_ffff;
                        ((h ^ (h >> 15)) & ((1 << grid.log2_entries) - 1)) + x
                    };
                    let value = self.tables[2 * (level.first + entry as usize) + feature];
                    weight(0) * weight(1) * weight(2) * f64::from(value)
                };
                out.push((0..8).map(corner).sum());
            }
        }
        out
    }

    /// Returns `h` and the raw density at the point `p`.
    pub fn at(&self, p: [f64; 3]) -> (Vec<f64>, f64) {
        let layers = self.shape.layers();
        let mut h = self.encode(p);
        for layer in layers.iter().filter(|layer| matches!(layer.role, Role::Trunk(_))) {
            h = self.dense(layer, &h).into_iter().map(|x| x.max(0.0)).collect();
        }
        let density = layers.iter().find(|layer| layer.role == Role::Density).unwrap();
        let raw = self.dense(density, &h)[0];
        (h, raw)
    }

    pub fn sigma(&self, raw: f64) -> f64 {
        match self.shape.density.unwrap() {
            DensityActivation::Relu => raw.max(0.0),
            DensityActivation::ShiftedSoftplus => (raw - 1.0).exp().ln_1p(),
            DensityActivation::Exponential => raw.min(20.0).exp(),
        }
    }

    /// Colour for the hidden features `p`, seen along `dir`.
    pub fn network(&self, p: &[f64], dir: Vec3) -> [f64; 3] {
        let [x, y, z] = dir.to_array().map(f64::from);
        let mut inputs = p.to_vec();
        // Real spherical harmonics of degree 3, 9 values.
        inputs.extend([
            0.282_094_791_773_878_14,
            -0.488_602_511_902_919_9 * y,
            0.488_602_511_902_919_9 * z,
            -0.488_602_511_902_919_9 * x,
            1.092_548_430_592_079 * x * y,
            -1.092_548_430_592_079 * y * z,
            0.946_174_695_757_560_1 * z * z - 0.315_391_565_252_520_05,
            -1.092_548_430_592_079 * x * z,
            0.546_274_215_296_039_5 * (x * x - y * y),
        ]);
        let layers = self.shape.layers();
        for layer in layers.iter().filter(|layer| matches!(layer.role, Role::Colour(_))) {
            inputs = self.dense(layer, &inputs).into_iter().map(|x| x.max(0.0)).collect();
        }
        let rgb = self.dense(layers.last().unwrap(), &inputs);
        [0, 1, 2].map(|c| 1.0 / (1.0 + (-rgb[c]).exp()))
    }

    /// Samples of a ray inside the box, front to back.
    pub fn samples(&self, ray: &Ray) -> Vec<Sample> {
        let bins = Bins::new(2.0, 6.0, 32).unwrap();
        let bounds = SceneBox { min: Vec3::NEG_ONE, max: Vec3::ONE };
        let inside = (0..32).map(|i| bins.at(i, 0.5)).filter(|&t| bounds.contains(ray.at(t)));
        inside
            .map(|t| {
                let (h, raw) = self.at(ray.at(t).to_array().map(f64::from));
                Sample { t: f64::from(t), sigma: self.sigma(raw), h }
            })
            .collect()
    }

    /// Returns the colour of a ray over the scene's background, and the opacity of the ray.
    pub fn pixel(&self, ray: &Ray, quality: &Quality) -> ([f64; 3], f64) {
        pixel_of(&[self], ray, quality)
    }
}

/// Returns the colour over the background and the opacity of a ray through several fields in one box. Densities add. A
/// field's share of a sample's weight is proportional to its density. Each field's colour branch is evaluated once.
pub fn pixel_of(fields: &[&Oracle], ray: &Ray, quality: &Quality) -> ([f64; 3], f64) {
    let samples: Vec<_> = fields.iter().map(|field| field.samples(ray)).collect();
    let (mut left, mut opacity, mut waiting) = (1.0, 0.0, 0.0);
    // Σ weight · h and Σ weight of each field.
    let mut sums: Vec<_> = fields.iter().map(|field| (vec![0.0; field.shape.h_rows()], 0.0)).collect();
    for i in 0..samples[0].len() {
        let sigma: f64 = samples.iter().map(|of| of[i].sigma).sum();
        let weight = left * (1.0 - (-sigma * 0.125).exp());
        left *= (-sigma * 0.125).exp();
        opacity += weight;
        waiting += weight;
        if waiting > f64::from(quality.colour_cut) {
            for ((sum, total), of) in sums.iter_mut().zip(&samples) {
                let share = waiting * of[i].sigma / sigma;
                sum.iter_mut().zip(&of[i].h).for_each(|(sum, h)| *sum += share * h);
                *total += share;
            }
            waiting = 0.0;
        }
        if left < f64::from(quality.transmittance_cut) {
            opacity = 1.0;
            break;
        }
    }
    let taken: f64 = sums.iter().map(|(_, total)| total).sum();
    let mut rgb = SCENE.background.map(|c| (1.0 - opacity) * f64::from(c));
    for (field, (sum, total)) in fields.iter().zip(&sums).filter(|(_, (_, total))| *total > 0.0) {
        let mean: Vec<f64> = sum.iter().map(|sum| sum / total).collect();
        let own = field.network(&mean, ray.dir);
        rgb = [0, 1, 2].map(|c| rgb[c] + opacity * total / taken * own[c]);
    }
    (rgb, opacity)
}
