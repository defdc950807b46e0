//! Tests of matrix products: every instruction set against plain loops.

extern crate std;

use super::*;
use crate::simd::Isa;
use crate::testing::noise;
use std::format;
use std::vec;
use std::vec::Vec;

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
fn products_equal_plain_loops_with_every_kernel() {
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
                    for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
                        let mut found = c.clone();
                        gemm(isa, g, &a, &b, &mut found, init, relu);
                        if isa == Isa::Portable {
                            assert_eq!(found, expected, "case {case}");
                        }
                        for (e, f) in expected.iter().zip(&found) {
                            assert!((e - f).abs() <= 1e-5 * e.abs().max(1.0), "{isa:?} case {case}: {e} {f}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn a_nan_passes_through_the_relu_with_every_kernel() {
    for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
        let g = Gemm { m: 1, n: 16, k: 1, a_row: 1, a_col: 1, b_row: 16, c_row: 16 };
        let mut c = vec![0.0; 16];
        gemm(isa, g, &[f32::NAN], &[1.0; 16], &mut c, Init::Zero, true);
        assert!(c.iter().all(|x| x.is_nan()), "{isa:?}");
    }
}

#[test]
fn strides_whose_reach_overflows_are_refused() {
    let half = usize::MAX / 2 + 1;
    // In each product, the last index times one of the strides wraps around to 0.
    for g in [
        Gemm { m: 3, n: 16, k: 1, a_row: half, a_col: 1, b_row: 16, c_row: 16 },
        Gemm { m: 1, n: 16, k: 3, a_row: 3, a_col: half, b_row: 16, c_row: 16 },
        Gemm { m: 1, n: 16, k: 3, a_row: 3, a_col: 1, b_row: half, c_row: 16 },
        Gemm { m: 3, n: 16, k: 1, a_row: 1, a_col: 1, b_row: 16, c_row: half },
    ] {
        let refused = std::panic::catch_unwind(|| {
            let (a, b, mut c) = (vec![0.0; 64], vec![0.0; 64], vec![0.0; 64]);
            gemm(Isa::Portable, g, &a, &b, &mut c, Init::Zero, false);
        });
        let message = refused.expect_err("refused");
        let text = message.downcast_ref::<&str>().copied().unwrap_or("not the kernel's own message");
        assert!(text.starts_with("gemm: "), "{g:?}: {text}");
    }
}

#[test]
fn paired_layers_equal_the_oracle_with_every_kernel() {
    for (outputs, stride, main, extra) in
        [(1, 16, 1, 0), (6, 64, 63, 0), (13, 80, 64, 27), (128, 64, 255, 1), (3, 64, 128, 0), (4, 128, 7, 2)]
    {
        // Rounds values to bf16 and packs them in pairs.
        let paired = |values: &[f32]| -> Vec<f32> {
            values.chunks(2).map(|two| pair(two[0], two.get(1).copied().unwrap_or(0.0))).collect()
        };
        let round = |x: &f32| ::half::bf16::from_f32(*x).to_f32();
        let weights: Vec<Vec<f32>> = (0..outputs).map(|row| noise(main + extra, 1 + row as u32)).collect();
        let words: Vec<f32> =
            weights.iter().flat_map(|row| [paired(&row[..main]), paired(&row[main..])].concat()).collect();
        let rows = [noise(main * stride, 1000), noise(extra * stride, 1001)];
        let [front, side] = [(0, main), (1, extra)].map(|(i, count)| {
            let mut values = rows[i].clone();
            pair_rows(&mut values, count, stride);
            values
        });
        let row = pairs(main) + pairs(extra);
        let parts = [
            PairedInput { weights: &words, row, pairs: pairs(main), inputs: &front },
            PairedInput { weights: &words[pairs(main)..], row, pairs: pairs(extra), inputs: &side },
        ];
        let (bias, start) = (noise(outputs, 1002), noise(outputs * stride, 1003));
        for init in [Init::Zero, Init::Bias(&bias), Init::Accumulate] {
            for relu in [false, true] {
                for isa in [Isa::Portable, Isa::Avx512] {
                    let mut found = start.clone();
                    dense_bf16(isa, parts, outputs, stride, init, &mut found, relu, PairedOutput::Floats);
                    let mut words = start.clone();
                    dense_bf16(isa, parts, outputs, stride, init, &mut words, relu, PairedOutput::Pairs);
                    for i in 0..outputs {
                        for j in 0..stride {
                            let mut sum = match init {
                                Init::Zero => 0.0,
                                Init::Bias(bias) => f64::from(bias[i]),
                                Init::Accumulate => f64::from(start[i * stride + j]),
                            };
                            for (p, w) in weights[i].iter().enumerate() {
                                let x = if p < main {
                                    &rows[0][p * stride + j]
                                } else {
                                    &rows[1][(p - main) * stride + j]
                                };
                                sum += f64::from(round(w)) * f64::from(round(x));
                            }
                            let expected = if relu { sum.max(0.0) } else { sum };
                            let value = found[i * stride + j];
                            let what = format!("{isa:?} {outputs}x{stride}x{main}+{extra} {init:?} row {i}");
                            assert!(
                                (f64::from(value) - expected).abs() <= 2e-5,
                                "{what}: {value} {expected}"
                            );
                            // Outputs in pairs equal the f32 outputs, rounded to bf16.
                            let word = words[i / 2 * stride + j].to_bits();
                            let bits = if i % 2 == 0 { word & 0xffff } else { word >> 16 };
                            assert_eq!(bits, u32::from(::half::bf16::from_f32(value).to_bits()), "{what}");
                        }
                    }
                    if outputs % 2 == 1 {
                        assert!(
                            words[outputs / 2 * stride..][..stride].iter().all(|w| w.to_bits() >> 16 == 0)
                        );
                    }
                }
            }
        }
    }
}

#[cfg(feature = "normals")]
#[test]
fn transposed_paired_weights_equal_plain_loops_with_every_kernel() {
    for (outputs, inputs, stride) in [(1, 1, 16), (6, 63, 64), (13, 8, 80), (128, 27, 64), (3, 2, 48)] {
        // Words per row of weights: the pairs, and at each end an unused word, as if the row were part of a longer row.
        let row = pairs(inputs) + 2;
        let weights: Vec<Vec<f32>> = (0..outputs).map(|o| noise(inputs, 1 + o as u32)).collect();
        let words: Vec<f32> = weights
            .iter()
            .flat_map(|w| {
                let paired = w.chunks(2).map(|two| pair(two[0], two.get(1).copied().unwrap_or(0.0)));
                [vec![f32::NAN], paired.collect(), vec![f32::NAN]].concat()
            })
            .collect();
        let (from, start) = (noise(outputs * stride, 2000), noise(inputs * stride + 16, 2001));
        for accumulate in [false, true] {
            for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
                let mut found = start.clone();
                let sizes = [outputs, inputs];
                transposed_bf16(isa, &words[1..], row, sizes, stride, &from, &mut found, accumulate);
                for i in 0..inputs {
                    for j in 0..stride {
                        let at = i * stride + j;
                        let mut sum = if accumulate { f64::from(start[at]) } else { 0.0 };
                        for (o, weights) in weights.iter().enumerate() {
                            let weight = ::half::bf16::from_f32(weights[i]).to_f64();
                            sum += weight * f64::from(from[o * stride + j]);
                        }
                        // Bound on the rounding error of a sum of `outputs` products, each at most 1.
                        let bound = (outputs + 2) as f64 * 6e-8 * (outputs + 1) as f64;
                        let off = (f64::from(found[at]) - sum).abs();
                        assert!(off <= bound, "{isa:?} {outputs}x{inputs}x{stride}: {off:e}");
                    }
                }
                assert_eq!(found[inputs * stride..], start[inputs * stride..], "nothing beyond");
            }
        }
    }
}

#[test]
fn every_f16_widens_to_what_half_says() {
    for bits in 0..=u16::MAX {
        let (found, expected) = (f16_at(&bits.to_le_bytes(), 0), ::half::f16::from_bits(bits).to_f32());
        assert!(found.to_bits() == expected.to_bits() || found.is_nan() && expected.is_nan(), "{bits:#06x}");
        if expected.is_finite() {
            let (g, mut product) = (Gemm { m: 1, n: 1, k: 1, a_row: 1, a_col: 1, b_row: 1, c_row: 1 }, [0.0]);
            gemm_f16(Isa::Portable, g, &bits.to_le_bytes(), &[1.0], &mut product, Init::Zero, false);
            assert_eq!(product[0], expected, "{bits:#06x} as a weight");
        }
    }
}

#[test]
fn kernels_are_named_both_ways() {
    let every = Isa::ALL.into_iter().flat_map(|isa| Storage::ALL.map(|storage| Kernel::new(isa, storage)));
    for kernel in every {
        assert_eq!(Kernel::by_name(&format!("{kernel}")), Some(kernel));
    }
    for name in ["gpu", "", "avx2-", "avx2-f64", "-f16", "avx2-f16-f16"] {
        assert_eq!(Kernel::by_name(name), None, "{name}");
    }
    assert_eq!(
        format!("{} {}", Kernel::IN_PLACE, Kernel::new(Isa::Avx512, Storage::F32)),
        "portable-f16 avx512"
    );
    assert!(Kernel::detect().available() && !Kernel::detect().rounds());
    assert!(Kernel::all().any(|kernel| kernel == Kernel::IN_PLACE) && Kernel::all().count() >= 2);
}
