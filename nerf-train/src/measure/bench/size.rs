//! Cameras with fewer pixels, and enlargement of the frames that are rendered with them.

use crate::data::cameras;
use crate::measure::frame::Frame;
use anyhow::Context;
use nerf_core::camera::Camera;

/// Returns a camera of the same view with `quarters`/4 of the width and height, but at least one pixel along each side.
pub fn scaled(camera: &Camera, quarters: u32) -> anyhow::Result<Camera> {
    if quarters == 4 {
        return Ok(*camera);
    }
    let i = *camera.intrinsics();
    let side = |pixels: u32| ((u64::from(pixels) * u64::from(quarters) + 2) / 4).max(1) as u32;
    cameras::scaled(camera, (side(i.width), side(i.height))).context("camera")
}

/// Enlarges a frame to the size of `camera`'s picture: bilinear between pixel centres, clamped at the picture's border.
/// Median distances and normals are left out: interpolation across an object's outline is meaningless.
pub fn enlarged(frame: Frame, camera: &Camera) -> Frame {
    let i = camera.intrinsics();
    let (width, height) = (i.width as usize, i.height as usize);
    if (frame.width, frame.height) == (width, height) {
        return frame;
    }
    let columns = taps(frame.width, width);
    let rows = taps(frame.height, height);
    let plane = |values: &[f32]| spread(values, frame.width, &columns, &rows);
    let channel = |c: usize| plane(&frame.rgb.iter().map(|rgb| rgb[c]).collect::<Vec<f32>>());
    let [r, g, b] = [0, 1, 2].map(channel);
    Frame {
        width,
        height,
        rgb: r.iter().zip(&g).zip(&b).map(|((&r, &g), &b)| [r, g, b]).collect(),
        opacity: plane(&frame.opacity),
        ray_distance: plane(&frame.ray_distance),
        z_depth: plane(&frame.z_depth),
        median_distance: Vec::new(),
        normals: Vec::new(),
        counters: frame.counters,
    }
}

/// Returns the taps of linear interpolation from `small` to `large` pixels along a side. Each of the `large` pixels has
/// one tap: the indices of two neighbouring `small` pixels, and the weight of the second.
fn taps(small: usize, large: usize) -> Vec<(usize, usize, f32)> {
    let last = small.saturating_sub(1);
    let tap = |i: usize| {
        let at = ((i as f32 + 0.5) * small as f32 / large as f32 - 0.5).clamp(0.0, last as f32);
        let low = at as usize;
        (low, (low + 1).min(last), at - low as f32)
    };
    (0..large).map(tap).collect()
}

fn spread(
    values: &[f32],
    width: usize,
    columns: &[(usize, usize, f32)],
    rows: &[(usize, usize, f32)],
) -> Vec<f32> {
    let mix = |a: f32, b: f32, share: f32| a + (b - a) * share;
    let mut out = Vec::with_capacity(columns.len() * rows.len());
    for &(upper, lower, down) in rows {
        let row = |y: usize| &values[y * width..][..width];
        let (upper, lower) = (row(upper), row(lower));
        for &(left, right, across) in columns {
            let at = |row: &[f32]| mix(row[left], row[right], across);
            out.push(mix(at(upper), at(lower), down));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::demo;
    use nerf_core::render::Counters;

    fn camera(size: u32) -> Camera {
        demo::small(2, 1, size).val[0].camera
    }

    #[test]
    fn a_smaller_camera_sees_the_same_and_the_whole_one_is_untouched() {
        let whole = camera(20);
        assert_eq!(scaled(&whole, 4).expect("a camera"), whole);
        let half = scaled(&whole, 2).expect("a camera");
        assert_eq!((half.intrinsics().width, half.intrinsics().height), (10, 10));
        // The centre of a pixel at half size is the corner between four pixels at full size.
        for (x, y) in [(0.5, 0.5), (3.5, 7.5), (9.5, 9.5)] {
            let (a, b) = (half.ray(x, y), whole.ray(2.0 * x, 2.0 * y));
            assert!((a.dir - b.dir).length() < 1e-6 && a.origin == b.origin);
        }
        let tiny = scaled(&camera(16), 1).expect("a camera");
        assert_eq!(tiny.intrinsics().width, 4);
    }

    #[test]
    fn enlarging_keeps_what_is_linear() {
        let (small, large) = (10usize, camera(20));
        let at = |i: usize| (i % small) as f32 + 10.0 * (i / small) as f32;
        let plane: Vec<f32> = (0..small * small).map(at).collect();
        let frame = Frame {
            width: small,
            height: small,
            rgb: plane.iter().map(|&v| [v, 2.0 * v, 0.5]).collect(),
            opacity: plane.clone(),
            ray_distance: plane.clone(),
            z_depth: plane,
            median_distance: Vec::new(),
            normals: Vec::new(),
            counters: Counters::default(),
        };
        let big = enlarged(frame.clone(), &large);
        assert_eq!((big.width, big.height, big.rgb.len()), (20, 20, 400));
        for y in 1..19 {
            for x in 1..19 {
                let expected = (x as f32 - 0.5) / 2.0 + 10.0 * (y as f32 - 0.5) / 2.0;
                let found = big.opacity[y * 20 + x];
                assert!((found - expected).abs() < 1e-4, "{x} {y}: {found} {expected}");
                assert!((big.rgb[y * 20 + x][1] - 2.0 * expected).abs() < 1e-4);
            }
        }
        let same = enlarged(frame.clone(), &camera(10));
        assert_eq!(same.rgb, frame.rgb);
    }
}
