//! Tests of bundle adjustment on synthetic cameras and points.

use super::*;

const FRAME: Frame = Frame { principal: DVec2::new(400.0, 300.0), aspect: 1.0, tangential: [1e-3, -2e-3] };

/// Ten cameras of two devices and 80 points around the origin, with exact observations. Each camera is about 6 from the
/// origin.
fn truth() -> Bundle {
    let devices = [(600.0, [-0.05, 0.02]), (750.0, [0.03, 0.0])];
    let device = |(focal, radial): (f64, [f64; 2])| Device { focal, radial, second_order: radial[1] != 0.0 };
    let photograph = |i: usize| {
        let rotation =
            DQuat::from_rotation_x(0.3 + 0.05 * (i % 3) as f64) * DQuat::from_rotation_y(0.5 * i as f64);
        Photograph { rotation, translation: DVec3::new(0.1, -0.2, 6.0), device: i % 2, frame: FRAME }
    };
    let wave = |i: usize, by: f64| 2.0 * (by * (i + 1) as f64).sin();
    let mut bundle = Bundle {
        devices: devices.map(device).to_vec(),
        photographs: (0..10).map(photograph).collect(),
        points: (0..80).map(|i| DVec3::new(wave(i, 1.3), wave(i, 2.1), wave(i, 3.7))).collect(),
        observations: Vec::new(),
    };
    let pairs = (0..80).flat_map(|point| (0..10).map(move |photograph| (point, photograph)));
    bundle.observations =
        pairs.map(|(point, photograph)| Observation { photograph, point, at: DVec2::ZERO }).collect();
    for i in 0..bundle.observations.len() {
        let at = bundle.residual(&bundle.observations[i]).expect("in front");
        bundle.observations[i].at = at;
    }
    bundle
}

/// Copy of `truth` with errors in all cameras and points; the observations stay exact.
fn disturbed(truth: &Bundle) -> Bundle {
    let mut bundle = truth.clone();
    for (i, photograph) in bundle.photographs.iter_mut().enumerate() {
        let by = DVec3::new((i as f64).sin(), (2.0 * i as f64).cos(), (3.0 * i as f64).sin());
        photograph.rotation = (DQuat::from_scaled_axis(0.02 * by) * photograph.rotation).normalize();
        photograph.translation += 0.1 * by;
    }
    bundle.points.iter_mut().enumerate().for_each(|(i, point)| point.x += 0.05 * (7.0 * i as f64).sin());
    for device in &mut bundle.devices {
        (device.focal, device.radial) = (device.focal * 1.06, [0.0; 2]);
    }
    bundle
}

fn centres(bundle: &Bundle) -> Vec<DVec3> {
    bundle.photographs.iter().map(Photograph::centre).collect()
}

fn worst(bundle: &Bundle) -> f64 {
    bundle.errors().into_iter().fold(0.0, f64::max)
}

#[test]
fn derivatives_are_those_of_differences() {
    let bundle = disturbed(&truth());
    let seen = bundle.observations[123];
    let jacobian = bundle.linearised(&seen).expect("in front");
    let (photograph, device) = (seen.photograph, bundle.photographs[seen.photograph].device);
    let difference = |change: &dyn Fn(&mut Bundle, f64)| {
        let at = |step: f64| {
            let mut moved = bundle.clone();
            change(&mut moved, step);
            moved.residual(&seen).expect("in front")
        };
        (at(1e-5) - at(-1e-5)) / 2e-5
    };
    let agrees = |what: &str, found: [f64; 2], expected: DVec2| {
        assert!(
            (DVec2::from(found) - expected).length() < 1e-4 * (1.0 + expected.length()),
            "{what} {found:?} {expected}"
        );
    };
    for axis in 0..3 {
        let along = |step: f64| DVec3::from(std::array::from_fn(|i| if i == axis { step } else { 0.0 }));
        let turned = difference(&|bundle, step| {
            let rotation = &mut bundle.photographs[photograph].rotation;
            *rotation = DQuat::from_scaled_axis(along(step)) * *rotation;
        });
        agrees("turn", jacobian.pose.map(|row| row[axis]), turned);
        let shifted = difference(&|bundle, step| bundle.photographs[photograph].translation += along(step));
        agrees("shift", jacobian.pose.map(|row| row[3 + axis]), shifted);
        let point = difference(&|bundle, step| bundle.points[seen.point] += along(step));
        agrees("point", jacobian.point.map(|row| row[axis]), point);
    }
    let focal = difference(&|bundle, step| bundle.devices[device].focal *= step.exp());
    agrees("focal", jacobian.device.map(|row| row[0]), focal);
    let k1 = difference(&|bundle, step| bundle.devices[device].radial[0] += step);
    agrees("k1", jacobian.device.map(|row| row[1]), k1);
}

#[test]
fn cameras_and_points_are_found_again_where_they_were() {
    let truth = truth();
    let mut bundle = disturbed(&truth);
    assert!(worst(&bundle) > 20.0);
    bundle.adjust(&centres(&truth));
    assert!(worst(&bundle) < 1e-3, "{}", worst(&bundle));
    for (found, truth) in bundle.devices.iter().zip(&truth.devices) {
        assert!((found.focal / truth.focal - 1.0).abs() < 1e-4, "{found:?}");
        assert!((found.radial[0] - truth.radial[0]).abs() < 1e-3, "{found:?}");
    }
    for (found, truth) in centres(&bundle).into_iter().zip(centres(&truth)) {
        assert!((found - truth).length() < 1e-3, "{found} {truth}");
    }
    assert!(bundle.points.iter().zip(&truth.points).all(|(a, b)| (*a - *b).length() < 1e-3));
}

#[test]
fn a_wrong_match_moves_nothing_far() {
    let truth = truth();
    let mut bundle = disturbed(&truth);
    bundle.observations[17].at += DVec2::new(200.0, -90.0);
    bundle.adjust(&centres(&truth));
    let mut errors = bundle.errors();
    errors.sort_by(f64::total_cmp);
    assert!(errors[errors.len() / 2] < 0.05 && errors[errors.len() - 1] > 100.0, "{errors:?}");
}

#[test]
fn points_that_are_behind_a_camera_or_nowhere_do_no_harm() {
    let truth = truth();
    let mut bundle = disturbed(&truth);
    (bundle.points[3], bundle.points[4]) = (DVec3::new(0.0, 0.0, 100.0), DVec3::NAN);
    bundle.adjust(&centres(&truth));
    let good =
        bundle.observations.iter().zip(bundle.errors()).filter(|(seen, _)| ![3, 4].contains(&seen.point));
    assert!(good.map(|(_, error)| error).fold(0.0, f64::max) < 1.0);
    let mut none = Bundle { photographs: vec![], devices: vec![], points: vec![], observations: vec![] };
    none.adjust(&[]);
}
