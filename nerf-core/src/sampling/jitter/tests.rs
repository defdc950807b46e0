//! Tests of the samples' positions inside their bins.

extern crate std;

use super::*;
use crate::camera::Ray;
use crate::sampling::OccupancyGrid;
use crate::space::SceneBox;
use crate::testing::noise;
use glam::Vec3;
use std::vec::Vec;

fn place(seed: u64, x: u32, y: u32, ray: u32) -> SampleJitter {
    SampleJitter::of(Some(seed), x, y, ray)
}

#[test]
fn samples_lie_in_their_bins_in_order_and_evenly() {
    for count in [1, 3, 64, 4096] {
        let bins = Bins::new(2.0, 6.0, count).unwrap();
        let (mut sum, mut n) = (0.0, 0);
        for pixel in 0..40 {
            let place = place(1, pixel, 2 * pixel, pixel % 3);
            let t: Vec<f32> = (0..count).map(|bin| place.t(&bins, bin)).collect();
            assert!(t.is_sorted());
            for (bin, &t) in t.iter().enumerate() {
                let bin_of_it = bin as u32;
                assert!((bins.at(bin_of_it, 0.0)..bins.at(bin_of_it + 1, 0.0)).contains(&t));
                assert_eq!(bins.middle_around(t), bins.at(bin_of_it, 0.5));
                sum += f64::from((t - 2.0) / bins.delta()) - bin as f64;
                n += 1;
            }
        }
        // Limit: five standard deviations of the mean of n uniform numbers, plus the rounding of t.
        let off = (sum / f64::from(n) - 0.5).abs();
        assert!(off < 5.0 / (12.0 * f64::from(n)).sqrt() + 1e-3, "{count} bins: {off}");
    }
}

#[test]
fn a_fraction_of_nearly_one_stays_in_its_bin() {
    // From about bin 64 on, bin + u may round to bin + 1, an edge that belongs to the next bin.
    for (near, far, count) in
        [(2.0, 6.0, 4096), (2.0, 6.1, 4096), (0.0, 217.78308, 473), (6.5900173, 109.108185, 399)]
    {
        let bins = Bins::new(near, far, count).unwrap();
        for bin in 0..count {
            for u in [0.0, 0.5, 1.0f32.next_down()] {
                let t = bins.within(bin, u);
                assert!((bins.at(bin, 0.0)..bins.at(bin + 1, 0.0)).contains(&t), "{u} of {bin}: {t}");
                assert_eq!(bins.middle_around(t), bins.at(bin, 0.5), "{u} of {bin}");
            }
        }
    }
}

#[test]
fn every_pixel_ray_bin_and_seed_has_a_number_of_its_own() {
    // A bin has width 1: the position in the bin is the fractional part of t.
    let bins = Bins::new(0.0, 64.0, 64).unwrap();
    let mut seen: Vec<u32> = Vec::new();
    for seed in [0, 1, u64::MAX] {
        for (x, y, ray) in [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1 << 20, 3, 255)] {
            let place = place(seed, x, y, ray);
            seen.extend((0..64).map(|bin| (place.t(&bins, bin) - bin as f32).to_bits()));
        }
    }
    let count = seen.len();
    seen.sort_unstable();
    seen.dedup();
    // In bin 32, a position has 2^18 possible values: one or two of the 960 positions coincide by chance.
    assert!(100 * seen.len() >= 99 * count, "{} of {count}", seen.len());
}

#[test]
fn the_march_through_the_occupancy_grid_finds_the_first_jittered_sample_that_is_occupied() {
    let bounds = SceneBox { min: Vec3::new(-1.0, -2.0, -1.0), max: Vec3::new(1.0, 1.0, 3.0) };
    let numbers = noise(3000, 5);
    let (mut found_some, mut passed) = (0, 0);
    for (case, n) in numbers.chunks_exact(6).enumerate() {
        let resolution = [[2, 3, 4], [7, 5, 9], [32, 32, 32]][case % 3];
        let cells = resolution.iter().map(|&side| usize::from(side)).product::<usize>();
        let bits: Vec<u8> = (0..cells.div_ceil(8)).map(|i| ((i * 31 + case) % 17 / 12) as u8 * 5).collect();
        let occupancy = OccupancyGrid::new(bounds, resolution, &bits);
        let bins = Bins::new(0.5, 9.0, [16, 200, 1500][case / 3 % 3]).unwrap();
        let origin = Vec3::new(n[0], n[1], n[2]) * 4.0;
        let Some(dir) = (Vec3::new(n[3], n[4], n[5]) - origin).try_normalize() else { continue };
        let (ray, place) = (Ray { origin, dir }, place(9, case as u32, 3, 0));
        let t = |bin| place.t(&bins, bin);
        let end = bins.count();
        let mut from = 0;
        for _ in 0..20 {
            let naive = (from..end).find(|&bin| occupancy.occupied(ray.at(t(bin)))).unwrap_or(end);
            assert_eq!(occupancy.first_occupied(&ray, &bins, from, end, t), naive, "case {case} from {from}");
            found_some += usize::from(naive < end);
            passed += naive - from;
            from = (naive + 1).min(end);
        }
        // Bins outside the overlapping range have no sample inside the box.
        if let Some((enter, exit)) = bounds.clip(&ray, 0.5, 9.0) {
            let inside = bins.overlapping(enter, exit);
            let outside = (0..end).filter(|bin| !inside.contains(bin));
            assert!(outside.clone().all(|bin| !bounds.contains(ray.at(t(bin)))));
        }
    }
    assert!(found_some > 100 && passed > 10_000, "{found_some} {passed}");
}
