extern crate std;

use super::*;
use crate::Kernel;
use crate::blob::{Body, FrontPoint, ParetoFront};
use crate::camera::{Intrinsics, Lens, Pose};
use crate::plan::{Batch, Outputs};
use crate::testing::{body, bytes, every_kind, halve, parameters};
use glam::Vec3;
use std::vec;
use std::vec::Vec;

/// Three points of a Pareto front: number of samples, PSNR loss in dB, relative cost.
const POINTS: [(u16, f32, f32); 3] = [(32, 0.0, 1.0), (16, 0.1, 0.5), (4, 0.9, 0.1)];

fn scene(points: &[(u16, f32, f32)]) -> Vec<u8> {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 31));
    let point = |&(samples, loss_db, cost): &(u16, f32, f32)| FrontPoint {
        samples,
        transmittance_cut: 0.0,
        colour_cut: 0.0,
        occupancy: false,
        math: 0,
        proposal: false,
        loss_db,
        cost,
    };
    let front: ParetoFront = points.iter().map(point).collect();
    bytes(&Body { front, ..body(a, None, &weights) })
}

fn camera(width: u32, height: u32) -> Camera {
    let pose = Pose::look_at(Vec3::new(1.0, 2.0, 3.3), Vec3::ZERO, Vec3::Y).unwrap();
    Camera::new(Intrinsics::centred(width, height, width as f32), Lens::NONE, pose).unwrap()
}

/// Makes a [`Pace`] with the measured times `times` at the first points, and infinity at all other points.
fn pace_of(times: &[f32]) -> Pace {
    let mut pace = Pace::UNKNOWN;
    pace.milliseconds[..times.len()].copy_from_slice(times);
    pace
}

#[test]
fn a_time_buys_the_least_loss_it_can() {
    let bytes = scene(&POINTS);
    let blob = Blob::open(&bytes).unwrap();
    let pace = pace_of(&[80.0, 40.0, 10.0]);
    for (wish, samples, within) in
        [(1e9, 32, true), (80.0, 32, true), (79.9, 16, true), (10.0, 4, true), (9.9, 4, false)]
    {
        let (choice, time) = pace.within(&blob, wish).unwrap();
        assert_eq!((choice.quality.samples, choice.within), (samples, within), "{wish} ms");
        assert_eq!(time <= wish, within);
    }
    // A point with fewer multiply-adds may take longer on this host.
    let odd = pace_of(&[20.0, 40.0, 10.0]);
    assert_eq!(odd.within(&blob, 30.0).unwrap().0.quality.samples, 32);
    assert_eq!(Pace::UNKNOWN.within(&blob, 1e9), None);
    let (bare, pace) = (scene(&[]), pace_of(&[1.0]));
    assert_eq!(pace.within(&Blob::open(&bare).unwrap(), 1e9), None);
}

#[test]
fn a_pace_is_read_from_the_caller_s_clock_cheapest_point_first() {
    let bytes = scene(&POINTS);
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let plan = Plan::new(&blob, &Quality::default(), Outputs::ALL, Batch::FULL).unwrap();
    let mut workspace = vec![Line::UNINIT; Pace::lines(&renderer, &plan)];
    assert!(workspace.len() >= renderer.workspace_lines(&plan));
    let camera = camera(200, 100);
    // Simulated time of each render, ms: 7 for the warm-up, then 4 and 3, 30 and 20, 100 and 200 for the three points.
    let go = |limit: f32, workspace: &mut [Line]| {
        let takes = [7_000u64, 4_000, 3_000, 30_000, 20_000, 100_000, 200_000];
        let (mut now, mut calls) = (1_000_000, 0usize);
        let mut clock = || {
            now += if calls % 2 == 1 { takes[calls / 2] } else { 13 };
            calls += 1;
            now
        };
        let pace = Pace::measure(&renderer, &plan, &camera, limit, workspace, &mut clock);
        (pace, calls)
    };
    // Every 4th pixel of every 4th row is timed: 50 × 25 of the 20,000 pixels, 1/16 of the frame.
    let frame = |sample: f32| sample * 16.0;
    let (pace, calls) = go(1e9, &mut workspace);
    assert_eq!((pace.unwrap(), calls), (pace_of(&[frame(100.0), frame(20.0), frame(3.0)]), 14));
    let (pace, calls) = go(300.0, &mut workspace);
    let pace = pace.unwrap();
    assert_eq!((pace.milliseconds[1], pace.milliseconds[0], calls), (frame(20.0), f32::INFINITY, 10));
    let short = workspace.len() - 1;
    let (refused, calls) = go(1e9, &mut workspace[..short]);
    assert_eq!((refused, calls), (Err(RenderError::Memory { expected: short + 1, found: short }), 0));
}

#[test]
fn a_thinned_camera_sees_the_middles_of_its_larger_pixels() {
    for (width, height, right, down) in [(200, 100, 4, 4), (201, 103, 4, 7), (3, 2, 3, 1), (7, 7, 1, 1)] {
        let camera = camera(width, height);
        let thin = camera.thinned(right, down);
        let i = thin.intrinsics();
        assert_eq!((i.width, i.height), (width / right, height / down));
        for (x, y) in [(0.5, 0.5), (i.width as f32 - 0.5, i.height as f32 - 0.5)] {
            let (a, b) = (thin.ray(x, y), camera.ray(x * right as f32, y * down as f32));
            assert!((a.dir - b.dir).length() < 1e-6 && a.origin == b.origin);
        }
    }
}

#[test]
fn a_view_of_any_shape_is_sampled_all_over_by_about_as_many_rays() {
    let sides = [1, 2, 3, 40, 57, 200, 4096, 65_536, 1 << 23];
    for (width, height) in sides.into_iter().flat_map(|w| sides.map(|h| (w, h))) {
        let pose = Pose::look_at(Vec3::new(0.0, 0.0, 4.0), Vec3::ZERO, Vec3::Y).unwrap();
        let intrinsics = Intrinsics::centred(width, height, width.max(height) as f32);
        let camera = Camera::new(intrinsics, Lens::NONE, pose).unwrap();
        let (right, down) = steps(&camera);
        assert!((1..=width).contains(&right) && (1..=height).contains(&down));
        let (all, sample) = (pixels(&camera), pixels(&camera.thinned(right, down)));
        assert!(sample <= SAMPLED_RAYS, "{width}x{height}: {sample}");
        assert!(sample == all || sample >= SAMPLED_RAYS / 8, "{width}x{height}: {sample}");
    }
}
