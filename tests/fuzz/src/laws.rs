//! What holds of every pixel, whatever the scene and the camera.

use nerf_core::plan::Outputs;
use nerf_core::volume::Pixel;

/// Checks one pixel of a frame without tone stage, whose rays run from `near` to `far`.
///
/// The mean of numbers in a range stays in it up to rounding: at most 4,096 compensated terms, each
/// within a few f32 roundings, for which 1e-5 is a wide margin.
pub fn check_pixel(pixel: &Pixel, outputs: Outputs, near: f32, far: f32) {
    let Pixel { rgb, opacity, ray_distance, z_depth, median_distance, normal } = *pixel;
    assert!((0.0..=1.0).contains(&opacity), "opacity: {pixel:?}");
    assert!(rgb.iter().all(|c| (-1e-5..=1.0 + 1e-5).contains(c)), "rgb: {pixel:?}");
    let slack = 1e-5 * far;
    let range = near - slack..=(far + slack).min(f32::MAX);
    assert!(range.contains(&ray_distance), "ray_distance, {near} to {far}: {pixel:?}");
    assert!(z_depth.is_finite(), "z_depth: {pixel:?}");
    if outputs.median_distance {
        assert!(range.contains(&median_distance), "median_distance, {near} to {far}: {pixel:?}");
    }
    // Unit length or nothing.
    let length = normal.iter().map(|x| x * x).sum::<f32>().sqrt();
    assert!(length == 0.0 || (outputs.normals && (length - 1.0).abs() < 1e-5), "normal: {pixel:?}");
}
