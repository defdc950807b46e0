//! Errors of the network at exact points, with every kernel and maths backend, and of sums of extreme values.

mod activations;

pub use activations::CASES as ACTIVATIONS;

use crate::table::{BACKENDS, Row, Worst, cases, exact_kernels, isas};
use nerf_core::blob::Blob;
use nerf_core::math::MathBackend;
use nerf_core::matrix::{
    Gemm, Init, PairedInput, PairedOutput, dense_bf16, gemm, gemm_f16, pair_rows, pairs,
};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Counters, Renderer};
use nerf_core::{Isa, Kernel};
use nerf_testing::error::worst_of;
use nerf_testing::noise::signed;
use nerf_testing::oracle::network::{Network, f16};
use nerf_testing::scenes::{Recipe, kernels};

cases! {
    densities_of_random_networks: "error of sigma, relative above 1" => || queries(0);
    colours_of_random_networks: "absolute error of rgb" => || queries(1);
    a_dot_product_of_512_extremes_of_f16: "error over the sum of magnitudes" => extremes;
}

const POINTS: usize = 640;

/// Measures the largest error of sigma (`output` 0) or rgb (1) for each backend, and for the kernel that rounds
/// weights.
fn queries(output: usize) -> Vec<Row> {
    let mut worst = vec![Worst::default(); BACKENDS.len() + 1];
    let wide = Recipe { trunk: (8, 256), skip: true, seed: 21, ..Recipe::PLAIN };
    for (name, recipe) in [("4x32", Recipe::PLAIN), ("skip", Recipe::SKIP), ("8x256", wide)] {
        let bytes = recipe.blob();
        let blob = Blob::open(&bytes).expect("a blob");
        let weights: Vec<f64> =
            blob.weights().chunks_exact(2).map(|b| f16(u16::from_le_bytes([b[0], b[1]]))).collect();
        let oracle = Network::of_file(blob.architecture(), &weights);
        let mut state = 5;
        let positions: Vec<[f32; 3]> = (0..POINTS).map(|_| [0; 3].map(|_| signed(&mut state))).collect();
        let dirs: Vec<[f32; 3]> =
            positions.iter().map(|_| unit([0; 3].map(|_| signed(&mut state)))).collect();
        let double = |v: &[f32; 3]| v.map(f64::from);
        let truth: Vec<(f64, [f64; 3])> = positions
            .iter()
            .zip(&dirs)
            .map(|(p, d)| (oracle.sigma(&double(p)), oracle.rgb(&double(p), &double(d))))
            .collect();
        let compare = |kernel: Kernel, math: MathBackend, worst: &mut Worst| {
            let (sigma, rgb, _) = ask(&bytes, kernel, math, &positions, &dirs);
            for (i, (s, c)) in truth.iter().enumerate() {
                let error = match output {
                    0 => (f64::from(sigma[i]) - s).abs() / s.max(1.0),
                    _ => worst_of((0..3).map(|k| (f64::from(rgb[i][k]) - c[k]).abs())),
                };
                worst.see(error, || format!("{name}, point {i}, {}", kernel));
            }
        };
        for (&(_, math), worst) in BACKENDS.iter().zip(&mut worst) {
            exact_kernels().for_each(|kernel| compare(kernel, math, worst));
        }
        for kernel in kernels().filter(|kernel| kernel.rounds()) {
            compare(kernel, MathBackend::Polynomial, &mut worst[BACKENDS.len()]);
        }
    }
    // Up to nine times what was seen: the rough backends' errors at the input go through eight layers, and cancel.
    let bounds = [[2e-5, 2e-5, 5e-2, 5e-4, 2e-1], [4e-6, 4e-6, 6e-3, 4e-5, 4e-2]][output];
    let mut rows: Vec<Row> = Vec::new();
    for (i, worst) in worst.into_iter().enumerate() {
        match BACKENDS.get(i) {
            Some(&(name, _)) => rows.push(worst.row(name, "exact", bounds[i])),
            None if worst.at.is_empty() => {}
            None => rows.push(worst.row("polynomial", "avx512-bf16", bounds[i])),
        }
    }
    rows
}

fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
    v.map(|x| x / length)
}

/// Evaluates density and colour at points with the renderer.
pub(crate) fn ask(
    bytes: &[u8],
    kernel: Kernel,
    math: MathBackend,
    positions: &[[f32; 3]],
    dirs: &[[f32; 3]],
) -> (Vec<f32>, Vec<[f32; 3]>, Counters) {
    let blob = Blob::open(bytes).expect("a blob");
    let quality = Quality { math, ..Quality::default() };
    let plan = Plan::new(&blob, &quality, Outputs::RGB, Batch::FULL).expect("a plan");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let (mut sigma, mut rgb) = (vec![0.0; positions.len()], vec![[0.0; 3]; positions.len()]);
    let counters =
        renderer.query(&plan, positions, dirs, &mut workspace, &mut sigma, &mut rgb).expect("an answer");
    (sigma, rgb, counters)
}

/// Measures products of rows of extreme f16 values, from ±65,504 to the smallest subnormals, with inputs of very
/// different sizes. The rows are unpacked to f32, read in place, or rounded to bf16 together with their inputs.
fn extremes() -> Vec<Row> {
    let (k, n) = (512, 16);
    // The largest, the least, 1, the least normal one, and the next below 1.
    let sizes = [0x7bffu16, 0x0001, 0x3c00, 0x0400, 0x3bff];
    let mut state = 9;
    let halves: Vec<u16> =
        (0..k).map(|i| sizes[i % 5] | if signed(&mut state) < 0.0 { 0x8000 } else { 0 }).collect();
    let a: Vec<f32> = halves.iter().map(|&bits| f16(bits) as f32).collect();
    let b: Vec<f32> = (0..k * n).map(|i| signed(&mut state) * [1.0, 1e4, 1e-4][i % 3]).collect();
    let see = |worst: &mut Worst, a: &[f32], b: &[f32], c: &[f32], isa: Isa| {
        for (column, &found) in c.iter().enumerate() {
            let terms = (0..k).map(|p| f64::from(a[p]) * f64::from(b[p * n + column]));
            let (truth, all) = terms.fold((0.0, 0.0), |(sum, all), term| (sum + term, all + term.abs()));
            worst.see((f64::from(found) - truth).abs() / all, || format!("column {column}, {}", isa.name()));
        }
    };
    let g = Gemm { m: 1, n, k, a_row: k, a_col: 1, b_row: n, c_row: n };
    let [mut unpacked, mut in_place, mut rounded] = [(); 3].map(|()| Worst::default());
    let bytes: Vec<u8> = halves.iter().flat_map(|bits| bits.to_le_bytes()).collect();
    for isa in isas() {
        let mut c = vec![f32::NAN; n];
        gemm(isa, g, &a, &b, &mut c, Init::Zero, false);
        see(&mut unpacked, &a, &b, &c, isa);
        gemm_f16(isa, g, &bytes, &b, &mut c, Init::Zero, false);
        see(&mut in_place, &a, &b, &c, isa);
    }

    // The layer against the sums of what is left after rounding: that is half an ulp of 8 bits, and not the layer's.
    let (mut weights, mut inputs) = (a.clone(), b.clone());
    pair_rows(&mut weights, k, 1);
    pair_rows(&mut inputs, k, n);
    let [a, b] = [&a, &b].map(|all| all.iter().copied().map(bf16).collect::<Vec<f32>>());
    let parts = [(&weights[..], &inputs[..], pairs(k)), (&[], &[], 0)];
    let parts = parts.map(|(weights, inputs, pairs)| PairedInput { weights, row: pairs, pairs, inputs });
    for isa in [Isa::Portable, Isa::Avx512] {
        let mut c = vec![f32::NAN; n];
        dense_bf16(isa, parts, 1, n, Init::Zero, &mut c, false, PairedOutput::Floats);
        see(&mut rounded, &a, &b, &c, isa);
    }
    vec![
        unpacked.row("any", "exact", DOT),
        in_place.row("any", "exact, f16 in place", DOT),
        rounded.row("any", "bf16, of what it rounds to", DOT),
    ]
}

/// Bound: about nine times the observed error. The worst case would be 513 u, 3.1e-5 (Higham 2002, eq. 3.5), but
/// rounding errors of either sign cancel.
const DOT: f64 = 6e-7;

/// Rounds a number to the nearest bf16 (8 significant bits), ties to even; returns the result as an f32.
fn bf16(x: f32) -> f32 {
    let bits = x.to_bits();
    f32::from_bits((bits + 0x7fff + (bits >> 16 & 1)) & 0xffff_0000)
}
