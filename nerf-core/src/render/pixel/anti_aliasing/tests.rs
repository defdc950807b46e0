//! Tests of anti-aliasing by several rays per pixel.

extern crate std;

use super::*;
use crate::memory::{Arena, Line, Measure};
use crate::volume::Pixel;
use std::vec;
use std::vec::Vec;

#[test]
fn one_ray_is_the_centre_s_and_several_spread_evenly_around_it() {
    for n in [1u16, 2, 3, 4, 6, 16, 37, 64, 256] {
        let effects = Effects { anti_aliasing: n, ..Effects::NONE };
        let points: Vec<(f32, f32)> = (0..n.into()).map(|ray| offset(&effects, ray)).collect();
        assert!(n > 1 || points == [(0.5, 0.5)]);
        // Each of the `n` rows and each of the `n` columns of the pixel has one point.
        for (right, axis) in [|p: &(f32, f32)| p.0, |p: &(f32, f32)| p.1].into_iter().enumerate() {
            let mut cells: Vec<u16> = points.iter().map(|p| (axis(p) * f32::from(n)) as u16).collect();
            cells.sort_unstable();
            assert!(cells.into_iter().eq(0..n), "{n} rays, axis {right}");
        }
        // Discrepancy: the fraction of points in a rectangle at the corner differs from its area by at most (ln n + 1)
        // / n. For random points, the difference is about 1/√n.
        let mut worst = 0.0f32;
        for (a, b) in (1..=8).flat_map(|a| (1..=8).map(move |b| (a as f32 / 8.0, b as f32 / 8.0))) {
            let inside = points.iter().filter(|(x, y)| *x < a && *y < b).count();
            worst = worst.max((inside as f32 / f32::from(n) - a * b).abs());
        }
        std::println!("{n} rays: discrepancy {worst}");
        assert!(worst <= (f32::from(n).ln() + 1.0) / f32::from(n), "{n}: {worst}");
    }
}

fn lines(effects: &Effects, surface: bool, pixels: usize) -> usize {
    let mut measure = Measure::default();
    Sums::lay_out(&mut measure, effects, surface, pixels);
    measure.lines
}

#[test]
fn a_mean_weights_distances_by_opacity_and_leaves_out_what_has_no_surface() {
    let effects = Effects { anti_aliasing: 4, ..Effects::NONE };
    let mut memory = vec![Line::UNINIT; lines(&effects, false, 2)];
    let mut sums = Sums::lay_out(&mut Arena::new(&mut memory), &effects, false, 2);
    let pixel = |grey, opacity, ray_distance| Pixel {
        rgb: [grey; 3],
        opacity,
        ray_distance,
        z_depth: 0.5 * ray_distance,
        ..Pixel::BLANK
    };
    // The sums serve two tiles in turn: results of the first must not change the second.
    for _ in 0..2 {
        let rays = [pixel(1.0, 1.0, 2.0), pixel(0.5, 0.25, 4.0), pixel(0.0, 0.0, 9.0), pixel(0.5, 5e-5, 9.0)];
        for (ray, mut mean) in rays.into_iter().enumerate() {
            let empty = pixel(0.25, 5e-5, 9.0);
            let mut none = empty;
            let last = sums.add(&effects, 0, ray as u32, &mut none, 9.0);
            assert_eq!(last, sums.add(&effects, 1, ray as u32, &mut mean, 9.0));
            assert_eq!(last, ray == 3);
            if last {
                assert_eq!(none, Pixel { ray_distance: 9.0, z_depth: 9.0, ..empty });
                assert_eq!(mean.rgb, [0.5; 3]);
                assert!((mean.opacity - 1.250_05 / 4.0).abs() < 1e-7);
                assert!((mean.ray_distance - 3.0 / 1.25).abs() < 1e-6);
                assert!((mean.z_depth - 1.5 / 1.25).abs() < 1e-6);
            }
        }
    }
    assert_eq!(lines(&Effects::NONE, true, 1 << 20), 0, "no memory for one ray a pixel");
}

#[test]
fn a_median_needs_half_of_the_rays_and_normals_turn_with_opacity() {
    let effects = Effects { anti_aliasing: 4, ..Effects::NONE };
    let mut memory = vec![Line::UNINIT; lines(&effects, true, 1)];
    let mut sums = Sums::lay_out(&mut Arena::new(&mut memory), &effects, true, 1);
    let pixel = |opacity, median_distance, normal| Pixel { opacity, median_distance, normal, ..Pixel::BLANK };
    let mut mean = |rays: [Pixel; 4]| {
        let add = |(ray, mut pixel)| sums.add(&effects, 0, ray as u32, &mut pixel, 9.0).then_some(pixel);
        rays.into_iter().enumerate().filter_map(add).next().unwrap()
    };
    let (x, y) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let edge = mean([pixel(1.0, 3.0, x), pixel(0.75, 4.0, y), pixel(0.0, 9.0, [0.0; 3]), pixel(0.0, 9.0, y)]);
    assert_eq!(edge.median_distance, 3.5, "half of the rays have one");
    assert!((edge.normal[0] - 0.8).abs() < 1e-6 && (edge.normal[1] - 0.6).abs() < 1e-6, "{edge:?}");
    let thin = mean([pixel(1.0, 3.0, x), pixel(0.25, 9.0, x), pixel(0.0, 9.0, x), pixel(0.0, 9.0, x)]);
    assert_eq!((thin.median_distance, thin.normal), (9.0, x), "one of four");
    let across = mean([pixel(0.5, 0.0, x), pixel(0.5, 0.0, [-1.0, 0.0, 0.0]), Pixel::BLANK, Pixel::BLANK]);
    assert_eq!((across.median_distance, across.normal), (0.0, [0.0; 3]), "not asked for; cancelled");
}
