extern crate std;

use super::*;
use crate::camera::Ray;
use crate::space::{BoundsError, SceneBox};
use glam::Vec3;
use std::vec;

#[test]
fn overlapping_covers_every_bin_whose_middle_is_inside() {
    let mut worst_extra = 0;
    for (near, far) in
        [(2.0, 6.0), (0.0, 1.0), (0.1, 0.7), (0.0, 1e-30), (1e6, 1e6 + 8.0), (3.0, 3e6), (0.0, 3e38)]
    {
        for count in [1, 2, 3, 64, 100, 4096] {
            let bins = Bins::new(near, far, count).unwrap();
            let step = (bins.count() / 16).max(1);
            let middles: vec::Vec<f32> = (0..count).map(|i| bins.at(i, 0.5)).collect();
            let marks = (0..count).step_by(step as usize).flat_map(|i| {
                let (edge, middle) = (bins.at(i, 0.0), middles[i as usize]);
                [edge, edge.next_down(), middle, middle.next_up(), middle.next_down()]
            });
            let marks: vec::Vec<f32> = marks.chain([near, far]).collect();
            for &enter in &marks {
                for &exit in &marks {
                    if enter > exit {
                        continue;
                    }
                    let found = bins.overlapping(enter, exit);
                    assert!(found.end <= count && found.start <= found.end);
                    let inside = |t: &f32| (enter..=exit).contains(t);
                    let first = middles.iter().position(inside);
                    let last = middles.iter().rposition(inside);
                    if let (Some(first), Some(last)) = (first, last) {
                        let (first, last) = (first as u32, last as u32);
                        assert!(
                            found.start <= first && last < found.end,
                            "{near}..{far} / {count}: {enter}..{exit} gives {found:?}, needs {first}..={last}"
                        );
                        if near < 1e5 {
                            worst_extra = worst_extra.max(first - found.start).max(found.end - 1 - last);
                        }
                    }
                }
            }
        }
    }
    std::println!("bins beyond the interval: at most {worst_extra}");
    assert!(worst_extra <= 2);
}

#[test]
fn overlapping_survives_what_is_no_interval() {
    let bins = Bins::new(2.0, 6.0, 64).unwrap();
    for enter in [f32::NAN, f32::NEG_INFINITY, f32::INFINITY, -1e30, 1e30] {
        for exit in [f32::NAN, f32::NEG_INFINITY, f32::INFINITY, -1e30, 1e30] {
            let found = bins.overlapping(enter, exit);
            assert!(found.start <= 64 && found.end <= 64);
        }
    }
    assert_eq!(bins.overlapping(f32::NEG_INFINITY, f32::INFINITY), 0..64);
}

#[test]
fn bins_tile_near_to_far() {
    let bins = Bins::new(2.0, 6.0, 64).unwrap();
    assert_eq!((bins.count(), bins.delta()), (64, 0.0625));
    assert_eq!((bins.at(0, 0.0), bins.at(0, 0.5), bins.at(63, 1.0)), (2.0, 2.03125, 6.0));
    for i in 0..63 {
        assert_eq!(bins.at(i, 1.0), bins.at(i + 1, 0.0));
    }
}

#[test]
fn ranges_without_bins_are_refused() {
    for (near, far, count) in [
        (2.0, 6.0, 0),
        (2.0, 2.0, 4),
        (6.0, 2.0, 4),
        (-1.0, 2.0, 4),
        (f32::NAN, 2.0, 4),
        (0.0, f32::NAN, 4),
        (0.0, f32::INFINITY, 4),
        (0.0, 1e-45, 4096),
    ] {
        let found = Bins::new(near, far, count);
        assert!(matches!(found, Err(BoundsError::Range { .. })), "{near} {far} {count}: {found:?}");
    }
}

#[test]
fn uniform_is_spread_evenly() {
    const DRAWS: u64 = 1 << 20;
    let mut bins = [0u32; 256];
    let (mut sum, mut squares) = (0.0f64, 0.0f64);
    for i in 0..DRAWS {
        let u = uniform(7, Purpose::Jitter, i % 1000, i / 1000);
        assert!((0.0..1.0).contains(&u));
        bins[(u * 256.0) as usize] += 1;
        sum += f64::from(u);
        squares += f64::from(u) * f64::from(u);
    }
    let n = DRAWS as f64;
    let expected = n / 256.0;
    let chi2: f64 = bins.iter().map(|&b| (f64::from(b) - expected).powi(2) / expected).sum();
    std::println!("mean {}, second moment {}, chi² {chi2} of 255", sum / n, squares / n);
    // Limits of five standard deviations.
    assert!((sum / n - 0.5).abs() < 5.0 * (1.0 / 12.0 / n).sqrt());
    assert!((squares / n - 1.0 / 3.0).abs() < 5.0 * (4.0 / 45.0 / n).sqrt());
    assert!((chi2 - 255.0).abs() < 5.0 * (2.0 * 255.0f64).sqrt());
}

#[test]
fn streams_indices_seeds_and_purposes_are_independent() {
    const N: u64 = 1 << 16;
    let base = |i: u64| f64::from(uniform(1, Purpose::Pixel, 5, i)) - 0.5;
    let others: [(&str, &dyn Fn(u64) -> f32); 6] = [
        ("next stream", &|i| uniform(1, Purpose::Pixel, 6, i)),
        ("stream 16 on", &|i| uniform(1, Purpose::Pixel, 21, i)),
        ("next seed", &|i| uniform(2, Purpose::Pixel, 5, i)),
        ("next purpose", &|i| uniform(1, Purpose::Jitter, 5, i)),
        ("next index", &|i| uniform(1, Purpose::Pixel, 5, i + 1)),
        ("streams as indices", &|i| uniform(1, Purpose::Pixel, i, 5)),
    ];
    for (name, other) in others {
        let correlation: f64 =
            (0..N).map(|i| base(i) * (f64::from(other(i)) - 0.5)).sum::<f64>() * 12.0 / N as f64;
        std::println!("{name}: {correlation}");
        assert!(correlation.abs() < 5.0 / (N as f64).sqrt(), "{name}: {correlation}");
    }
}

#[test]
fn a_number_is_a_function_of_its_counters() {
    assert_eq!(uniform_u32(1, Purpose::Image, 2, 3), uniform_u32(1, Purpose::Image, 2, 3));
    assert_eq!(
        uniform(1, Purpose::Image, 2, 3),
        (uniform_u32(1, Purpose::Image, 2, 3) >> 8) as f32 / 16_777_216.0
    );
    // The largest value of a counter and 0 give different numbers.
    assert_ne!(uniform_u32(0, Purpose::Cell, u64::MAX, 0), uniform_u32(0, Purpose::Cell, 0, 0));
    assert_ne!(uniform_u32(u64::MAX, Purpose::Cell, 0, u64::MAX), uniform_u32(0, Purpose::Cell, 0, 0));
}

/// Reference in f64: the cell of `p`, and the distance from `p` to the nearest cell face, counted in cells. `None`
/// outside the closed box.
fn cell_of(bounds: &SceneBox, resolution: [u16; 3], p: Vec3) -> Option<([usize; 3], f64)> {
    let mut cell = [0; 3];
    let mut to_face = f64::INFINITY;
    for axis in 0..3 {
        let (low, high) = (f64::from(bounds.min[axis]), f64::from(bounds.max[axis]));
        let n = f64::from(resolution[axis]);
        let at = (f64::from(p[axis]) - low) / (high - low) * n;
        if !(0.0..=n).contains(&at) {
            return None;
        }
        cell[axis] = (at as usize).min(usize::from(resolution[axis]) - 1);
        to_face = to_face.min((at - at.round()).abs());
    }
    Some((cell, to_face))
}

#[test]
fn occupied_is_the_bit_of_the_cell_of_the_point() {
    let mut tested = 0;
    for (min, max) in [
        (Vec3::splat(-1.5), Vec3::splat(1.5)),
        (Vec3::new(-1e6, 1.0, 1e6 - 3.0), Vec3::new(1e6, 2.0, 1e6)),
        (Vec3::new(0.1, -0.7, 1e-3), Vec3::new(0.3, 1e3, 2e-3)),
    ] {
        let bounds = SceneBox::new(min, max).unwrap();
        for resolution in [[1, 1, 1], [3, 5, 7], [10, 96, 49]] {
            let [nx, ny, nz] = resolution.map(usize::from);
            let cells = nx * ny * nz;
            let bits: vec::Vec<u8> =
                (0..cells.div_ceil(8) as u64).map(|i| uniform_u32(3, Purpose::Cell, 0, i) as u8).collect();
            let occupancy = OccupancyGrid::new(bounds, resolution, &bits);
            for i in 0..4000u64 {
                let u = |axis| uniform(9, Purpose::Cell, i, axis) * 1.2 - 0.1;
                let p = min + (max - min) * Vec3::new(u(0), u(1), u(2));
                match cell_of(&bounds, resolution, p) {
                    None => assert!(!occupancy.occupied(p), "{p}"),
                    // Next to a face, rounding may put the point into either cell.
                    Some((_, to_face)) if to_face < 1e-4 => {}
                    Some(([x, y, z], _)) => {
                        tested += 1;
                        let index = (x * ny + y) * nz + z;
                        assert_eq!(occupancy.occupied(p), bits[index / 8] >> (index % 8) & 1 == 1, "{p}");
                    }
                }
            }
        }
    }
    std::println!("{tested} points");
    assert!(tested > 10_000);
}

#[test]
fn a_full_occupancy_grid_is_the_closed_box() {
    for i in 0..3000u64 {
        let u = |k| uniform(4, Purpose::Cell, i, k);
        let scale = 10f32.powi((u(0) * 12.0) as i32 - 6);
        let min = Vec3::new(u(1) - 0.5, u(2) - 0.5, u(3) - 0.5) * scale;
        let max = min + Vec3::new(u(4) + 1e-3, u(5) + 1e-3, u(6) + 1e-3) * scale;
        let bounds = SceneBox::new(min, max).unwrap();
        let side = 1 + (u(7) * 200.0) as u16;
        let resolution = [side, 1 + side / 3, 2];
        let full = vec![0xff; (usize::from(side) * usize::from(1 + side / 3) * 2).div_ceil(8)];
        let occupancy = OccupancyGrid::new(bounds, resolution, &full);
        let middle = 0.5 * (min + max);
        for axis in 0..3 {
            for face in [min[axis], max[axis]] {
                for at in [face, face.next_up(), face.next_down()] {
                    let mut p = middle;
                    p[axis] = at;
                    assert_eq!(occupancy.occupied(p), bounds.contains(p), "{bounds:?} {resolution:?} {p}");
                }
            }
        }
        for corner in [min, max, Vec3::new(min.x, max.y, max.z), Vec3::new(max.x, min.y, max.z)] {
            assert!(occupancy.occupied(corner), "{bounds:?} {resolution:?} {corner}");
        }
    }
}

#[test]
fn occupancies_without_cells_or_bits_are_empty() {
    let bounds = SceneBox { min: Vec3::NEG_ONE, max: Vec3::ONE };
    for resolution in [[0, 1, 1], [1, 0, 1], [1, 1, 0], [0, 0, 0]] {
        let occupancy = OccupancyGrid::new(bounds, resolution, &[0xff]);
        assert!(!occupancy.occupied(Vec3::ZERO) && !occupancy.occupied(Vec3::NEG_ONE), "{resolution:?}");
        assert_eq!(occupancy.occupied_share(), 0.0);
    }
    let short = OccupancyGrid::new(bounds, [2, 2, 4], &[0xff]);
    assert!(short.occupied(Vec3::NEG_ONE) && !short.occupied(Vec3::ONE));
    assert_eq!(short.occupied_share(), 0.5);
    for p in [Vec3::NAN, Vec3::splat(f32::INFINITY), Vec3::splat(-1e30)] {
        assert!(!short.occupied(p));
    }
    let flat = SceneBox { min: Vec3::ONE, max: Vec3::ONE };
    let _ = OccupancyGrid::new(flat, [2, 2, 2], &[0xff]).occupied(Vec3::ONE);
}

#[test]
fn a_march_through_a_corner_meets_both_diagonal_cells() {
    let bounds = SceneBox { min: Vec3::splat(-1e6), max: Vec3::splat(1e6) };
    // Only the cells (0, 0, 0) and (1, 1, 1) of 2 × 2 × 2 are occupied.
    let occupancy = OccupancyGrid::new(bounds, [2, 2, 2], &[0b1000_0001]);
    assert!(
        occupancy.occupied(Vec3::splat(-1.0))
            && occupancy.occupied(Vec3::ZERO)
            && occupancy.occupied(Vec3::ONE)
    );
    assert!(!occupancy.occupied(Vec3::new(-1.0, 0.0, 0.0)) && !occupancy.occupied(Vec3::new(1.0, 1.0, -1.0)));
    assert_eq!(occupancy.occupied_share(), 0.25);
}

/// Test rays. A third have random directions, a third are nearly perpendicular to an axis, a third are along an axis.
/// Every second ray begins at a corner of cells.
fn marched_rays(bounds: &SceneBox, resolution: [u16; 3]) -> vec::Vec<Ray> {
    let noise = crate::testing::noise(6 * 400, 77);
    let size = (bounds.max - bounds.min) / Vec3::from(resolution.map(f32::from));
    let mut rays = vec![];
    for (i, n) in noise.chunks(6).enumerate() {
        let centre = 0.5 * (bounds.min + bounds.max);
        let mut origin = centre + Vec3::new(n[0], n[1], n[2]) * (bounds.max - bounds.min);
        let mut dir = Vec3::new(n[3], n[4], n[5]);
        if i % 3 == 1 {
            dir[i / 3 % 3] = [0.0, -0.0, 1e-30, 1e-8][i / 9 % 4];
        }
        if i % 3 == 2 {
            dir = Vec3::ZERO;
            dir[i / 3 % 3] = if i / 9 % 2 == 0 { 1.0 } else { -1.0 };
        }
        if i % 2 == 0 {
            origin = bounds.min + ((origin - bounds.min) / size).round() * size;
        }
        rays.push(Ray { origin, dir: dir.normalize() });
    }
    rays
}

#[test]
fn a_march_meets_the_bins_that_asking_at_each_meets() {
    let boxes = [
        SceneBox { min: Vec3::splat(-1.5), max: Vec3::splat(1.5) },
        SceneBox { min: Vec3::new(-0.3, 7.0, -1e3), max: Vec3::new(0.4, 8.1, 1e3) },
        SceneBox { min: Vec3::splat(1e6), max: Vec3::splat(1e6 + 4.0) },
    ];
    let (mut live, mut asked) = (0u32, 0u32);
    for (k, bounds) in boxes.iter().enumerate() {
        for resolution in [[1, 1, 1], [5, 3, 8], [32, 32, 32]] {
            let cells: usize = resolution.iter().map(|&side| usize::from(side)).product();
            for every in [1, 3, 29, usize::MAX] {
                let mut bits = vec![0u8; cells.div_ceil(8)];
                (0..cells).filter(|cell| cell % every == every / 2).for_each(|c| bits[c / 8] |= 1 << (c % 8));
                let occupancy = OccupancyGrid::new(*bounds, resolution, &bits);
                let around = occupancy.occupied_box();
                let far = 3.0 * (bounds.max - bounds.min).max_element();
                for count in [7, 64, 1000] {
                    let bins = Bins::new(0.0, far, count).unwrap();
                    let middle = |bin| bins.at(bin, 0.5);
                    for ray in marched_rays(bounds, resolution).iter().skip(k).step_by(7) {
                        let mut next = 0;
                        for bin in 0..count {
                            let p = ray.at(bins.at(bin, 0.5));
                            asked += 1;
                            if occupancy.occupied(p) {
                                live += 1;
                                assert!(around.is_some_and(|around| around.contains(p)), "{p} of {around:?}");
                                next = occupancy.first_occupied(ray, &bins, next, count, middle);
                                assert_eq!(next, bin, "{bounds:?} {resolution:?} {ray:?}");
                                next += 1;
                            }
                        }
                        assert_eq!(
                            occupancy.first_occupied(ray, &bins, next, count, middle),
                            count,
                            "{ray:?}"
                        );
                    }
                }
            }
        }
    }
    assert!(live > 10_000 && live < asked / 4, "{live} of {asked}");
}
