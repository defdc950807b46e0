use super::*;
use crate::data::demo::{DemoSpec, dataset};
use crate::model::config::{Preset, Surroundings};
use crate::model::engine::Batch;
use crate::show::cameras::page;
use crate::train::rays::{MarchCells, RayBank};
use nerf_core::Isa;

fn small() -> Dataset {
    dataset(&DemoSpec { train: 6, val: 2, size: 24, ..DemoSpec::default() }).expect("a scene")
}

fn request(views: &[View]) -> Request<'_> {
    Request { views, split: "train", camera: None, rays: 20, step: 3, up: None, frustum: None }
}

#[test]
fn the_rays_are_those_of_the_training_step() {
    let data = small();
    let config = Preset::Small.config();
    let scene = Scene::new(&data, &config, &request(&data.train)).unwrap();
    let (bounds, occupancy) = find_bounds(&data, &config, None).unwrap();
    let occupancy = occupancy.unwrap();
    let bank = RayBank::new(&data.train, data.background, bounds, &config).unwrap();
    let mut batch = Batch::default();
    let s = &config.sampling;
    bank.fill(&mut batch, 3, s.rays, s.live_samples, Some(&occupancy.lookup()));
    assert_eq!((scene.step.rays, scene.step.live), (batch.rays.len(), batch.positions.len()));
    assert_eq!(scene.rays.len(), 20);
    assert!(scene.live() > 0 && scene.culled() > 0);
    let mut positions = batch.positions.iter();
    for (shown, ray) in scene.rays.iter().zip(&batch.rays) {
        assert_eq!((shown.dir.to_array(), shown.live.len()), (ray.dir, ray.samples as usize));
        assert_eq!(shown.origin, scene.cameras[shown.camera].camera.pose().position);
        for (&t, &p) in shown.live.iter().zip(&mut positions) {
            // Only `source` tells which camera a ray belongs to: the sample must lie on the ray from that camera.
            assert!(shown.at(t).distance(Vec3::from(p)) < 1e-4);
        }
        for t in shown.live.iter().chain(&shown.culled) {
            assert!((bounds.near..=bounds.far).contains(t) && bounds.scene_box.contains(shown.at(*t)));
        }
        assert!(shown.culled.iter().all(|&t| !occupancy.lookup().occupied(shown.at(t))));
    }
}

#[test]
fn rays_of_an_unbounded_scene_begin_at_their_cameras_and_its_ball_is_drawn() {
    let data = small();
    let config = Preset::Grid.config().around(Surroundings::Unbounded);
    let scene = Scene::new(&data, &config, &request(&data.train)).unwrap();
    let (bounds, _) = find_bounds(&data, &config, None).unwrap();
    let contraction = bounds.contraction.unwrap();
    assert!(scene.step.marched && bounds.near == 0.0 && scene.live() > 0);
    for ray in &scene.rays {
        assert_eq!((ray.near, scene.cameras[ray.camera].near), (0.0, 0.0));
        assert!(ray.samples().all(|t| t <= scene.bounds.far), "{ray:?}");
        // Space nearer to a camera than `empty_before` is taken as empty, so no sample lies there (10 % tolerance).
        assert!(ray.live.iter().all(|&t| t > 0.9 * bounds.empty_before), "{ray:?}");
    }
    let outline = scene.outline();
    let from_centre = |p: &Vec3| p.distance(contraction.centre()) / contraction.radius();
    assert_eq!(outline.len(), 3);
    assert!(outline.concat().iter().all(|p| (from_centre(p) - 1.0).abs() < 1e-5));
    // The frusta are large enough to show the photographs, and the text of facts mentions the inner ball.
    assert!(scene.frustum >= 0.1 * contraction.radius() && scene.facts().contains("ball of radius"));
    assert!(page::page(&scene).unwrap().contains(scene.ends()));
}

#[test]
fn a_grid_shows_the_marched_rays_of_its_training_in_a_box() {
    let data = small();
    let config = Preset::Grid.config().around(Surroundings::Known);
    let scene = Scene::new(&data, &config, &request(&data.train)).unwrap();
    let (bounds, occupancy) = find_bounds(&data, &config, None).unwrap();
    let bank = RayBank::new(&data.train, data.background, bounds, &config).unwrap();
    let (mut batch, s) = (Batch::default(), &config.sampling);
    // Early in training of a bounded scene, march steps are twice as long as at the end.
    let width = 2.0 * bounds.step(s.steps_across);
    let cells = MarchCells::new(occupancy.unwrap().live());
    bank.fill_marched(Isa::Portable, &mut batch, 3, s.rays, &cells, width);
    assert_eq!((scene.step.rays, scene.step.live), (batch.rays.len(), batch.positions.len()));
    let mut positions = batch.positions.iter();
    for shown in &scene.rays {
        for (&t, &p) in shown.live.iter().zip(&mut positions) {
            assert!(shown.at(t).distance(Vec3::from(p)) < 1e-4);
            assert!((scene.bounds.near..=scene.bounds.far).contains(&t));
        }
    }
    let edges = scene.outline();
    assert!(scene.live() > 0 && edges.len() == 12);
    assert!(
        edges.iter().all(|edge| (*edge.first().unwrap() - *edge.last().unwrap()).abs().min_element() == 0.0)
    );
}

#[test]
fn one_camera_has_its_own_rays_alone_and_in_the_page() {
    let data = small();
    let config = Preset::Small.config();
    let all = Scene::new(&data, &config, &request(&data.train)).unwrap();
    let one = Request { camera: Some(4), ..request(&data.train) };
    let one = Scene::new(&data, &config, &one).unwrap();
    assert_eq!((one.cameras.len(), one.cameras[0].index, one.rays.len()), (1, 4, 20));
    let own = &all.cameras[4].own_rays;
    assert!(own.len() >= 4 && own.iter().all(|ray| ray.camera == 4));
    for (a, b) in own.iter().zip(&one.rays) {
        assert_eq!((a.origin, a.dir, &a.live), (b.origin, b.dir, &b.live));
    }
}

#[test]
fn what_is_not_there_is_named() {
    let data = small();
    let config = Preset::Small.config();
    let message = |request: &Request<'_>| Scene::new(&data, &config, request).unwrap_err().to_string();
    let far = Request { camera: Some(6), ..request(&data.train) };
    assert_eq!(message(&far), "--camera: expected less than 6 (split `train`), found 6");
    let none = Request { split: "test", ..request(&data.test) };
    assert!(message(&none).contains("--split") && message(&none).contains("test"));
    let mut bad = Preset::Small.config();
    bad.sampling.near = Some(9.0);
    assert!(Scene::new(&data, &bad, &request(&data.train)).is_err());
}

#[test]
fn frusta_follow_the_picture() {
    let data = small();
    let scene = Scene::new(&data, &Preset::Small.config(), &request(&data.train)).unwrap();
    let camera = &scene.cameras[0];
    let pose = camera.camera.pose();
    let i = *camera.camera.intrinsics();
    let local = camera.corners(2.0).map(|p| pose.rotation.transpose() * (p - pose.position));
    let (x, y) = (2.0 * i.cx / i.fx, 2.0 * i.cy / i.fy);
    for (found, expected) in local.iter().zip([(-x, y), (x, y), (x, -y), (-x, -y)]) {
        assert!(found.distance(Vec3::new(expected.0, expected.1, -2.0)) < 1e-4, "{found}");
    }
}

#[test]
fn lengths_are_round() {
    for (length, expected) in [(1.4, 1.0), (2.0, 2.0), (0.07, 0.05), (99.0, 50.0)] {
        assert!((round_length(length) / expected - 1.0).abs() < 1e-5, "{length}");
    }
}

#[test]
fn pages_hold_pictures_and_names() {
    let mut data = small();
    data.name = "<b>&\"".into();
    let scene = Scene::new(&data, &Preset::Small.config(), &request(&data.train)).unwrap();
    let page = page::page(&scene).unwrap();
    assert!(!page.contains("<b>&") && page.contains("<title>&lt;b&gt;&amp;&quot;"));
    assert!(!page.contains("{{") && page.matches("data:image/jpeg;base64,").count() == 6);
}

#[test]
fn numbers_are_short() {
    assert_eq!([short(2.0), short(1.23456), short(-0.5), short(10.0)], ["2", "1.235", "-0.5", "10"]);
}
