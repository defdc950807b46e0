extern crate std;

use super::*;
use crate::math::polynomial::SIN_COS_DOMAIN;
use crate::testing::Worse;
use std::vec;
use std::vec::Vec;

fn isas() -> impl Iterator<Item = Isa> {
    Isa::ALL.into_iter().filter(|isa| isa.available())
}

/// Test inputs of magnitude up to `limit`: ±0, subnormals, multiples of 2^-k and the adjacent floats, numbers of all
/// magnitudes, and random numbers.
fn hard(limit: f32) -> Vec<f32> {
    let mut all = vec![0.0, 1e-45, 1e-40, f32::MIN_POSITIVE, 1.0, 0.5f32.next_up(), 1.0 / 3.0, limit];
    for k in 0..=18 {
        for n in [1.0, 3.0, 5.0, 1023.0] {
            let x = n * 0.5f32.powi(k);
            all.extend([x, x.next_up(), x.next_down()]);
        }
    }
    for e in -12..=4 {
        all.extend([1.0, 1.234_567, 3.3, 9.876_543].map(|m| m * 10f32.powi(e)));
    }
    let noise = crate::testing::noise(1000, 77);
    all.extend(noise.iter().map(|x| x * limit));
    all.extend(noise.iter().copied());
    let negative: Vec<f32> = all.iter().map(|x| -x).collect();
    all.extend(negative);
    all.retain(|x| x.abs() <= limit);
    let short = all.len() % 192;
    all.extend(vec![0.25; if short == 0 { 0 } else { 192 - short }]);
    all
}

/// Sine and cosine of `2^level s x` in f64. With `s = π`, the angle is reduced exactly.
fn truth(scale: AngleScale, level: i32, x: f32) -> (f64, f64) {
    let u = f64::from(x) * 2f64.powi(level);
    let angle = match scale {
        AngleScale::Pi => core::f64::consts::PI * (u % 2.0),
        AngleScale::One => u,
    };
    (angle.sin(), angle.cos())
}

/// Largest error of the encoding over `points`. Also checks the order of the outputs, and that the identity is a copy.
fn worst(isa: Isa, math: MathBackend, encoding: SinusoidalEncoding, points: &[f32]) -> f64 {
    let (inputs, stride) = (usize::from(encoding.inputs), 64);
    let mut worst = 0.0f64;
    for block in points.chunks_exact(inputs * stride) {
        let mut out = vec![f32::NAN; encoding.outputs() * stride];
        encode_block(isa, math, &encoding, stride, block, &mut out);
        let mut rows = out.chunks_exact(stride);
        if encoding.identity {
            for input in 0..inputs {
                let (found, x) = (rows.next().unwrap(), &block[input * stride..][..stride]);
                assert!(found.iter().zip(x).all(|(a, b)| a.to_bits() == b.to_bits()), "identity is a copy");
            }
        }
        for level in 0..i32::from(encoding.levels) {
            for cosine in [false, true] {
                for input in 0..inputs {
                    let row = rows.next().unwrap();
                    for (&found, &x) in row.iter().zip(&block[input * stride..]) {
                        let (sin, cos) = truth(encoding.scale, level, x);
                        worst = worst.worse((f64::from(found) - if cosine { cos } else { sin }).abs());
                    }
                }
            }
        }
        assert!(rows.next().is_none());
    }
    worst
}

#[test]
fn sixteen_levels_of_pi_stay_within_1_2e_7_up_to_1e4() {
    for isa in isas() {
        for (inputs, identity) in [(2, true), (3, true), (3, false)] {
            let encoding = SinusoidalEncoding { inputs, levels: 16, scale: AngleScale::Pi, identity };
            let worst = worst(isa, MathBackend::Polynomial, encoding, &hard(1e4));
            std::println!("{isa:?}, {inputs} inputs: {worst:e}");
            assert!(worst <= 1.2e-7, "{isa:?}: {worst:e}");
        }
    }
}

#[test]
fn scale_one_stays_within_1_2e_7_on_its_domain() {
    for isa in isas() {
        for levels in [1, 4, 10, 16] {
            let encoding = SinusoidalEncoding { inputs: 3, levels, scale: AngleScale::One, identity: true };
            let limit = SIN_COS_DOMAIN / 2f32.powi(i32::from(levels) - 1);
            let worst = worst(isa, MathBackend::Polynomial, encoding, &hard(limit));
            std::println!("{isa:?}, s = 1, {levels} levels: {worst:e}");
            assert!(worst <= 1.2e-7, "{isa:?}: {worst:e}");
        }
    }
}

#[test]
fn other_backends_err_by_their_rows() {
    let encoding = |levels| SinusoidalEncoding { inputs: 3, levels, scale: AngleScale::Pi, identity: true };
    for isa in isas() {
        let points = hard(2.0);
        let rows = [
            #[cfg(feature = "libm")]
            (MathBackend::Libm, 16, 4e-7),
            #[cfg(feature = "micromath")]
            (MathBackend::Micromath, 16, 2e-3),
            (MathBackend::Recurrence, 10, 1e-4),
        ];
        for (math, levels, limit) in rows {
            let worst = worst(isa, math, encoding(levels), &points);
            std::println!("{isa:?} {math:?}, {levels} levels: {worst:e}");
            assert!(worst <= limit, "{isa:?} {math:?}: {worst:e}");
        }
    }
}

#[test]
fn exact_multiples_give_exact_values() {
    let encoding = SinusoidalEncoding { inputs: 3, levels: 4, scale: AngleScale::Pi, identity: false };
    // At level 0, x = 0, ½ and 1 give the angles 0, π/2 and π.
    let (x, mut out) = ([-0.0, 0.5, 1.0], [f32::NAN; 24]);
    encode_block(Isa::Portable, MathBackend::Polynomial, &encoding, 1, &x, &mut out);
    assert_eq!(out[..6], [0.0, 1.0, 0.0, 1.0, 0.0, -1.0]);
    assert_eq!(out[6..12], [0.0, 0.0, 0.0, 1.0, -1.0, 1.0]);
}

#[test]
fn one_column_equals_sixty_four_with_portable_instructions() {
    let points = hard(1e4);
    for scale in [AngleScale::Pi, AngleScale::One] {
        let encoding = SinusoidalEncoding { inputs: 3, levels: 4, scale, identity: true };
        for block in points.chunks_exact(3 * 64) {
            let mut wide = vec![0.0; encoding.outputs() * 64];
            encode_block(Isa::Portable, MathBackend::Polynomial, &encoding, 64, block, &mut wide);
            for column in 0..64 {
                let one: [f32; 3] = core::array::from_fn(|input| block[input * 64 + column]);
                let mut narrow = vec![0.0; encoding.outputs()];
                encode_block(Isa::Portable, MathBackend::Polynomial, &encoding, 1, &one, &mut narrow);
                for (channel, value) in narrow.iter().enumerate() {
                    assert_eq!(value.to_bits(), wide[channel * 64 + column].to_bits(), "channel {channel}");
                }
            }
        }
    }
}

#[test]
fn a_value_does_not_depend_on_its_neighbours_with_any_instruction_set() {
    let encoding = SinusoidalEncoding { inputs: 3, levels: 10, scale: AngleScale::Pi, identity: true };
    let points = hard(10.0);
    let (a, b) = (&points[..192], &points[192..384]);
    for isa in isas() {
        let go = |x: &[f32]| {
            let mut out = vec![0.0; encoding.outputs() * 64];
            encode_block(isa, MathBackend::Polynomial, &encoding, 64, x, &mut out);
            out
        };
        let mut mixed = b.to_vec();
        let column = 37;
        (0..3).for_each(|input| mixed[input * 64 + column] = a[input * 64 + column]);
        let (from_a, from_mixed) = (go(a), go(&mixed));
        for channel in 0..encoding.outputs() {
            let at = channel * 64 + column;
            assert_eq!(from_a[at].to_bits(), from_mixed[at].to_bits(), "{isa:?} channel {channel}");
        }
    }
}

#[test]
fn outputs_count_inputs_levels_and_identity() {
    for (inputs, levels, identity, outputs) in
        [(3, 10, true, 63), (3, 4, false, 24), (2, 0, true, 2), (3, 16, true, 99)]
    {
        assert_eq!(
            SinusoidalEncoding { inputs, levels, scale: AngleScale::One, identity }.outputs(),
            outputs
        );
    }
}

#[test]
#[cfg_attr(debug_assertions, should_panic(expected = "expected 45 values, found 44"))]
fn a_short_output_is_refused_or_filled_as_far_as_it_goes() {
    let encoding = SinusoidalEncoding { inputs: 3, levels: 1, scale: AngleScale::Pi, identity: true };
    let x: [f32; 15] = core::array::from_fn(|i| i as f32 / 16.0);
    let (mut whole, mut short) = ([0.0; 45], [0.0; 44]);
    encode_block(Isa::Portable, MathBackend::Polynomial, &encoding, 5, &x, &mut whole);
    encode_block(Isa::Portable, MathBackend::Polynomial, &encoding, 5, &x, &mut short);
    assert_eq!(short, whole[..44]);
}
