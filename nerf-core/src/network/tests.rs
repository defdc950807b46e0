extern crate std;

use super::*;
use crate::encoding::{AngleScale, SinusoidalEncoding};
use crate::math::MathBackend;
use crate::matrix::Kernel;
use crate::simd::Isa;
use crate::testing::{Worse, architecture, every_kind, halve, noise, parameters, pi};
use std::string::ToString;
use std::vec;
use std::vec::Vec;

const STRIDE: usize = 64;

/// Results of a network for a block: sigma and the three colour rows.
type Answer = (Vec<f32>, Vec<f32>);

/// Evaluates density and colour of a block: `positions` and `dirs` are `[inputs][stride]`.
fn evaluate(network: &Network<'_>, stride: usize, positions: &[f32], dirs: &[f32]) -> Answer {
    let math = MathBackend::Polynomial;
    let mut encoded = vec![0.0; network.encoded_rows() * stride];
    let mut front = vec![0.0; network.activation_rows() * stride];
    let mut back = front.clone();
    let mut scratch = Scratch { stride, encoded: &mut encoded, front: &mut front, back: &mut back };
    network.trunk(math, &mut scratch, positions);
    let (mut sigma, mut rgb) = (vec![0.0; stride], vec![0.0; 3 * stride]);
    network.density(math, &scratch, &mut sigma);
    let direction = |encoded: &mut [f32], to: &mut [f32]| network.direction(math, stride, encoded, dirs, to);
    network.colour(math, &mut scratch, direction, &mut rgb);
    (sigma, rgb)
}

fn encode_f64(e: &SinusoidalEncoding, x: &[f64]) -> Vec<f64> {
    let mut out = if e.identity { x.to_vec() } else { vec![] };
    let s = if e.scale == AngleScale::Pi { core::f64::consts::PI } else { 1.0 };
    for level in 0..i32::from(e.levels) {
        let angle = |x: &f64| 2f64.powi(level) * s * x;
        out.extend(x.iter().map(|x| angle(x).sin()));
        out.extend(x.iter().map(|x| angle(x).cos()));
    }
    out
}

/// Computes sigma and rgb of one sample in f64, directly from the diagram in the docs of `network`. `p`: parameters in
/// their stored order.
fn oracle(a: &Architecture, p: &[f32], x: &[f64], d: &[f64]) -> (f64, [f64; 3]) {
    let mut rest = p;
    let mut dense = |input: &[f64], outputs: usize, relu: bool| -> Vec<f64> {
        let (weights, after) = rest.split_at(input.len() * outputs);
        let (bias, after) = after.split_at(outputs);
        rest = after;
        let row = |(row, b): (&[f32], &f32)| {
            let sum = row.iter().zip(input).fold(f64::from(*b), |sum, (w, x)| sum + f64::from(*w) * x);
            if relu { sum.max(0.0) } else { sum }
        };
        weights.chunks(input.len()).zip(bias).map(row).collect()
    };
    let encoded = encode_f64(a.position.sinusoidal().unwrap(), x);
    let mut h = encoded.clone();
    for layer in &a.trunk {
        if layer.skip {
            h.extend(&encoded);
        }
        h = dense(&h, usize::from(layer.width), true);
    }
    let sigma = match a.density {
        None => 0.0,
        Some(DensityActivation::Relu) => dense(&h, 1, false)[0].max(0.0),
        Some(DensityActivation::ShiftedSoftplus) => (dense(&h, 1, false)[0] - 1.0).exp().ln_1p(),
        Some(DensityActivation::Exponential) => dense(&h, 1, false)[0].min(20.0).exp(),
    };
    if let Some(direction) = &a.direction {
        h.extend(encode_f64(direction.sinusoidal().unwrap(), d));
    }
    for &width in &a.colour {
        h = dense(&h, usize::from(width), true);
    }
    let raw = dense(&h, 3, false);
    assert!(rest.is_empty(), "every parameter is used once");
    (sigma, core::array::from_fn(|c| 1.0 / (1.0 + (-raw[c]).exp())))
}

fn architectures() -> Vec<(&'static str, Architecture)> {
    let softplus = Architecture { density: Some(DensityActivation::ShiftedSoftplus), ..every_kind() };
    let bare = SinusoidalEncoding { inputs: 3, levels: 3, scale: AngleScale::One, identity: false };
    let skips = [(32, false), (32, true), (32, true)];
    vec![
        ("every kind of layer", every_kind()),
        ("softplus", softplus),
        ("exponential", Architecture { density: Some(DensityActivation::Exponential), ..every_kind() }),
        ("one layer, no direction, no hidden colour", architecture(pi(3, 2), None, &[(16, false)], &[])),
        (
            "no direction, two colour layers",
            architecture(pi(3, 6), None, &[(33, false), (31, false)], &[8, 5]),
        ),
        (
            "direction straight into rgb",
            architecture(pi(3, 4), Some(pi(3, 4)), &[(20, false), (20, true)], &[]),
        ),
        ("s = 1, no identity", architecture(bare, Some(bare), &skips, &[16])),
        ("wide direction, narrow position", architecture(pi(3, 0), Some(pi(3, 6)), &[(1, false)], &[1])),
        ("a 2D field", architecture(pi(2, 8), None, &[(40, false), (24, true)], &[16])),
        ("four colour layers", architecture(pi(3, 4), Some(pi(3, 4)), &[(64, false)], &[32, 16, 16, 8])),
    ]
}

/// A block of random positions in [-1, 1) and of random unit directions, each `[3][STRIDE]`.
fn block(seed: u32) -> (Vec<f32>, Vec<f32>) {
    let mut dirs = noise(3 * STRIDE, seed + 1);
    for i in 0..STRIDE {
        let length = (0..3).map(|c| dirs[c * STRIDE + i].powi(2)).sum::<f32>().sqrt();
        (0..3).for_each(|c| dirs[c * STRIDE + i] /= length);
    }
    (noise(3 * STRIDE, seed), dirs)
}

fn isas() -> impl Iterator<Item = Isa> {
    Isa::ALL.into_iter().filter(|isa| isa.available())
}

fn column(rows: &[f32], inputs: usize, i: usize) -> Vec<f64> {
    (0..inputs).map(|c| f64::from(rows[c * STRIDE + i])).collect()
}

#[test]
fn every_architecture_is_its_drawing_with_every_kernel() {
    for (name, a) in architectures() {
        a.check().unwrap();
        let (bytes, parameters) = halve(&parameters(&a, 3));
        let (positions, dirs) = block(5);
        // Largest errors of sigma and rgb: of exact kernels, then of kernels that round weights.
        let mut worst = [[0.0f64; 2]; 2];
        for kernel in Kernel::all() {
            let mut memory = vec![0.0; a.parameters()];
            let weights = Weights::prepare(&a, kernel.storage, &bytes, &mut memory);
            let network = Network::new(&a, weights, kernel.isa).unwrap();
            assert_eq!(network.kernel(), kernel);
            let [worst_sigma, worst_rgb] = &mut worst[usize::from(kernel.rounds())];
            let (sigma, rgb) = evaluate(&network, STRIDE, &positions, &dirs);
            for i in 0..STRIDE {
                let x = column(&positions, usize::from(a.position.inputs()), i);
                let (s, c) = oracle(&a, &parameters, &x, &column(&dirs, 3, i));
                *worst_sigma = worst_sigma.worse((f64::from(sigma[i]) - s).abs() / s.abs().max(1.0));
                for (channel, truth) in c.into_iter().enumerate() {
                    *worst_rgb = worst_rgb.worse((f64::from(rgb[channel * STRIDE + i]) - truth).abs());
                }
            }
        }
        std::println!("{name}: {worst:?}");
        for ([sigma, rgb], [most_sigma, most_rgb]) in worst.into_iter().zip([[5e-6, 2e-6], [5e-2, 1e-2]]) {
            assert!(sigma <= most_sigma && rgb <= most_rgb, "{name}: {sigma:e} {rgb:e}");
        }
    }
}

#[test]
fn weights_in_place_and_unpacked_agree_bit_for_bit() {
    for ((name, a), isa) in
        architectures().into_iter().flat_map(|it| isas().map(move |isa| (it.clone(), isa)))
    {
        let (bytes, parameters) = halve(&parameters(&a, 11));
        let (positions, dirs) = block(13);
        let in_place = Network::new(&a, Weights::InPlace(&bytes), isa).unwrap();
        let prepared = Network::new(&a, Weights::Prepared(&parameters), isa).unwrap();
        assert!(in_place.whole_blocks() != (isa == Isa::Portable) && prepared.whole_blocks());
        let wide = evaluate(&in_place, STRIDE, &positions, &dirs);
        assert_eq!(wide, evaluate(&prepared, STRIDE, &positions, &dirs), "{name} {isa:?}");
        for stride in [1, 3, 16].into_iter().filter(|stride| stride % 16 == 0 || isa == Isa::Portable) {
            let inputs = usize::from(a.position.inputs());
            let cut = |rows: &[f32], inputs: usize| -> Vec<f32> {
                (0..inputs).flat_map(|c| rows[c * STRIDE..c * STRIDE + stride].to_vec()).collect()
            };
            let (sigma, rgb) = evaluate(&in_place, stride, &cut(&positions, inputs), &cut(&dirs, 3));
            assert_eq!(sigma, wide.0[..stride], "{name}, stride {stride}");
            assert_eq!(rgb, cut(&wide.1, 3), "{name}, stride {stride}");
        }
    }
}

#[test]
fn unpacking_is_exact_for_every_finite_half() {
    let bits: Vec<u16> = (0..=u16::MAX).filter(|b| b & 0x7c00 != 0x7c00).collect();
    // The weights begin at byte 1, since they need no alignment.
    let bytes: Vec<u8> = core::iter::once(0).chain(bits.iter().flat_map(|b| b.to_le_bytes())).collect();
    let mut unpacked = vec![0.0; bits.len()];
    unpack(&bytes[1..], &mut unpacked);
    for (&b, x) in bits.iter().zip(unpacked) {
        let (sign, exponent, mantissa) = (b >> 15, i32::from(b >> 10 & 31), f64::from(b & 1023));
        let magnitude = if exponent == 0 {
            mantissa * 2f64.powi(-24)
        } else {
            (1024.0 + mantissa) * 2f64.powi(exponent - 25)
        };
        assert_eq!(f64::from(x), if sign == 1 { -magnitude } else { magnitude }, "{b:#06x}");
    }
}

#[test]
fn a_512_wide_sum_of_the_largest_halves_is_finite() {
    let a = architecture(pi(3, 0), None, &[(512, false), (1, false)], &[]);
    let (bytes, _) = halve(&vec![65_504.0; a.parameters()]);
    let network = Network::new(&a, Weights::InPlace(&bytes), Isa::Portable).unwrap();
    let (sigma, rgb) = evaluate(&network, 1, &[1.0; 3], &[]);
    assert!(
        sigma[0].is_finite() && (sigma[0] / 5.756e17 - 1.0).abs() < 1e-3 && rgb == [1.0; 3],
        "{sigma:?} {rgb:?}"
    );
}

#[test]
fn an_exponential_density_is_finite_positive_and_flat_above_its_limit_and_nan_stays() {
    // raw = relu(x) − relu(−x) = x, the position's first coordinate.
    let a = Architecture {
        density: Some(DensityActivation::Exponential),
        ..architecture(pi(3, 0), None, &[(2, false)], &[])
    };
    let layers = a.layers();
    let mut all = vec![0.0; a.parameters()];
    (all[layers[0].weights], all[layers[0].weights + 3]) = (1.0, -1.0);
    (all[layers[1].weights], all[layers[1].weights + 1]) = (1.0, -1.0);
    let raws =
        [-1e4, -100.0, -1.0, 0.0, 0.5, 19.5, 20.0, 20.5, 1e4, f32::INFINITY, f32::NEG_INFINITY, f32::NAN];
    let mut positions = vec![0.0; 3 * 16];
    positions[..12].copy_from_slice(&raws);
    for math in [
        MathBackend::Polynomial,
        #[cfg(feature = "libm")]
        MathBackend::Libm,
        #[cfg(feature = "micromath")]
        MathBackend::Micromath,
    ] {
        for isa in isas() {
            let network = Network::new(&a, Weights::Prepared(&all), isa).unwrap();
            let mut encoded = vec![0.0; 3 * 16];
            let (mut front, mut back) = (vec![0.0; 48], vec![0.0; 48]);
            let mut scratch =
                Scratch { stride: 16, encoded: &mut encoded, front: &mut front, back: &mut back };
            let mut sigma = vec![0.0; 16];
            network.trunk(math, &mut scratch, &positions);
            network.density(math, &scratch, &mut sigma);
            let what = std::format!("{math:?}, {isa:?}: {sigma:?}");
            assert!(sigma[..9].iter().all(|s| *s > 0.0 && s.is_finite()), "{what}");
            assert!(sigma[..2].iter().all(|s| *s < 1e-37) && (sigma[3] - 1.0).abs() < 1e-2, "{what}");
            assert!(sigma[6] == sigma[7] && sigma[7] == sigma[8], "{what}");
            assert!((f64::from(sigma[6]) / 20f64.exp() - 1.0).abs() < 2e-2 && sigma[11].is_nan(), "{what}");
        }
    }
}

#[test]
fn parameters_that_are_too_few_make_no_network() {
    let a = every_kind();
    let n = a.parameters();
    assert!(Network::new(&a, Weights::Prepared(&vec![0.0; n - 1]), Isa::Portable).is_none());
    assert!(Network::new(&a, Weights::InPlace(&vec![0; 2 * n - 1]), Isa::Portable).is_none());
    assert!(Network::new(&a, Weights::Prepared(&vec![0.0; n]), Isa::Portable).is_some());
    let no_trunk = Architecture { trunk: heapless::Vec::new(), ..a };
    assert!(Network::new(&no_trunk, Weights::Prepared(&vec![0.0; n]), Isa::Portable).is_none());
}

#[test]
fn layers_lie_end_to_end_and_macs_add_up() {
    for (name, a) in architectures() {
        let layers = a.layers();
        let mut offset = 0;
        for layer in &layers {
            assert_eq!((layer.weights, layer.bias), (offset, offset + layer.macs()), "{name}");
            offset = layer.bias + layer.outputs;
        }
        assert_eq!(a.parameters(), offset);
        assert_eq!(a.density_macs() + a.colour_macs(), layers.iter().map(Layer::macs).sum::<usize>());
    }
    // The original NeRF with its feature layer merged: 8×256, skip at the fifth layer, 10 and 4 levels, colour 128.
    let trunk: Vec<_> = (0..8).map(|i| (256, i == 4)).collect();
    let seed = architecture(pi(3, 10), Some(pi(3, 4)), &trunk, &[128]);
    assert_eq!((seed.density_macs(), seed.colour_macs()), (491_264, 36_608));
    assert_eq!(seed.trunk_width(), 256);
}

#[test]
fn every_architecture_error_is_reached_and_says_what_it_found() {
    use ArchitectureError as E;
    let good = every_kind();
    assert_eq!(good.check(), Ok(()));
    let with = |change: &dyn Fn(&mut Architecture)| {
        let mut a = good.clone();
        change(&mut a);
        a.check().unwrap_err()
    };
    let inputs = |field, expected, found| E::EncodingInputs { field, expected, found };
    let levels = |field, found| E::EncodingLevels { field, found };
    let bare = SinusoidalEncoding { identity: false, ..pi(3, 0) };
    let cases = [
        (with(&|a| a.position = pi(2, 4).into()), inputs("position", 3, 2), "expected 3 inputs, found 2"),
        (with(&|a| a.density = None), inputs("position", 2, 3), "expected 2 inputs"),
        (with(&|a| a.direction = Some(pi(2, 4).into())), inputs("direction", 3, 2), "direction"),
        (with(&|a| a.position = pi(3, 17).into()), levels("position", 17), "found 17"),
        (with(&|a| a.direction = Some(bare.into())), levels("direction", 0), "found 0"),
        (
            with(&|a| {
                a.density = None;
                a.position = pi(2, 4).into();
            }),
            E::DirectionWithoutDensity,
            "2D field",
        ),
        (with(&|a| a.trunk.clear()), E::NoTrunk, "found none"),
        (with(&|a| a.trunk[0].skip = true), E::SkipAtFirstLayer, "no skip"),
        (
            with(&|a| a.trunk[1].width = 513),
            E::Width { field: "trunk", index: 1, found: 513 },
            "trunk layer 1",
        ),
        (with(&|a| a.colour[0] = 0), E::Width { field: "colour", index: 0, found: 0 }, "found 0"),
    ];
    for (found, expected, text) in cases {
        assert_eq!(found, expected);
        assert!(found.to_string().contains(text), "{found}");
    }
    let most = architecture(pi(3, 16), Some(pi(3, 16)), &[(512, false); MAX_TRUNK], &[512; MAX_COLOUR]);
    assert_eq!(most.check(), Ok(()));
    assert_eq!(most.layers().len(), MAX_LAYERS);
}
