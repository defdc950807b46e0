use super::exposure::LogGains;
use super::sights::Sights;
use crate::data::demo::{DemoSpec, dataset};
use crate::data::{Dataset, KeyPoint, SparsePoint};
use glam::Vec3;

/// Demo scene with 1000 points on a lattice around its centre. Each view has a key point wherever one of these points
/// projects to, even if the point is hidden.
pub(crate) fn tracked() -> Dataset {
    let mut data = dataset(&DemoSpec { train: 8, val: 2, size: 48, ..Default::default() }).expect("a scene");
    let at = |i: i32| (i as f32 - 4.5) * 0.1;
    data.points = (0..1000)
        .map(|i| [at(i / 100), at(i / 10 % 10), at(i % 10)])
        .map(|position| SparsePoint { position, error: 0.5, track: 8 })
        .collect();
    let points = data.points.clone();
    for view in data.train.iter_mut().chain(&mut data.val) {
        let (width, height) = view.size();
        let shown = points.iter().enumerate().filter_map(|(i, point)| {
            let (x, y) = view.camera.project(Vec3::from(point.position))?;
            let inside = (0.0..width as f32).contains(&x) && (0.0..height as f32).contains(&y);
            inside.then_some(KeyPoint { x, y, point: i as u32 })
        });
        view.key_points = shown.collect();
    }
    data
}

#[test]
fn key_points_that_contradict_their_point_are_left_out() {
    let mut data = tracked();
    let all = Sights::of(&data.train, &data.points);
    assert_eq!(all.count(), data.train.iter().map(|view| view.key_points.len()).sum::<usize>());
    let view = &mut data.train[0];
    let expected = (Vec3::from(data.points[view.key_points[0].point as usize].position)
        - view.camera.pose().position)
        .length();
    assert!((all.of_views[0][0].distance - expected).abs() < 1e-5);
    // Makes seven key points invalid: one is moved by 4 pixels; the points of the others are behind the camera,
    // extremely far away, seen by two photographs, of large error, of error NaN, and missing.
    view.key_points[0].x += 4.0;
    let behind = view.camera.pose().position - view.camera.pose().forward();
    let bad = [behind.to_array(), [1e30; 3], [0.0; 3], [0.0; 3], [0.0; 3]];
    let first = data.points.len() as u32;
    data.points.extend(bad.map(|position| SparsePoint { position, error: 0.5, track: 8 }));
    data.points[first as usize + 2].track = 2;
    data.points[first as usize + 3].error = 1e9;
    data.points[first as usize + 4].error = f32::NAN;
    let (x, y) = (10.0, 10.0);
    view.key_points.extend((first..first + 5).map(|point| KeyPoint { x, y, point }));
    view.key_points.push(KeyPoint { x, y, point: u32::MAX });
    let some = Sights::of(&data.train, &data.points);
    assert_eq!(some.count(), all.count() - 1);
    let said = some.to_string();
    assert!(said.contains("left out: 3 of points") && said.contains("3 whose point"), "{said}");
}

#[test]
fn gains_are_measured_where_photographs_show_the_same_points() {
    let mut data = tracked();
    for view in data.train.iter_mut() {
        // Uniform pictures: the colour of a point does not depend on the viewing direction.
        view.pixels.fill([100, 100, 100, 255]);
    }
    let factors = [0.6f32, 0.8, 0.9, 1.0, 1.0, 1.2, 1.5, 1.9];
    for (view, factor) in data.train.iter_mut().zip(factors) {
        view.pixels.fill(
            [100.0, 100.0, 60.0]
                .map(|c: f32| (c * factor) as u8)
                .into_iter()
                .chain([255])
                .collect::<Vec<_>>()
                .try_into()
                .expect("four"),
        );
    }
    let sights = Sights::of(&data.train, &data.points);
    let gains = LogGains::measured(&data.train, &sights).expect("tracks");
    let mean = factors.iter().map(|f| f.ln()).sum::<f32>() / 8.0;
    for (gain, factor) in gains.0.iter().zip(factors) {
        assert!((gain[0] - (factor.ln() - mean)).abs() < 0.02, "{gain:?} for {factor}");
    }
    assert!((gains.spread() - 0.34).abs() < 0.05, "{}", gains.spread());
    for channel in 0..3 {
        assert!(gains.0.iter().map(|g| f64::from(g[channel])).sum::<f64>().abs() < 1e-5);
    }
    // A single photograph four stops darker than the 199 others is an outlier, although the spread is small.
    let mut log = LogGains::none(200);
    log.0[7] = [-1.25; 3];
    log.centre();
    assert!(log.spread() < super::exposure::CALLED_FOR, "{}", log.spread());
    assert_eq!(log.outlier().map(|(view, _)| view), Some(7));
    assert_eq!(LogGains(vec![[0.6; 3], [-0.6; 3]]).outlier(), None);
    // Black photographs give no measurements: all log gains are 0.
    data.train.iter_mut().for_each(|view| view.pixels.fill([0, 0, 0, 255]));
    let black = LogGains::measured(&data.train, &sights).expect("tracks");
    assert_eq!(black, LogGains::none(8));
    data.train.iter_mut().for_each(|view| view.key_points.clear());
    assert_eq!(LogGains::measured(&data.train, &Sights::of(&data.train, &data.points)), None);
}
