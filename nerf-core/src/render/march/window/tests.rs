extern crate std;

use super::*;
use crate::render::march::ray::{MarchAll, RayState};
use crate::render::pixel::PixelRay;
use crate::simd::Isa;
use crate::space::SceneBox;
use crate::testing::noise;
use glam::Vec3;
use std::vec;

fn isas() -> impl Iterator<Item = Isa> {
    Isa::ALL.into_iter().filter(|isa| isa.available())
}

/// Returns the index of the first occupied bin in `next..end`, found by [`LookUp::first_occupied`] with all bins as
/// candidates.
fn first_occupied(
    isa: Isa,
    window: &mut Window,
    (occupancy, inner): (&OccupancyGrid<'_>, bool),
    contraction: Option<&Contraction>,
    ray: &Ray,
    bins: &Bins,
    (next, end): (u32, u32),
) -> u32 {
    let mut state = RayState {
        pixel: PixelRay { ray: *ray, ..PixelRay::NONE },
        ends: bins.ends,
        next,
        end,
        window: *window,
        ..RayState::NONE
    };
    let rays = core::slice::from_mut(&mut state);
    isa.run(MarchAll { occupancy, contraction, bins, rays, list: &[0], inner });
    *window = state.window;
    state.next
}

/// Clears the bits of the cells at the faces of the scene box.
fn empty_faces(bits: &mut [u8], resolution: [u16; 3]) {
    let [nx, ny, nz] = resolution.map(usize::from);
    for i in 0..nx * ny * nz {
        let [x, y, z] = [i / nz / ny, i / nz % ny, i % nz];
        if x % (nx - 1) == 0 || y % (ny - 1) == 0 || z % (nz - 1) == 0 {
            bits[i / 8] &= !(1 << (i % 8));
        }
    }
}

/// [`LookUp::first_occupied`] finds the same bins as a test of every bin, with each instruction set.
///
/// Cases: near and far boxes, rays along axes and faces, cut bins, grids whose cells at the faces are all empty,
/// windows that end behind the last bin, and grids of more than 2^23 cells.
#[test]
fn windows_find_the_bins_that_asking_at_each_finds() {
    let boxes = [
        SceneBox { min: Vec3::splat(-1.5), max: Vec3::splat(1.5) },
        SceneBox { min: Vec3::new(-0.3, 7.0, -1e3), max: Vec3::new(0.4, 8.1, 1e3) },
        SceneBox { min: Vec3::splat(1e6), max: Vec3::splat(1e6 + 4.0) },
    ];
    let (mut live, mut asked) = (0u32, 0u32);
    for (k, bounds) in boxes.iter().enumerate() {
        let sides = bounds.max - bounds.min;
        for resolution in [[1, 1, 1], [5, 3, 8], [32, 31, 33], [12, 14, 13], [300, 200, 180]] {
            let cells: usize = resolution.iter().map(|&side| usize::from(side)).product();
            let mut bits: vec::Vec<u8> = noise(cells.div_ceil(8), 7 + k as u32)
                .iter()
                .map(|x| if *x > 0.2 { 0 } else { x.to_bits().to_le_bytes()[0] })
                .collect();
            let inner = resolution == [12, 14, 13];
            if inner {
                empty_faces(&mut bits, resolution);
            }
            let occupancy = OccupancyGrid::new(*bounds, resolution, &bits);
            for i in 0..40 {
                let r = noise(8, 100 * i + k as u32);
                let mut dir = Vec3::new(r[0], r[1], r[2]);
                if i % 3 == 1 {
                    dir[i as usize / 3 % 3] = [0.0, -0.0, 1e-30][i as usize / 9 % 3];
                }
                let dir = dir.normalize();
                // The ray aims at a point in or near the box. Every fifth ray aims at the plane of a face.
                let mut target = bounds.min + sides * (0.5 + 0.6 * Vec3::new(r[3], r[4], r[5]));
                if i % 5 == 0 {
                    target[i as usize % 3] = bounds.max[i as usize % 3];
                }
                let reach = sides.length();
                let ray = Ray { origin: target - dir * reach, dir };
                for count in [7, 33, 500] {
                    let whole = Bins::new(0.0, 2.0 * reach, count).unwrap();
                    let (bins, part) = match i % 2 {
                        0 => (whole, 0..count),
                        _ => whole.cut(reach * (0.7 + 0.2 * r[6]), reach * (1.4 + 0.2 * r[7]), f32::MAX),
                    };
                    for isa in isas() {
                        let (mut window, mut next) = (Window::NONE, part.start);
                        for bin in part.clone() {
                            asked += 1;
                            if occupancy.occupied(ray.at(bins.at(bin, 0.5))) {
                                live += 1;
                                let part = (next, part.end);
                                next = first_occupied(
                                    isa,
                                    &mut window,
                                    (&occupancy, inner),
                                    None,
                                    &ray,
                                    &bins,
                                    part,
                                );
                                assert_eq!(next, bin, "{} {resolution:?} {ray:?} {bins:?}", isa.name());
                                next += 1;
                            }
                        }
                        let part = (next, part.end);
                        let end =
                            first_occupied(isa, &mut window, (&occupancy, inner), None, &ray, &bins, part);
                        assert_eq!(end, part.1, "{} {resolution:?} {ray:?} {bins:?}", isa.name());
                    }
                }
            }
        }
    }
    let isas = isas().count() as u32;
    assert!(live > 2_500 * isas && live < asked / 4, "{live} of {asked}");
}

/// [`LookUp::first_occupied`] finds the same bins as a test of every bin in unbounded scenes, where contracted rays are
/// curves. Rays begin at the centre, near it and far away.
#[cfg(feature = "contraction")]
#[test]
fn windows_find_the_bins_of_a_contraction() {
    let (mut live, mut asked) = (0u32, 0u32);
    for (k, (centre, radius)) in
        [(Vec3::ZERO, 1.0), (Vec3::new(-7.0, 30.0, 0.1), 0.3), (Vec3::splat(1e6), 4.0)]
            .into_iter()
            .enumerate()
    {
        let cube = Contraction::cube(centre, radius);
        for resolution in [[1, 1, 1], [5, 3, 8], [32, 31, 33]] {
            let cells: usize = resolution.iter().map(|&side| usize::from(side)).product();
            let bits: vec::Vec<u8> = noise(cells.div_ceil(8), 17 + k as u32)
                .iter()
                .map(|x| if *x > 0.2 { 0 } else { x.to_bits().to_le_bytes()[0] })
                .collect();
            let occupancy = OccupancyGrid::new(cube, resolution, &bits);
            for i in 0..40 {
                let r = noise(7, 100 * i + k as u32);
                let dir = Vec3::new(r[0], r[1], if i % 3 == 1 { 0.0 } else { r[2] }).normalize();
                let aside =
                    centre + Vec3::new(r[3], r[4], r[5]) * radius * [0.0, 1.0, 3.0, 1e3][i as usize % 4];
                let ray = Ray { origin: aside, dir };
                for power in Contraction::POWERS {
                    let contraction = Contraction::new(&cube, power).unwrap();
                    let farthest = 1.0 + f32::from(power);
                    let whole = Bins::of_width(-farthest, 2.0 * farthest / 300.0, 300);
                    let (bins, part) =
                        whole.cut(r[6] * farthest, contraction.step_at(100.0 * radius), f32::MAX);
                    for isa in isas() {
                        let (mut window, mut next) = (Window::NONE, part.start);
                        let mut find = |next| {
                            let (contraction, part) = (Some(&contraction), (next, part.end));
                            first_occupied(
                                isa,
                                &mut window,
                                (&occupancy, false),
                                contraction,
                                &ray,
                                &bins,
                                part,
                            )
                        };
                        for bin in part.clone() {
                            asked += 1;
                            let p = contraction.contract(ray.at(contraction.distance(bins.at(bin, 0.5))));
                            if occupancy.occupied(p) {
                                live += 1;
                                assert_eq!(find(next), bin, "{} {resolution:?} {ray:?} {bins:?}", isa.name());
                                next = bin + 1;
                            }
                        }
                        assert_eq!(find(next), part.end, "{} {resolution:?} {ray:?}", isa.name());
                    }
                }
            }
        }
    }
    assert!(live > 10_000 && live < asked / 2, "{live} of {asked}");
}
