//! Errors of elementary functions at every f32 of their domain, or every 1,009th, with every backend and kernel.

use crate::table::{BACKENDS, Row, Worst, cases, isas};
use nerf_core::math::{Elementary, MathBackend};
use nerf_testing::oracle::encoding::sin_cos_pi;
use nerf_testing::oracle::network::{sigmoid, softplus};

cases! {
    sin_of_pi_u_for_every_finite_u: "absolute error" =>
        || sweep(Elementary::SinPi, f32::MAX, |u| sin_cos_pi(u).0, absolute, [1.2e-7, 4e-7, 2e-3]);
    cos_of_pi_u_for_every_finite_u: "absolute error" =>
        || sweep(Elementary::CosPi, f32::MAX, |u| sin_cos_pi(u).1, absolute, [1.2e-7, 4e-7, 2e-3]);
    sin_up_to_1e5: "absolute error" =>
        || sweep(Elementary::Sin, 1e5, f64::sin, absolute, [1.2e-7, 1.2e-7, 1e-2]);
    cos_up_to_1e5: "absolute error" =>
        || sweep(Elementary::Cos, 1e5, f64::cos, absolute, [1.2e-7, 1.2e-7, 1e-2]);
    exp_of_everything: "relative error, of arguments clamped to [-87, 88]" =>
        || sweep(Elementary::Exp, f32::MAX, |x| x.clamp(-87.0, 88.0).exp(), relative, [2e-7, 2e-7, 1e-2]);
    decay_of_everything: "error of e^-x, relative where the result is above 1, of arguments clamped to [-88, 87]" =>
        || sweep(Elementary::Decay, f32::MAX, decay, relative_above_one, [2e-7, 2e-7, 4e-7]);
    expm1_of_everything: "relative error, of arguments clamped to [-87, 88]" =>
        || sweep(Elementary::Expm1, f32::MAX, |x| x.clamp(-87.0, 88.0).exp_m1(), relative, [4e-7, 2e-7, 4e-7]);
    softplus_of_everything: "error, relative where the result is above 1" =>
        || sweep(Elementary::Softplus, f32::MAX, softplus, relative_above_one, [2e-7, 2e-7, 1e-2]);
    sigmoid_of_everything: "absolute error" =>
        || sweep(Elementary::Sigmoid, f32::MAX, sigmoid, absolute, [1.2e-7, 1.2e-7, 1e-3]);
}

/// Returns whether every f32 is tested: `NERF_EXHAUSTIVE` is set.
pub fn exhaustive() -> bool {
    std::env::var_os("NERF_EXHAUSTIVE").is_some()
}

/// Returns `e^-x` with a clamped argument, as transmittance needs it; its error may be as large as that of `expm1`.
fn decay(x: f64) -> f64 {
    (-x).clamp(-87.0, 88.0).exp()
}

fn absolute(found: f64, truth: f64) -> f64 {
    (found - truth).abs()
}

fn relative(found: f64, truth: f64) -> f64 {
    (found - truth).abs() / truth.abs().max(1e-37)
}

fn relative_above_one(found: f64, truth: f64) -> f64 {
    (found - truth).abs() / truth.abs().max(1.0)
}

/// Number of values that are passed to a backend together, of each sign.
const CHUNK: usize = 4096;

/// Measures a function at every `step`-th f32 up to `limit`, of either sign, and at `limit` itself.
fn sweep(
    function: Elementary,
    limit: f32,
    truth: fn(f64) -> f64,
    error: fn(f64, f64) -> f64,
    bounds: [f64; 3],
) -> Vec<Row> {
    let step = if exhaustive() { 1 } else { 1009 };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let last = limit.to_bits() as usize;
    let chunks = (last / step + 1).div_ceil(CHUNK);
    // Recurrence takes these from the polynomials; the encoding's cases have it.
    let backends = &BACKENDS[..3];
    let part = |thread: usize| {
        let mut worst = vec![Worst::default(); backends.len()];
        let mut out = vec![0.0; 2 * CHUNK];
        for chunk in (thread..chunks).step_by(threads) {
            let bits = (0..CHUNK).map(|i| ((chunk * CHUNK + i) * step).min(last) as u32);
            let x: Vec<f32> = bits.flat_map(|bits| [f32::from_bits(bits), -f32::from_bits(bits)]).collect();
            let truths: Vec<f64> = x.iter().map(|&x| truth(f64::from(x))).collect();
            for (&(_, math), worst) in backends.iter().zip(&mut worst) {
                // One value at a time is one value at a time with every kernel.
                let kernels = isas().take(if math == MathBackend::Polynomial { usize::MAX } else { 1 });
                for isa in kernels {
                    function.apply(isa, math, &x, &mut out);
                    for ((&x, &found), &truth) in x.iter().zip(&out).zip(&truths) {
                        worst.see(error(f64::from(found), truth), || format!("{x:e}, {}", isa.name()));
                    }
                }
            }
        }
        worst
    };
    let parts: Vec<Vec<Worst>> = std::thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|thread| scope.spawn(move || part(thread))).collect();
        running.into_iter().map(|thread| thread.join().expect("a sweep")).collect()
    });
    let rows = backends.iter().enumerate().map(|(i, &(name, _))| {
        let mut all = Worst::default();
        parts.iter().for_each(|part| all.see(part[i].error, || part[i].at.clone()));
        let kernels = if i == 0 { "exact" } else { "portable" };
        all.row(name, kernels, bounds[i])
    });
    rows.collect()
}
