extern crate std;

use super::LEAST_TRANSMITTANCE;
use crate::Kernel;
use crate::blob::{Blob, Body, ParetoFront, Proposal, StoredOccupancy};
use crate::camera::{Camera, Intrinsics, Lens, Pose};
use crate::encoding::{AngleScale, SinusoidalEncoding};
use crate::math::MathBackend;
use crate::memory::Line;
use crate::network::{Architecture, DensityActivation, Shading, TrunkLayer};
use crate::plan::{Batch, Outputs, Plan, Quality};
use crate::render::{Counters, Rect, RenderError, Renderer, Switch};
use crate::sampling::{Bins, sample_interval, sample_pdf};
use crate::testing::{SCENE, body, bytes, every_kind, halve, noise, parameters};
use crate::volume::{Accumulator, Pixel};
use glam::Vec3;
use std::string::ToString;
use std::vec;
use std::vec::Vec;

const COARSE: u32 = 20;
const DRAWN: u32 = 32;
const ROW: u64 = (COARSE + DRAWN) as u64;

/// Position encoding of the proposal network.
const POSITION: SinusoidalEncoding =
    SinusoidalEncoding { inputs: 3, levels: 3, scale: AngleScale::One, identity: true };

/// Architecture of a proposal network that is wider than the scene's network.
fn coarse_architecture() -> Architecture {
    Architecture {
        position: POSITION.into(),
        direction: None,
        trunk: [(40, false), (28, true)]
            .map(|(width, skip)| TrunkLayer { width, skip })
            .into_iter()
            .collect(),
        density: Some(DensityActivation::Relu),
        colour: [].into_iter().collect(),
        shading: Shading::PerSample,
    }
}

/// Parameters of the proposal network. The density layer's parameters are multiplied by 6, for steep densities.
fn coarse_parameters(seed: u32) -> Vec<f32> {
    let a = coarse_architecture();
    let mut all = parameters(&a, seed);
    all[a.layers()[2].weights..a.density_parameters()].iter_mut().for_each(|w| *w *= 6.0);
    all
}

/// Blob of the tests' scene. `coarse`: parameters of the scene's proposal network; `None` for a scene without one.
fn scene(occupancy: Option<StoredOccupancy<'_>>, coarse: Option<&[f32]>) -> Vec<u8> {
    let shape = coarse_architecture();
    scene_of(occupancy, coarse.map(|coarse| (&shape, coarse)))
}

fn scene_of(occupancy: Option<StoredOccupancy<'_>>, coarse: Option<(&Architecture, &[f32])>) -> Vec<u8> {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 7));
    let (coarse_weights, _) = halve(coarse.map_or(&[], |(_, parameters)| parameters));
    let proposal = coarse.map(|(shape, _)| Proposal {
        position: POSITION,
        trunk: shape.trunk.clone(),
        density: DensityActivation::Relu,
        samples: COARSE as u16,
        weights: &coarse_weights[..2 * shape.density_parameters()],
    });
    bytes(&Body { proposal, front: ParetoFront::new(), ..body(a, occupancy, &weights) })
}

fn camera(width: u32, height: u32) -> Camera {
    let pose = Pose::look_at(Vec3::new(1.0, 2.0, 3.3), Vec3::new(0.1, 0.0, -0.1), Vec3::Y).unwrap();
    Camera::new(Intrinsics::centred(width, height, width.max(height) as f32), Lens::NONE, pose).unwrap()
}

fn kernels() -> impl Iterator<Item = Kernel> {
    Kernel::all()
}

/// Renders a frame of the blob. Returns pixels, counters and the number of workspace lines.
fn render(bytes: &[u8], kernel: Kernel, quality: Quality, batch: Batch) -> (Vec<Pixel>, Counters, usize) {
    let blob = Blob::open(bytes).unwrap();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let plan = Plan::new(&blob, &quality, Outputs::ALL, batch).unwrap();
    let renderer = Renderer::new(blob, kernel, &mut memory).unwrap();
    let camera = camera(23, 19);
    let none = Pixel { rgb: [f32::NAN; 3], opacity: f32::NAN, ..Pixel::BLANK };
    let mut pixels = vec![none; 23 * 19];
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let mut put = |x: u32, y: u32, pixel: &Pixel| pixels[(y * 23 + x) as usize] = *pixel;
    let counters = renderer.render(&plan, &camera, Rect::full(&camera), &mut workspace, &mut put).unwrap();
    (pixels, counters, workspace.len())
}

/// Density and colour at the point `p` seen along `dir`, by `Renderer::query`.
fn ask(renderer: &Renderer<'_>, plan: &Plan<'_>, p: Vec3, dir: Vec3) -> (f32, [f32; 3]) {
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(plan)];
    let (mut sigma, mut rgb) = ([0.0], [[0.0; 3]]);
    let (p, dir) = ([p.to_array()], [dir.to_array()]);
    renderer.query(plan, &p, &dir, &mut workspace, &mut sigma, &mut rgb).unwrap();
    (sigma[0], rgb[0])
}

#[test]
fn a_picture_is_the_composite_of_the_drawn_samples_bit_for_bit() {
    let occupancy = [0b0111_1011];
    let coarse = coarse_parameters(11);
    // The proposal network as the network of a scene, so that a query gives its densities.
    let (coarse_weights, _) = halve(&coarse);
    for occupancy in [None, Some(StoredOccupancy { resolution: [2; 3], bits: &occupancy })] {
        let (bytes, alone) = (
            scene(occupancy.clone(), Some(&coarse)),
            crate::testing::bytes(&body(coarse_architecture(), occupancy.clone(), &coarse_weights)),
        );
        for (kernel, cut) in kernels().flat_map(|kernel| [(kernel, 0.0), (kernel, 0.3)]) {
            let occupancy = occupancy.is_some();
            let quality = Quality { transmittance_cut: cut, occupancy, ..Quality::EXACT };
            let (found, ..) = render(&bytes, kernel, quality, Batch::FULL);
            let (fine, coarse) = (Blob::open(&bytes).unwrap(), Blob::open(&alone).unwrap());
            let plain = Quality { proposal: false, ..quality };
            let plans =
                [&fine, &coarse].map(|blob| Plan::new(blob, &plain, Outputs::RGB, Batch::FULL).unwrap());
            let mut memory =
                [&fine, &coarse].map(|blob| vec![Line::UNINIT; Renderer::prepared_lines(blob, kernel)]);
            let [fine_memory, coarse_memory] = &mut memory;
            let fine = Renderer::new(fine, kernel, fine_memory).unwrap();
            let coarse = Renderer::new(coarse, kernel, coarse_memory).unwrap();
            let (camera, bins) = (camera(23, 19), Bins::new(2.0, 6.0, COARSE).unwrap());
            let mut hits = 0;
            for (i, found) in found.iter().enumerate().step_by(5) {
                let ray = camera.ray((i % 23) as f32 + 0.5, (i / 23) as f32 + 0.5);
                let mut row = vec![0.0; ROW as usize];
                let mut seen = Accumulator::NONE;
                for bin in 0..COARSE {
                    let t = bins.at(bin, 0.5);
                    let (sigma, _) = ask(&coarse, &plans[1], ray.at(t), ray.dir);
                    if sigma > 0.0 && seen.transmittance() >= LEAST_TRANSMITTANCE {
                        row[(DRAWN + bin) as usize] =
                            seen.add_density(MathBackend::Polynomial, sigma, t, bins.delta());
                    }
                }
                sample_pdf(&bins, &mut row, |_| 0.5);
                let mut ray_sum = Accumulator::NONE;
                for k in 0..row.len() {
                    let (sigma, rgb) = ask(&fine, &plans[0], ray.at(row[k]), ray.dir);
                    if sigma > 0.0 && ray_sum.transmittance() >= cut {
                        hits += 1;
                        ray_sum.add(
                            MathBackend::Polynomial,
                            sigma,
                            rgb,
                            row[k],
                            sample_interval(2.0, 6.0, &row, k).1,
                        );
                    }
                }
                let is_cut = ray_sum.transmittance() < cut;
                let cosine = camera.z_per_distance(&ray);
                let expected = ray_sum.finish_from(0.0, is_cut, SCENE.background, 6.0, cosine);
                assert_eq!(*found, expected, "{kernel:?}, cut {cut}, pixel {i}");
            }
            assert!(hits > 200, "{hits}");
        }
    }
}

#[test]
fn a_picture_does_not_depend_on_the_batch() {
    let bytes = scene(None, Some(&coarse_parameters(11)));
    for quality in [Quality::EXACT, Quality::default()] {
        let (expected, work, _) = render(&bytes, Kernel::IN_PLACE, quality, Batch::FULL);
        for (rays, samples) in [(1, 1), (3, 1), (7, 5), (400, 64)] {
            let (found, counters, _) = render(&bytes, Kernel::IN_PLACE, quality, Batch { rays, samples });
            assert_eq!(found, expected, "{rays} rays, {samples} samples");
            assert_eq!(counters, work);
        }
    }
}

#[test]
#[cfg(all(feature = "jitter", feature = "anti-aliasing", feature = "median"))]
fn effects_and_medians_of_drawn_samples_do_not_depend_on_the_batch() {
    use crate::plan::{Effects, Jitter};
    let bytes = scene(None, Some(&coarse_parameters(11)));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let outputs = Outputs { median_distance: true, ..Outputs::ALL };
    let go = |effects: Effects, batch: Batch| {
        let plan = Plan::new(&blob, &Quality::EXACT, outputs, batch).unwrap();
        let plan = plan.with_effects(effects).unwrap();
        let (camera, mut pixels) = (camera(23, 19), vec![Pixel::BLANK; 23 * 19]);
        let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
        let mut put = |x: u32, y: u32, pixel: &Pixel| pixels[(y * 23 + x) as usize] = *pixel;
        renderer.render(&plan, &camera, Rect::full(&camera), &mut workspace, &mut put).unwrap();
        pixels
    };
    let large = Batch::FULL;
    let plain = go(Effects::NONE, large);
    let halved = plain.iter().filter(|pixel| pixel.median_distance < 6.0).count();
    assert!(halved > 20 && halved < 400, "{halved}");
    for pixel in &plain {
        // A ray has a median distance if its opacity is above one half. Opacities within rounding error of one half are
        // exempt.
        let margin = (pixel.opacity - 0.5).abs() > 1e-5;
        assert!(!margin || (pixel.opacity > 0.5) == (pixel.median_distance < 6.0), "{pixel:?}");
    }
    let effects = Effects { jitter: Some(Jitter { seed: 7 }), anti_aliasing: 3, ..Effects::NONE };
    let jittered = go(effects, large);
    assert!(jittered != plain && jittered != go(Effects { jitter: None, ..effects }, large));
    for (rays, samples) in [(1, 1), (7, 5)] {
        assert_eq!(go(effects, Batch { rays, samples }), jittered, "{rays} rays, {samples} samples");
    }
}

#[test]
fn without_it_bits_work_and_memory_are_those_of_a_scene_that_has_none() {
    let bits = [0b0110_1011];
    let occupancy = Some(StoredOccupancy { resolution: [2; 3], bits: &bits });
    let (with, without) = (scene(occupancy.clone(), Some(&coarse_parameters(11))), scene(occupancy, None));
    for quality in [Quality::EXACT, Quality::default()] {
        let off = Quality { proposal: false, ..quality };
        for kernel in kernels() {
            let expected = render(&without, kernel, quality, Batch::FULL);
            assert_eq!(render(&with, kernel, off, Batch::FULL), expected, "{kernel:?}");
            let (_, on, memory) = render(&with, kernel, quality, Batch::FULL);
            assert!(on.proposal_evaluations > 0 && memory > expected.2);
            assert_eq!(expected.1.proposal_evaluations, 0);
        }
    }
}

#[test]
fn counters_add_up() {
    let bits = [0b0110_1011];
    let bytes =
        scene(Some(StoredOccupancy { resolution: [2; 3], bits: &bits }), Some(&coarse_parameters(11)));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob, Kernel::IN_PLACE, &mut []).unwrap();
    let batch = Batch { rays: 9, samples: 4 };
    let (_, exact, _) = render(&bytes, Kernel::IN_PLACE, Quality::EXACT, batch);
    for quality in [Quality::EXACT, Quality::default()] {
        let (_, c, _) = render(&bytes, Kernel::IN_PLACE, quality, batch);
        assert_eq!(c.samples_kept + c.samples_skipped, c.rays * ROW);
        assert_eq!(c.density_evaluations, c.samples_kept);
        assert!(c.proposal_evaluations <= exact.proposal_evaluations);
        let shares = renderer.shares(&c);
        let macs = coarse_architecture().density_macs() as u64;
        assert_eq!(shares.proposal, c.proposal_evaluations * macs);
        assert_eq!(shares.proposal + shares.direction + shares.density + shares.colour, c.macs);
        assert!(
            shares.direction > 0
                && shares.direction.is_multiple_of(renderer.network().direction_macs() as u64)
        );
    }
}

#[test]
fn a_full_occupancy_changes_no_bit() {
    let coarse = coarse_parameters(11);
    let bits = [0xff];
    let full = scene(Some(StoredOccupancy { resolution: [2; 3], bits: &bits }), Some(&coarse));
    let batch = Batch { rays: 30, samples: 16 };
    let gated = Quality { occupancy: true, ..Quality::EXACT };
    let (found, expected) = (
        render(&full, Kernel::IN_PLACE, gated, batch),
        render(&full, Kernel::IN_PLACE, Quality::EXACT, batch),
    );
    assert_eq!((found.0, found.1), (expected.0, expected.1));
}

#[test]
fn a_proposal_that_sees_nothing_gives_even_samples() {
    let a = coarse_architecture();
    let mut blind = vec![0.0; a.parameters()];
    blind[a.density_parameters() - 1] = -1.0;
    let bytes = scene(None, Some(&blind));
    let batch = Batch { rays: 30, samples: 16 };
    let (found, counters, _) = render(&bytes, Kernel::IN_PLACE, Quality::EXACT, batch);
    assert!(counters.proposal_evaluations > 0 && counters.samples_kept > 0);
    // Reference: 4,096 evenly spaced samples.
    let dense = Quality { samples: 4096, proposal: false, ..Quality::EXACT };
    let (expected, ..) = render(&bytes, Kernel::IN_PLACE, dense, batch);
    let even = Quality { samples: ROW as u16, proposal: false, ..Quality::EXACT };
    let (even, ..) = render(&bytes, Kernel::IN_PLACE, even, batch);
    let error = |pixels: &[Pixel]| -> f64 {
        let square = |(a, b): (&Pixel, &Pixel)| f64::from(a.opacity - b.opacity).powi(2);
        pixels.iter().zip(&expected).map(square).sum()
    };
    let (drawn, even) = (error(&found), error(&even));
    std::println!("squared error {drawn:e}, evenly {even:e}");
    // The drawn samples merge two evenly spaced sequences, so that their error may be several times that of one
    // sequence.
    assert!(drawn < 16.0 * even, "{drawn} {even}");
}

#[test]
fn densities_that_are_no_numbers_are_counted_and_never_seen() {
    // In ten layers of such weights, values overflow f32, and a sum of infinities of both signs is NaN.
    let layer = TrunkLayer { width: 8, skip: false };
    let deep = Architecture { trunk: [layer; 10].into_iter().collect(), ..coarse_architecture() };
    let wild: Vec<f32> = noise(deep.parameters(), 5).iter().map(|w| w * 60_000.0).collect();
    let bytes = scene_of(None, Some((&deep, &wild)));
    let (pixels, counters, _) =
        render(&bytes, Kernel::IN_PLACE, Quality::EXACT, Batch { rays: 5, samples: 8 });
    let (_, without, _) =
        render(&bytes, Kernel::IN_PLACE, Quality { proposal: false, ..Quality::EXACT }, Batch::SMALLEST);
    assert!(counters.invalid_samples > 0 && without.invalid_samples == 0);
    assert!(pixels.iter().all(|p| p.rgb.iter().all(|c| c.is_finite()) && p.opacity <= 1.0));
    assert_eq!(counters.samples_kept + counters.samples_skipped, counters.rays * ROW);
}

#[test]
fn a_workspace_one_line_short_is_refused() {
    let bytes = scene(None, Some(&coarse_parameters(11)));
    let blob = Blob::open(&bytes).unwrap();
    for kernel in kernels() {
        let lines = Renderer::prepared_lines(&blob, kernel);
        if lines > 0 {
            let mut short = vec![Line::UNINIT; lines - 1];
            let error = Renderer::new(blob.clone(), kernel, &mut short).map(drop).unwrap_err();
            assert_eq!(error, RenderError::Memory { expected: lines, found: lines - 1 });
        }
        let mut memory = vec![Line::UNINIT; lines];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::FULL).unwrap();
        let expected = renderer.workspace_lines(&plan);
        let mut short = vec![Line::UNINIT; expected - 1];
        let mut put = |_: u32, _: u32, _: &Pixel| panic!("a pixel was written");
        let camera = camera(4, 4);
        let error = renderer.render(&plan, &camera, Rect::full(&camera), &mut short, &mut put).unwrap_err();
        assert_eq!(error, RenderError::Memory { expected, found: expected - 1 });
    }
}

#[test]
fn what_drawing_needs_in_memory_is_a_row_a_ray() {
    let bytes = scene(None, Some(&coarse_parameters(11)));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let lines = |quality: Quality, rays| {
        let batch = Batch { rays, samples: 16 };
        renderer.workspace_lines(&Plan::new(&blob, &quality, Outputs::ALL, batch).unwrap())
    };
    let off = Quality { proposal: false, ..Quality::EXACT };
    let extra = |rays| lines(Quality::EXACT, rays) - lines(off, rays);
    // A ray needs 208 bytes: 1,600 more rays need a whole number of lines.
    assert_eq!(extra(1616) - extra(16), 1600 * 4 * ROW as usize / 64);
}

#[test]
fn an_explanation_names_the_proposal_and_why_it_is_off() {
    let bytes = scene(None, Some(&coarse_parameters(11)));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let explain = |proposal| {
        let quality = Quality { proposal, ..Quality::EXACT };
        let plan = Plan::new(&blob, &quality, Outputs::ALL, Batch::SMALLEST).unwrap();
        let (_, counters, _) = render(&bytes, Kernel::IN_PLACE, quality, Batch::SMALLEST);
        let explanation = renderer.explain(&plan).with_counters(counters);
        let stage = explanation.stages().into_iter().find(|stage| stage.name == "proposal").unwrap();
        (stage.switch, explanation.to_string())
    };
    let (switch, text) = explain(true);
    assert_eq!(switch, Switch::On);
    let macs = coarse_architecture().density_macs();
    for line in [
        "samples            52 a ray from 2 to 6, 32 drawn from the proposal, 20 its own",
        &std::format!("proposal           on, 20 samples a ray, {macs} multiply-adds an evaluation"),
        "% of the work",
    ] {
        assert!(text.contains(line), "{line}: {text}");
    }
    let (switch, text) = explain(false);
    assert_eq!(switch, Switch::SwitchedOff);
    assert!(text.contains("proposal           off: switched off by the request"), "{text}");
}
