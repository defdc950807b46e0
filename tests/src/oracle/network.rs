//! The multilayer perceptron of a radiance field.

use super::encoding::encode;

/// `y = W x + b`.
#[derive(Clone, Debug, Default)]
pub struct Dense {
    /// `[outputs][inputs]`
    pub w: Vec<Vec<f64>>,
    /// `[outputs]`
    pub b: Vec<f64>,
}

impl Dense {
    /// The product, summed in ascending order.
    pub fn apply(&self, x: &[f64]) -> Vec<f64> {
        let row = |(w, b): (&Vec<f64>, &f64)| {
            assert_eq!(w.len(), x.len(), "a layer of other inputs");
            w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>() + b
        };
        self.w.iter().zip(&self.b).map(row).collect()
    }
}

/// An encoding's settings.
#[derive(Clone, Copy, Debug)]
pub struct Encoding {
    /// Number of levels.
    pub levels: u8,
    /// Whether angles are `2^k π x`, not `2^k x`.
    pub pi: bool,
    /// Whether the inputs themselves come first.
    pub identity: bool,
}

impl Encoding {
    fn of(&self, x: &[f64]) -> Vec<f64> {
        encode(x, self.levels, self.pi, self.identity)
    }
}

/// A radiance field, or a 2D field, which has no density.
#[derive(Clone, Debug)]
pub struct Network {
    /// Of the position, or of the point of an image.
    pub position: Encoding,
    /// Of the viewing direction, if colour depends on it.
    pub direction: Option<Encoding>,
    /// Dense+ReLU layers, and whether each takes `[h, PE(x)]`.
    pub trunk: Vec<(Dense, bool)>,
    /// From the trunk to the raw density.
    pub density: Option<Dense>,
    /// Whether sigma is `ln(1 + exp(raw − 1))`, not `max(0, raw)`.
    pub softplus: bool,
    /// A linear layer between trunk and colour, as the original code has it.
    pub feature: Option<Dense>,
    /// Dense+ReLU layers; the first takes `[h, PE(d)]`.
    pub colour: Vec<Dense>,
    /// The last layer, sigmoid behind it.
    pub rgb: Dense,
}

fn relu(x: Vec<f64>) -> Vec<f64> {
    x.into_iter().map(|x| x.max(0.0)).collect()
}

/// `ln(1 + e^x)` without overflow.
pub fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// `1 / (1 + e^−x)`.
pub fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

impl Network {
    /// What the trunk says of a point.
    pub fn trunk(&self, x: &[f64]) -> Vec<f64> {
        let encoded = self.position.of(x);
        let mut h = encoded.clone();
        for (layer, skip) in &self.trunk {
            if *skip {
                h.extend(&encoded);
            }
            h = relu(layer.apply(&h));
        }
        h
    }

    /// The density head before its activation; 0 of a 2D field.
    pub fn raw_density(&self, x: &[f64]) -> f64 {
        self.density.as_ref().map_or(0.0, |head| head.apply(&self.trunk(x))[0])
    }

    /// Density, per world unit.
    pub fn sigma(&self, x: &[f64]) -> f64 {
        let raw = self.raw_density(x);
        if self.softplus { softplus(raw - 1.0) } else { raw.max(0.0) }
    }

    /// Colour, display-encoded, in `[0, 1]`.
    pub fn rgb(&self, x: &[f64], dir: &[f64]) -> [f64; 3] {
        let mut h = self.trunk(x);
        if let Some(feature) = &self.feature {
            h = feature.apply(&h);
        }
        if let Some(direction) = &self.direction {
            h.extend(direction.of(dir));
        }
        for layer in &self.colour {
            h = relu(layer.apply(&h));
        }
        let raw = self.rgb.apply(&h);
        [0, 1, 2].map(|i| sigmoid(raw[i]))
    }

    /// A network of the parameters of a file: layers in the order trunk, density, colour, rgb, each `W` row by row,
    /// then `b` (`nerf-core/docs/blob-format.md`). Of `shape`, only what the file says is read.
    pub fn of_file(shape: &nerf_core::network::Architecture, parameters: &[f64]) -> Self {
        use nerf_core::encoding::AngleScale;
        let encoding = |e: &nerf_core::encoding::SinusoidalEncoding| Encoding {
            levels: e.levels,
            pi: e.scale == AngleScale::Pi,
            identity: e.identity,
        };
        let values = |e: &nerf_core::encoding::SinusoidalEncoding| {
            usize::from(e.inputs) * (usize::from(e.identity) + 2 * usize::from(e.levels))
        };
        let position = shape.position.sinusoidal().expect("a sinusoidal encoding of positions");
        let direction =
            shape.direction.as_ref().map(|it| it.sinusoidal().expect("a sinusoidal one of directions"));
        let mut rest = parameters.iter().copied();
        let mut dense = |inputs: usize, outputs: usize| {
            let w = (0..outputs).map(|_| rest.by_ref().take(inputs).collect()).collect();
            Dense { w, b: rest.by_ref().take(outputs).collect() }
        };
        let encoded = values(position);
        let mut width = encoded;
        let trunk = shape.trunk.iter().map(|layer| {
            let inputs = width + if layer.skip { encoded } else { 0 };
            width = usize::from(layer.width);
            (dense(inputs, width), layer.skip)
        });
        let trunk = trunk.collect();
        let density = shape.density.map(|_| dense(width, 1));
        let mut extra = direction.map_or(0, values);
        let mut colour = Vec::new();
        for &hidden in &shape.colour {
            colour.push(dense(width + extra, usize::from(hidden)));
            (width, extra) = (usize::from(hidden), 0);
        }
        let rgb = dense(width + extra, 3);
        assert_eq!(rest.next(), None, "parameters are left");
        Self {
            position: encoding(position),
            direction: direction.map(encoding),
            trunk,
            density,
            softplus: shape.density == Some(nerf_core::network::DensityActivation::ShiftedSoftplus),
            feature: None,
            colour,
            rgb,
        }
    }
}

/// The number of an IEEE 754 binary16.
pub fn f16(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f64::from(bits & 0x3ff));
    let size = match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1024.0 + fraction) * 2f64.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -size } else { size }
}
