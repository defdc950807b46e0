use super::*;
use crate::data::Report;

fn cameras() -> Vec<Camera> {
    let spec = DemoSpec { size: 48, ..Default::default() };
    [(-0.9, 0.45), (2.0, 0.1), (4.0, 0.9), (1.0, -0.35)]
        .map(|(a, z)| spec.camera(a, z).expect("a camera"))
        .into()
}

#[test]
fn hits_are_on_the_surface_and_nothing_is_in_front() {
    for camera in cameras() {
        for i in 0..48 * 48 {
            let (x, y) = ((i % 48) as f32 + 0.5, (i / 48) as f32 + 0.5);
            let ray = camera.ray(x, y);
            let Some(hit) = trace(&camera, x, y) else { continue };
            let point = ray.at(hit.ray_distance);
            assert!(signed_distance(point).abs() < 2e-6, "({x}, {y}): {}", signed_distance(point));
            assert!(SCENE_BOX.contains(point));
            for step in 0..100 {
                let before = hit.ray_distance * step as f32 / 100.0;
                assert!(signed_distance(ray.at(before)) > -1e-5);
            }
            let axis = (point - camera.pose().position).dot(camera.pose().forward());
            assert!((hit.z_depth - axis).abs() < 1e-5);
            assert!(hit.normal.dot(ray.dir) < 1e-3 && (hit.normal.length() - 1.0).abs() < 1e-5);
            assert!(hit.rgb.iter().all(|v| (0.0..=1.0).contains(v)));
        }
    }
}

#[test]
fn bounding_spheres_hold_their_shapes() {
    for shape in &shapes::SCENE {
        for i in 0..4000 {
            let z = 2.0 * (f64::from(i) + 0.5) / 4000.0 - 1.0;
            let (sin, cos) = (2.399_963 * f64::from(i)).sin_cos();
            let dir = DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
            assert!(shape.distance(shape.centre + dir * shape.reach) >= -1e-12, "{:?}", shape.look);
        }
    }
}

#[test]
fn misses_stay_outside() {
    let camera = &cameras()[0];
    for i in 0..48 * 48 {
        let (x, y) = ((i % 48) as f32 + 0.5, (i / 48) as f32 + 0.5);
        if trace(camera, x, y).is_none() {
            let ray = camera.ray(x, y);
            let nearest = (0..1000).map(|s| signed_distance(ray.at(s as f32 * 0.006))).fold(1.0, f32::min);
            assert!(nearest > -5e-6, "({x}, {y}) passes {nearest} inside");
        }
    }
}

#[test]
fn truth_agrees_with_itself() {
    let camera = &cameras()[0];
    let truth = render_truth(camera);
    assert_eq!(truth, render_truth(camera));
    let mut edges = 0;
    for i in 0..truth.rgba.len() {
        let (alpha, hit) = (truth.rgba[i][3], truth.ray_distance[i]);
        assert_eq!(truth.opaque[i], alpha == 255);
        assert_eq!(hit.is_some(), truth.z_depth[i].is_some());
        assert!(hit.is_some() || alpha < 255);
        assert!(hit.is_none() || alpha > 0);
        edges += usize::from(alpha > 0 && alpha < 255);
    }
    let covered = truth.opaque.iter().filter(|o| **o).count();
    assert!(covered > 400 && covered < 2100 && edges > 40, "{covered} opaque, {edges} edges");
}

#[test]
fn some_surface_point_changes_colour_with_the_direction() {
    let [a, b] = [(-0.9, 0.45), (-0.6, 0.45)]
        .map(|(azimuth, z)| DemoSpec::default().camera(azimuth, z).expect("camera"));
    let mut largest = 0.0f32;
    for i in 0..128 * 128 {
        let (x, y) = ((i % 128) as f32 + 0.5, (i / 128) as f32 + 0.5);
        let Some(hit) = trace(&a, x, y) else { continue };
        let point = a.ray(x, y).at(hit.ray_distance);
        // Projects the point into the other camera's picture.
        let local = b.pose().rotation.transpose() * (point - b.pose().position);
        let k = b.intrinsics();
        let (u, v) = (k.cx - k.fx * local.x / local.z, k.cy + k.fy * local.y / local.z);
        let Some(other) = trace(&b, u, v) else { continue };
        if (b.ray(u, v).at(other.ray_distance) - point).length() < 1e-4 {
            largest = largest.max((hit.rgb[1] - other.rgb[1]).abs());
        }
    }
    assert!(largest > 0.2, "{largest}");
}

#[test]
fn the_data_set_is_whole_and_raises_no_alarm() {
    let start = std::time::Instant::now();
    let data = dataset(&DemoSpec::default()).expect("the default spec");
    println!("{:?} for all views", start.elapsed());
    assert_eq!((data.train.len(), data.val.len()), (60, 8));
    assert_eq!(Background::of(&data.train), Background::Alpha);
    let report = Report::of(&data);
    println!("{report}");
    assert!(report.warnings.is_empty(), "{:?}", report.warnings);
    assert!(Vec3::from(report.look_at.expect("an orbit").point).length() < 1e-3);
    let flat: Vec<&View> = data.train.iter().chain(&data.val).collect();
    for (i, a) in flat.iter().enumerate() {
        let border = |i: usize| [0, 127].contains(&(i % 128)) || [0, 127].contains(&(i / 128));
        let cut = a.pixels.iter().enumerate().any(|(i, p)| border(i) && p[3] > 0);
        assert!(a.pixels.iter().any(|p| p[3] == 255) && !cut, "{} is cut", a.name);
        let apart = |b: &&View| (a.camera.pose().position - b.camera.pose().position).length() > 0.05;
        assert!(flat[i + 1..].iter().all(apart), "{} has a twin", a.name);
    }
}

#[test]
fn a_bad_spec_is_an_error() {
    for spec in [
        DemoSpec { size: 0, ..Default::default() },
        DemoSpec { focal: 0.0, ..Default::default() },
        DemoSpec { radius: 0.0, ..Default::default() },
        DemoSpec { radius: f32::NAN, ..Default::default() },
    ] {
        assert!(dataset(&spec).is_err(), "{spec:?}");
    }
}
