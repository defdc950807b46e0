extern crate std;

use super::*;
use crate::testing::noise;
use std::vec;

/// Every bin with a sample in an occupied cell is a candidate bin of the ray's packet. Tested with each instruction
/// set, and with packets near and far, narrow and wide, that begin inside or outside the box.
#[test]
fn no_occupied_cell_is_outside_of_a_packets_stretches() {
    let boxes = [
        SceneBox { min: Vec3::splat(-1.5), max: Vec3::splat(1.5) },
        SceneBox { min: Vec3::new(-0.3, 7.0, -2.0), max: Vec3::new(0.4, 8.1, 1.0) },
        SceneBox { min: Vec3::splat(1e4), max: Vec3::splat(1e4 + 4.0) },
    ];
    let (mut missed, mut narrowed, mut occupied) = (0, 0, 0);
    for (k, bounds) in boxes.iter().enumerate() {
        let sides = bounds.max - bounds.min;
        for resolution in [[1, 1, 1], [5, 3, 8], [40, 64, 37], [300, 200, 180]] {
            let cells: usize = resolution.iter().map(|&side| usize::from(side)).product();
            let mut bits = vec![0u8; cells.div_ceil(8)];
            for x in noise(6, 3 + k as u32) {
                set(&mut bits, (0.5 * (x + 1.0) * cells as f32) as usize % cells);
            }
            let occupancy = OccupancyGrid::new(*bounds, resolution, &bits);
            let coarse = CoarseOccupancy::new(Some(&occupancy));
            let around = occupancy.occupied_box().unwrap();
            let packets = coarse.packets_of(&occupancy);
            assert_eq!(packets.is_some(), VECTORS);
            let Some(packets) = packets else { return };
            for i in 0..200 {
                let r = noise(10, 1000 * i + k as u32);
                let away = sides.length() * [0.0, 0.4, 2.0][i as usize % 3];
                let target = around.min + (around.max - around.min) * (0.5 + Vec3::new(r[3], r[4], r[5]));
                let dir = Vec3::new(r[0], r[1], r[2]).normalize();
                let spread = [0.0, 0.0005, 0.002, 0.3][i as usize % 4];
                let rays: [Ray; 16] = core::array::from_fn(|j| {
                    let aside = Vec3::from_slice(&noise(3, 77 * i + j as u32)) * spread;
                    Ray { origin: target - dir * away, dir: (dir + aside).normalize() }
                });
                for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
                    let found = packets.intervals_of(isa, &rays);
                    missed += u32::from(found.is_none());
                    narrowed += u32::from(found.is_some_and(|found| found.found != u64::MAX));
                    for bins in [500, 60].map(|n| Bins::new(0.0, 5.0 * sides.length(), n).unwrap()) {
                        let candidates = found.map(|found| CandidateBins::new(&found, &bins, 0.0));
                        for ray in &rays {
                            for bin in
                                (0..bins.count()).filter(|&bin| occupancy.occupied(ray.at(bins.at(bin, 0.5))))
                            {
                                occupied += 1;
                                let kept = candidates.is_some_and(|candidates| {
                                    candidates.next(bin) == bin && bin < candidates.end()
                                });
                                assert!(
                                    kept,
                                    "{resolution:?} {ray:?}: bin {bin} of {bins:?} not in {found:?}"
                                );
                            }
                        }
                    }
                }
            }
        }
    }
    let isas = Isa::ALL.into_iter().filter(|isa| isa.available()).count() as u32;
    assert!(
        missed > 300 * isas && narrowed > 50 * isas && occupied > 1000 * isas,
        "{missed} {narrowed} {occupied}"
    );
}

#[test]
fn a_ray_that_is_no_number_hides_none_beside_it() {
    let bounds = SceneBox { min: Vec3::splat(-1.0), max: Vec3::splat(1.0) };
    let occupancy = OccupancyGrid::new(bounds, [8; 3], &[0xff; 64]);
    let coarse = CoarseOccupancy::new(Some(&occupancy));
    let packets = coarse.packets_of(&occupancy);
    assert_eq!(packets.is_some(), VECTORS);
    let Some(packets) = packets else { return };
    let seen = Ray { origin: Vec3::new(0.0, 0.0, 5.0), dir: Vec3::NEG_Z };
    for broken in [Ray { dir: Vec3::NAN, ..seen }, Ray { origin: Vec3::new(0.0, f32::INFINITY, 0.0), ..seen }]
    {
        assert_eq!(packets.intervals_of(Isa::detect(), &[seen, broken]), Some(Intervals::ALL));
    }
}
