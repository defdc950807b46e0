//! Tests of the ray march.

use super::*;
use crate::train::occupancy::OccupiedCells;
use nerf_core::Isa;
use nerf_core::sampling::{Purpose, uniform};

/// An occupancy grid with about the fraction `share` of its cells occupied, in clumps of `side`³ cells.
fn cells(bounds: SceneBox, resolution: [u16; 3], side: u32, share: f32) -> OccupiedCells {
    let [nx, ny, nz] = resolution.map(u32::from);
    let clump = |cell: u32| {
        [cell / (ny * nz), cell / nz % ny, cell % nz]
            .iter()
            .fold(0, |all, at| 1000 * all + u64::from(at / side))
    };
    let live = |&cell: &u32| uniform(7, Purpose::Cell, 0, clump(cell)) < share;
    OccupiedCells::of(bounds, resolution, (0..nx * ny * nz).filter(live))
}

#[test]
fn the_samples_of_a_march_are_those_in_occupied_cells() {
    let bounds = SceneBox::new(Vec3::new(-1.0, -0.5, 0.25), Vec3::new(1.0, 2.0, 1.0)).expect("a box");
    let draw = |i: u64| uniform(7, Purpose::Cell, 1, i);
    // The second case has empty blocks to skip. In the third, steps are too long to test blocks.
    for (resolution, side, share, step) in
        [([9u16, 17, 5], 1, 0.5, 0.013), ([70, 83, 25], 5, 0.02, 0.025), ([70, 83, 25], 5, 0.02, 0.06)]
    {
        let live = cells(bounds, resolution, side, share);
        let (marched, occupancy) = (MarchCells::new(&live), live.lookup());
        let (mut found, mut expected, mut apart) = (0, 0, 0);
        for i in 0..600u64 {
            let v =
                |j: u64| Vec3::new(draw(1000 + 6 * i + j), draw(9000 + 6 * i + j), draw(19000 + 6 * i + j));
            let origin = bounds.min + (bounds.max - bounds.min) * v(0);
            let Some(dir) = (v(1) - Vec3::splat(0.5)).try_normalize() else { continue };
            let ray = Ray { origin, dir };
            let Some((enter, exit)) = bounds.clip(&ray, 0.0, 1e9) else { continue };
            let count = ((exit - enter) / step) as u32;
            let march = |isa: Isa| {
                let mut found = Vec::new();
                let (cells, ray, positions) = (&marched, &ray, &mut found);
                isa.run(March { cells, ray, first: enter, step, count, positions });
                found
            };
            let positions = march(Isa::detect());
            for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
                assert_eq!(march(isa), positions, "{isa:?}");
            }
            let points = (0..count).map(|i| ray.at(enter + i as f32 * step));
            let oracle: Vec<Vec3> = points.filter(|&p| occupancy.occupied(p)).collect();
            found += positions.len();
            expected += oracle.len();
            apart += positions.len().abs_diff(oracle.len());
        }
        // The march and the lookup may assign a point on a face to different cells.
        let few = expected > 100 && apart <= 3;
        assert!(few, "{resolution:?}: {found} found, {expected} expected, {apart} apart");
    }
}

#[test]
fn the_samples_of_a_contracted_march_are_those_in_occupied_cells() {
    let bounds = Contraction::cube(Vec3::new(0.5, -1.0, 2.0), 1.5);
    let contraction = Contraction::new(&bounds, 2).expect("a cube");
    let resolution = [9u16, 17, 5];
    let draw = |i: u64| uniform(7, Purpose::Cell, 1, i);
    let live = cells(bounds, resolution, 1, 0.5);
    let (cells, occupancy) = (MarchCells::new(&live), live.lookup());
    let (mut expected, mut apart) = (0, 0);
    for i in 0..200u64 {
        let v = |j: u64| Vec3::new(draw(1000 + 6 * i + j), draw(2000 + 6 * i + j), draw(3000 + 6 * i + j));
        let origin = bounds.min + (bounds.max - bounds.min) * v(0);
        let Some(dir) = (v(1) - Vec3::splat(0.5)).try_normalize() else { continue };
        let eye = Ray { origin, dir };
        let (ray, start) = contraction.centred(&eye);
        // The count is not a multiple of the group size.
        let (first, step, count) = (-1.3, 0.03, 130);
        let mut samples = Samples::default();
        Isa::detect().run(MarchContracted {
            cells: &cells,
            contraction: &contraction,
            ray: &ray,
            first,
            step,
            count,
            start,
            samples: &mut samples,
        });
        let Samples { positions, deltas, gradient_scales, steps: _ } = samples;
        assert_eq!((positions.len(), positions.len()), (deltas.len(), gradient_scales.len()));
        let at = (0..count).map(|i| first + i as f32 * step);
        let point = |s: f32| contraction.contract(ray.at(contraction.distance(s)));
        let oracle: Vec<f32> = at.filter(|&s| occupancy.occupied(point(s))).collect();
        expected += oracle.len();
        apart += positions.len().abs_diff(oracle.len());
        if positions.len() == oracle.len() {
            for (((p, delta), scale), &s) in positions.iter().zip(deltas).zip(gradient_scales).zip(&oracle) {
                let radii = (ray.at(contraction.distance(s)) - eye.origin).dot(dir) / contraction.radius();
                let expected = (radii * radii).min(1.0);
                assert!((scale - expected).abs() < 1e-3, "{scale}, not {expected}");
                let length = contraction.distance(s + 0.5 * step) - contraction.distance(s - 0.5 * step);
                assert!((Vec3::from(*p) - point(s)).length() < 1e-4, "{p:?} at {s}");
                assert!((delta - length).abs() < 1e-3 * length, "{delta}, not {length}");
            }
        }
    }
    // The march and the lookup may assign a point on a face to different cells.
    assert!(expected > 4_000 && apart <= 3, "{expected} expected, {apart} apart");
}
