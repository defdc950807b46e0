//! Every tier against plain loops.

extern crate std;

use super::*;
use std::vec;
use std::vec::Vec;

/// Repeatable values in [-1, 1).
fn noise(n: usize, seed: u32) -> Vec<f32> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 8_388_608.0 - 1.0
    };
    (0..n).map(|_| next()).collect()
}

fn naive(g: Gemm, a: &[f32], b: &[f32], c: &mut [f32], init: Init<'_>, relu: bool) {
    for i in 0..g.m {
        for j in 0..g.n {
            let mut sum = match init {
                Init::Zero => 0.0,
                Init::Bias(bias) => bias[i],
                Init::Accumulate => c[i * g.c_row + j],
            };
            for p in 0..g.k {
                sum += a[i * g.a_row + p * g.a_col] * b[p * g.b_row + j];
            }
            c[i * g.c_row + j] = if relu && 0.0 > sum { 0.0 } else { sum };
        }
    }
}

#[test]
fn products_equal_plain_loops_on_every_tier() {
    for (case, (m, n, k)) in
        [(1, 16, 0), (1, 64, 63), (3, 64, 1), (6, 64, 27), (13, 80, 64), (128, 64, 155), (70, 320, 64)]
            .into_iter()
            .enumerate()
    {
        let (a, b, c) = (noise(m * k + 1, 1), noise(k * n + 16, 2), noise(m * (n + 16), 3));
        let bias = noise(m, 4);
        for transposed in [false, true] {
            let (a_row, a_col) = if transposed { (1, m) } else { (k, 1) };
            let g = Gemm { m, n, k, a_row, a_col, b_row: n, c_row: n + 16 };
            for init in [Init::Zero, Init::Bias(&bias), Init::Accumulate] {
                for relu in [false, true] {
                    let mut expected = c.clone();
                    naive(g, &a, &b, &mut expected, init, relu);
                    for tier in Tier::ALL.into_iter().filter(|tier| tier.available()) {
                        let mut found = c.clone();
                        gemm(tier, g, &a, &b, &mut found, init, relu);
                        if tier == Tier::Scalar {
                            assert_eq!(found, expected, "case {case}");
                        }
                        for (e, f) in expected.iter().zip(&found) {
                            assert!(
                                (e - f).abs() <= 1e-5 * e.abs().max(1.0),
                                "{tier:?} case {case}: {e} {f}"
                            );
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn a_nan_passes_through_the_relu_on_every_tier() {
    for tier in Tier::ALL.into_iter().filter(|tier| tier.available()) {
        let g = Gemm { m: 1, n: 16, k: 1, a_row: 1, a_col: 1, b_row: 16, c_row: 16 };
        let mut c = vec![0.0; 16];
        gemm(tier, g, &[f32::NAN], &[1.0; 16], &mut c, Init::Zero, true);
        assert!(c.iter().all(|x| x.is_nan()), "{tier:?}");
    }
}

#[test]
fn tiers_are_named_both_ways() {
    for tier in Tier::ALL {
        assert_eq!(Tier::by_name(tier.name()), Some(tier));
    }
    assert_eq!(Tier::by_name("gpu"), None);
    assert!(Tier::detect().available());
}

#[test]
fn strides_whose_reach_overflows_are_refused() {
    let half = usize::MAX / 2 + 1;
    // (m - 1) * a_row and (k - 1) * b_row wrap around to 0.
    for g in [
        Gemm { m: 3, n: 16, k: 1, a_row: half, a_col: 1, b_row: 16, c_row: 16 },
        Gemm { m: 1, n: 16, k: 3, a_row: 3, a_col: half, b_row: 16, c_row: 16 },
        Gemm { m: 1, n: 16, k: 3, a_row: 3, a_col: 1, b_row: half, c_row: 16 },
        Gemm { m: 3, n: 16, k: 1, a_row: 1, a_col: 1, b_row: 16, c_row: half },
    ] {
        let refused = std::panic::catch_unwind(|| {
            let (a, b, mut c) = (vec![0.0; 64], vec![0.0; 64], vec![0.0; 64]);
            gemm(Tier::Scalar, g, &a, &b, &mut c, Init::Zero, false);
        });
        let message = refused.expect_err("refused");
        let text = message.downcast_ref::<&str>().copied().unwrap_or("not the kernel's own message");
        assert!(text.starts_with("gemm: "), "{g:?}: {text}");
    }
}
