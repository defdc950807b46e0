//! Benchmark of matrix products with fused bias and ReLU, and of a trunk made of these products, with every kernel.

mod support;

use nerf_core::matrix::{Gemm, Init, PairedInput, PairedOutput, dense_bf16, gemm, pair, pairs};
use nerf_core::network::{Network, Weights};
use nerf_core::simd::BLOCK;
use nerf_core::{MathBackend, Storage};
use std::hint::black_box;
use support::networks::{Activations, halves, seed};
use support::{Table, kernels, noise};

const WIDTHS: [usize; 4] = [64, 128, 256, 512];
const BATCHES: [usize; 5] = [16, 64, 512, 4096, 8192];

fn main() {
    let mut table = Table::new();
    for kernel in kernels().filter(|kernel| kernel.storage != Storage::F16) {
        for width in WIDTHS {
            for batch in BATCHES {
                // Blocks of at most 64 samples, each `[channel][block]`, as in the network.
                let n = batch.min(BLOCK);
                let g = Gemm { m: width, n, k: width, a_row: width, a_col: 1, b_row: n, c_row: n };
                let (mut a, bias) = (noise(width * width, 1), noise(width, 2));
                let mut b = noise(width * batch, 3);
                if kernel.rounds() {
                    // At least as many words as the pairs need.
                    a.iter_mut().chain(&mut b).for_each(|x| *x = pair(*x, -*x));
                }
                let mut c = vec![0.0; width * batch];
                let name = format!("product {}, {width}×{width}, {batch} samples", kernel);
                let init = Init::Bias(&bias);
                table.line(&name, kernel, 1, 2.0 * (width * width * batch) as f64, || {
                    for (inputs, c) in b.chunks(width * n).zip(c.chunks_mut(width * n)) {
                        if kernel.rounds() {
                            let (row, pairs) = (pairs(width), pairs(width));
                            let main = PairedInput { weights: &a, row, pairs, inputs };
                            let none = PairedInput { pairs: 0, ..main };
                            dense_bf16(
                                kernel.isa,
                                [main, none],
                                width,
                                n,
                                init,
                                c,
                                true,
                                PairedOutput::Pairs,
                            );
                        } else {
                            gemm(kernel.isa, g, &a, inputs, c, init, true);
                        }
                    }
                    black_box(&mut c);
                });
            }
        }
    }
    // All work of a sample up to its density: encoding, eight layers with bias and ReLU, density head and its
    // activation.
    let architecture = seed();
    let halves = halves(&architecture);
    for kernel in kernels() {
        let mut memory = vec![0.0; architecture.parameters()];
        let weights = Weights::prepare(&architecture, kernel.storage, &halves, &mut memory);
        let network = Network::new(&architecture, weights, kernel.isa).expect("they fit");
        for batch in [4096, 16384] {
            let positions = noise(3 * batch, 4);
            let mut sigma = vec![0.0; batch];
            let mut memory = Activations::new(BLOCK, network.encoded_rows(), network.activation_rows());
            let name = format!("trunk 8×256 {}, {batch} samples", kernel);
            table.line(&name, kernel, 1, 2.0 * (architecture.density_macs() * batch) as f64, || {
                for (positions, sigma) in positions.chunks(3 * BLOCK).zip(sigma.chunks_mut(BLOCK)) {
                    let mut scratch = memory.scratch();
                    network.trunk(MathBackend::Polynomial, &mut scratch, positions);
                    network.density(MathBackend::Polynomial, &scratch, sigma);
                }
                black_box(&mut sigma);
            });
        }
    }
}
