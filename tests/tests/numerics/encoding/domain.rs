//! Inputs outside the encoding's domain never reach the encoding: boxes, points, directions and cameras are refused
//! before.

use crate::blob::{SCENE, body};
use crate::table::{Row, Worst, cases};
use nerf_core::Kernel;
use nerf_core::blob::{Blob, BlobError, Body, Content, SceneFacts, encoded_len};
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
use nerf_core::memory::Line;
use nerf_core::network::Architecture;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Counters, RenderError, Renderer};
use nerf_testing::scenes::{Recipe, kernels};

cases! {
    boxes_that_leave_the_domain_are_refused: "scenes that are written all the same, or refused within it" => boxes;
    points_outside_of_the_box_are_not_encoded: "answers but density 0, black, without work" => outside;
    directions_that_are_none_are_refused: "answers that are no typed error" => directions;
    cameras_at_no_place_are_refused: "cameras of them" => cameras;
}

/// Sizes far beyond any domain, infinities, and NaN.
const FAR: [f32; 5] = [1e30, f32::MAX, f32::INFINITY, f32::NEG_INFINITY, f32::NAN];

fn boxes() -> Vec<Row> {
    let mut worst = Worst::default();
    let recipe = Recipe { occupancy: None, ..Recipe::TINY };
    for scale in [AngleScale::Pi, AngleScale::One] {
        for levels in 0..=16u8 {
            let position = SinusoidalEncoding { inputs: 3, levels, scale, identity: true };
            let architecture = Architecture { position: position.into(), ..recipe.architecture() };
            let weights = vec![0; 2 * architecture.parameters()];
            let highest = 2f32.powi(i32::from(levels.max(1)) - 1);
            let limit = if scale == AngleScale::One { 1e5 / highest } else { f32::MAX / highest };
            let refused = |side: f32| {
                let facts = SceneFacts { min: [-1.0, side.min(-1.0), -1.0], ..SCENE };
                let body = Body { content: Content::Scene(facts), ..body(architecture.clone(), &weights) };
                match encoded_len(&body) {
                    Ok(_) => false,
                    Err(BlobError::EncodingDomain { .. } | BlobError::Bounds(_)) => true,
                    Err(other) => panic!("{other}"),
                }
            };
            let mut check = |side: f32, expected: bool| {
                let wrong = f64::from(u8::from(refused(side) != expected));
                worst.see(wrong, || format!("{scale:?}, {levels} levels, a box to {side:e}"));
            };
            // A box of f32::MAX and 1 has no finite size.
            let edge = limit.min(1e38);
            check(-edge, false);
            if limit < 1e38 {
                check(-limit.next_up(), true);
            }
            check(-f32::INFINITY, true);
            if scale == AngleScale::One {
                check(-1e30, true);
            }
        }
    }
    vec![worst.row("any", "any", 0.0)]
}

/// Evaluates density and colour at one point.
fn ask(kernel: Kernel, position: [f32; 3], dir: [f32; 3]) -> Result<(f32, [f32; 3], Counters), RenderError> {
    let bytes = Recipe::PLAIN.blob();
    let blob = Blob::open(&bytes).expect("a blob");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
    let plan = Plan::new(&blob, &Quality::EXACT, Outputs::RGB, Batch::FULL).expect("a plan");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let (mut sigma, mut rgb) = ([7.0], [[7.0; 3]]);
    let counters = renderer.query(&plan, &[position], &[dir], &mut workspace, &mut sigma, &mut rgb)?;
    Ok((sigma[0], rgb[0], counters))
}

fn outside() -> Vec<Row> {
    let mut worst = Worst::default();
    for kernel in kernels() {
        for bad in FAR.into_iter().chain([-1e30, 1.0f32.next_up()]) {
            for axis in 0..3 {
                let mut p = [0.0; 3];
                p[axis] = if axis == 2 && bad == 1.0f32.next_up() { 1.5f32.next_up() } else { bad };
                let (sigma, rgb, work) = ask(kernel, p, [0.0, 0.0, -1.0]).expect("an answer");
                let nothing = sigma == 0.0 && rgb == [0.0; 3] && work == Counters::default();
                worst.see(f64::from(u8::from(!nothing)), || format!("{p:?}, {}", kernel));
            }
        }
    }
    vec![worst.row("any", "any", 0.0)]
}

fn directions() -> Vec<Row> {
    let mut worst = Worst::default();
    for kernel in kernels() {
        for bad in FAR.into_iter().chain([0.0, 0.99, 1.01, 1e-30, 1e15, -1e30]) {
            for axis in 0..3 {
                let mut dir = [0.0; 3];
                dir[axis] = bad;
                let refused =
                    matches!(ask(kernel, [0.0; 3], dir), Err(RenderError::Direction { index: 0, .. }));
                worst.see(f64::from(u8::from(!refused)), || format!("{dir:?}, {}", kernel));
            }
        }
    }
    vec![worst.row("any", "any", 0.0)]
}

fn cameras() -> Vec<Row> {
    let mut worst = Worst::default();
    for bad in FAR.into_iter().chain([-1e30]) {
        for at in 0..12 {
            let mut rows = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0]];
            rows[at / 4][at % 4] = bad;
            let camera = Camera::new(Intrinsics::centred(4, 4, 4.0), Lens::NONE, Pose::from_rows(rows));
            worst.see(f64::from(u8::from(camera.is_ok())), || format!("{rows:?}"));
        }
    }
    vec![worst.row("any", "any", 0.0)]
}
