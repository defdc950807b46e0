//! Second implementation of the loss, sample by sample in f64, for finite differences.

use super::*;

/// Returns `W [x, extra] + b`, after a ReLU if `relu`.
fn dense(d: &Dense, p: &[f64], x: &[f64], extra: &[f64], relu: bool) -> Vec<f64> {
    let input: Vec<f64> = x.iter().chain(extra).copied().collect();
    assert_eq!(input.len(), d.inputs());
    (0..d.outputs)
        .map(|o| {
            let row = &p[d.weights + o * d.inputs()..][..d.inputs()];
            let y = p[d.bias + o] + row.iter().zip(&input).map(|(w, x)| w * x).sum::<f64>();
            if relu { y.max(0.0) } else { y }
        })
        .collect()
}

fn encode(e: &SinusoidalEncoding, x: &[f32; 3]) -> Vec<f64> {
    let x = || x.iter().take(e.inputs as usize).map(|&x| f64::from(x));
    let s = if e.scale == AngleScale::Pi { std::f64::consts::PI } else { 1.0 };
    let mut out: Vec<f64> = if e.identity { x().collect() } else { Vec::new() };
    for level in 0..e.levels {
        let angle = f64::from(1 << level) * s;
        out.extend(x().map(|x| (angle * x).sin()));
        out.extend(x().map(|x| (angle * x).cos()));
    }
    out
}

/// Returns sigma (infinite in a 2D field) and, if a direction is given, colour.
pub(super) fn evaluate(m: &Model, p: &[f64], x: &[f32; 3], dir: Option<&[f32; 3]>) -> (f64, Vec<f64>) {
    let a = &m.architecture;
    let px = encode(a.position.sinusoidal().unwrap(), x);
    let mut h = px.clone();
    let (mut sigma, mut colour) = (f64::INFINITY, Vec::new());
    for d in m.layers() {
        match d.part {
            Part::Trunk(_) => h = dense(&d, p, &h, if d.extra > 0 { &px } else { &[] }, true),
            Part::Density => {
                let raw = dense(&d, p, &h, &[], false)[0] * f64::from(m.density_scale);
                sigma = match a.density {
                    Some(DensityActivation::Relu) => raw.max(0.0),
                    _ => (raw - 1.0).exp().ln_1p(),
                };
            }
            _ => {
                let Some(dir) = dir else { continue };
                let pd = if d.extra > 0 {
                    encode(a.direction.unwrap().sinusoidal().unwrap(), dir)
                } else {
                    Vec::new()
                };
                h = dense(&d, p, &h, &pd, matches!(d.part, Part::Colour(_)));
                if d.part == Part::Rgb {
                    colour = h.iter().map(|raw| 1.0 / (1.0 + (-raw).exp())).collect();
                }
            }
        }
    }
    (sigma, colour)
}

pub(super) fn loss(m: &Model, p: &[f64], batch: &Batch) -> f64 {
    let mut squared = 0.0;
    let mut first = 0;
    for ray in &batch.rays {
        let mut shown = [0.0; 3];
        let mut transmittance = 1.0;
        for i in first..first + ray.samples as usize {
            let (sigma, colour) = evaluate(m, p, &batch.positions[i], Some(&ray.dir));
            let kept = if sigma == f64::INFINITY { 0.0 } else { (-sigma * f64::from(batch.deltas[i])).exp() };
            for k in 0..3 {
                shown[k] += transmittance * (1.0 - kept) * colour[k];
            }
            transmittance *= kept;
        }
        first += ray.samples as usize;
        for (k, shown) in shown.into_iter().enumerate() {
            let error = shown + transmittance * f64::from(ray.background[k]) - f64::from(ray.rgb[k]);
            squared += error * error;
        }
    }
    let empty: f64 = batch.empty.iter().map(|x| evaluate(m, p, x, None).0.ln_1p()).sum();
    let mean = |sum: f64, count: usize| if count == 0 { 0.0 } else { sum / count as f64 };
    let empty = if m.architecture.density.is_some() { mean(empty, batch.empty.len()) } else { 0.0 };
    mean(squared, 3 * batch.rays.len()) + f64::from(batch.empty_weight) * empty
}
