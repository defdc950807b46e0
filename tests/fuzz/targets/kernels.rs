//! Every kernel against an f64 evaluation that carries a bound of its own rounding along.
//!
//! The bound follows from the number formats alone (Higham 2002, section 3.1): a sum of `n` products
//! in f32, in any order, fused or not, is off by at most `γ_n Σ|w||x|`, `γ_n = n u / (1 − n u)`,
//! `u = 2⁻²⁴`; errors of the inputs pass through `Σ|w|`. The kernel that rounds adds 2⁻⁸ for each operand.
#![no_main]

use arbitrary::{Result, Unstructured};
use libfuzzer_sys::{Corpus, fuzz_target};
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::network::{DensityActivation, TrunkLayer};
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Counters, Renderer};
use nerf_fuzz::damage::{blob_of, body_of};
use nerf_fuzz::values::any_f32;
use nerf_testing::oracle::encoding::encode;
use nerf_testing::oracle::network::{f16, sigmoid, softplus};
use nerf_testing::scenes::{Recipe, kernels};
use std::sync::LazyLock;

static BASE: LazyLock<Vec<u8>> = LazyLock::new(|| Recipe { occupancy: None, ..Recipe::TINY }.blob());

/// Beyond this a partial sum may overflow in one order and not in another.
const MOST: f64 = 1e37;

fuzz_target!(|data: &[u8]| -> Corpus {
    if compare(&mut Unstructured::new(data)).is_ok() { Corpus::Keep } else { Corpus::Reject }
});

/// A network of any small shape, its weights from the bytes.
fn any_blob(u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
    let mut body = body_of(&BASE).expect("a body");
    let encoding = |u: &mut Unstructured<'_>| {
        let scale = if u.arbitrary()? { AngleScale::Pi } else { AngleScale::One };
        Ok(SinusoidalEncoding { inputs: 3, levels: u.int_in_range(0..=6)?, scale, identity: true })
    };
    let shape = &mut body.architecture;
    shape.position = encoding(u)?.into();
    shape.direction = if u.arbitrary()? { Some(encoding(u)?.into()) } else { None };
    let width = |u: &mut Unstructured<'_>| u.choose(&[1u16, 2, 3, 7, 8, 15, 16, 17, 31, 33]).copied();
    shape.trunk.clear();
    for i in 0..u.int_in_range(1..=4u8)? {
        let _ = shape.trunk.push(TrunkLayer { width: width(u)?, skip: i > 0 && u.ratio(1, 3)? });
    }
    shape.colour.clear();
    for _ in 0..u.int_in_range(0..=2u8)? {
        let _ = shape.colour.push(width(u)?);
    }
    shape.density =
        Some(if u.arbitrary()? { DensityActivation::Relu } else { DensityActivation::ShiftedSoftplus });
    // One exponent for each layer keeps most networks in range; the seed's bits fill the rest.
    let mut state = u.arbitrary::<u64>()? | 1;
    let mut weights = Vec::new();
    for layer in shape.layers() {
        let (exponent, spread) = (u.int_in_range(6..=18u16)?, u.ratio(1, 16)?);
        for _ in 0..(layer.inputs() + 1) * layer.outputs {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            let bits = (state >> 32) as u16;
            let exponent =
                if spread { (bits >> 10 & 31).min(30) } else { exponent.saturating_sub(bits >> 12 & 3) };
            weights.extend((bits & 0x83ff | exponent << 10).to_le_bytes());
        }
    }
    body.weights = &weights;
    Ok(blob_of(&body).expect("a blob"))
}

fn compare(u: &mut Unstructured<'_>) -> Result<()> {
    let bytes = any_blob(u)?;
    let blob = Blob::open(&bytes).expect("a sound shape");
    let bounds = blob.scene_box().expect("a scene");
    let (mut positions, mut dirs) = (Vec::new(), Vec::new());
    for _ in 0..*u.choose(&[1u8, 3, 16, 17, 64, 65, 70])? {
        let any = u.ratio(1, 8)?;
        let unit = |u: &mut Unstructured<'_>| Ok(f32::from(u.arbitrary::<i16>()?) / 32768.0);
        positions.push(if any {
            [any_f32(u)?, any_f32(u)?, any_f32(u)?]
        } else {
            [unit(u)?, unit(u)?, unit(u)?]
        });
        let dir = glam::Vec3::new(unit(u)?, unit(u)?, unit(u)?);
        dirs.push(dir.try_normalize().unwrap_or(glam::Vec3::X).to_array());
    }
    let evaluation = Evaluation::of(&blob);
    let inside = |i: &usize| bounds.contains(positions[*i].into());
    let live = (0..positions.len()).filter(inside).count() as u64;
    // A few of each block; the rest stand beside them, and their numbers are checked as such.
    let expected: Vec<_> = (0..positions.len())
        .filter(inside)
        .step_by(positions.len() / 8 + 1)
        .map(|i| (i, [false, true].map(|rounds| evaluation.at(positions[i], dirs[i], rounds))))
        .collect();
    for kernel in kernels() {
        let (sigma, rgb, work) = query(&blob, kernel, &positions, &dirs);
        let at = |what, i: usize| {
            format!("{what} of point {i}, {:?} along {:?}, {}", positions[i], dirs[i], kernel)
        };
        for i in 0..positions.len() {
            assert!(sigma[i] >= 0.0, "{}: {}", at("sigma", i), sigma[i]);
            assert!(rgb[i].iter().all(|c| (0.0..=1.0).contains(c)), "{}: {:?}", at("rgb", i), rgb[i]);
            assert!(inside(&i) || (sigma[i], rgb[i]) == (0.0, [0.0; 3]), "{}", at("outside", i));
        }
        for (i, by_rounding) in &expected {
            let (density, colour) = &by_rounding[usize::from(kernel.rounds())];
            density.check(sigma[*i], || at("sigma", *i));
            for (c, expected) in rgb[*i].iter().zip(colour) {
                expected.check(*c, || at("rgb", *i));
            }
        }
        assert_eq!((work.samples_kept, work.density_evaluations), (live, live), "{}: {work:?}", kernel);
    }
    Ok(())
}

type Answer = (Vec<f32>, Vec<[f32; 3]>, Counters);

fn query(blob: &Blob<'_>, kernel: Kernel, positions: &[[f32; 3]], dirs: &[[f32; 3]]) -> Answer {
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
    let quality = Quality { math: MathBackend::Polynomial, ..Quality::EXACT };
    let plan = Plan::new(blob, &quality, Outputs::RGB, Batch::FULL).expect("a plan");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let (mut sigma, mut rgb) = (vec![f32::NAN; positions.len()], vec![[f32::NAN; 3]; positions.len()]);
    let work =
        renderer.query(&plan, positions, dirs, &mut workspace, &mut sigma, &mut rgb).expect("an answer");
    (sigma, rgb, work)
}

/// A number, how far an evaluation in f32 may be off it, and the largest sum on the way; `None` where that
/// leaves f32.
#[derive(Clone, Copy, Debug)]
struct Bounded {
    value: f64,
    error: f64,
    size: Option<f64>,
}

impl Bounded {
    fn check(&self, found: f32, at: impl Fn() -> String) {
        if self.size.is_some_and(|size| size < MOST) {
            let off = (f64::from(found) - self.value).abs();
            assert!(off <= self.error, "{}: {found} is off {off:e} of {self:?}", at());
        }
    }
}

struct Evaluation<'b> {
    blob: &'b Blob<'b>,
    parameters: Vec<f64>,
}

impl<'b> Evaluation<'b> {
    fn of(blob: &'b Blob<'b>) -> Self {
        let parameters =
            blob.weights().as_chunks().0.iter().map(|&pair| f16(u16::from_le_bytes(pair))).collect();
        Self { blob, parameters }
    }

    /// Sigma and colour; `rounds` as the kernel does.
    fn at(&self, p: [f32; 3], dir: [f32; 3], rounds: bool) -> (Bounded, [Bounded; 3]) {
        let shape = self.blob.architecture();
        // The encoder's bound; the inputs themselves are exact.
        let encoded = |x: [f32; 3], e: &SinusoidalEncoding| -> Vec<Bounded> {
            let values = encode(&x.map(f64::from), e.levels, e.scale == AngleScale::Pi, e.identity);
            let exact = if e.identity { 3 } else { 0 };
            let bounded =
                |(i, value)| Bounded { value, error: if i < exact { 0.0 } else { 1.2e-7 }, size: Some(1.0) };
            values.into_iter().enumerate().map(bounded).collect()
        };
        let position = encoded(p, shape.position.sinusoidal().expect("as it was made"));
        let direction = shape
            .direction
            .as_ref()
            .map_or(Vec::new(), |e| encoded(dir, e.sinusoidal().expect("as it was made")));
        let layers = self.blob.layers();
        let mut layers = layers.iter();
        let mut dense = |main: &[Bounded], extra: &[Bounded], rectify: bool| -> Vec<Bounded> {
            let layer = layers.next().expect("a layer");
            let inputs: Vec<Bounded> = main.iter().chain(extra).copied().collect();
            assert_eq!(inputs.len(), layer.inputs());
            (0..layer.outputs)
                .map(|row| {
                    let weights = &self.parameters[layer.weights + row * inputs.len()..][..inputs.len()];
                    let sum = product(weights, &inputs, self.parameters[layer.bias + row], rounds);
                    if rectify { Bounded { value: sum.value.max(0.0), ..sum } } else { sum }
                })
                .collect()
        };
        let mut h = position.clone();
        for layer in &shape.trunk {
            h = dense(&h, if layer.skip { &position } else { &[] }, true);
        }
        let raw = dense(&h, &[], false)[0];
        // Neither activation is steeper than 1; softplus has a relative error of its own, and raw − 1 is rounded.
        let sigma = match shape.density {
            Some(DensityActivation::ShiftedSoftplus) => {
                let value = softplus(raw.value - 1.0);
                let error = raw.error * 1.001 + 2e-7 * (value + raw.value.abs() + 1.0);
                Bounded { value, error, ..raw }
            }
            _ => Bounded { value: raw.value.max(0.0), ..raw },
        };
        let mut extra = &direction[..];
        for _ in 0..shape.colour.len() {
            h = dense(&h, extra, true);
            extra = &[];
        }
        let raw = dense(&h, extra, false);
        let colour = |raw: &Bounded| Bounded {
            value: sigmoid(raw.value),
            error: 0.25 * raw.error * 1.001 + 3e-7,
            ..*raw
        };
        (sigma, [colour(&raw[0]), colour(&raw[1]), colour(&raw[2])])
    }
}

/// `Σ w x + b` with a bound.
fn product(weights: &[f64], inputs: &[Bounded], bias: f64, rounds: bool) -> Bounded {
    const U: f64 = 1.0 / (1u64 << 24) as f64;
    let n = weights.len() as f64 + 4.0;
    let gamma = 1.01 * n * U;
    let (mut value, mut passed, mut size) = (bias, 0.0, bias.abs());
    // What the kernel that rounds makes of a product: both operands to 8 bits, an accumulator that flushes.
    let rounded = if rounds { 2.01 / 256.0 } else { 0.0 };
    let mut fits = true;
    for (w, x) in weights.iter().zip(inputs) {
        let reach = x.value.abs() + x.error;
        value += w * x.value;
        passed += w.abs() * (x.error + rounded * reach);
        size += w.abs() * reach;
        fits &= x.size.is_some();
    }
    let size = size * (1.0 + rounded);
    let error = passed + gamma * size + 1e-30;
    Bounded { value, error, size: (fits && size < MOST).then_some(size) }
}
