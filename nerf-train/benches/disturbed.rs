//! Fits of faulty captures: photographs of the demo's scene in a room, unchanged and with one fault each.
//!
//! `cargo bench -p nerf-train --bench disturbed -- FILE.png` fits each capture for 4,000 steps, and prints the PSNR of
//! held-out views. Learned gains, pose refinement and the search for moving objects are turned off. The command writes
//! the picture of the guide's "When it goes wrong": a held-out photograph, and each fit's rendering of it.

use glam::{Quat, Vec3};
use nerf_core::Kernel;
use nerf_core::camera::{Camera, Pose};
use nerf_train::cli::{SetOption, read_config};
use nerf_train::data::demo::{DemoSpec, dataset};
use nerf_train::data::pictures::rgb::Picture;
use nerf_train::data::{Background, Dataset, View, over};
use nerf_train::fit::run::{Ended, RunOptions, run};
use nerf_train::measure::frame;
use nerf_train::model::config::{Exposure, MovingObjects, PoseRefinement, Preset, Surroundings};
use nerf_train::show::contact_sheet::{Cell, contact_sheet};
use nerf_train::system::progress::ProgressStyle;
use nerf_train::train::schedule::Budget;
use std::path::Path;

type Disturb = fn(&mut Dataset);

const STEPS: u32 = 4_000;
/// Half of the side of the room around the scene, world units.
const ROOM: f32 = 8.0;
/// Captures to fit: caption, and function that puts the fault into the photographs.
const WAYS: [(&str, Disturb); 5] = [
    ("as it should be", |_| {}),
    ("fog: no photograph from this side", gap),
    ("blur: poses off by 1° and 1 %, not refined", poses),
    ("floaters: something moved", object),
    ("blotches: exposure off by ±1 EV, one gain for all", exposure),
];

fn main() {
    let file = std::env::args().skip(1).find(|argument| argument != "--bench").expect("FILE.png");
    let clean = photographs();
    let mut cells = vec![Cell::new(picture(&clean.val[0]), "photograph")];
    for (name, disturb) in WAYS {
        let mut capture = clean.clone();
        disturb(&mut capture);
        let options = RunOptions::unattended(
            Budget { steps: Some(STEPS), seconds: None },
            Kernel::detect(),
            ProgressStyle::Quiet,
        );
        let options = RunOptions { report: true, validate_every: Some(u32::MAX), ..options };
        let mut config = read_config(Preset::Grid, None, &SetOption::default(), Surroundings::Unbounded)
            .expect("settings");
        config.optimiser.steps = STEPS;
        // What would mend exposure, poses and what moved.
        (config.capture.exposure, config.capture.poses) = (Exposure::Shared, PoseRefinement::Given);
        config.capture.moving = MovingObjects::Off;
        let Ended::Finished(outcome) = run(&capture, config, &options, &|_| false).expect("a run") else {
            unreachable!("nobody stops it")
        };
        let shown = outcome.shown.iter().find(|shown| shown.view == 0).expect("the first view");
        println!(
            "{name}: {:.2} dB; {:.2} dB shown",
            outcome.scores.psnr_db().unwrap_or(f64::NAN),
            shown.psnr_db
        );
        cells.push(Cell::new(frame::picture(&shown.frame), name));
    }
    contact_sheet("", &cells, 3).write_png(Path::new(&file)).expect("FILE.png: written");
}

/// Returns the demo's views from cameras at z = 0.2 to 2.4 world units, with the walls of a room as background. The
/// data set does not say which pixels are background.
fn photographs() -> Dataset {
    let spec = DemoSpec { train: 120, val: 16, size: 200, ..DemoSpec::default() };
    let mut data = dataset(&spec).expect("a scene");
    // From above alone, as people stand.
    for views in [&mut data.train, &mut data.val] {
        views.retain(|view| (0.2..2.4).contains(&view.camera.pose().position.z));
    }
    for view in data.train.iter_mut().chain(&mut data.val) {
        let (width, camera) = (view.size().0 as usize, view.camera);
        for (i, pixel) in view.pixels.iter_mut().enumerate() {
            let ray = camera.ray((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
            let wall = wall(ray.origin, ray.dir);
            let [r, g, b] = over(*pixel, wall).map(|c| (255.0 * c + 0.5) as u8);
            *pixel = [r, g, b, 255];
        }
    }
    data.background = Background::Unknown;
    (data.near, data.far) = (None, None);
    data
}

/// Returns the colour of the room at the point where a ray from inside meets it: tiles on the floor, pictures on the
/// walls.
fn wall(origin: Vec3, dir: Vec3) -> [f32; 3] {
    let far = (Vec3::splat(ROOM).copysign(dir) - origin) / dir;
    let t = far.min_element();
    let (p, plane) = (origin + t * dir, far.to_array().iter().position(|&f| f == t).unwrap_or(2));
    let (u, v) = match plane {
        0 => (p.y, p.z),
        1 => (p.x, p.z),
        _ => (p.x, p.y),
    };
    let line = |w: f32| (w / 2.0).fract().abs() < 0.04;
    match (plane, dir.z < 0.0) {
        (2, true) if line(u) || line(v) => [0.35, 0.33, 0.3],
        (2, true) => [0.72, 0.68, 0.6],
        (2, false) => [0.9, 0.9, 0.88],
        _ if (u / 5.0).fract().abs() < 0.5 && v.abs() < 2.0 => {
            [0.3 + 0.06 * (v * 3.0).floor().abs(), 0.4, 0.25 + 0.05 * (u * 3.0).floor().rem_euclid(9.0)]
        }
        _ => [0.8, 0.78, 0.74],
    }
}

/// Removes the training photographs within 75 degrees of azimuth of the first held-out photograph.
fn gap(data: &mut Dataset) {
    let azimuth = |view: &View| {
        let eye = view.camera.pose().position;
        Vec3::new(eye.x, eye.y, 0.0).normalize_or_zero()
    };
    let side = azimuth(&data.val[0]);
    data.train.retain(|view| azimuth(view).dot(side) < 75f32.to_radians().cos());
}

/// Rotates each training camera by 1 degree about a different axis, and moves it by 1 % of its distance to the origin.
fn poses(data: &mut Dataset) {
    for (i, view) in data.train.iter_mut().enumerate() {
        let [x, y, z] = numbers(i).map(|u| u - 0.5);
        let axis = Vec3::new(x, y, z).normalize();
        let turned = glam::Mat3::from_quat(Quat::from_axis_angle(axis, 1f32.to_radians()));
        let pose = view.camera.pose();
        let position = pose.position + 0.01 * pose.position.length() * Vec3::new(z, x, y).normalize();
        let pose = Pose { rotation: turned * pose.rotation, position };
        view.camera = Camera::new(*view.camera.intrinsics(), *view.camera.lens(), pose).expect("a camera");
    }
}

/// Paints an orange rectangle into every third training photograph, each time at a different place.
fn object(data: &mut Dataset) {
    for (i, view) in data.train.iter_mut().enumerate().filter(|(i, _)| i % 3 == 0) {
        let (width, height) = view.size();
        let [x, y, _] = numbers(i);
        let (left, top) = ((x * 0.65 * width as f32) as u32, (y * 0.6 * height as f32) as u32);
        for y in top..top + height * 2 / 5 {
            for x in left..left + width * 35 / 100 {
                view.pixels[(y * width + x) as usize] = [220, 130, 40, 255];
            }
        }
    }
}

/// Multiplies the linear light of each training photograph by a gain from 2^-1 to 2^1.
fn exposure(data: &mut Dataset) {
    for (i, view) in data.train.iter_mut().enumerate() {
        let gain = (2.0 * numbers(i)[0] - 1.0).exp2();
        for pixel in &mut view.pixels {
            for c in &mut pixel[..3] {
                let light = (f32::from(*c) / 255.0).powf(2.2) * gain;
                *c = (255.0 * light.min(1.0).powf(1.0 / 2.2) + 0.5) as u8;
            }
        }
    }
}

/// Returns element `i` of a sequence of points in the unit cube whose neighbours are far apart (Roberts's sequence).
fn numbers(i: usize) -> [f32; 3] {
    [0.819_172_5, 0.671_043_6, 0.549_700_5].map(|step: f32| (0.2 + step * i as f32).fract())
}

fn picture(view: &View) -> Picture {
    let (width, height) = view.size();
    let rgb = view.pixels.iter().map(|&pixel| over(pixel, [0.0; 3])).collect();
    Picture::new(width as usize, height as usize, rgb).expect("a picture")
}
