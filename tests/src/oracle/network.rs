//! The multilayer perceptron of a radiance field.

use super::encoding::encode;

/// A dense layer, `y = W x + b`.
#[derive(Clone, Debug, Default)]
pub struct Dense {
    /// Weights, `[outputs][inputs]`.
    pub w: Vec<Vec<f64>>,
    /// Biases, `[outputs]`.
    pub b: Vec<f64>,
}

impl Dense {
    /// Returns `W x + b`. Products are summed in ascending order of the inputs, before the bias is added.
    pub fn apply(&self, x: &[f64]) -> Vec<f64> {
        let row = |(w, b): (&Vec<f64>, &f64)| {
            assert_eq!(w.len(), x.len(), "a layer of other inputs");
            w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>() + b
        };
        self.w.iter().zip(&self.b).map(row).collect()
    }
}

/// Settings of a sinusoidal encoding.
#[derive(Clone, Copy, Debug)]
pub struct Encoding {
    /// Number of levels.
    pub levels: u8,
    /// True for angles `2^k π x`, false for `2^k x`.
    pub pi: bool,
    /// True if the inputs themselves come before the sines and cosines.
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
    /// Encoding of the position, or of the image point of a 2D field.
    pub position: Encoding,
    /// Encoding of the viewing direction; `None` if colour does not depend on the direction.
    pub direction: Option<Encoding>,
    /// Dense layers with ReLU. The flag is true if the layer takes `[h, PE(x)]`, false if it takes `h`.
    pub trunk: Vec<(Dense, bool)>,
    /// Density head, from the trunk's output to the raw density; `None` for a 2D field.
    pub density: Option<Dense>,
    /// True if sigma is `ln(1 + exp(raw − 1))`, false if sigma is `max(0, raw)`.
    pub softplus: bool,
    /// Linear layer between trunk and colour branch, as in the original code.
    pub feature: Option<Dense>,
    /// Dense layers with ReLU of the colour branch; the first takes `[h, PE(d)]`.
    pub colour: Vec<Dense>,
    /// Last layer of the colour branch, followed by a sigmoid.
    pub rgb: Dense,
}

fn relu(x: Vec<f64>) -> Vec<f64> {
    x.into_iter().map(|x| x.max(0.0)).collect()
}

/// Returns `ln(1 + e^x)` without overflow.
pub fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// Returns `1 / (1 + e^−x)`.
pub fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

impl Network {
    /// Returns the trunk's output at a point.
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

    /// Returns the density head's output before its activation; 0 for a 2D field.
    pub fn raw_density(&self, x: &[f64]) -> f64 {
        self.density.as_ref().map_or(0.0, |head| head.apply(&self.trunk(x))[0])
    }

    /// Returns the density, per world unit.
    pub fn sigma(&self, x: &[f64]) -> f64 {
        let raw = self.raw_density(x);
        if self.softplus { softplus(raw - 1.0) } else { raw.max(0.0) }
    }

    /// Returns the colour, display-encoded, in `[0, 1]`.
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

    /// Makes a network from the parameters in a file: layers in the order trunk, density, colour, rgb, each `W` row by
    /// row, then `b` (`nerf-core/docs/blob-format.md`). From `shape`, reads only fields that the file contains.
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

/// Converts the bits of an IEEE 754 binary16 to a number.
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
