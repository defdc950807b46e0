//! Tests of outputs that are off or not built. An output that is off needs no work and no memory, and changes no bit of
//! the other outputs. An output that the build lacks is refused.

extern crate std;

use crate::blob::{Blob, StoredOccupancy};
use crate::memory::{Line, lines_for};
use crate::plan::{Batch, Outputs, Plan, PlanError, Quality};
use crate::render::tests::{camera, kernels, render};
use crate::render::{Counters, Renderer};
use crate::testing::{body, bytes, every_kind, halve, parameters};
use crate::volume::Pixel;
use std::string::ToString;
use std::vec;
use std::vec::Vec;

/// All combinations of the outputs that every build has.
fn sets() -> impl Iterator<Item = Outputs> {
    (0..16).map(|bits| Outputs {
        rgb: bits & 1 != 0,
        opacity: bits & 2 != 0,
        ray_distance: bits & 4 != 0,
        z_depth: bits & 8 != 0,
        ..Outputs::NONE
    })
}

/// Returns `outputs` with median distance and normals requested, if this build has them.
fn with_surface(outputs: Outputs) -> Outputs {
    Outputs { median_distance: cfg!(feature = "median"), normals: cfg!(feature = "normals"), ..outputs }
}

/// Returns a copy of the pixel with median distance and normal set to 0.
fn plain(pixel: &Pixel) -> Pixel {
    Pixel { median_distance: 0.0, normal: [0.0; 3], ..*pixel }
}

#[test]
fn off_costs_nothing_and_on_changes_nothing_else() {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 31));
    let bits = [0b1110_1011];
    let bytes = bytes(&body(a.clone(), Some(StoredOccupancy { resolution: [2; 3], bits: &bits }), &weights));
    let blob = Blob::open(&bytes).unwrap();
    let camera = camera(13, 11);
    for kernel in kernels() {
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        let batch = Batch { rays: 40, samples: 64 };
        for (quality, outputs) in
            [Quality::EXACT, Quality::default()].into_iter().flat_map(|q| sets().map(move |set| (q, set)))
        {
            let plan = |outputs| Plan::new(&blob, &quality, outputs, batch).unwrap();
            let (off, on) = (plan(outputs), plan(with_surface(outputs)));
            let (without, with) = (render(&renderer, &off, &camera), render(&renderer, &on, &camera));
            // Work differs by the density gradients alone.
            let normals = with.counters.normal_evaluations;
            let macs = with.counters.macs - normals * a.gradient_macs() as u64;
            assert_eq!(without.counters, Counters { normal_evaluations: 0, macs, ..with.counters });
            assert_eq!(normals > 0, cfg!(feature = "normals"));
            // Pixels differ in median distance and normal alone.
            assert!(without.pixels.iter().all(|pixel| *pixel == plain(pixel)));
            assert_eq!(without.pixels, with.pixels.iter().map(plain).collect::<Vec<_>>());
            // Memory differs by the following buffers.
            let picks = if outputs.rgb { 0 } else { 2 * lines_for::<f32>(64) };
            let median = lines_for::<f32>(40);
            // Buffers for normals: sums, queue, signs of 61 units, gradient with respect to 27 encoded inputs and to
            // position.
            let normals = lines_for::<[f32; 6]>(40)
                + 3 * lines_for::<f32>(64)
                + lines_for::<u16>((24 + 20 + 17) * 4)
                + lines_for::<f32>(27 * 64)
                + lines_for::<f32>(3 * 64);
            let extra = usize::from(cfg!(feature = "median")) * median
                + usize::from(cfg!(feature = "normals")) * (normals + picks);
            assert_eq!(renderer.workspace_lines(&on), renderer.workspace_lines(&off) + extra);
        }
    }
}

#[test]
fn depth_alone_is_trunk_and_density_and_exactly_those_of_the_colour_frame() {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 31));
    let bytes = bytes(&body(a.clone(), None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let camera = camera(13, 11);
    let depth = Outputs { z_depth: true, ..Outputs::NONE };
    let median = Outputs { median_distance: cfg!(feature = "median"), ..depth };
    for kernel in kernels() {
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        for quality in [Quality::EXACT, Quality::default()] {
            let go = |outputs| {
                let plan = Plan::new(&blob, &quality, outputs, Batch::FULL).unwrap();
                render(&renderer, &plan, &camera)
            };
            let colour = go(Outputs::RGB).counters;
            for outputs in [depth, median] {
                let alone = go(outputs).counters;
                assert_eq!(alone.colour_evaluations, 0);
                assert_eq!(alone.macs, alone.density_evaluations * a.density_macs() as u64);
                assert_eq!(alone.density_evaluations, colour.density_evaluations);
                assert_eq!(alone.macs, renderer.shares(&colour).density);
            }
            if cfg!(feature = "normals") {
                let alone = go(Outputs { normals: true, ..Outputs::NONE }).counters;
                let shares = renderer.shares(&alone);
                assert_eq!((alone.colour_evaluations, shares.colour, shares.direction), (0, 0, 0));
                assert_eq!(shares.density, renderer.shares(&colour).density);
                assert_eq!(shares.normals, alone.normal_evaluations * a.gradient_macs() as u64);
                // Normals are evaluated at the samples at which colour is evaluated.
                assert_eq!(alone.normal_evaluations, colour.colour_evaluations);
            }
        }
    }
}

#[test]
fn what_this_build_lacks_is_refused_by_name() {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 31));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    for (effect, built, outputs) in [
        ("median_distance", cfg!(feature = "median"), Outputs { median_distance: true, ..Outputs::NONE }),
        ("normals", cfg!(feature = "normals"), Outputs { normals: true, ..Outputs::NONE }),
    ] {
        match Plan::new(&blob, &Quality::EXACT, outputs, Batch::SMALLEST) {
            Ok(_) => assert!(built, "{effect}"),
            Err(error) => {
                assert_eq!(error, PlanError::NotBuilt { effect });
                assert!(!built && error.to_string().contains(effect), "{error}");
            }
        }
    }
}

#[test]
#[cfg(all(feature = "median", feature = "jitter"))]
fn a_median_stays_in_the_bin_of_a_jittered_sample() {
    use crate::plan::{Effects, Jitter};
    // The first bin is opaque: the median is at the bin's near edge, wherever the bin's sample lies.
    let a = every_kind();
    let mut all = vec![0.0; a.parameters()];
    let layers = a.layers();
    let density = layers.iter().find(|layer| layer.role == crate::network::Role::Density).unwrap();
    all[density.bias] = 6e4;
    let (weights, _) = halve(&all);
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), crate::Kernel::IN_PLACE, &mut []).unwrap();
    let camera = camera(13, 11);
    let outputs = Outputs { median_distance: true, ..Outputs::NONE };
    let go = |jitter| {
        let plan = Plan::new(&blob, &Quality::EXACT, outputs, Batch::SMALLEST).unwrap();
        let plan = plan.with_effects(Effects { jitter, ..Effects::NONE }).unwrap();
        render(&renderer, &plan, &camera).pixels
    };
    let (plain, mut seen) = (go(None), 0);
    for pixel in (0..20).flat_map(|seed| go(Some(Jitter { seed }))).filter(|pixel| pixel.opacity > 0.5) {
        let scene = blob.scene().unwrap();
        let bin = scene.step();
        let offset = (pixel.median_distance - scene.near) / bin;
        assert!((offset - offset.round()).abs() < 1e-2, "a bin's beginning, found {offset}");
        assert!((scene.near..scene.far).contains(&pixel.median_distance));
        seen += 1;
    }
    assert!(seen > 1000 && plain.iter().any(|pixel| pixel.opacity > 0.5), "{seen}");
}
