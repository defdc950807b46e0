//! Errors of compositing against the oracle, for densities and bins of every size, with every maths backend.

mod laws;

pub use laws::CASES as LAWS;

use crate::table::{BACKENDS, Row, Worst, cases};
use nerf_core::math::MathBackend;
use nerf_core::volume::{OPACITY_EPSILON, Pixel, composite};
use nerf_testing::error::{excess, worse};
use nerf_testing::noise::share;
use nerf_testing::oracle;

/// Densities and widths of bins that break volume renderers (camp_zipnerf's `render_test.py`).
static SIZES: [f32; 7] = [0.0, 1e-30, 1e-10, 1.0, 1e10, 1e30, f32::INFINITY];

/// Backends with different exponential functions; the recurrence uses the polynomials' exponential.
const EXPONENTIALS: &[(&str, MathBackend)] = BACKENDS.split_at(3).0;

/// Bound of the error of a ray: errors of exp and expm1 in each weight (2e-7 and 4e-7), two roundings, and the effect
/// of rounding the optical thickness, `Σ w (2^-23 tau)`, at most 2^-23. A transmittance computed as `1 + expm1` is no
/// worse.
pub const RAY: f64 = 1e-6;

cases! {
    a_ray_of_4096_random_samples: "absolute error of colour and opacity" => || random_rays(4096, 1.0);
    a_ray_of_4096_thin_samples: "absolute error of colour and opacity" => || random_rays(4096, 1e-4);
    a_ray_of_64_random_samples: "absolute error of colour and opacity" => || random_rays(64, 1.0);
    thin_samples_keep_their_precision: "relative error of a single sample's opacity" => thin;
    every_size_of_density_and_bin: "absolute error of opacity; distances outside of near to far, over `far`; colours in [0, 1]" => sizes;
    every_size_of_density_and_bin_weighs: "error of Σw + T = 1, with each weight by itself; weights in [0, 1]" => weighed;
    walls_in_the_first_and_the_last_bin: "error of colour, opacity and distance" => walls;
    bins_of_no_width: "pixels they change" => no_width;
    edges_that_do_not_ascend_or_are_no_numbers: "rays of them that become a picture" => edges;
    densities_and_colours_that_are_no_numbers: "pixels they change" => no_numbers;
    empty_rays: "pixels that are not background, opacity 0 and `far`" => empty;
    white_on_white: "light above 1" => white;
    splitting_a_bin_in_two: "change of colour and opacity" => splitting;
}

/// Returns the oracle's pixel of a ray whose bins lie between `edges`.
fn truth(sigma: &[f32], rgb: &[[f32; 3]], edges: &[f32], background: [f32; 3]) -> oracle::volume::Pixel {
    let wide = |x: f32| f64::from(x);
    let sigma: Vec<f64> = sigma.iter().copied().map(wide).collect();
    let rgb: Vec<[f64; 3]> = rgb.iter().map(|c| c.map(wide)).collect();
    let t: Vec<f64> = edges.windows(2).map(|e| 0.5 * (wide(e[0]) + wide(e[1]))).collect();
    let delta: Vec<f64> = edges.windows(2).map(|e| wide(e[1]) - wide(e[0])).collect();
    oracle::volume::composite(&sigma, &rgb, &t, &delta, background.map(wide))
}

/// Returns the largest error of colour and opacity.
pub fn off(found: &Pixel, truth: &oracle::volume::Pixel) -> f64 {
    let colour = (0..3).map(|c| (f64::from(found.rgb[c]) - truth.rgb[c]).abs());
    colour.fold((f64::from(found.opacity) - truth.opacity).abs(), worse)
}

/// Returns one row for each backend.
fn by_backend(bounds: [f64; 3], measure: impl Fn(MathBackend, &mut Worst)) -> Vec<Row> {
    let row = |(&(name, math), bound)| {
        let mut worst = Worst::default();
        measure(math, &mut worst);
        worst.row(name, "any", bound)
    };
    EXPONENTIALS.iter().zip(bounds).map(row).collect()
}

fn random_rays(n: usize, density: f32) -> Vec<Row> {
    let mut state = 7;
    let rays: Vec<_> = (0..200)
        .map(|_| {
            let sigma: Vec<f32> =
                (0..n).map(|_| density * (4.0 * share(&mut state) - 1.0).max(0.0)).collect();
            let rgb: Vec<[f32; 3]> = (0..n).map(|_| [0; 3].map(|_| share(&mut state))).collect();
            (sigma, rgb)
        })
        .collect();
    let edges: Vec<f32> = (0..=n).map(|i| 2.0 + 4.0 * i as f32 / n as f32).collect();
    let background = [1.0, 0.5, 0.0];
    let truths: Vec<_> = rays.iter().map(|(sigma, rgb)| truth(sigma, rgb, &edges, background)).collect();
    by_backend([RAY; 3], |math, worst| {
        for (ray, ((sigma, rgb), truth)) in rays.iter().zip(&truths).enumerate() {
            let found = composite(math, sigma, rgb, &edges, background).expect("a ray");
            worst.see(off(&found, truth), || format!("ray {ray}"));
        }
    })
}

fn thin() -> Vec<Row> {
    by_backend([1e-6; 3], |math, worst| {
        for exponent in -120..=0 {
            for mantissa in [1.0f32, 1.3, 1.999] {
                let tau = mantissa * 2f32.powi(exponent);
                let found = composite(math, &[tau], &[[1.0; 3]], &[0.0, 1.0], [0.0; 3]).expect("a ray");
                let truth = -(-f64::from(tau)).exp_m1();
                let error = (f64::from(found.opacity) - truth).abs() / truth;
                worst.see(error, || format!("sigma delta = {tau:e}"));
            }
        }
    })
}

/// Calls `see` with two samples: all pairs of densities, and all pairs of bins between finite edges, at all distances.
fn every_size(mut see: impl FnMut([f32; 2], [f32; 3], &dyn Fn() -> String)) {
    let pairs = |sizes: &'static [f32]| sizes.iter().flat_map(move |a| sizes.iter().map(move |b| (*a, *b)));
    let finite = SIZES.split_at(6).0;
    for ((a, b), near) in pairs(&SIZES).flat_map(|pair| finite.iter().map(move |near| (pair, *near))) {
        for (first, second) in pairs(finite) {
            let edges = [near, near + first, near + first + second];
            assert!(edges[2].is_finite(), "{edges:?}");
            see([a, b], edges, &|| format!("sigma {a:e}, {b:e}, bins {first:e}, {second:e} from {near:e}"));
        }
    }
}

/// Returns how far a pixel's distances lie outside of `near..far`, divided by `far`.
fn beyond(found: &Pixel, near: f32, far: f32) -> f64 {
    let [near, far] = [near, far].map(f64::from);
    let outside = |t: f32| excess(worse(near - f64::from(t), f64::from(t) - far)) / far.max(1e-30);
    worse(outside(found.ray_distance), outside(found.z_depth))
}

fn sizes() -> Vec<Row> {
    by_backend([2e-7; 3], |math, worst| {
        every_size(|sigma, edges, at| {
            let rgb = [[1.0; 3], [0.5; 3]];
            let found = composite(math, &sigma, &rgb, &edges, [0.25; 3]).expect("a ray");
            let truth = truth(&sigma, &rgb, &edges, [0.25; 3]);
            worst.see((f64::from(found.opacity) - truth.opacity).abs(), at);
            let colour = found.rgb.iter().all(|c| (0.0..=1.0).contains(c));
            worst.see(if colour && (0.0..=1.0).contains(&found.opacity) { 0.0 } else { f64::INFINITY }, at);
            worst.see(beyond(&found, edges[0], edges[2]), at);
        });
    })
}

fn weighed() -> Vec<Row> {
    by_backend([1e-6; 3], |math, worst| {
        every_size(|sigma, edges, at| {
            let weights = weights(math, &sigma, &edges);
            let bad = weights.iter().any(|w| !(0.0..=1.0).contains(w));
            let sum: f64 = weights.iter().map(|&w| f64::from(w)).sum();
            worst.see(if bad { f64::NAN } else { (sum - 1.0).abs() }, at);
        });
    })
}

/// Returns the weight of each sample, followed by the transmittance behind the last sample, which is the weight of an
/// opaque wall there.
fn weights(math: MathBackend, sigma: &[f32], edges: &[f32]) -> Vec<f32> {
    let n = sigma.len();
    let (mut sigma, mut edges) = (sigma.to_vec(), edges.to_vec());
    sigma.push(f32::INFINITY);
    edges.push(edges[n].next_up().max(edges[n] + 1.0));
    let weight = |i: usize| {
        let mut rgb = vec![[0.0; 3]; n + 1];
        rgb[i] = [1.0; 3];
        composite(math, &sigma, &rgb, &edges, [0.0; 3]).expect("a ray").rgb[0]
    };
    (0..=n).map(weight).collect()
}

fn walls() -> Vec<Row> {
    by_backend([0.0; 3], |math, worst| {
        for n in [1, 2, 64, 4096] {
            let edges: Vec<f32> = (0..=n).map(|i| 2.0 + 4.0 * i as f32 / n as f32).collect();
            let rgb: Vec<[f32; 3]> = (0..n).map(|i| [0.25 + 0.5 * i as f32 / n as f32, 1.0, 0.0]).collect();
            for (bin, wall) in
                [0, n - 1].into_iter().flat_map(|bin| [1e7, 1e30, f32::INFINITY].map(|w| (bin, w)))
            {
                // In front of the last bin there is nothing, behind the first is fog.
                let mut sigma = vec![if bin == 0 { 3.0 } else { 0.0 }; n];
                sigma[bin] = wall;
                let found = composite(math, &sigma, &rgb, &edges, [0.5; 3]).expect("a ray");
                let middle = 0.5 * edges[bin] + 0.5 * edges[bin + 1];
                let right = found.rgb == rgb[bin] && found.opacity == 1.0 && found.ray_distance == middle;
                worst.see(if right { 0.0 } else { 1.0 }, || {
                    format!("{wall:e} in bin {bin} of {n}: {found:?}")
                });
            }
        }
    })
}

fn no_width() -> Vec<Row> {
    by_backend([0.0; 3], |math, worst| {
        for thin in SIZES {
            let (sigma, rgb) = ([0.5, thin, 0.75], [[1.0, 0.0, 0.5], [0.5; 3], [0.25; 3]]);
            let with = composite(math, &sigma, &rgb, &[2.0, 3.0, 3.0, 5.0], [1.0; 3]);
            let without =
                composite(math, &[sigma[0], sigma[2]], &[rgb[0], rgb[2]], &[2.0, 3.0, 5.0], [1.0; 3]);
            worst.see(f64::from(u8::from(with != without)), || format!("density {thin:e}"));
        }
        // And nothing but such bins is nothing.
        let found = composite(math, &SIZES, &[[1.0; 3]; 7], &[3.0; 8], [0.25; 3]).expect("a ray");
        worst.see(f64::from(u8::from(found.opacity != 0.0 || found.rgb != [0.25; 3])), || "all".to_string());
    })
}

fn edges() -> Vec<Row> {
    by_backend([0.0; 3], |math, worst| {
        let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
        let mut rays: Vec<[f32; 4]> = vec![
            [2.0, 1.0, 3.0, 4.0],
            [2.0, 3.0, 2.5, 4.0],
            [2.0, 3.0, 4.0, 4.0f32.next_down()],
            [-0.0, 1.0, 2.0, -3.0],
        ];
        for at in 0..4 {
            rays.extend(bad.map(|bad| {
                let mut edges = [2.0, 3.0, 4.0, 5.0];
                edges[at] = bad;
                edges
            }));
        }
        for edges in rays {
            let found = composite(math, &[1.0; 3], &[[1.0; 3]; 3], &edges, [0.0; 3]);
            worst.see(f64::from(u8::from(found.is_ok())), || format!("{edges:?}"));
        }
    })
}

fn no_numbers() -> Vec<Row> {
    by_backend([0.0; 3], |math, worst| {
        let edges = [2.0, 3.0, 4.0, 5.0];
        let (sigma, rgb) = ([0.5, 0.0, 0.75], [[1.0, 0.0, 0.5], [0.0; 3], [0.25; 3]]);
        let clean = composite(math, &sigma, &rgb, &edges, [1.0; 3]).expect("a ray");
        let mut check = |density: f32, colour: [f32; 3]| {
            let found = composite(math, &[0.5, density, 0.75], &[rgb[0], colour, rgb[2]], &edges, [1.0; 3]);
            worst.see(f64::from(u8::from(found != Ok(clean))), || format!("{density:e}, {colour:?}"));
        };
        for bad in [f32::NAN, f32::from_bits(0xffc0_1234), f32::NEG_INFINITY, -1.0, -0.0] {
            check(bad, [0.5; 3]);
        }
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            (0..3).for_each(|channel| {
                let mut colour = [0.5; 3];
                colour[channel] = bad;
                check(9.0, colour);
                check(f32::INFINITY, colour);
            });
        }
    })
}

/// Counts pixels of empty rays that are not background. Distances are `far` where nothing is hit; no output is a
/// disparity, which could be 0/0.
fn empty() -> Vec<Row> {
    by_backend([0.0; 3], |math, worst| {
        for n in [0, 1, 64, 4096] {
            let edges: Vec<f32> = (0..=n).map(|i| 2.0 + 4.0 * i as f32 / 4096.0).collect();
            for sigma in [0.0, -0.0, -1e30, f32::NEG_INFINITY, f32::NAN, 1e-45, 1e-12] {
                let found = composite(math, &vec![sigma; n], &vec![[1.0; 3]; n], &edges, [0.25, 0.5, 1.0]);
                let found = found.expect("a ray");
                // What is as good as nothing has an opacity, but no surface.
                let none = if sigma > 0.0 { found.opacity <= OPACITY_EPSILON } else { found.opacity == 0.0 };
                let background = found.rgb == [0.25, 0.5, 1.0] || (sigma > 0.0 && found.opacity > 0.0);
                let far = found.ray_distance == edges[n] && found.z_depth == edges[n];
                worst.see(if none && background && far { 0.0 } else { 1.0 }, || {
                    format!("{n} of {sigma:e}: {found:?}")
                });
            }
        }
    })
}

fn white() -> Vec<Row> {
    // Half an ulp of 1 for each of three sums.
    by_backend([2e-7; 3], |math, worst| {
        for n in [1, 2, 3, 64, 1000, 4096] {
            let edges: Vec<f32> = (0..=n).map(|i| 2.0 + 4.0 * i as f32 / n as f32).collect();
            let mut state = n as u64;
            for density in [1e-3, 0.1, 1.0, 3.0, 30.0, 1e3, f32::INFINITY] {
                let sigma: Vec<f32> = (0..n).map(|_| density * (0.5 + share(&mut state))).collect();
                let found = composite(math, &sigma, &vec![[1.0; 3]; n], &edges, [1.0; 3]).expect("a ray");
                let at = || format!("{n} of {density:e}: {found:?}");
                // All is white, whatever the opacity.
                worst.see((f64::from(found.rgb[0]) - 1.0).abs(), at);
                worst.see(if (0.0..=1.0).contains(&found.opacity) { 0.0 } else { f64::INFINITY }, at);
            }
        }
    })
}

fn splitting() -> Vec<Row> {
    by_backend([1e-6; 3], |math, worst| {
        let mut state = 3;
        for ray in 0..200 {
            let n = 64;
            let sigma: Vec<f32> = (0..n).map(|_| 3.0 * share(&mut state)).collect();
            let rgb: Vec<[f32; 3]> = (0..n).map(|_| [0; 3].map(|_| share(&mut state))).collect();
            let edges: Vec<f32> = (0..=n).map(|i| 2.0 + i as f32 / 16.0).collect();
            let whole = composite(math, &sigma, &rgb, &edges, [1.0; 3]).expect("a ray");
            let halves: Vec<f32> = (0..=2 * n).map(|i| 2.0 + i as f32 / 32.0).collect();
            let sigma: Vec<f32> = (0..2 * n).map(|i| sigma[i / 2]).collect();
            let rgb: Vec<[f32; 3]> = (0..2 * n).map(|i| rgb[i / 2]).collect();
            let split = composite(math, &sigma, &rgb, &halves, [1.0; 3]).expect("a ray");
            worst.see(change(&whole, &split), || format!("ray {ray}"));
        }
    })
}

/// Returns the largest difference of colour and opacity between two pixels.
fn change(a: &Pixel, b: &Pixel) -> f64 {
    let colour = (0..3).map(|c| f64::from((a.rgb[c] - b.rgb[c]).abs()));
    colour.fold(f64::from((a.opacity - b.opacity).abs()), worse)
}
