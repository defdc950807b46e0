//! Errors of whole rays, from the sample points to the pixel, against the oracle's network and sums, also for networks
//! whose values overflow. Rays, sample points and widths of bins are the renderer's own; these have cases of their own.

mod faint;
mod hostile;

pub use faint::CASES as FAINT;
pub use hostile::CASES as HOSTILE;

use crate::blob::{SCENE, bytes, weights};
use crate::table::{BACKENDS, Row, Worst, cases, exact_kernels};
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::Camera;
use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::network::{Architecture, DensityActivation, Shading, TrunkLayer};
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Counters, Rect, Renderer};
use nerf_core::sampling::Bins;
use nerf_core::space::SceneBox;
use nerf_core::volume::{OPACITY_EPSILON, Pixel};
use nerf_testing::error::{excess, worse};
use nerf_testing::oracle;
use nerf_testing::oracle::network::f16;
use nerf_testing::scenes::{Recipe, camera, kernels};
use std::sync::OnceLock;

cases! {
    frames_of_4096_samples_a_ray: "error of opacity, closed form of a constant medium" => medium;
    colours_of_whole_rays: "absolute error of colour and opacity" => || whole(|scene, truth, found| scene.light(truth, found), 0);
    distances_of_whole_rays: "error of distance and z-depth, times opacity, over `far`" => || whole(|scene, truth, found| scene.distance(truth, found), 1);
    medians_of_whole_rays: "error of the optical thickness in front, which is ln 2" => || whole(|scene, truth, found| scene.median(truth, found), 2);
    frames_are_the_sums_of_what_a_query_says: "absolute error of colour and opacity" => sums;
}

/// Image width and height of the cases, pixels.
const SIZE: [u32; 2] = [13, 11];

/// Bounds of the errors of colours, distances and medians with each backend: four to nine times the observed errors.
/// The sum along a ray of the errors that the network's cases allow would be a hundred times larger, but errors of
/// either sign cancel.
const BOUNDS: [[f64; 3]; 4] =
    [[2e-6, 5e-7, 2e-5], [2e-6, 5e-7, 2e-5], [5e-3, 1e-3, 2e-2], [4e-5, 5e-6, 8e-5]];

/// A scene, its camera and its bins.
struct Scene {
    bytes: Vec<u8>,
    camera: Camera,
    bins: Bins,
    background: [f64; 3],
    far: f64,
}

/// Samples of one ray: sigma, rgb and t. `cosine`: cosine of the angle between ray and view axis.
struct Samples {
    sigma: Vec<f64>,
    rgb: Vec<[f64; 3]>,
    t: Vec<f64>,
    cosine: f64,
}

impl Scene {
    fn new() -> Self {
        let bytes = Recipe::SKIP.blob();
        let blob = Blob::open(&bytes).expect("a blob");
        let facts = blob.scene().expect("a scene");
        let bins = Bins::new(facts.near, facts.far, facts.samples().into()).expect("bins");
        let (background, far) = (facts.background.map(f64::from), f64::from(facts.far));
        Self { camera: camera(SIZE[0], SIZE[1]), bins, background, far, bytes }
    }

    fn pixels(&self) -> impl Iterator<Item = [u32; 2]> {
        (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| [x, y]))
    }

    /// Returns the sample points of a pixel's ray inside the box: distances t, positions, and the ray's direction. The
    /// points are the renderer's own, in f32, since the effect of rounding a point depends on the highest frequency of
    /// the scene.
    fn points(&self, [x, y]: [u32; 2]) -> (Vec<f32>, Vec<[f32; 3]>, [f32; 3]) {
        let blob = Blob::open(&self.bytes).expect("a blob");
        let bounds: SceneBox = blob.scene_box().expect("a box");
        let ray = self.camera.ray(x as f32 + 0.5, y as f32 + 0.5);
        let t = (0..self.bins.count()).map(|i| self.bins.at(i, 0.5));
        let t: Vec<f32> = t.filter(|&t| bounds.contains(ray.at(t))).collect();
        let points = t.iter().map(|&t| ray.at(t).to_array()).collect();
        (t, points, ray.dir.to_array())
    }

    /// Returns the cosine of the angle between a ray and the view axis, the pose's −z.
    fn cosine(&self, dir: [f32; 3]) -> f64 {
        let rows = self.camera.pose().to_rows();
        let (axis, dir) = ([0, 1, 2].map(|row| -f64::from(rows[row][2])), dir.map(f64::from));
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        dot(axis, dir) / (dot(axis, axis) * dot(dir, dir)).sqrt()
    }

    /// Returns the oracle's pixel of a ray's samples.
    fn composite(&self, samples: &Samples) -> oracle::volume::Pixel {
        let delta = vec![f64::from(self.bins.delta()); samples.t.len()];
        oracle::volume::composite(&samples.sigma, &samples.rgb, &samples.t, &delta, self.background)
    }

    /// Returns a scene, and the samples of all pixels from the oracle's f64 network.
    fn truth() -> &'static (Self, Vec<Samples>) {
        static TRUTH: OnceLock<(Scene, Vec<Samples>)> = OnceLock::new();
        TRUTH.get_or_init(|| {
            let scene = Self::new();
            let blob = Blob::open(&scene.bytes).expect("a blob");
            let weights: Vec<f64> =
                blob.weights().chunks_exact(2).map(|b| f16(u16::from_le_bytes([b[0], b[1]]))).collect();
            let network = oracle::network::Network::of_file(blob.architecture(), &weights);
            let rays = scene.pixels().map(|pixel| {
                let (t, points, dir) = scene.points(pixel);
                let points: Vec<[f64; 3]> = points.iter().map(|p| p.map(f64::from)).collect();
                Samples {
                    sigma: points.iter().map(|p| network.sigma(p)).collect(),
                    rgb: points.iter().map(|p| network.rgb(p, &dir.map(f64::from))).collect(),
                    t: t.into_iter().map(f64::from).collect(),
                    cosine: scene.cosine(dir),
                }
            });
            let rays: Vec<Samples> = rays.collect();
            let seen: Vec<f64> = rays.iter().map(|ray| scene.composite(ray).opacity).collect();
            let above = |least: f64| seen.iter().filter(|&&opacity| opacity > least).count();
            let (any, some, opaque) = (above(0.0), above(0.05), above(0.95));
            assert!(
                any < seen.len() && some > 50 && opaque > 10 && opaque < some,
                "of {} rays {any} meet anything, {some} something, {opaque} a wall",
                seen.len()
            );
            (scene, rays)
        })
    }

    /// Renders the scene with one kernel and backend.
    fn frame(&self, kernel: Kernel, math: MathBackend, outputs: Outputs) -> (Vec<Pixel>, Counters) {
        frame(&self.bytes, &self.camera, kernel, math, 0, outputs)
    }

    fn light(&self, samples: &Samples, found: &Pixel) -> f64 {
        super::volume::off(found, &self.composite(samples))
    }

    fn distance(&self, samples: &Samples, found: &Pixel) -> f64 {
        let truth = self.composite(samples);
        let [ray_distance, z_depth] = [found.ray_distance, found.z_depth].map(f64::from);
        let (none, least) = ((ray_distance, z_depth) == (self.far, self.far), f64::from(OPACITY_EPSILON));
        if truth.opacity < 0.5 * least {
            return if none { 0.0 } else { f64::INFINITY };
        }
        // Where rounding decides whether there is a surface, either answer is right.
        if truth.opacity < 2.0 * least && none {
            return 0.0;
        }
        let mean = truth.distance_sum / truth.opacity;
        let off = worse((ray_distance - mean).abs(), (z_depth - mean * samples.cosine).abs());
        off * truth.opacity / self.far
    }

    fn median(&self, samples: &Samples, found: &Pixel) -> f64 {
        let (median, half) = (f64::from(found.median_distance), f64::from(self.bins.delta()) / 2.0);
        // `min` and `max` would lose it.
        if median.is_nan() {
            return median;
        }
        // The optical thickness in front of where the renderer says: density is constant in a bin.
        let in_front = |t: f64| (t - (median.min(t + half)) + half).clamp(0.0, 2.0 * half);
        let thickness: f64 = samples
            .sigma
            .iter()
            .zip(&samples.t)
            .map(|(sigma, &t)| sigma * (2.0 * half - in_front(t)).max(0.0))
            .sum();
        let ln_2 = std::f64::consts::LN_2;
        // `far` is what a ray says that half of the light passes.
        if median == self.far { excess(thickness - ln_2) } else { (thickness - ln_2).abs() }
    }
}

/// Renders a scene file with the exact quality. `samples`: samples per ray, or 0 for the scene's own number.
fn frame(
    bytes: &[u8],
    camera: &Camera,
    kernel: Kernel,
    math: MathBackend,
    samples: u16,
    outputs: Outputs,
) -> (Vec<Pixel>, Counters) {
    let blob = Blob::open(bytes).expect("a blob");
    let quality = Quality { math, samples, ..Quality::EXACT };
    let plan = Plan::new(&blob, &quality, outputs, Batch::FULL).expect("a plan");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let width = camera.intrinsics().width;
    let mut pixels = vec![Pixel::BLANK; (width * camera.intrinsics().height) as usize];
    let mut put = |x: u32, y: u32, pixel: &Pixel| pixels[(y * width + x) as usize] = *pixel;
    let counters =
        renderer.render(&plan, camera, Rect::full(camera), &mut workspace, &mut put).expect("a frame");
    (pixels, counters)
}

/// Measures media of one density: opacity behind n samples is `1 − exp(−sigma delta n)`.
fn medium() -> Vec<Row> {
    const SAMPLES: u16 = 4096;
    let shape = Architecture {
        position: SinusoidalEncoding { inputs: 3, levels: 0, scale: AngleScale::Pi, identity: true }.into(),
        direction: None,
        trunk: [TrunkLayer { width: 1, skip: false }].into_iter().collect(),
        density: Some(DensityActivation::Relu),
        colour: [].into_iter().collect(),
        shading: Shading::PerSample,
    };
    let camera = camera(4, 3);
    let bins = Bins::new(SCENE.near, SCENE.far, SAMPLES.into()).expect("bins");
    let bounds = SceneBox { min: SCENE.min.into(), max: SCENE.max.into() };
    let row = |&(name, math): &(&'static str, MathBackend)| {
        let mut worst = Worst::default();
        // f16 of 2^-10, ½ and 8.
        for (bits, sigma) in [(0x1400, 2f64.powi(-10)), (0x3800, 0.5), (0x4800, 8.0)] {
            let all = weights(&shape, |layer, _, column| if (layer, column) == (1, None) { bits } else { 0 });
            let blob = bytes(&shape, &all);
            for kernel in kernels() {
                let (pixels, _) = frame(&blob, &camera, kernel, math, SAMPLES, OUTPUTS);
                for (i, pixel) in pixels.iter().enumerate() {
                    let ray = camera.ray((i % 4) as f32 + 0.5, (i / 4) as f32 + 0.5);
                    let inside = |bin: &u32| bounds.contains(ray.at(bins.at(*bin, 0.5)));
                    let n = (0..u32::from(SAMPLES)).filter(inside).count();
                    let truth = -(-sigma * f64::from(bins.delta()) * n as f64).exp_m1();
                    let error = (f64::from(pixel.opacity) - truth).abs();
                    worst.see(error, || format!("sigma {sigma}, {n} samples, {}", kernel));
                }
            }
        }
        worst.row(name, "any", super::volume::RAY)
    };
    BACKENDS.iter().map(row).collect()
}

/// All outputs except normals, which the gradient's cases test.
const OUTPUTS: Outputs = Outputs { median_distance: true, ..Outputs::ALL };

/// Measures the errors of one of the three outputs of [`BOUNDS`].
fn whole(measure: fn(&Scene, &Samples, &Pixel) -> f64, output: usize) -> Vec<Row> {
    let (scene, rays) = Scene::truth();
    let row = |(&(name, math), bounds): (&(&'static str, MathBackend), [f64; 3])| {
        let mut worst = Worst::default();
        for kernel in exact_kernels() {
            let (pixels, _) = scene.frame(kernel, math, OUTPUTS);
            for ((pixel, samples), at) in pixels.iter().zip(rays).zip(scene.pixels()) {
                worst.see(measure(scene, samples, pixel), || format!("pixel {at:?}, {}", kernel));
            }
        }
        worst.row(name, "exact", bounds[output])
    };
    BACKENDS.iter().zip(BOUNDS).map(row).collect()
}

/// Measures, with every kernel (the rounding one included), the difference between a frame and the oracle's sum of the
/// same network's results at the same points.
fn sums() -> Vec<Row> {
    let (scene, _) = Scene::truth();
    let row = |&(name, math): &(&'static str, MathBackend)| {
        let mut worst = Worst::default();
        for kernel in kernels() {
            let (pixels, _) = scene.frame(kernel, math, OUTPUTS);
            for (pixel, at) in pixels.iter().zip(scene.pixels()) {
                let (t, points, dir) = scene.points(at);
                let (sigma, rgb, _) =
                    super::network::ask(&scene.bytes, kernel, math, &points, &vec![dir; t.len()]);
                let samples = Samples {
                    sigma: sigma.into_iter().map(f64::from).collect(),
                    rgb: rgb.into_iter().map(|c| c.map(f64::from)).collect(),
                    t: t.into_iter().map(f64::from).collect(),
                    cosine: scene.cosine(dir),
                };
                worst.see(scene.light(&samples, pixel), || format!("pixel {at:?}, {}", kernel));
            }
        }
        worst.row(name, "any", super::volume::RAY)
    };
    BACKENDS.iter().map(row).collect()
}
