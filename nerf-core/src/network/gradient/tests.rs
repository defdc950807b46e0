//! Compares the gradient with an f64 oracle that bounds the error of f32, and the oracle with finite differences.

extern crate std;

use super::*;
use crate::encoding::{AngleScale, SinusoidalEncoding};
use crate::matrix::Kernel;
use crate::network::{Architecture, DensityActivation};
use crate::simd::Isa;
use crate::testing::{Worse, architecture, every_kind, halve, noise, parameters, pi};
use std::vec;
use std::vec::Vec;

const STRIDE: usize = 64;

/// Largest rounding errors of one kernel. `sums`, `weights` and `activations` are relative errors: of one addition or
/// multiplication, of one stored weight, of one stored activation. `trigonometry` is the absolute error of a sine or
/// cosine.
#[derive(Clone, Copy)]
struct Rounding {
    sums: f64,
    weights: f64,
    activations: f64,
    trigonometry: f64,
}

impl Rounding {
    fn of(kernel: Kernel) -> Self {
        let f32s = Self { sums: 2f64.powi(-24), weights: 0.0, activations: 0.0, trigonometry: 1.2e-7 };
        let bf16 = 2f64.powi(-9);
        if kernel.rounds() { Self { weights: bf16, activations: bf16, ..f32s } } else { f32s }
    }

    /// Rounding of the oracle's own f64 arithmetic.
    const F64: Self = Self { sums: 1.2e-16, weights: 0.0, activations: 0.0, trigonometry: 2.5e-16 };
}

/// An exact value, and a bound of its error in the kernel's rounded arithmetic.
#[derive(Clone, Copy, Default)]
struct Bounded {
    value: f64,
    error: f64,
}

impl Bounded {
    /// Largest magnitude that the rounded value can have.
    fn reach(self) -> f64 {
        self.value.abs() + self.error
    }
}

/// Raw density and gradient at a point, with the a priori error bounds of every step (Higham 2002, §3.1).
struct Oracle {
    raw: Bounded,
    gradient: [Bounded; 3],
    /// Bound of |∂³raw/∂x³| along each axis while no ReLU switches.
    third: [f64; 3],
    /// Whether each ReLU of the trunk is on, layer by layer.
    on: Vec<bool>,
    /// Whether rounding may switch a ReLU on or off.
    ambiguous: bool,
}

fn scale_of(e: &SinusoidalEncoding) -> f64 {
    if e.scale == AngleScale::Pi { core::f64::consts::PI } else { 1.0 }
}

/// Sine and cosine of `2^level s x`, where `s` is the encoding's frequency scale, 1 or π. With `s = π`, `2^level x` is
/// reduced modulo 2 before it is multiplied by π.
fn sin_cos(e: &SinusoidalEncoding, level: usize, x: f64) -> (f64, f64) {
    let u = 2f64.powi(level as i32) * x;
    match e.scale {
        AngleScale::One => u.sin_cos(),
        AngleScale::Pi => ((u - 2.0 * (u / 2.0).round()) * core::f64::consts::PI).sin_cos(),
    }
}

fn oracle(a: &Architecture, p: &[f32], x: [f64; 3], r: Rounding) -> Oracle {
    // Higham's γ, the relative error bound of a sum of `n` products and an initial value.
    let gamma = |n: usize| (n + 2) as f64 * r.sums / (1.0 - (n + 2) as f64 * r.sums);
    let weight = |i: usize| Bounded { value: f64::from(p[i]), error: r.weights * f64::from(p[i]).abs() };
    // `bias + Σ w x`, with an error bound that holds for any order of summation.
    let dot = |terms: &mut dyn Iterator<Item = (Bounded, Bounded)>, bias: f64| {
        let (mut sum, mut size, mut n) = (Bounded { value: bias, error: 0.0 }, bias.abs(), 0);
        for (w, x) in terms {
            sum.value += w.value * x.value;
            sum.error += w.reach() * x.reach() - (w.value * x.value).abs();
            size += w.reach() * x.reach();
            n += 1;
        }
        Bounded { error: sum.error + gamma(n) * size, ..sum }
    };
    let e = a.position.sinusoidal().unwrap();
    let trigonometric = |value: f64| Bounded { value, error: r.trigonometry };
    let mut sines: Vec<Bounded> = vec![];
    for level in 0..usize::from(e.levels) {
        sines.extend(x.iter().map(|&x| trigonometric(sin_cos(e, level, x).0)));
        sines.extend(x.iter().map(|&x| trigonometric(sin_cos(e, level, x).1)));
    }
    let exact = x.map(|value| Bounded { value, error: 0.0 });
    let identity = if e.identity { &exact[..] } else { &[] };
    let round = |x: Bounded| Bounded { error: x.error + r.activations * x.reach(), ..x };
    let encoded: Vec<Bounded> = identity.iter().chain(&sines).copied().map(round).collect();

    let (mut on, mut ambiguous) = (vec![], false);
    let mut h = encoded.clone();
    let layers = a.layers();
    for layer in &layers[..a.trunk.len()] {
        let mut inputs = h;
        inputs.extend(&encoded[..layer.extra]);
        h = (0..layer.outputs)
            .map(|row| {
                let row_at = layer.weights + row * layer.inputs();
                let mut terms = inputs.iter().enumerate().map(|(i, &x)| (weight(row_at + i), x));
                let sum = dot(&mut terms, f64::from(p[layer.bias + row]));
                ambiguous |= sum.value.abs() <= sum.error;
                on.push(sum.value > 0.0);
                if sum.value > 0.0 { round(sum) } else { Bounded::default() }
            })
            .collect();
    }
    let head = layers[a.trunk.len()];
    let mut terms = h.iter().enumerate().map(|(i, &h)| (weight(head.weights + i), h));
    let raw = dot(&mut terms, f64::from(p[head.bias]));

    let mut of_h: Vec<Bounded> = (0..head.main).map(|i| weight(head.weights + i)).collect();
    let mut of_encoded = vec![Bounded::default(); encoded.len()];
    let mut end = on.len();
    for (index, layer) in layers[..a.trunk.len()].iter().enumerate().rev() {
        let start = end - layer.outputs;
        for (g, on) in of_h.iter_mut().zip(&on[start..end]) {
            *g = if *on { *g } else { Bounded::default() };
        }
        end = start;
        let of_input = |i: usize| {
            let terms = of_h.iter().enumerate();
            dot(&mut terms.map(|(row, &g)| (weight(layer.weights + row * layer.inputs() + i), g)), 0.0)
        };
        let encoded_from = if index == 0 { 0 } else { layer.main };
        for (i, sum) in of_encoded.iter_mut().enumerate().take(layer.inputs() - encoded_from) {
            let part = of_input(encoded_from + i);
            // `part` is the share of this layer, `sum` that of the later layers. The error is bounded as if they were
            // one sum.
            let error = sum.error + part.error + gamma(layer.outputs) * (sum.reach() + part.reach());
            *sum = Bounded { value: sum.value + part.value, error };
        }
        of_h = (0..if index == 0 { 0 } else { layer.main }).map(of_input).collect();
    }

    let first = if e.identity { 3 } else { 0 };
    let mut third = [0.0; 3];
    let gradient = core::array::from_fn(|axis| {
        let one = Bounded { value: 1.0, error: 0.0 };
        let mut terms = vec![];
        if e.identity {
            terms.push((one, of_encoded[axis]));
        }
        for level in 0..usize::from(e.levels) {
            let (sin, cos) = (6 * level + axis, 6 * level + 3 + axis);
            let s = 2f64.powi(level as i32) * scale_of(e);
            let times = |x: Bounded, s: f64| Bounded { value: x.value * s, error: x.error * s.abs() };
            let (of_sin, of_cos) = (of_encoded[first + sin], of_encoded[first + cos]);
            third[axis] += s.powi(3) * (of_sin.reach() + of_cos.reach());
            terms.push((times(sines[cos], s), of_sin));
            terms.push((times(sines[sin], -s), of_cos));
        }
        dot(&mut terms.into_iter(), 0.0)
    });
    Oracle { raw, gradient, third, on, ambiguous }
}

/// Architectures with skips, with softplus, and with sinusoidal encodings of several kinds: frequency scale `s` 1 or π,
/// with and without the position itself among the outputs (identity), few and many levels.
fn architectures() -> Vec<(&'static str, Architecture)> {
    let softplus = Architecture { density: Some(DensityActivation::ShiftedSoftplus), ..every_kind() };
    let bare = |scale, levels| SinusoidalEncoding { inputs: 3, levels, scale, identity: false };
    let named = |scale, levels| SinusoidalEncoding { identity: true, ..bare(scale, levels) };
    let skips = [(32, false), (32, true), (19, true)];
    vec![
        ("every kind of layer", every_kind()),
        ("softplus", softplus),
        ("one layer", architecture(pi(3, 2), None, &[(16, false)], &[])),
        ("identity alone", architecture(pi(3, 0), None, &[(24, false), (24, true)], &[])),
        ("no identity, s = 1, two skips", architecture(bare(AngleScale::One, 3), None, &skips, &[])),
        (
            "s = 1, ten levels",
            architecture(named(AngleScale::One, 10), None, &[(40, false), (24, true)], &[]),
        ),
        ("s = π, ten levels, no identity", architecture(bare(AngleScale::Pi, 10), None, &skips, &[])),
        // Smaller, since the error bound of a deeper or wider network might let every ReLU switch.
        ("the seed's shape, smaller", {
            let trunk: Vec<_> = (0..5).map(|i| (24, i == 3)).collect();
            architecture(pi(3, 10), Some(pi(3, 4)), &trunk, &[32])
        }),
    ]
}

/// Computes the gradients of a block, without blur: `[3][stride]`.
fn gradients(network: &Network<'_>, math: MathBackend, stride: usize, positions: &[f32]) -> Vec<f32> {
    blurred(network, math, stride, positions, 0.0)
}

/// Computes the gradients of a block, `[3][stride]`, averaged over a Gaussian of standard deviation `blur`, world
/// units.
fn blurred(
    network: &Network<'_>,
    math: MathBackend,
    stride: usize,
    positions: &[f32],
    blur: f32,
) -> Vec<f32> {
    let mut encoded = vec![f32::NAN; network.encoded_rows() * stride];
    let mut front = vec![f32::NAN; network.activation_rows() * stride];
    let mut back = front.clone();
    let mut scratch = Scratch { stride, encoded: &mut encoded, front: &mut front, back: &mut back };
    let mut signs = vec![0xaaaa; network.sign_words(stride)];
    let mut of_encoded = vec![f32::NAN; network.gradient_rows() * stride];
    let mut memory = GradientScratch { signs: &mut signs, encoded: &mut of_encoded };
    let mut gradient = vec![f32::NAN; 3 * stride];
    network.gradient(math, &mut scratch, &mut memory, positions, blur, &mut gradient);
    gradient
}

/// Computes the gradients of a block of `STRIDE` samples with `kernel`: `[3][STRIDE]`.
fn gradients_of(kernel: Kernel, a: &Architecture, bytes: &[u8], positions: &[f32]) -> Vec<f32> {
    let mut memory = vec![0.0; a.parameters()];
    let weights = Weights::prepare(a, kernel.storage, bytes, &mut memory);
    gradients(&Network::new(a, weights, kernel.isa).unwrap(), MathBackend::Polynomial, STRIDE, positions)
}

fn point(positions: &[f32], i: usize) -> [f64; 3] {
    [0, 1, 2].map(|axis| f64::from(positions[axis * STRIDE + i]))
}

#[test]
fn gradients_are_the_oracle_s_with_every_kernel() {
    let mut of_rounding = 0;
    for (name, a) in architectures() {
        let (bytes, parameters) = halve(&parameters(&a, 3));
        let positions = noise(3 * STRIDE, 5);
        for kernel in Kernel::all() {
            let found = gradients_of(kernel, &a, &bytes, &positions);
            let (mut checked, mut worst, mut size) = (0, 0.0f64, 0.0f64);
            for i in 0..STRIDE {
                let o = oracle(&a, &parameters, point(&positions, i), Rounding::of(kernel));
                // Rounding may switch a ReLU at this point: the gradient jumps there, and either side is right.
                if o.ambiguous {
                    continue;
                }
                checked += 1;
                for (axis, truth) in o.gradient.into_iter().enumerate() {
                    let off = (f64::from(found[axis * STRIDE + i]) - truth.value).abs();
                    assert!(off <= truth.error, "{name} {kernel}: {off:e} > {:e}", truth.error);
                    (worst, size) = (worst.worse(off / truth.error), size.max(truth.value.abs()));
                }
            }
            std::println!("{name} {kernel}: {checked} points, {worst:.3} of the bound, size {size:.1}");
            match kernel.rounds() {
                true => of_rounding += checked,
                false => assert!(checked > STRIDE / 2 && size > 0.1, "{name} {kernel}"),
            }
        }
    }
    // Rounding to bf16 may switch nearly all ReLUs of a deep network: only shallow ones are compared.
    assert!(of_rounding > STRIDE || Kernel::all().all(|kernel| !kernel.rounds()), "{of_rounding}");
}

#[test]
fn the_oracle_s_gradient_is_the_limit_of_differences() {
    // A power of two, so that `x ± h` is exact in f64.
    let h = 2f64.powi(-26);
    for (name, a) in architectures() {
        let (_, parameters) = halve(&parameters(&a, 3));
        let positions = noise(3 * STRIDE, 5);
        let mut checked = 0;
        for i in 0..STRIDE {
            let x = point(&positions, i);
            let at = |axis: usize, step: f64| {
                let mut x = x;
                x[axis] += step;
                oracle(&a, &parameters, x, Rounding::F64)
            };
            let middle = oracle(&a, &parameters, x, Rounding::F64);
            for axis in 0..3 {
                let (before, after) = (at(axis, -h), at(axis, h));
                if before.on != after.on || before.ambiguous || after.ambiguous {
                    continue;
                }
                checked += 1;
                let difference = (after.raw.value - before.raw.value) / (2.0 * h);
                let rounding = (after.raw.error + before.raw.error) / (2.0 * h);
                // The term in h² is the remainder of the central difference.
                let bound = rounding + h * h / 6.0 * middle.third[axis] + middle.gradient[axis].error;
                let off = (difference - middle.gradient[axis].value).abs();
                assert!(off <= bound, "{name}: {off:e} > {bound:e}");
                assert!(bound <= 1e-3 * middle.third[axis].max(1.0), "{name}: a bound that proves nothing");
            }
        }
        assert!(checked > 2 * STRIDE, "{name}: {checked}");
    }
}

#[test]
fn one_block_of_any_width_gives_the_same_bits() {
    for (name, a) in architectures() {
        let (bytes, unpacked) = halve(&parameters(&a, 11));
        let positions = noise(3 * STRIDE, 13);
        let cut = |rows: &[f32], n: usize| -> Vec<f32> {
            (0..3).flat_map(|axis| rows[axis * STRIDE..][..n].to_vec()).collect()
        };
        let in_place = Network::new(&a, Weights::InPlace(&bytes), Isa::Portable).unwrap();
        let math = MathBackend::Polynomial;
        let wide = gradients(&in_place, math, STRIDE, &positions);
        let prepared = Network::new(&a, Weights::Prepared(&unpacked), Isa::Portable).unwrap();
        assert_eq!(wide, gradients(&prepared, math, STRIDE, &positions), "{name}: in place and prepared");
        for n in [1, 3, 16, 37] {
            assert_eq!(gradients(&in_place, math, n, &cut(&positions, n)), cut(&wide, n), "{name} {n}");
        }
        for kernel in Kernel::all() {
            let mut memory = vec![0.0; a.parameters()];
            let network =
                Network::new(&a, Weights::prepare(&a, kernel.storage, &bytes, &mut memory), kernel.isa)
                    .unwrap();
            let wide = gradients(&network, math, STRIDE, &positions);
            for n in [16, 48] {
                let found = gradients(&network, math, n, &cut(&positions, n));
                assert_eq!(found, cut(&wide, n), "{name} {kernel} {n}");
            }
        }
    }
}

#[test]
fn every_backend_s_gradient_is_about_the_same() {
    let a = every_kind();
    let (bytes, _) = halve(&parameters(&a, 17));
    let network = Network::new(&a, Weights::InPlace(&bytes), Isa::Portable).unwrap();
    let positions = noise(3 * STRIDE, 19);
    let exact = gradients(&network, MathBackend::Polynomial, STRIDE, &positions);
    let size = exact.iter().fold(0.0f32, |size, x| size.max(x.abs()));
    // Limits relative to the largest gradient; sines of micromath err by some parts in a thousand.
    let rows = [
        #[cfg(feature = "libm")]
        (MathBackend::Libm, 1e-5),
        #[cfg(feature = "micromath")]
        (MathBackend::Micromath, 2e-2),
        (MathBackend::Recurrence, 1e-4),
    ];
    for (math, limit) in rows {
        let found = gradients(&network, math, STRIDE, &positions);
        // A ReLU close to 0 may switch, so that a few gradients may exceed the limit.
        let off = found.iter().zip(&exact).filter(|(a, b)| (*a - *b).abs() > limit * size).count();
        assert!(off <= 6, "{math:?}: {off}");
    }
}

/// A network with raw density `relu(slope · x + 8)`: linear in the box, exact in f16 and in bf16.
fn linear(slope: [f32; 3]) -> (Architecture, Vec<f32>) {
    let a = architecture(pi(3, 0), None, &[(2, false), (1, false)], &[]);
    let mut all = vec![0.0; a.parameters()];
    let layers = a.layers();
    all[layers[0].weights..][..3].copy_from_slice(&slope);
    all[layers[0].bias] = 8.0;
    // The second unit is off everywhere; without the ReLU's mask it would add a slope.
    all[layers[0].weights + 3..][..3].copy_from_slice(&[1.0, 1.0, 1.0]);
    all[layers[0].bias + 1] = -4.0;
    all[layers[1].weights..][..2].copy_from_slice(&[1.0, 1.0]);
    all[layers[2].weights] = 1.0;
    (a, all)
}

#[test]
fn the_gradient_of_a_linear_density_is_exact() {
    let slope = [1.5, -2.0, 0.25];
    let (a, all) = linear(slope);
    let (bytes, _) = halve(&all);
    for kernel in Kernel::all() {
        let found = gradients_of(kernel, &a, &bytes, &noise(3 * STRIDE, 23));
        for (axis, slope) in slope.into_iter().enumerate() {
            assert!(found[axis * STRIDE..][..STRIDE].iter().all(|&x| x == slope), "{kernel}");
        }
    }
}

/// A network whose raw density is linear in the encoding, `bias + Σ_c w_c PE_c(x)`: all ReLUs are on.
fn linear_in_the_encoding(encoding: SinusoidalEncoding) -> (Architecture, Vec<f32>) {
    let a = architecture(encoding, None, &[(1, false)], &[]);
    let mut all = vec![0.0; a.parameters()];
    let layers = a.layers();
    all[..encoding.outputs()].copy_from_slice(&noise(encoding.outputs(), 37));
    // Larger than the weighted sum can be, so that the ReLU is always on.
    all[layers[0].bias] = encoding.outputs() as f32 + 8.0;
    all[layers[1].weights] = 1.0;
    (a, all)
}

#[test]
fn a_blurred_gradient_is_the_gradient_s_mean_over_a_gaussian() {
    for encoding in [pi(3, 10), SinusoidalEncoding { scale: AngleScale::One, identity: false, ..pi(3, 7) }] {
        let (a, all) = linear_in_the_encoding(encoding);
        let (bytes, unpacked) = halve(&all);
        let network = Network::new(&a, Weights::InPlace(&bytes), Isa::Portable).unwrap();
        let positions = noise(3 * STRIDE, 41);
        let sharp = gradients(&network, MathBackend::Polynomial, STRIDE, &positions);
        for blur in [0.0f32, 0.002, 0.01, 0.1] {
            let found = blurred(&network, MathBackend::Polynomial, STRIDE, &positions, blur);
            if blur == 0.0 {
                assert_eq!(found, sharp);
            }
            for i in (0..STRIDE).step_by(7) {
                for axis in 0..3 {
                    // Mean over 40,001 points within ±8 deviations, much denser than the shortest wavelength.
                    let (mut mean, mut mass, mut size) = (0.0, 0.0, 0.0f64);
                    for step in -20_000i32..=20_000 {
                        let off = 8.0 * f64::from(step) / 20_000.0;
                        let weight = (-0.5 * off * off).exp();
                        let x = f64::from(positions[axis * STRIDE + i]) + off * f64::from(blur);
                        let of = |channel: usize| f64::from(unpacked[channel]);
                        let first = if encoding.identity { 3 } else { 0 };
                        let mut slope = if encoding.identity { of(axis) } else { 0.0 };
                        for level in 0..usize::from(encoding.levels) {
                            let s = 2f64.powi(level as i32) * scale_of(&encoding);
                            let (sin, cos) = sin_cos(&encoding, level, x);
                            let at = first + 6 * level + axis;
                            slope += s * (of(at) * cos - of(at + 3) * sin);
                            size = size.max(s * (of(at).abs() + of(at + 3).abs()));
                        }
                        mean += weight * slope;
                        mass += weight;
                    }
                    let off = (f64::from(found[axis * STRIDE + i]) - mean / mass).abs();
                    // Sines err by 1.2e-7, damping by 4e-7, plus a dozen roundings, relative to the finest level.
                    assert!(off <= 2e-6 * size, "{blur}: {off:e} of {size:e}");
                }
            }
        }
    }
}

#[test]
fn a_2d_field_has_no_gradient_of_a_density() {
    let a = architecture(pi(2, 3), None, &[(16, false)], &[]);
    let (bytes, _) = halve(&parameters(&a, 29));
    let network = Network::new(&a, Weights::InPlace(&bytes), Isa::Portable).unwrap();
    let found = gradients(&network, MathBackend::Polynomial, STRIDE, &noise(2 * STRIDE, 31));
    assert!(found[..2 * STRIDE].iter().all(|&x| x == 0.0));
}

#[test]
fn the_work_is_the_trunk_twice() {
    // The original NeRF's network. The gradient excludes the 256 multiply-adds of the density head.
    let trunk: Vec<_> = (0..8).map(|i| (256, i == 4)).collect();
    let seed = architecture(pi(3, 10), Some(pi(3, 4)), &trunk, &[128]);
    assert_eq!(seed.gradient_macs(), 2 * (seed.density_macs() - 256));
    // One sign bit for each of the trunk's 2,048 ReLUs.
    let bytes = vec![0; 2 * seed.parameters()];
    let network = Network::new(&seed, Weights::InPlace(&bytes), Isa::Portable).unwrap();
    assert_eq!(network.sign_words(1) * size_of::<u16>(), 256);
}
