extern crate std;

use super::*;
use crate::blob::{Blob, Body, Content};
use crate::plan::{Batch, Outputs, Quality};
use crate::simd::Isa;
use crate::testing::{SCENE, body, bytes, every_kind, halve, noise, parameters};
use glam::Vec3;
use std::vec::Vec;

/// Compares [`SpanAll`] with [`Span::new`]: rays through the box, past it, from inside and along its axes, with and
/// without limits of distance, in every lattice.
#[test]
fn spans_of_many_rays_are_those_of_each() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let (mut hits, mut asked) = (0, 0);
    for lattice in [Lattice::Own, Lattice::Extended, Lattice::March, Lattice::Contracted] {
        let content = Content::Scene(SCENE);
        let bytes = bytes(&Body { content, ..body(every_kind(), None, &weights) });
        let blob = Blob::open(&bytes).unwrap();
        let mut plan = Plan::new(&blob, &Quality::default(), Outputs::ALL, Batch::FULL).unwrap();
        plan.lattice = lattice;
        if lattice == Lattice::Contracted {
            plan.contraction = Contraction::new(&plan.bounds, 2);
            plan.bins = Bins::of_width(-2.5, 0.02, 250);
            if plan.contraction.is_none() {
                continue;
            }
        }
        let (min, max) = (plan.bounds.min, plan.bounds.max);
        let around = SceneBox { min: min + 0.1 * (max - min), max };
        for packet in 0..60u32 {
            let count = 1 + packet as usize * 7 % MAX_LANES;
            let mut ranges = [[0.0; MAX_LANES]; 2];
            let rays: Vec<Ray> = (0..count)
                .map(|i| {
                    let r = noise(9, 100 * packet + i as u32);
                    let mut dir = Vec3::new(r[0], r[1], r[2]);
                    if i % 4 == 1 {
                        dir[i / 4 % 3] = [0.0, -0.0, 1e-39][i / 12];
                    }
                    let target = 0.5 * (min + max) + 0.7 * (max - min) * Vec3::new(r[3], r[4], r[5]);
                    let away = [0.0, 1.0, 5.0, 1e4][packet as usize % 4];
                    let t_min = if packet % 3 == 0 { 0.0 } else { 3.0 * r[6].abs() };
                    let t_max = if packet % 5 == 0 { f32::MAX } else { 9.0 * r[7].abs() };
                    (ranges[0][i], ranges[1][i]) = (t_min, t_max);
                    let dir = if i == 13 { Vec3::NAN } else { dir.normalize() };
                    Ray { origin: target - away * dir, dir }
                })
                .collect();
            for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
                let mut found = Spans::NONE;
                let (plan, ranges) = (&plan, &ranges);
                isa.run(SpanAll { plan, around: &around, rays: &rays, ranges, to: &mut found });
                for (i, ray) in rays.iter().enumerate() {
                    let range = [ranges[0][i], ranges[1][i]];
                    let expected = Span::new(plan, &around, ray, range).filter(|span| !span.bins.is_empty());
                    let found = found.of(i, ray);
                    asked += 1;
                    assert_eq!(found.is_some(), expected.is_some(), "{lattice:?} {ray:?} {range:?}");
                    let (Some(found), Some(expected)) = (found, expected) else { continue };
                    hits += 1;
                    assert_eq!(found.bins, expected.bins, "{lattice:?} {ray:?} {range:?}");
                    assert_eq!(found.start.to_bits(), expected.start.to_bits(), "{lattice:?} {ray:?}");
                    let bits = |span: &Span| {
                        let parts = span.ends.parts().map(f32::to_bits);
                        (span.ray.origin.to_array().map(f32::to_bits), parts)
                    };
                    assert_eq!(bits(&found), bits(&expected), "{lattice:?} {ray:?} {range:?}");
                }
            }
        }
    }
    assert!(asked / 10 < hits && hits < asked * 9 / 10, "{hits} of {asked}");
}
