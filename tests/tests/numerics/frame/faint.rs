//! Rays of tiny opacity in scenes with deferred shading, where the network runs once per ray at the weighted mean of
//! the features: opacities down to subnormal numbers and 0.

use super::frame;
use crate::blob::{SCENE, body, weights};
use crate::table::{BACKENDS, Row, Worst, cases};
use nerf_core::blob::{Body, Content, SceneFacts, StoredTables, encoded_len, write};
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_core::encoding::{DirectionEncoding, GridEncoding, PositionEncoding};
use nerf_core::math::MathBackend;
use nerf_core::network::{Architecture, DensityActivation, Shading};
use nerf_core::plan::Outputs;
use nerf_core::render::Counters;
use nerf_core::volume::Pixel;
use nerf_testing::scenes::{f16_bits, kernels};

cases! {
    colours_of_faint_rays: "error of colour over opacity, opacities from 1e-7 up" => colours;
    rays_of_denormal_opacity: "pixels that are no numbers or too bright, and networks asked for nothing" => denormal;
}

/// Bound of the error of colours: four times the observed error.
const BOUND: f64 = 3e-7;

/// Makes a scene of density `exp(bias)` whose grid is 0.5 everywhere, with a black background.
fn blob(bias: f32) -> Vec<u8> {
    let grid = GridEncoding {
        inputs: 3,
        features: 2,
        log2_entries: 9,
        resolutions: [[4; 3], [8; 3]].into_iter().collect(),
    };
    let shape = Architecture {
        position: PositionEncoding::Grid(grid.clone()),
        direction: Some(DirectionEncoding::SphericalHarmonics { degree: 2 }),
        trunk: [].into_iter().collect(),
        density: Some(DensityActivation::Exponential),
        colour: [8].into_iter().collect(),
        shading: Shading::PerRay,
    };
    let all = weights(&shape, |layer, row, column| match (layer, column) {
        (0, None) => f16_bits(bias),
        (0, Some(_)) => 0,
        (_, column) => f16_bits(((7 * row + 3 * column.unwrap_or(11) + layer) % 13) as f32 / 13.0 - 0.4),
    });
    let tables: Vec<u8> = (0..grid.values()).flat_map(|_| f16_bits(0.5).to_le_bytes()).collect();
    let scene = SceneFacts { background: [0.0; 3], ..SCENE };
    let body = Body {
        content: Content::Scene(scene),
        tables: Some(StoredTables::F16(&tables)),
        ..body(shape, &all)
    };
    let mut bytes = vec![0; encoded_len(&body).expect("a valid body")];
    write(&body, &mut bytes).expect("a valid body");
    bytes
}

fn camera() -> Camera {
    let pose = Pose::from_rows([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0]]);
    Camera::new(Intrinsics::centred(8, 8, 12.0), Lens::NONE, pose).expect("a camera")
}

fn colours() -> Vec<Row> {
    let row = |&(name, math): &(&'static str, MathBackend)| {
        let mut worst = Worst::default();
        for kernel in kernels() {
            let draw = |bias| frame(&blob(bias), &camera(), kernel, math, 0, Outputs::ALL).0;
            let dense = draw(10.0);
            for bias in [-15.0, -12.0, -8.0, -4.0, 0.0] {
                for (pixel, dense) in draw(bias).iter().zip(&dense).filter(|(pixel, _)| pixel.opacity > 0.0) {
                    assert!(dense.opacity > 0.999 && pixel.opacity > 1e-7, "{pixel:?}, {dense:?}");
                    let error = |c: usize| {
                        (f64::from(pixel.rgb[c]) / f64::from(pixel.opacity) - f64::from(dense.rgb[c])).abs()
                    };
                    worst.see((0..3).map(error).fold(0.0, f64::max), || {
                        format!("{kernel}, opacity {:.0e}", pixel.opacity)
                    });
                }
            }
        }
        worst.row(name, "any", BOUND)
    };
    BACKENDS.iter().map(row).collect()
}

fn denormal() -> Vec<Row> {
    let row = |&(name, math): &(&'static str, MathBackend)| {
        let mut worst = Worst::default();
        for kernel in kernels() {
            for bias in [-60.0, -85.0, -88.0, -92.0, -98.0, -104.0, -200.0] {
                let (pixels, counters) = frame(&blob(bias), &camera(), kernel, math, 0, Outputs::ALL);
                let wrong = wrong(&pixels, &counters);
                worst.see(wrong as f64, || format!("{kernel}, exp({bias})"));
            }
        }
        worst.row(name, "any", 0.0)
    };
    BACKENDS.iter().map(row).collect()
}

fn wrong(pixels: &[Pixel], counters: &Counters) -> usize {
    let sound =
        |p: &&Pixel| p.rgb.iter().all(|c| (0.0..=p.opacity).contains(c)) && p.ray_distance == SCENE.far;
    let asked = pixels.iter().filter(|p| p.opacity > 0.0).count() as u64;
    let wrong = pixels.iter().filter(|p| !sound(p)).count();
    wrong + usize::from(counters.colour_evaluations != asked || counters.invalid_samples > 0)
}
