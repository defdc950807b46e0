extern crate std;

use super::*;
use crate::testing::noise;
use std::format;

const UNIT: SceneBox = SceneBox { min: Vec3::NEG_ONE, max: Vec3::ONE };

fn clip(origin: [f32; 3], dir: [f32; 3]) -> Option<(f32, f32)> {
    UNIT.clip(&Ray { origin: origin.into(), dir: dir.into() }, 0.0, 100.0)
}

#[test]
fn a_ray_through_the_box_enters_and_leaves_at_its_faces() {
    assert_eq!(clip([0.0, 0.0, 4.0], [0.0, 0.0, -1.0]), Some((3.0, 5.0)));
    assert_eq!(clip([-3.0, 0.5, -0.5], [1.0, 0.0, 0.0]), Some((2.0, 4.0)));
    let diagonal = Vec3::ONE.normalize();
    let (enter, exit) = clip((diagonal * -5.0).into(), diagonal.into()).unwrap();
    assert!((enter - (5.0 - 3f32.sqrt())).abs() < 1e-6 && (exit - (5.0 + 3f32.sqrt())).abs() < 1e-6);
}

#[test]
fn a_ray_from_inside_starts_at_near() {
    assert_eq!(clip([0.0; 3], [0.0, 1.0, 0.0]), Some((0.0, 1.0)));
    let ray = Ray { origin: Vec3::ZERO, dir: Vec3::X };
    assert_eq!(UNIT.clip(&ray, 0.25, 0.75), Some((0.25, 0.75)));
    assert_eq!(UNIT.clip(&ray, 1.5, 9.0), None, "the box ends before near");
}

#[test]
fn a_ray_that_misses_or_looks_away_is_none() {
    assert_eq!(clip([0.0, 3.0, 4.0], [0.0, 0.0, -1.0]), None);
    assert_eq!(clip([0.0, 0.0, 4.0], [0.0, 0.0, 1.0]), None);
    assert_eq!(clip([4.0, 0.0, 4.0], [0.6, 0.0, -0.8]), None);
}

#[test]
fn a_ray_on_a_face_or_an_edge_counts_as_inside() {
    assert_eq!(clip([1.0, 0.0, 4.0], [0.0, 0.0, -1.0]), Some((3.0, 5.0)));
    assert_eq!(clip([1.0, -1.0, 4.0], [0.0, -0.0, -1.0]), Some((3.0, 5.0)));
    assert_eq!(clip([1.0, 1.0, 1.0], [0.0, 0.0, -1.0]), Some((0.0, 2.0)), "starting on a corner");
    let beside = 1.0f32.next_up();
    assert_eq!(clip([beside, 0.0, 4.0], [0.0, 0.0, -1.0]), None);
    assert_eq!(clip([0.0, -beside, 4.0], [0.0, 0.0, -1.0]), None);
}

#[test]
fn a_corner_touched_is_one_point() {
    let dir = Vec3::new(1.0, -1.0, 0.0).normalize();
    let (enter, exit) = clip([0.0, 2.0, 1.0], dir.into()).unwrap();
    assert_eq!(enter, exit);
}

#[test]
fn subnormal_and_huge_directions_decide_nothing_by_accident() {
    for tiny in [1e-45, -1e-45, 1e-39, -1e-39, 0.0, -0.0] {
        assert_eq!(clip([1.0, -1.0, 4.0], [tiny, -tiny, -1.0]), Some((3.0, 5.0)), "{tiny}");
        assert_eq!(clip([1.5, 0.0, 4.0], [tiny, 0.0, -1.0]), None, "{tiny}");
    }
    // `dir` is not of unit length: t counts multiples of `dir`.
    let (enter, exit) = clip([0.0, 0.0, 4.0], [0.0, 0.0, -1e30]).unwrap();
    assert!(enter > 2.9e-30 && exit < 5.1e-30);
    assert_eq!(clip([0.0; 3], [0.0; 3]), Some((0.0, 100.0)), "standing still inside");
    assert_eq!(clip([2.0; 3], [0.0; 3]), None, "standing still outside");
}

#[test]
fn rays_and_ranges_that_are_no_numbers_meet_nothing() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert_eq!(clip([0.0; 3], [bad, 0.0, -1.0]), None, "dir {bad}");
        assert_eq!(clip([0.0, bad, 0.0], [0.0, 0.0, -1.0]), None, "origin {bad}");
        assert_eq!(clip([0.0, 0.0, bad], [0.0, 0.0, -1.0]), None, "origin {bad}");
    }
    let ray = Ray { origin: Vec3::new(0.0, 0.0, 4.0), dir: Vec3::NEG_Z };
    for (near, far) in [(f32::NAN, 9.0), (0.0, f32::NAN), (f32::NAN, f32::NAN), (5.0, 4.0)] {
        assert_eq!(UNIT.clip(&ray, near, far), None, "{near}..{far}");
    }
}

#[test]
fn clipping_agrees_with_marching() {
    for row in noise(2000 * 6, 1).as_chunks::<6>().0 {
        let origin = Vec3::from_slice(&row[..3]) * 3.0;
        let dir = Vec3::from_slice(&row[3..]).normalize();
        let ray = Ray { origin, dir };
        let span = UNIT.clip(&ray, 0.0, 8.0);
        for i in 0..=800 {
            let t = i as f32 * 0.01;
            let inside = span.is_some_and(|(enter, exit)| (enter..=exit).contains(&t));
            let border = span.is_some_and(|(a, b)| (t - a).abs() < 1e-5 || (t - b).abs() < 1e-5);
            // Rounding decides whether a ray that grazes an edge is inside.
            let p = ray.at(t).abs().max_element();
            assert!(inside == UNIT.contains(ray.at(t)) || border || (p - 1.0).abs() < 1e-5, "{ray:?} {t}");
        }
    }
}

#[test]
fn boxes_that_hold_nothing_are_refused() {
    let bad = [
        (Vec3::ONE, Vec3::NEG_ONE),
        (Vec3::NEG_ONE, Vec3::new(1.0, -1.0, 1.0)),
        (Vec3::ZERO, Vec3::ZERO),
        (Vec3::NAN, Vec3::ONE),
        (Vec3::NEG_ONE, Vec3::new(1.0, 1.0, f32::INFINITY)),
        (Vec3::splat(-3e38), Vec3::splat(3e38)),
    ];
    for (min, max) in bad {
        assert!(matches!(SceneBox::new(min, max), Err(BoundsError::Box { .. })), "{min} {max}");
    }
    assert_eq!(SceneBox::new(Vec3::NEG_ONE, Vec3::ONE), Ok(UNIT));
    assert!(UNIT.contains(Vec3::ONE) && UNIT.contains(Vec3::NEG_ONE) && !UNIT.contains(Vec3::NAN));
    let error = BoundsError::Box { min: [1.0; 3], max: [0.0; 3] };
    assert!(format!("{error}").contains("min < max"));
    assert!(format!("{}", BoundsError::Range { near: 2.0, far: 1.0 }).contains("near 2, far 1"));
}
