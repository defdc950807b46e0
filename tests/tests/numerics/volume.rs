//! Compositing against the oracle, at every size of everything.

use crate::table::{Row, Worst, cases};
use nerf_core::volume::composite;
use nerf_tests::oracle;

/// What breaks volume renderers (camp_zipnerf's `render_test.py`).
const SIZES: [f32; 7] = [0.0, 1e-30, 1e-10, 1.0, 1e10, 1e30, f32::INFINITY];

cases! {
    a_ray_of_4096_random_samples: "absolute error of colour and opacity" => || random_rays(4096, 1.0);
    a_ray_of_4096_thin_samples: "absolute error of colour and opacity" => || random_rays(4096, 1e-4);
    a_ray_of_64_random_samples: "absolute error of colour and opacity" => || random_rays(64, 1.0);
    thin_samples_keep_their_precision: "relative error of a single sample's opacity" => thin;
    every_size_of_density_and_bin: "absolute error of opacity; colour and distance finite" => sizes;
    splitting_a_bin_in_two: "change of colour and opacity" => splitting;
}

fn noise(state: &mut u64) -> f32 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 40) as f32 / (1u64 << 24) as f32
}

/// The oracle's pixel of bins between edges.
fn truth(sigma: &[f32], rgb: &[[f32; 3]], edges: &[f32], background: [f32; 3]) -> oracle::volume::Pixel {
    let wide = |x: f32| f64::from(x);
    let sigma: Vec<f64> = sigma.iter().copied().map(wide).collect();
    let rgb: Vec<[f64; 3]> = rgb.iter().map(|c| c.map(wide)).collect();
    let t: Vec<f64> = edges.windows(2).map(|e| 0.5 * (wide(e[0]) + wide(e[1]))).collect();
    let delta: Vec<f64> = edges.windows(2).map(|e| wide(e[1]) - wide(e[0])).collect();
    oracle::volume::composite(&sigma, &rgb, &t, &delta, background.map(wide))
}

fn random_rays(n: usize, density: f32) -> Vec<Row> {
    let (mut worst, mut state) = (Worst::default(), 7);
    for ray in 0..200 {
        let sigma: Vec<f32> = (0..n).map(|_| density * (4.0 * noise(&mut state) - 1.0).max(0.0)).collect();
        let rgb: Vec<[f32; 3]> = (0..n).map(|_| [0; 3].map(|_| noise(&mut state))).collect();
        let edges: Vec<f32> = (0..=n).map(|i| 2.0 + 4.0 * i as f32 / n as f32).collect();
        let background = [1.0, 0.5, 0.0];
        let found = composite(&sigma, &rgb, &edges, background).expect("a ray");
        let truth = truth(&sigma, &rgb, &edges, background);
        let errors = (0..3).map(|c| f64::from(found.rgb[c]) - truth.rgb[c]);
        let opacity = f64::from(found.opacity) - truth.opacity;
        errors.chain([opacity]).for_each(|e| worst.see(e.abs(), || format!("ray {ray}")));
    }
    vec![worst.row("polynomial", "any", 1e-6)]
}

fn thin() -> Vec<Row> {
    let mut worst = Worst::default();
    for exponent in -120..=0 {
        for mantissa in [1.0f32, 1.3, 1.999] {
            let tau = mantissa * 2f32.powi(exponent);
            let pixel = composite(&[tau], &[[1.0; 3]], &[0.0, 1.0], [0.0; 3]).expect("a ray");
            let truth = -(-f64::from(tau)).exp_m1();
            worst.see((f64::from(pixel.opacity) - truth).abs() / truth, || format!("sigma delta = {tau:e}"));
        }
    }
    vec![worst.row("polynomial", "any", 1e-6)]
}

fn sizes() -> Vec<Row> {
    let mut worst = Worst::default();
    // Two samples of any density each, in bins of any width that edges can have.
    for (a, b) in SIZES.into_iter().flat_map(|a| SIZES.map(|b| (a, b))) {
        for (first, second) in SIZES[..6].iter().flat_map(|a| SIZES[..6].iter().map(move |b| (*a, *b))) {
            let edges = [0.0, first, first + second];
            let found = composite(&[a, b], &[[1.0; 3], [0.5; 3]], &edges, [0.25; 3]).expect("a ray");
            let truth = truth(&[a, b], &[[1.0; 3], [0.5; 3]], &edges, [0.25; 3]);
            let at = || format!("sigma {a:e}, {b:e}, bins {first:e}, {second:e}");
            worst.see((f64::from(found.opacity) - truth.opacity).abs(), at);
            let finite = found.rgb.iter().all(|c| (0.0..=1.0).contains(c)) && found.ray_distance.is_finite();
            worst.see(if finite && (0.0..=1.0).contains(&found.opacity) { 0.0 } else { f64::INFINITY }, at);
        }
    }
    vec![worst.row("polynomial", "any", 2e-7)]
}

fn splitting() -> Vec<Row> {
    let (mut worst, mut state) = (Worst::default(), 3);
    for ray in 0..200 {
        let n = 64;
        let sigma: Vec<f32> = (0..n).map(|_| 3.0 * noise(&mut state)).collect();
        let rgb: Vec<[f32; 3]> = (0..n).map(|_| [0; 3].map(|_| noise(&mut state))).collect();
        let edges: Vec<f32> = (0..=n).map(|i| 2.0 + i as f32 / 16.0).collect();
        let whole = composite(&sigma, &rgb, &edges, [1.0; 3]).expect("a ray");
        let twice = |i: usize| i / 2;
        let halves: Vec<f32> = (0..=2 * n).map(|i| 2.0 + i as f32 / 32.0).collect();
        let sigma: Vec<f32> = (0..2 * n).map(|i| sigma[twice(i)]).collect();
        let rgb: Vec<[f32; 3]> = (0..2 * n).map(|i| rgb[twice(i)]).collect();
        let split = composite(&sigma, &rgb, &halves, [1.0; 3]).expect("a ray");
        let opacity = (whole.opacity - split.opacity).abs();
        let colour = (0..3).map(|c| (whole.rgb[c] - split.rgb[c]).abs());
        colour.chain([opacity]).for_each(|e| worst.see(f64::from(e), || format!("ray {ray}")));
    }
    vec![worst.row("polynomial", "any", 1e-6)]
}
