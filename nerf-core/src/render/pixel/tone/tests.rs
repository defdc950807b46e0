extern crate std;

use super::*;
#[cfg(feature = "libm")]
use crate::math::libm::Libm;
#[cfg(feature = "micromath")]
use crate::math::micromath::Micromath;
use crate::math::polynomial::Polynomial;

fn decode_f64(c: f64) -> f64 {
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

fn encode_f64(x: f64) -> f64 {
    if x <= 0.0031308 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// Largest absolute errors of decoding and of encoding on `[0, 1]`.
fn errors<M: Math>() -> (f64, f64) {
    let mut worst = (0.0f64, 0.0f64);
    for i in 0..=100_000 {
        let x = i as f32 / 100_000.0;
        let decoded = f64::from(decode_srgb::<M>([x; 3])[0]);
        worst.0 = worst.0.max((decoded - decode_f64(x.into())).abs());
        worst.1 = worst.1.max((f64::from(encode_srgb::<M>(x)) - encode_f64(x.into())).abs());
    }
    std::println!("{}: {worst:?}", core::any::type_name::<M>());
    worst
}

#[test]
fn the_srgb_curve_stays_within_its_rows() {
    let (decode, encode) = errors::<Polynomial>();
    assert!(decode <= 4e-7 && encode <= 4e-7);
    #[cfg(feature = "libm")]
    {
        let (decode, encode) = errors::<Libm>();
        assert!(decode <= 4e-7 && encode <= 4e-7);
    }
    #[cfg(feature = "micromath")]
    {
        let (decode, encode) = errors::<Micromath>();
        assert!(decode <= 4e-7 && encode <= 4e-7);
    }
}

#[test]
fn ends_are_exact_and_what_is_outside_is_cut() {
    assert_eq!(decode_srgb::<Polynomial>([0.0, -0.1, f32::NAN]), [0.0; 3]);
    for (x, expected) in [(0.0, 0.0), (-1.0, 0.0), (1.0, 1.0), (7.0, 1.0), (1e30, 1.0)] {
        assert!((encode_srgb::<Polynomial>(x) - expected).abs() <= 1.2e-7, "{x}");
    }
}

#[test]
fn encoding_undoes_decoding() {
    let mut worst = 0.0f32;
    for i in 0..=255u8 {
        let c = f32::from(i) / 255.0;
        let back = encode_srgb::<Polynomial>(decode_srgb::<Polynomial>([c; 3])[0]);
        worst = worst.max((back - c).abs());
    }
    std::println!("round trip {worst:e}");
    // Encoding multiplies an error of decoding by the slope of the encoding curve. Where this slope is largest, 12.92,
    // decoding is nearly exact.
    assert!(worst <= 1e-6, "{worst:e}");
}

#[test]
fn every_curve_rises_from_0_to_1() {
    for map in [ToneMap::Reinhard, ToneMap::Filmic] {
        assert_eq!(curve(map, 0.0), 0.0);
        let mut last = 0.0;
        for i in 1..=4000 {
            // 4,000 inputs over 14 stops; each is larger than the previous by 0.25 %.
            let x = 1e-3 * (f64::from(i) * 0.0025).exp() as f32;
            let y = curve(map, x);
            assert!(y > last || y == 1.0, "{map:?} at {x}: {y} after {last}");
            assert!(y <= 1.0);
            last = y;
        }
        assert!(curve(map, 3e38) > 0.999 && curve(map, 3e38) <= 1.0, "{map:?}");
    }
    assert_eq!(curve(ToneMap::Reinhard, 1.0), 0.5);
    // Value of Narkowicz's fit at 1, by hand: (2.51 + 0.03) / (2.43 + 0.59 + 0.14).
    assert!((curve(ToneMap::Filmic, 1.0) - 2.54 / 3.16).abs() < 1e-7);
    assert_eq!(curve(ToneMap::None, 7.5), 7.5);
    let mut last = -1.0;
    for i in 0..=4096 {
        let y = encode_srgb::<Polynomial>(i as f32 / 4096.0);
        assert!(y > last, "{i}");
        last = y;
    }
}

#[test]
fn whole_stops_double_exactly_and_others_by_their_power() {
    for stops in -32..=32i8 {
        assert_eq!(exp2::<Polynomial>(stops.into()), 2f32.powi(stops.into()));
    }
    for stops in [-31.7, -0.5, 0.1, 2.25, 30.9] {
        let off = f64::from(exp2::<Polynomial>(stops)) / f64::from(stops).exp2() - 1.0;
        assert!(off.abs() < 3e-7, "{stops}: {off}");
    }
}

#[test]
fn nothing_asked_for_changes_no_bit() {
    for c in [0.0, 1e-40, 0.3, 1.0, 1.000_000_1, -0.0] {
        assert_eq!(to_light(&Tone::NONE, MathBackend::Polynomial, [c; 3])[0].to_bits(), c.to_bits());
        assert_eq!(to_display(&Tone::NONE, MathBackend::Polynomial, [c; 3])[0].to_bits(), c.to_bits());
    }
}
