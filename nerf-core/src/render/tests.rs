extern crate std;

mod batches;
mod collisions;
#[cfg(feature = "contraction")]
mod contraction;
#[cfg(feature = "grid")]
mod deferred;
mod effects;
#[cfg(feature = "grid")]
mod grid;
mod segments;
mod views;

use super::*;
use crate::blob::{Blob, StoredOccupancy};
use crate::camera::{Camera, Intrinsics, Lens, Pose};
use crate::math::MathBackend;
use crate::matrix::Kernel;
use crate::memory::Line;
use crate::network::{Architecture, Role};
use crate::plan::{Batch, Outputs, Plan, Quality};
use crate::sampling::Bins;
use crate::simd::BLOCK;
use crate::space::SceneBox;
use crate::testing::{SCENE, Worse, architecture, body, bytes, every_kind, halve, parameters, pi};
use crate::volume::Pixel;
use glam::Vec3;
use std::vec;
use std::vec::Vec;

pub(super) fn camera(width: u32, height: u32) -> Camera {
    let pose = Pose::look_at(Vec3::new(1.0, 2.0, 3.3), Vec3::new(0.1, 0.0, -0.1), Vec3::Y).unwrap();
    Camera::new(Intrinsics::centred(width, height, width.max(height) as f32), Lens::NONE, pose).unwrap()
}

/// Parameters of a network with density `sigma` and colour `sigmoid(raw)` everywhere; all weights are 0.
pub(super) fn constant(a: &Architecture, sigma: f32, raw: [f32; 3]) -> Vec<f32> {
    let mut all = vec![0.0; a.parameters()];
    for layer in &a.layers() {
        match layer.role {
            Role::Density => all[layer.bias] = sigma,
            Role::Rgb => all[layer.bias..layer.bias + 3].copy_from_slice(&raw),
            _ => {}
        }
    }
    all
}

pub(super) struct Picture {
    pub pixels: Vec<Pixel>,
    pub counters: Counters,
}

pub(super) fn render(renderer: &Renderer<'_>, plan: &Plan<'_>, camera: &Camera) -> Picture {
    let rect = Rect::full(camera);
    let none = Pixel { rgb: [f32::NAN; 3], opacity: f32::NAN, ..Pixel::BLANK };
    let mut pixels = vec![none; (rect.width * rect.height) as usize];
    let mut memory = vec![Line::UNINIT; renderer.workspace_lines(plan)];
    let mut put = |x: u32, y: u32, pixel: &Pixel| pixels[(y * rect.width + x) as usize] = *pixel;
    let counters = renderer.render(plan, camera, rect, &mut memory, &mut put).unwrap();
    Picture { pixels, counters }
}

pub(super) fn kernels() -> impl Iterator<Item = Kernel> {
    Kernel::all()
}

#[test]
fn a_constant_medium_has_the_closed_form() {
    let a = architecture(pi(3, 4), Some(pi(3, 2)), &[(16, false)], &[8]);
    let (sigma, raw) = (0.75f32, [0.0f32, 2.0, -1.0]);
    let (weights, _) = halve(&constant(&a, sigma, raw));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let camera = camera(20, 13);
    let (bins, scene_box) =
        (Bins::new(2.0, 6.0, 32).unwrap(), SceneBox { min: Vec3::NEG_ONE, max: Vec3::ONE });
    for kernel in kernels() {
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::FULL).unwrap();
        let picture = render(&renderer, &plan, &camera);
        let (mut worst, mut worst_distance, mut hits) = (0.0f64, 0.0f64, 0);
        for (i, pixel) in picture.pixels.iter().enumerate() {
            let ray = camera.ray((i % 20) as f32 + 0.5, (i / 20) as f32 + 0.5);
            let inside: Vec<f64> = (0..32)
                .map(|i| bins.at(i, 0.5))
                .filter(|&t| scene_box.contains(ray.at(t)))
                .map(f64::from)
                .collect();
            if inside.is_empty() {
                let empty = Pixel {
                    rgb: SCENE.background,
                    opacity: 0.0,
                    ray_distance: 6.0,
                    z_depth: 6.0,
                    ..Pixel::BLANK
                };
                assert_eq!(*pixel, empty);
                continue;
            }
            hits += 1;
            let tau = f64::from(sigma) * 0.125;
            let opacity = -(-tau * inside.len() as f64).exp_m1();
            worst = worst.worse((f64::from(pixel.opacity) - opacity).abs());
            for (c, raw) in raw.into_iter().enumerate() {
                let colour = 1.0 / (1.0 + f64::from(-raw).exp());
                let seen = opacity * colour + (1.0 - opacity) * f64::from(SCENE.background[c]);
                worst = worst.worse((f64::from(pixel.rgb[c]) - seen).abs());
            }
            let weight = |(i, t): (usize, &f64)| (-tau * i as f64).exp() * -(-tau).exp_m1() * t;
            let distance = inside.iter().enumerate().map(weight).sum::<f64>() / opacity;
            let z = distance * f64::from(camera.z_per_distance(&ray));
            worst_distance = worst_distance.worse((f64::from(pixel.ray_distance) - distance).abs());
            worst_distance = worst_distance.worse((f64::from(pixel.z_depth) - z).abs());
        }
        std::println!("{kernel:?}: {hits} hits, {worst:e}, distances {worst_distance:e}");
        assert!(hits > 50 && hits < 260 && worst <= 1e-6 && worst_distance <= 4e-6);
    }
}

#[test]
fn no_density_is_background_at_far_and_no_colour_is_computed() {
    let a = every_kind();
    let (weights, _) = halve(&constant(&a, -1.0, [1.0; 3]));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::SMALLEST).unwrap();
    for background in [SCENE.background, [0.0; 3], [1.0, 0.0, 0.125]] {
        let picture = render(&renderer, &plan.with_background(background).unwrap(), &camera(6, 5));
        let empty = Pixel { rgb: background, opacity: 0.0, ray_distance: 6.0, z_depth: 6.0, ..Pixel::BLANK };
        assert!(picture.pixels.iter().all(|pixel| *pixel == empty));
        assert_eq!(picture.counters.colour_evaluations, 0);
        assert!(picture.counters.samples_kept > 0);
    }
}

#[test]
fn counters_add_up_and_without_colour_only_the_density_is_paid() {
    let a = every_kind();
    let (weights, _) = halve(&constant(&a, 0.5, [0.0; 3]));
    let bits = [0b0110_1001];
    let bytes = bytes(&body(a.clone(), Some(StoredOccupancy { resolution: [2; 3], bits: &bits }), &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let camera = camera(11, 7);
    for quality in
        [Quality::EXACT, Quality::default(), Quality { transmittance_cut: 0.9, ..Quality::default() }]
    {
        let mut kept = None;
        for batch in [Batch::SMALLEST, Batch { rays: 9, samples: 5 }, Batch::FULL] {
            let plan = |outputs| Plan::new(&blob, &quality, outputs, batch).unwrap();
            let colour = render(&renderer, &plan(Outputs::ALL), &camera);
            let distance = Outputs { rgb: false, ..Outputs::ALL };
            let (with, without) = (colour.counters, render(&renderer, &plan(distance), &camera));
            for c in [with, without.counters] {
                assert_eq!(c.rays, 77);
                assert_eq!(c.rays * 32, c.samples_kept + c.samples_skipped);
                assert_eq!(c.samples_kept, c.density_evaluations);
                assert_eq!(c.invalid_samples, 0);
            }
            assert_eq!(*kept.get_or_insert(with.samples_kept), with.samples_kept, "in every batch");
            let density = with.density_evaluations * a.density_macs() as u64;
            assert_eq!(without.counters.colour_evaluations, 0);
            assert_eq!(without.counters.macs, density, "the trunk's share of the colour request");
            assert_eq!(without.counters.density_evaluations, with.density_evaluations);
            // The part of the colour branch that reads the encoded direction is evaluated once per ray.
            let per_ray = renderer.network().direction_macs() as u64;
            let per_sample = a.colour_macs() as u64 - per_ray;
            let rays = (with.macs - density - with.colour_evaluations * per_sample) / per_ray;
            assert!(rays > 0 && rays <= 77);
            for (a, b) in without.pixels.iter().zip(&colour.pixels) {
                assert_eq!((a.opacity, a.ray_distance, a.z_depth), (b.opacity, b.ray_distance, b.z_depth));
                assert_eq!(a.rgb, [0.0; 3], "colour was not asked for");
            }
        }
    }
}

#[test]
fn a_full_occupancy_changes_nothing() {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 21));
    let bits = [0xff; 43];
    let bytes = bytes(&body(
        a,
        Some(StoredOccupancy { resolution: [7, 7, 7], bits: &[&bits[..42], &[0x7f]].concat() }),
        &weights,
    ));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let gated = Quality { occupancy: true, ..Quality::EXACT };
    let plan = |quality: &Quality| Plan::new(&blob, quality, Outputs::ALL, Batch::SMALLEST).unwrap();
    let (a, b) = (
        render(&renderer, &plan(&gated), &camera(9, 9)),
        render(&renderer, &plan(&Quality::EXACT), &camera(9, 9)),
    );
    assert_eq!(a.pixels, b.pixels);
    assert_eq!(a.counters, b.counters);
}

#[test]
fn query_refuses_lengths_and_ignores_points_outside() {
    let a = every_kind();
    let (weights, _) = halve(&constant(&a, 0.5, [0.0; 3]));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::SMALLEST).unwrap();
    let mut memory = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let points = [[0.0; 3], [1.0; 3], [1.01, 0.0, 0.0], [f32::NAN; 3], [f32::INFINITY; 3]];
    let dirs = [[0.0, 0.0, 1.0]; 5];
    let (mut sigma, mut rgb) = ([9.0; 5], [[9.0; 3]; 5]);
    let counters = renderer.query(&plan, &points, &dirs, &mut memory, &mut sigma, &mut rgb).unwrap();
    assert_eq!(sigma, [0.5, 0.5, 0.0, 0.0, 0.0]);
    assert_eq!(rgb, [[0.5; 3], [0.5; 3], [0.0; 3], [0.0; 3], [0.0; 3]]);
    assert_eq!(counters.density_evaluations, 2);
    let lengths = RenderError::Lengths { positions: 5, dirs: 4, sigma: 5, rgb: 5 };
    let found = renderer.query(&plan, &points, &dirs[..4], &mut memory, &mut sigma, &mut rgb);
    assert_eq!(found, Err(lengths));
    assert_eq!(renderer.query(&plan, &[], &[], &mut memory, &mut [], &mut []), Ok(Counters::default()));
    // A direction that is not of unit length is an error if colour is requested, and is ignored otherwise.
    let mut dirs = dirs;
    dirs[3] = [0.0, 1e30, 0.0];
    let error = RenderError::Direction { index: 3, found: dirs[3] };
    assert_eq!(renderer.query(&plan, &points, &dirs, &mut memory, &mut sigma, &mut rgb), Err(error));
    assert!(std::format!("{error}").contains("dirs[3]: expected a vector of unit length"));
    let shape = Outputs { rgb: false, ..Outputs::ALL };
    let plan = Plan::new(&blob, &Quality::EXACT, shape, Batch::SMALLEST).unwrap();
    let found = renderer.query(&plan, &points, &dirs, &mut memory, &mut sigma, &mut rgb);
    assert_eq!(found.unwrap().density_evaluations, 2);
}

#[test]
fn samples_that_are_no_numbers_are_counted_the_same_in_every_batch() {
    let a = architecture(pi(3, 4), None, &[(16, false)], &[]);
    let (weights, unpacked) = halve(&parameters(&a, 41));
    let bytes = bytes(&body(a.clone(), None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let layers = a.layers();
    let at = |role| layers.iter().find(|layer| layer.role == role).unwrap();
    // The red output is NaN. The density is 0 at about half of the samples.
    let mut broken = unpacked.clone();
    broken[at(Role::Rgb).bias] = f32::NAN;
    broken[at(Role::Density).bias] -= 0.5;
    let renderer = Renderer::with_parameters(blob.clone(), Kernel::IN_PLACE, &broken, None).unwrap();
    let mut seen = vec![];
    for batch in
        [Batch { rays: 1, samples: 64 }, Batch { rays: 7, samples: 64 }, Batch { rays: 256, samples: 64 }]
    {
        let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, batch).unwrap();
        let picture = render(&renderer, &plan, &camera(12, 12));
        // Samples are black, so that a pixel shows the background alone.
        for pixel in &picture.pixels {
            assert_eq!(pixel.rgb, SCENE.background.map(|c| (1.0 - pixel.opacity) * c));
        }
        let no_colour = Outputs { rgb: false, ..Outputs::ALL };
        let plan = Plan::new(&blob, &Quality::EXACT, no_colour, batch).unwrap();
        let shape = render(&renderer, &plan, &camera(12, 12));
        assert_eq!(shape.counters.invalid_samples, 0);
        for (a, b) in picture.pixels.iter().zip(&shape.pixels) {
            assert_eq!((a.opacity, a.ray_distance), (b.opacity, b.ray_distance));
        }
        assert!(picture.pixels.iter().any(|pixel| pixel.opacity > 0.1));
        seen.push(picture.counters.invalid_samples);
    }
    assert!(seen[0] > 0 && seen.iter().all(|&n| n == seen[0]), "{seen:?}");
    // A query counts NaN colours, too, and returns black.
    let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::FULL).unwrap();
    let mut memory = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let points: Vec<[f32; 3]> = crate::testing::noise(300, 2).chunks(3).map(|p| [p[0], p[1], p[2]]).collect();
    let (mut sigma, mut rgb) = (vec![9.0; 100], vec![[9.0; 3]; 100]);
    let dirs = vec![[0.0, 0.0, 1.0]; 100];
    let counters = renderer.query(&plan, &points, &dirs, &mut memory, &mut sigma, &mut rgb).unwrap();
    assert!(sigma.iter().any(|&s| s > 0.0) && rgb.iter().all(|&c| c == [0.0; 3]));
    assert_eq!(counters.invalid_samples, sigma.iter().filter(|&&s| s > 0.0).count() as u64);
}

#[test]
fn parameters_of_another_architecture_are_no_lack_of_memory() {
    let a = every_kind();
    let (weights, _) = halve(&constant(&a, 0.5, [0.0; 3]));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap().with_weights(&weights[2..]);
    assert_eq!(Renderer::new(blob, Kernel::IN_PLACE, &mut []).unwrap_err(), RenderError::Network);
}

#[test]
fn rectangles_outside_the_image_and_small_workspaces_are_refused() {
    let a = every_kind();
    let (weights, _) = halve(&constant(&a, 0.5, [0.0; 3]));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let camera = camera(8, 6);
    for kernel in kernels() {
        let need = Renderer::prepared_lines(&blob, kernel);
        if need > 0 {
            let error = RenderError::Memory { expected: need, found: need - 1 };
            let mut short = vec![Line::UNINIT; need - 1];
            assert_eq!(Renderer::new(blob.clone(), kernel, &mut short).unwrap_err(), error);
        }
        let mut memory = vec![Line::UNINIT; need];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch { rays: 3, samples: 1 }).unwrap();
        let lines = renderer.workspace_lines(&plan);
        let mut workspace = vec![Line::UNINIT; lines];
        let mut put = |_: u32, _: u32, _: &Pixel| panic!("nothing is written");
        let full = Rect::full(&camera);
        let found = renderer.render(&plan, &camera, full, &mut workspace[..lines - 1], &mut put);
        assert_eq!(found, Err(RenderError::Memory { expected: lines, found: lines - 1 }));
        for rect in [
            Rect { width: 9, ..full },
            Rect { x: 8, width: 1, ..full },
            Rect { y: u32::MAX, ..full },
            Rect { x: 2, width: u32::MAX, ..full },
        ] {
            let found = renderer.render(&plan, &camera, rect, &mut workspace, &mut put);
            assert_eq!(found, Err(RenderError::Rect { rect, width: 8, height: 6 }));
        }
        let empty = Rect { x: 8, y: 6, width: 0, height: 0 };
        let found = renderer.render(&plan, &camera, empty, &mut workspace, &mut put);
        assert_eq!(found, Ok(Counters::default()));
    }
}

#[test]
fn the_most_rays_a_plan_allows_can_be_asked_for_their_workspace() {
    let a = every_kind();
    let (weights, _) = halve(&constant(&a, 0.5, [0.0; 3]));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let batch = Batch { rays: Batch::MAX_RAYS, samples: 1 };
    let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, batch).unwrap();
    assert!(renderer.workspace_lines(&plan) > Batch::MAX_RAYS);
    let found =
        renderer.render(&plan, &camera(2, 2), Rect::full(&camera(2, 2)), &mut [], &mut |_, _, _: &Pixel| {});
    assert!(matches!(found, Err(RenderError::Memory { found: 0, .. })));
}

#[test]
fn every_backend_renders_about_the_same_picture() {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 51));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let go = |math| {
        let quality = Quality { math, ..Quality::EXACT };
        let plan = Plan::new(&blob, &quality, Outputs::ALL, Batch::SMALLEST).unwrap();
        render(&renderer, &plan, &camera(6, 6)).pixels
    };
    let exact = go(MathBackend::Polynomial);
    let rows = [
        #[cfg(feature = "libm")]
        (MathBackend::Libm, 1e-5),
        #[cfg(feature = "micromath")]
        (MathBackend::Micromath, 0.05),
        (MathBackend::Recurrence, 1e-4),
    ];
    for (math, limit) in rows {
        let worst = go(math).iter().zip(&exact).fold(0.0f32, |worst, (a, b)| {
            let off = a.rgb.iter().zip(&b.rgb).map(|(a, b)| (a - b).abs());
            off.fold(worst, Worse::worse).worse((a.opacity - b.opacity).abs())
        });
        std::println!("{math:?}: {worst:e}");
        assert!(worst <= limit, "{math:?}: {worst:e}");
    }
}

#[test]
fn the_seed_network_takes_the_memory_the_docs_say() {
    let trunk: Vec<_> = (0..8).map(|i| (256, i == 4)).collect();
    let a = architecture(pi(3, 10), Some(pi(3, 4)), &trunk, &[128]);
    assert_eq!(a.parameters(), 530_052);
    let (weights, unpacked) = halve(&constant(&a, 0.0, [0.0; 3]));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let lines = |renderer: &Renderer<'_>, outputs, batch| {
        renderer.workspace_lines(&Plan::new(&blob, &Quality::EXACT, outputs, batch).unwrap())
    };
    let in_place = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    assert_eq!(lines(&in_place, Outputs::ALL, Batch::SMALLEST) * size_of::<Line>(), 3_584);
    let no_colour = Outputs { rgb: false, ..Outputs::ALL };
    assert_eq!(lines(&in_place, no_colour, Batch::SMALLEST) * size_of::<Line>(), 2_880);
    let prepared = Renderer::with_parameters(blob.clone(), Kernel::IN_PLACE, &unpacked, None).unwrap();
    let batch = Batch::FULL;
    assert_eq!(lines(&prepared, Outputs::ALL, batch) * size_of::<Line>(), 392_192);
    #[cfg(feature = "anti-aliasing")]
    for anti_aliasing in [2, 256] {
        let effects = crate::plan::Effects { anti_aliasing, ..crate::plan::Effects::NONE };
        let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, batch).unwrap();
        let plan = plan.with_effects(effects).unwrap();
        assert_eq!(prepared.workspace_lines(&plan) * size_of::<Line>(), 406_528);
    }
    assert_eq!(
        Renderer::prepared_lines(&blob, Kernel::new(crate::Isa::Avx2, crate::Storage::F32))
            * size_of::<Line>(),
        2_120_256
    );
}
