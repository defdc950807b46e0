//! Activation functions at and beyond the ends of their ranges.

use super::ask;
use crate::blob::{bytes, weights};
use crate::table::{BACKENDS, Row, Worst, cases, isas};
use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
use nerf_core::math::{Elementary, MathBackend};
use nerf_core::network::{Architecture, DensityActivation, Shading, TrunkLayer};
use nerf_testing::scenes::kernels;

cases! {
    sigmoid_at_ten_thousand: "distance from 1 and 0, at infinity too" => || ends(Elementary::Sigmoid, [1.0, 1.0]);
    softplus_at_ten_thousand: "distance from 10,000 and 0; from infinity and 0 at infinity" => || ends(Elementary::Softplus, [1e4, f64::INFINITY]);
    activations_keep_to_their_range: "values of f32 outside of it: softplus and decay at least 0, sigmoid and decay up to 1, exp above 0" => ranges;
    what_is_no_number_stays_none: "NaNs that become numbers" => no_numbers;
    relu_of_minus_zero: "densities of −0 or with weight" => minus_zero;
    densities_of_every_activation_are_none_or_more: "densities below 0 or NaN" => densities;
}

/// Measures values at ±1e4 and ±inf: the result must be 0 for negative inputs, and `expected` at 1e4 and at inf.
fn ends(function: Elementary, expected: [f64; 2]) -> Vec<Row> {
    let row = |&(name, math): &(&'static str, MathBackend)| {
        let mut worst = Worst::default();
        for isa in isas() {
            let x: [f32; 16] = std::array::from_fn(|i| [1e4, -1e4, f32::INFINITY, f32::NEG_INFINITY][i % 4]);
            let mut out = [f32::NAN; 16];
            function.apply(isa, math, &x, &mut out);
            for (x, found) in x.iter().zip(out) {
                let truth = if *x < 0.0 { 0.0 } else { expected[usize::from(x.is_infinite())] };
                // Of two infinities there is no difference.
                let error = if f64::from(found) == truth { 0.0 } else { (f64::from(found) - truth).abs() };
                worst.see(error, || format!("{x:e}, {}", isa.name()));
            }
        }
        // Exponentials end at e^-87, which is what is left of 0.
        worst.row(name, "exact", 1.7e-38)
    };
    BACKENDS.iter().map(row).collect()
}

fn ranges() -> Vec<Row> {
    let row = |&(name, math): &(&'static str, MathBackend)| {
        let mut worst = Worst::default();
        let mut outside = 0.0;
        for isa in isas() {
            // Every exponent, with 128 mantissas each, of either sign; then the infinities.
            let x: Vec<f32> = (0..0x7f80u32)
                .flat_map(|high| [high << 16 | high & 0x7fff, high << 16 | 0x8000_0000])
                .map(f32::from_bits)
                .chain([f32::INFINITY, f32::NEG_INFINITY])
                .collect();
            let mut out = vec![f32::NAN; x.len()];
            for function in [Elementary::Softplus, Elementary::Sigmoid, Elementary::Decay, Elementary::Exp] {
                function.apply(isa, math, &x, &mut out);
                for (&x, &found) in x.iter().zip(&out) {
                    let inside = match function {
                        Elementary::Softplus => found >= 0.0,
                        Elementary::Sigmoid => (0.0..=1.0).contains(&found),
                        // Of an optical thickness: never below 0.
                        Elementary::Decay => x < 0.0 || (0.0..=1.0).contains(&found),
                        _ => found > 0.0 && found.is_finite(),
                    };
                    outside += f64::from(u8::from(!inside));
                    worst.see(outside, || format!("{function:?} of {x:e} is {found:e}, {}", isa.name()));
                }
            }
        }
        worst.row(name, "exact", 0.0)
    };
    BACKENDS.iter().map(row).collect()
}

/// Counts NaNs that an activation function hides. A hidden NaN would be rendered without being counted as invalid.
fn no_numbers() -> Vec<Row> {
    use Elementary::{Decay, Exp, Expm1, Sigmoid, Softplus};
    let row = |&(name, math): &(&'static str, MathBackend)| {
        let mut worst = Worst::default();
        for (isa, function) in isas().flat_map(|t| [Exp, Expm1, Decay, Softplus, Sigmoid].map(|f| (t, f))) {
            let mut x: [f32; 16] = std::array::from_fn(|i| i as f32 - 8.0);
            let nans = [0x7fc0_0000, 0xffc0_0000, 0x7f80_0001, 0xffff_ffff].map(f32::from_bits);
            x[3..7].copy_from_slice(&nans);
            let mut out = [0.0; 16];
            function.apply(isa, math, &x, &mut out);
            let hidden = x.iter().zip(&out).filter(|(x, y)| x.is_nan() != y.is_nan()).count() as f64;
            worst.see(hidden, || format!("{function:?}, {}: {:?}", isa.name(), &out[3..7]));
        }
        worst.row(name, "exact", 0.0)
    };
    BACKENDS.iter().map(row).collect()
}

/// Measures networks whose raw density is −0: the unit before the density head gives 0, and the head's bias is −0.
fn minus_zero() -> Vec<Row> {
    let mut worst = Worst::default();
    let shape = Architecture {
        position: SinusoidalEncoding { inputs: 3, levels: 0, scale: AngleScale::Pi, identity: true }.into(),
        direction: None,
        trunk: [TrunkLayer { width: 2, skip: false }, TrunkLayer { width: 2, skip: false }]
            .into_iter()
            .collect(),
        density: Some(DensityActivation::Relu),
        colour: [].into_iter().collect(),
        shading: Shading::PerSample,
    };
    // −1 times a unit that is +0, or 1 times one that is −0: which a ReLU makes of −0 is nobody's business.
    for head in [0xbc00, 0x3c00] {
        let (minus_one, minus_zero) = (0xbc00, 0x8000);
        let all = weights(&shape, |layer, _, column| match (layer, column) {
            (0, None) => minus_one,
            (0, _) => minus_zero,
            (1, Some(_)) => minus_one,
            (_, Some(_)) => head,
            (_, None) => minus_zero,
        });
        let blob = bytes(&shape, &all);
        for kernel in kernels() {
            for (name, math) in BACKENDS {
                let (sigma, ..) = ask(&blob, kernel, math, &[[0.5; 3]; 3], &[[0.0, 0.0, -1.0]; 3]);
                let bad = sigma.iter().filter(|sigma| sigma.to_bits() != 0).count() as f64;
                worst.see(bad, || format!("{name}, {}: {sigma:?}", kernel));
            }
        }
    }
    vec![worst.row("any", "any", 0.0)]
}

/// Measures both density activations on raw densities from −65,504 to 65,504 times a coordinate.
fn densities() -> Vec<Row> {
    let mut worst = Worst::default();
    for (activation, scale) in [DensityActivation::Relu, DensityActivation::ShiftedSoftplus]
        .into_iter()
        .flat_map(|activation| [0x7bffu16, 0x3c00, 0x0001].map(|scale| (activation, scale)))
    {
        let shape = Architecture {
            position: SinusoidalEncoding { inputs: 3, levels: 0, scale: AngleScale::Pi, identity: true }
                .into(),
            direction: None,
            trunk: [TrunkLayer { width: 2, skip: false }].into_iter().collect(),
            density: Some(activation),
            colour: [].into_iter().collect(),
            shading: Shading::PerSample,
        };
        // relu(x) and relu(−x), and their difference times the scale.
        let all = weights(&shape, |layer, row, column| match (layer, row, column) {
            (0, 0, Some(0)) => 0x3c00,
            (0, 1, Some(0)) => 0xbc00,
            (1, _, Some(0)) => scale,
            (1, _, Some(1)) => scale | 0x8000,
            _ => 0,
        });
        let blob = bytes(&shape, &all);
        let positions: Vec<[f32; 3]> = (0..=256).map(|i| [i as f32 / 128.0 - 1.0, 0.0, 0.0]).collect();
        let dirs = vec![[0.0, 0.0, -1.0]; positions.len()];
        for kernel in kernels() {
            for (name, math) in BACKENDS {
                let (sigma, ..) = ask(&blob, kernel, math, &positions, &dirs);
                let bad =
                    sigma.iter().filter(|sigma| !(sigma.is_finite() && sigma.is_sign_positive())).count()
                        as f64;
                worst.see(bad, || format!("{activation:?}, {name}, {}", kernel));
            }
        }
    }
    vec![worst.row("any", "any", 0.0)]
}
