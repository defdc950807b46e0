use super::*;
use crate::data::demo::{DemoSpec, dataset};
use nerf_core::camera::Pose;

#[test]
fn one_view_is_enough_far_from_every_camera_and_two_are_needed_near_one() {
    let mut views =
        dataset(&DemoSpec { train: 2, val: 1, size: 16, ..DemoSpec::default() }).expect("a scene").train;
    // Both look along −z, the second from behind all that is asked for.
    for (view, z) in views.iter_mut().zip([1.0, -30.0]) {
        let pose =
            Pose::look_at(Vec3::new(0.0, 0.0, z), Vec3::new(0.0, 0.0, z - 1.0), Vec3::Y).expect("a pose");
        view.camera = view.camera.at(pose).expect("a camera");
    }
    let bounds = Contraction::cube(Vec3::ZERO, 1.0);
    let contraction = Contraction::new(&bounds, 2).expect("a cube");
    let occupancy = Occupancy::seen(bounds, 64, &views, &contraction, (&[0.0, 0.0], 0.1), &[]);
    let live = |z: f32| occupancy.lookup().occupied(contraction.contract(Vec3::new(0.02, 0.02, z)));
    assert!(live(-10.0) && live(-0.5), "far from both");
    assert!(!live(0.5), "half a radius before the first, which alone sees it");
    assert!(!live(3.0), "seen by neither");
}
