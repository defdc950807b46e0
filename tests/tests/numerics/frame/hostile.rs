//! Networks with finite f16 weights whose values overflow f32: a scene file may contain these networks, but no pixel
//! may show the overflow.

use super::frame;
use crate::blob::{SCENE, bytes, weights};
use crate::network::ask;
use crate::table::{BACKENDS, Row, Worst, cases};
use nerf_core::Kernel;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
use nerf_core::math::MathBackend;
use nerf_core::network::{Architecture, DensityActivation, Shading, TrunkLayer};
use nerf_core::plan::Outputs;
use nerf_core::render::Counters;
use nerf_core::volume::Pixel;
use nerf_testing::scenes::kernels;

cases! {
    infinite_densities_are_walls: "frames that are not the wall's, or that count it as no number" => || frames(0, wall);
    densities_that_are_no_numbers_are_empty_and_counted: "frames that are not background, or do not count each sample" => || frames(1, void);
    colours_that_are_no_numbers_are_black_and_counted: "frames that are not black walls, or do not count their colours" => || frames(2, black);
    queries_of_values_beyond_f32: "answers that are no numbers, or not counted as such" => queries;
}

/// Number of layers of 64 units that make values grow beyond f32: each multiplies by 64 · 65,504.
const LAYERS: usize = 8;

/// The largest f16, 65,504.
const MOST: u16 = 0x7bff;
const ONE: u16 = 0x3c00;

/// Makes a scene whose units are all equal and finally infinite. `kind` 0: density +inf. 1: density inf − inf. 2:
/// infinite density and colour inf · 0.
fn blob(kind: usize) -> Vec<u8> {
    let shape = Architecture {
        position: SinusoidalEncoding { inputs: 3, levels: 2, scale: AngleScale::Pi, identity: true }.into(),
        direction: None,
        trunk: (0..LAYERS).map(|_| TrunkLayer { width: 64, skip: false }).collect(),
        density: Some(DensityActivation::Relu),
        colour: [].into_iter().collect(),
        shading: Shading::PerSample,
    };
    let all = weights(&shape, |layer, _, column| match (layer, column) {
        // The first layer is 1 everywhere.
        (0, None) => ONE,
        (0, _) => 0,
        (LAYERS, Some(column)) if kind == 1 && column % 2 == 1 => MOST | 0x8000,
        (_, Some(_)) if layer <= LAYERS => MOST,
        (_, Some(_)) if kind == 2 => 0,
        (_, Some(_)) => ONE,
        _ => 0,
    });
    bytes(&shape, &all)
}

/// Returns a camera in front of the box; its distance at the corners is greater than `far`.
fn camera() -> Camera {
    let pose = Pose::from_rows([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0]]);
    Camera::new(Intrinsics::centred(8, 8, 8.0), Lens::NONE, pose).expect("a camera")
}

/// All outputs of a pixel.
const OUTPUTS: Outputs = Outputs { median_distance: true, normals: true, ..Outputs::ALL };

fn frames(kind: usize, wrong: fn(&[Pixel], &Counters) -> Option<String>) -> Vec<Row> {
    let bytes = blob(kind);
    let row = |&(name, math): &(&'static str, MathBackend)| {
        let mut worst = Worst::default();
        for kernel in kernels() {
            let (pixels, counters) = frame(&bytes, &camera(), kernel, math, 0, OUTPUTS);
            let wrong = wrong(&pixels, &counters).or_else(|| numbers(&pixels));
            let error = f64::from(u8::from(wrong.is_some()));
            worst.see(error, || format!("{}: {}", kernel, wrong.unwrap_or_default()));
        }
        worst.row(name, "any", 0.0)
    };
    BACKENDS.iter().map(row).collect()
}

/// Returns a description of the first pixel with a value that is not finite or is outside its range.
fn numbers(pixels: &[Pixel]) -> Option<String> {
    let sound = |p: &&Pixel| {
        let all = p.rgb.iter().chain(&p.normal).chain([&p.ray_distance, &p.z_depth, &p.median_distance]);
        let finite = all.clone().all(|x| x.is_finite()) && p.rgb.iter().all(|c| (0.0..=1.0).contains(c));
        finite && (0.0..=1.0).contains(&p.opacity)
    };
    pixels.iter().find(|pixel| !sound(pixel)).map(|pixel| format!("{pixel:?}"))
}

fn wall(pixels: &[Pixel], counters: &Counters) -> Option<String> {
    let hit = |p: &&Pixel| p.opacity == 1.0 && p.rgb == [1.0; 3] && p.ray_distance < SCENE.far;
    let hits = pixels.iter().filter(hit).count();
    let empty = pixels.iter().filter(|p| p.opacity == 0.0 && p.rgb == SCENE.background).count();
    // Only their gradients are no numbers.
    let good =
        hits > 20 && hits + empty == pixels.len() && counters.invalid_samples == counters.normal_evaluations;
    (!good).then(|| format!("{hits} hits, {empty} empty, {counters:?}"))
}

fn void(pixels: &[Pixel], counters: &Counters) -> Option<String> {
    let empty = |p: &&Pixel| {
        let far = [p.ray_distance, p.z_depth, p.median_distance] == [SCENE.far; 3];
        p.opacity == 0.0 && p.rgb == SCENE.background && far && p.normal == [0.0; 3]
    };
    let all = pixels.iter().filter(empty).count() == pixels.len();
    let counted = counters.samples_kept > 0 && counters.invalid_samples == counters.samples_kept;
    (!all || !counted).then(|| format!("{counters:?}, {:?}", pixels.iter().find(|p| !empty(p))))
}

fn black(pixels: &[Pixel], counters: &Counters) -> Option<String> {
    let sound =
        |p: &&Pixel| p.opacity == 1.0 && p.rgb == [0.0; 3] || p.opacity == 0.0 && p.rgb == SCENE.background;
    let all = pixels.iter().filter(sound).count() == pixels.len();
    let counted = counters.invalid_samples == counters.colour_evaluations + counters.normal_evaluations;
    (!all || !counted || counters.colour_evaluations == 0)
        .then(|| format!("{counters:?}, {:?}", pixels.iter().find(|p| !sound(p))))
}

fn queries() -> Vec<Row> {
    let expected = |kind: usize, sigma: f32, rgb: [f32; 3]| match kind {
        0 => sigma == f32::INFINITY && rgb == [1.0; 3],
        1 => sigma == 0.0 && rgb == [0.0; 3],
        _ => sigma == f32::INFINITY && rgb == [0.0; 3],
    };
    let row = |&(name, math): &(&'static str, MathBackend)| {
        let mut worst = Worst::default();
        for (kind, kernel) in (0..3).flat_map(|kind| kernels().map(move |kernel: Kernel| (kind, kernel))) {
            let points: Vec<[f32; 3]> = (0..70).map(|i| [i as f32 / 80.0, 0.0, 0.5]).collect();
            let (sigma, rgb, counters) = ask(&blob(kind), kernel, math, &points, &[[0.0, 0.0, -1.0]; 70]);
            let bad = sigma.iter().zip(&rgb).filter(|(s, c)| !expected(kind, **s, **c)).count() as f64;
            // Of each point the density, or the colour.
            let counted = counters.invalid_samples == if kind == 0 { 0 } else { 70 };
            worst.see(bad + f64::from(u8::from(!counted)), || {
                format!("kind {kind}, {}: {}, {:?}, {counters:?}", kernel, sigma[0], rgb[0])
            });
        }
        worst.row(name, "any", 0.0)
    };
    BACKENDS.iter().map(row).collect()
}
