//! Gradients of the density with respect to position, for normals, compared with finite differences of the oracle's f64
//! network.

use crate::table::{BACKENDS, Row, Worst, cases, exact_kernels};
use nerf_core::Kernel;
use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
use nerf_core::math::MathBackend;
use nerf_core::network::{
    Architecture, DensityActivation, GradientScratch, Network, Scratch, Shading, TrunkLayer, Weights,
};
use nerf_testing::error::worst_of;
use nerf_testing::noise::signed;
use nerf_testing::oracle;
use nerf_testing::oracle::network::f16;
use nerf_testing::scenes::kernels;

cases! {
    gradients_of_random_networks: "error over what the gradient's terms add up to without signs" => random;
    gradients_of_networks_without_doubtful_units: "error over what the gradient's terms add up to without signs" => certain;
    gradients_where_no_unit_is_on: "components that are not 0" => dark;
}

/// Number of samples in a block.
const STRIDE: usize = 64;

/// A network and its parts. Parameters are exact f16 values, so that f32 and f64 describe the same network.
struct Case {
    name: &'static str,
    shape: Architecture,
    bytes: Vec<u8>,
    oracle: oracle::network::Network,
}

/// Returns networks with and without identity, with both angle scales, few and many levels, skip layers, and both
/// density activations.
fn shapes() -> Vec<(&'static str, Architecture)> {
    let shape = |levels, scale, identity, trunk: &[(u16, bool)], density| Architecture {
        position: SinusoidalEncoding { inputs: 3, levels, scale, identity }.into(),
        direction: None,
        trunk: trunk.iter().map(|&(width, skip)| TrunkLayer { width, skip }).collect(),
        density: Some(density),
        colour: [].into_iter().collect(),
        shading: Shading::PerSample,
    };
    let (pi, one) = (AngleScale::Pi, AngleScale::One);
    let (relu, softplus) = (DensityActivation::Relu, DensityActivation::ShiftedSoftplus);
    vec![
        ("identity alone", shape(0, pi, true, &[(24, false), (24, true)], relu)),
        ("one layer", shape(4, pi, true, &[(16, false)], relu)),
        ("no identity", shape(6, pi, false, &[(32, false), (24, false)], softplus)),
        ("s = 1, skips", shape(5, one, true, &[(32, false), (32, true), (19, true)], relu)),
        ("ten levels, skip", shape(10, pi, true, &[(32, false), (32, false), (32, true)], softplus)),
        ("ten levels, s = 1", shape(10, one, false, &[(40, false), (24, false)], relu)),
    ]
}

impl Case {
    /// Makes a network with random weights. `bias` gives each bias from the largest value that the sum of the unit's
    /// inputs can have.
    fn new(name: &'static str, shape: Architecture, bias: impl Fn(&mut u64, f32) -> f32) -> Self {
        let mut state = 77;
        let mut all = vec![0.0f32; shape.parameters()];
        // Encoded values are at most 1, in the box of the points; so the most that a unit can be is known.
        let mut reach = 1.0f32;
        for layer in &shape.layers() {
            let scale = (6.0 / layer.inputs() as f32).sqrt();
            for w in &mut all[layer.weights..layer.bias] {
                *w = half(scale * signed(&mut state));
            }
            let mut most = 0.0f32;
            for row in 0..layer.outputs {
                let w = &all[layer.weights + row * layer.inputs()..][..layer.inputs()];
                let sum: f32 = w.iter().map(|w| w.abs()).sum();
                let bias = half(bias(&mut state, sum * reach));
                most = most.max(sum * reach + bias.abs());
                all[layer.bias + row] = bias;
            }
            reach = most.max(1.0);
        }
        let bytes: Vec<u8> = all.iter().flat_map(|&w| half_bits(w).to_le_bytes()).collect();
        let wide: Vec<f64> = bytes.chunks_exact(2).map(|b| f16(u16::from_le_bytes([b[0], b[1]]))).collect();
        let oracle = oracle::network::Network::of_file(&shape, &wide);
        Self { name, shape, bytes, oracle }
    }

    /// Returns the sum of the magnitudes of the terms of ∂raw/∂x, for each axis.
    fn terms(&self, x: &[f64]) -> [f64; 3] {
        let encoding = &self.oracle.position;
        let encoded = oracle::encoding::encode(x, encoding.levels, encoding.pi, encoding.identity);
        let mut h = encoded.clone();
        let mut on = Vec::new();
        for (layer, skip) in &self.oracle.trunk {
            if *skip {
                h.extend(&encoded);
            }
            h = layer.apply(&h).into_iter().map(|x| x.max(0.0)).collect();
            on.push(h.iter().map(|&h| h > 0.0).collect::<Vec<bool>>());
        }
        let head = self.oracle.density.as_ref().expect("a density");
        let mut of_h: Vec<f64> = head.w[0].iter().map(|w| w.abs()).collect();
        let mut of_encoded = vec![0.0; encoded.len()];
        for ((layer, skip), on) in self.oracle.trunk.iter().zip(&on).rev() {
            let mut of_inputs = vec![0.0; layer.w[0].len()];
            for ((row, of), _) in layer.w.iter().zip(&of_h).zip(on).filter(|(_, on)| **on) {
                of_inputs.iter_mut().zip(row).for_each(|(sum, w)| *sum += w.abs() * of);
            }
            let main = if *skip { of_inputs.len() - encoded.len() } else { of_inputs.len() };
            if *skip {
                of_encoded.iter_mut().zip(&of_inputs[main..]).for_each(|(sum, of)| *sum += of);
            }
            of_inputs.truncate(main);
            of_h = of_inputs;
        }
        of_encoded.iter_mut().zip(&of_h).for_each(|(sum, of)| *sum += of);
        let first = if encoding.identity { 3 } else { 0 };
        std::array::from_fn(|axis| {
            let mut sum = if encoding.identity { of_encoded[axis] } else { 0.0 };
            for level in 0..usize::from(encoding.levels) {
                let scale = 2f64.powi(level as i32) * if encoding.pi { std::f64::consts::PI } else { 1.0 };
                let at = first + 6 * level + axis;
                // |sin| and |cos| are at most 1, and an absolute error of theirs counts in full.
                sum += scale * (of_encoded[at] + of_encoded[at + 3]);
            }
            sum
        })
    }

    /// Returns ∂raw/∂x by finite differences; `None` if a ReLU switches within the differences, where no derivative
    /// exists.
    fn truth(&self, x: &[f64; 3]) -> Option<[f64; 3]> {
        // A small part of the finest wave: what the fourth power of it leaves is 1e-13 of the slope.
        let step = 2f64.powi(-12 - i32::from(self.oracle.position.levels));
        let raw = |x: &[f64]| self.oracle.raw_density(x);
        let (wide, narrow) =
            (oracle::gradient::gradient(raw, x, step), oracle::gradient::gradient(raw, x, step / 4.0));
        let size = self.terms(x);
        // Two steps disagree where something between them is not smooth.
        let smooth = (0..3).all(|axis| (wide[axis] - narrow[axis]).abs() <= 1e-8 * size[axis]);
        smooth.then(|| std::array::from_fn(|axis| wide[axis]))
    }

    /// Returns how close the nearest ReLU is to its switch: the magnitude of its input sum, divided by the sum of
    /// magnitudes.
    fn doubt(&self, x: &[f64; 3]) -> f64 {
        let encoding = &self.oracle.position;
        let encoded = oracle::encoding::encode(x, encoding.levels, encoding.pi, encoding.identity);
        let (mut h, mut nearest) = (encoded.clone(), f64::INFINITY);
        for (layer, skip) in &self.oracle.trunk {
            if *skip {
                h.extend(&encoded);
            }
            let sums = layer.apply(&h);
            for ((sum, w), b) in sums.iter().zip(&layer.w).zip(&layer.b) {
                let size = w.iter().zip(&h).map(|(w, h)| (w * h).abs()).sum::<f64>() + b.abs();
                nearest = nearest.min(sum.abs() / size.max(1e-30));
            }
            h = sums.into_iter().map(|x| x.max(0.0)).collect();
        }
        nearest
    }

    /// Returns the bound of rounding errors relative to [`Case::terms`] (Higham 2002, §3.1): of sums and products on
    /// the longest path of the backward pass, and of the encoding's derivative. `weights`: relative rounding of the
    /// weights, once per layer.
    fn roundings(&self, weights: f64) -> f64 {
        let layers = &self.oracle.trunk;
        let sums: usize = layers.iter().map(|(layer, skip)| layer.b.len() + 2 + usize::from(*skip)).sum();
        let levels = usize::from(self.oracle.position.levels);
        (sums + 3 * levels + 4) as f64 * 2f64.powi(-24) + (layers.len() + 1) as f64 * weights
    }

    /// Computes ∂raw/∂x of a block of points, `[3][STRIDE]`, with a kernel.
    fn found(&self, kernel: Kernel, math: MathBackend, points: &[f32]) -> Vec<f32> {
        let mut memory = vec![0.0; self.shape.parameters()];
        let weights = Weights::prepare(&self.shape, kernel.storage, &self.bytes, &mut memory);
        let network = Network::new(&self.shape, weights, kernel.isa).expect("a network");
        let rows = |rows: usize| vec![f32::NAN; rows * STRIDE];
        let (mut encoded, mut front) = (rows(network.encoded_rows()), rows(network.activation_rows()));
        let mut back = front.clone();
        let mut scratch =
            Scratch { stride: STRIDE, encoded: &mut encoded, front: &mut front, back: &mut back };
        let (mut signs, mut of_encoded) =
            (vec![0; network.sign_words(STRIDE)], rows(network.gradient_rows()));
        let mut memory = GradientScratch { signs: &mut signs, encoded: &mut of_encoded };
        let mut gradient = rows(3);
        network.gradient(math, &mut scratch, &mut memory, points, 0.0, &mut gradient);
        gradient
    }
}

/// Converts a number to the bits of an f16, rounded towards 0.
fn half_bits(x: f32) -> u16 {
    let bits = x.to_bits();
    let (sign, exponent) = ((bits >> 16 & 0x8000) as u16, (bits >> 23 & 0xff) as i32 - 112);
    if exponent <= 0 { sign } else { sign | (exponent as u16) << 10 | (bits >> 13 & 0x3ff) as u16 }
}

/// Rounds a number to an f16, towards 0.
fn half(x: f32) -> f32 {
    f16(half_bits(x)) as f32
}

/// Returns points that include ±0, subnormals and multiples of powers of two: `[3][STRIDE]`.
fn points() -> Vec<f32> {
    let mut state = 11;
    let mut all: Vec<f32> = (0..3 * STRIDE).map(|_| signed(&mut state)).collect();
    for (i, x) in [0.0, -0.0, 1e-45, -1e-40, 0.5, -0.25, 1.0, -1.0, 0.125].into_iter().enumerate() {
        all[i % 3 * STRIDE + i] = x;
    }
    all
}

/// A case and its reference values: derivatives and sums of term magnitudes per point. A point without a derivative, or
/// where a ReLU is too close to its switch, has `None`.
struct Known {
    case: Case,
    at: Vec<Option<([f64; 3], [f64; 3])>>,
}

fn known(bias: fn(&mut u64, f32) -> f32, doubt: f64) -> Vec<Known> {
    let points = points();
    let all = shapes().into_iter().map(|(name, shape)| {
        let case = Case::new(name, shape, bias);
        let at = (0..STRIDE).map(|i| {
            let x = [0, 1, 2].map(|axis| f64::from(points[axis * STRIDE + i]));
            let certain = case.doubt(&x) > doubt;
            certain.then(|| case.truth(&x)).flatten().map(|truth| (truth, case.terms(&x)))
        });
        let at: Vec<_> = at.collect();
        let left = at.iter().flatten().count();
        assert!(left > STRIDE / 2, "{name}: {left} points are left");
        Known { case, at }
    });
    all.collect()
}

/// Measures the errors of the gradient relative to the sum of term magnitudes.
fn compare(cases: &[Known], kernel: Kernel, math: MathBackend, worst: &mut Worst) {
    let points = points();
    for Known { case, at } in cases {
        let found = case.found(kernel, math, &points);
        for (i, known) in at.iter().enumerate() {
            let Some((truth, terms)) = known else { continue };
            for axis in 0..3 {
                let off = (f64::from(found[axis * STRIDE + i]) - truth[axis]).abs();
                // Without terms there is no gradient: it is exactly 0 then.
                let error = if off == 0.0 { 0.0 } else { off / terms[axis] };
                worst.see(error, || format!("{}, point {i}, {}", case.name, kernel));
            }
        }
    }
}

/// Largest error of a sine with each backend, for both angle scales up to 2^9 (from the encoding's rows).
const SINES: [f64; 4] = [1.2e-7, 4e-7, 1e-2, 1e-4];

/// Returns the bound for these cases. `sine`: error of a sine. `weights`: relative rounding of weights.
fn bound(cases: &[Known], sine: f64, weights: f64) -> f64 {
    sine + worst_of(cases.iter().map(|known| known.case.roundings(weights)))
}

/// Measures networks whose ReLUs switch anywhere. micromath's sines and bf16 weights are excluded: their errors make
/// every ReLU doubtful.
fn random() -> Vec<Row> {
    let bias = |state: &mut u64, _: f32| 0.1 + 0.1 * signed(state);
    let mut rows = Vec::new();
    for (i, doubt) in [(0, 1e-5), (1, 1e-5), (3, 1e-3)] {
        let (cases, (name, math)) = (known(bias, doubt), BACKENDS[i]);
        let mut worst = Worst::default();
        exact_kernels().for_each(|kernel| compare(&cases, kernel, math, &mut worst));
        rows.push(worst.row(name, "exact", bound(&cases, SINES[i], 0.0)));
    }
    rows
}

/// Measures networks in which each unit is active at all points or at none.
fn certain() -> Vec<Row> {
    let bias = |state: &mut u64, most: f32| (1.1 * most + 0.1) * (signed(state) + 0.25).signum();
    let cases = known(bias, 0.0);
    let mut rows = Vec::new();
    for (&(name, math), sine) in BACKENDS.iter().zip(SINES) {
        let mut worst = Worst::default();
        exact_kernels().for_each(|kernel| compare(&cases, kernel, math, &mut worst));
        rows.push(worst.row(name, "exact", bound(&cases, sine, 0.0)));
    }
    for kernel in kernels().filter(|kernel| kernel.rounds()) {
        let mut worst = Worst::default();
        compare(&cases, kernel, MathBackend::Polynomial, &mut worst);
        rows.push(worst.row("polynomial", "avx512-bf16", bound(&cases, SINES[0], 2f64.powi(-9))));
    }
    rows
}

/// Counts nonzero gradients of networks in which no unit is active. A unit whose sum is exactly 0 is not active.
fn dark() -> Vec<Row> {
    let mut worst = Worst::default();
    for (name, shape) in shapes() {
        for bias in [|_: &mut u64, most: f32| -1.1 * most - 0.1, |_: &mut u64, _: f32| -0.0] {
            let mut case = Case::new(name, shape.clone(), bias);
            if bias(&mut 1, 1.0) == 0.0 {
                // Weights of ±0 besides, so that all sums are ±0.
                let head = shape.layers()[shape.trunk.len()];
                case.bytes[..2 * head.weights]
                    .chunks_exact_mut(2)
                    .for_each(|b| b.copy_from_slice(&[0, b[1] & 0x80]));
            }
            for kernel in kernels() {
                for (_, math) in BACKENDS {
                    let found = case.found(kernel, math, &points());
                    let some = found.iter().filter(|&&x| x != 0.0).count() as f64;
                    worst.see(some, || format!("{name}, {}", kernel));
                }
            }
        }
    }
    vec![worst.row("any", "any", 0.0)]
}
