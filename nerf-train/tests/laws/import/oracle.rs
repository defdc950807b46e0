//! nerf-pytorch's forward pass in f64, from its formulas.

use super::made::{Checkpoint, Shape};
use nerf_train::measure::import::AngleFactor;
use nerf_train::measure::import::Identity;
use nerf_train::measure::import::Order;
use nerf_train::measure::import::RawDensity;
use nerf_train::measure::import::Settings;
use std::f64::consts::PI;

/// A network of a shape under settings.
pub struct Oracle {
    shape: Shape,
    settings: Settings,
}

impl Oracle {
    pub fn of(shape: &Shape, settings: &Settings) -> Self {
        Self { shape: shape.clone(), settings: settings.clone() }
    }

    /// Sigma and rgb.
    pub fn forward(&self, checkpoint: &Checkpoint, point: [f32; 3], dir: [f32; 3]) -> (f64, [f64; 3]) {
        let linear = |name: &str, x: &[f64]| -> Vec<f64> {
            let values = |part: &str| &checkpoint.0[&format!("{name}.{part}")].1;
            let (weight, bias) = (values("weight"), values("bias"));
            let row = |row: &[f64]| row.iter().zip(x).map(|(w, x)| w * x).sum::<f64>();
            assert_eq!(weight.len(), bias.len() * x.len(), "{name}");
            weight.chunks_exact(x.len()).zip(bias).map(|(w, b)| row(w) + b).collect()
        };
        let relu = |x: Vec<f64>| -> Vec<f64> { x.into_iter().map(|x| x.max(0.0)).collect() };
        let position = self.embed(point, self.shape.position);
        let mut h = position.clone();
        for i in 0..self.shape.trunk.len() {
            h = relu(linear(&format!("pts_linears.{i}"), &h));
            if self.shape.skips.contains(&i) {
                h = [position.clone(), h].concat();
            }
        }
        let (raw_sigma, raw_rgb) = match self.shape.direction {
            Some(columns) => {
                let alpha = linear("alpha_linear", &h)[0];
                let mut h = [linear("feature_linear", &h), self.embed(dir, columns)].concat();
                for i in 0..self.shape.views.len() {
                    h = relu(linear(&format!("views_linears.{i}"), &h));
                }
                (alpha, linear("rgb_linear", &h))
            }
            None => {
                let outputs = linear("output_linear", &h);
                (outputs[3], outputs[..3].to_vec())
            }
        };
        let sigma = match self.settings.density {
            RawDensity::Relu => raw_sigma.max(0.0),
            RawDensity::Softplus => raw_sigma.exp().ln_1p(),
            RawDensity::ShiftedSoftplus => (raw_sigma - 1.0).exp().ln_1p(),
        };
        (sigma, std::array::from_fn(|c| 1.0 / (1.0 + (-raw_rgb[c]).exp())))
    }

    /// As the trainer of this order would, loop for loop.
    fn embed(&self, v: [f32; 3], columns: usize) -> Vec<f64> {
        let v = v.map(f64::from);
        let s = if self.settings.angle_scale == AngleFactor::Pi { PI } else { 1.0 };
        let identity = columns % 6 == 3;
        let levels = columns / 6;
        let wave = |cosine: usize, k: usize, i: usize| {
            let angle = v[i] * s * (1u32 << k) as f64;
            if cosine == 1 { angle.cos() } else { angle.sin() }
        };
        let mut waves = Vec::new();
        let mut each =
            |outer: usize, middle: usize, inner: usize, at: &dyn Fn(usize, usize, usize) -> f64| {
                for a in 0..outer {
                    for b in 0..middle {
                        waves.extend((0..inner).map(|c| at(a, b, c)));
                    }
                }
            };
        match self.settings.order {
            Order::Level => each(levels, 2, 3, &|k, cosine, i| wave(cosine, k, i)),
            Order::Pairs => each(levels, 3, 2, &|k, i, cosine| wave(cosine, k, i)),
            Order::Input => each(3, levels, 2, &|i, k, cosine| wave(cosine, k, i)),
            Order::Halves => each(2, levels, 3, &|cosine, k, i| wave(cosine, k, i)),
            Order::HalvesByInput => each(2, 3, levels, &|cosine, i, k| wave(cosine, k, i)),
        }
        match (identity, self.settings.identity) {
            (true, Some(Identity::Last)) => [waves, v.to_vec()].concat(),
            (true, _) => [v.to_vec(), waves].concat(),
            (false, _) => waves,
        }
    }
}
