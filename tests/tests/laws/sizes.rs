//! Sizes that the core computes, compared with arithmetic that cannot overflow.

use nerf_core::Kernel;
use nerf_core::blob::{Blob, StoredOccupancy};
use nerf_core::encoding::{AngleScale, MAX_LEVELS, SinusoidalEncoding};
use nerf_core::math::MathBackend;
use nerf_core::memory::{Line, lines_for};
use nerf_core::network::{
    Architecture, DensityActivation, Layer, MAX_COLOUR, MAX_TRUNK, MAX_WIDTH, Shading, TrunkLayer,
};
use nerf_core::plan::Effects;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Rect, RenderError, Renderer};
use nerf_core::volume::Pixel;
use nerf_testing::scenes::{Recipe, camera, kernels};
use proptest::prelude::*;

/// Draws networks of all shapes within the format's limits, the largest included.
fn architectures() -> impl Strategy<Value = Architecture> {
    let width = || prop_oneof![1u16..=MAX_WIDTH as u16, Just(1), Just(MAX_WIDTH as u16)];
    let encoding = |inputs| {
        (0..=MAX_LEVELS, any::<bool>()).prop_map(move |(levels, identity)| SinusoidalEncoding {
            inputs,
            levels,
            scale: AngleScale::Pi,
            identity: identity || levels == 0,
        })
    };
    let trunk = prop::collection::vec((width(), any::<bool>()), 1..=MAX_TRUNK);
    let colour = prop::collection::vec(width(), 0..=MAX_COLOUR);
    (any::<bool>(), encoding(3), prop::option::of(encoding(3)), trunk, colour).prop_map(
        |(scene, position, direction, trunk, colour)| Architecture {
            position: SinusoidalEncoding { inputs: if scene { 3 } else { 2 }, ..position }.into(),
            direction: direction.filter(|_| scene).map(Into::into),
            trunk: trunk
                .into_iter()
                .enumerate()
                .map(|(i, (width, skip))| TrunkLayer { width, skip: skip && i > 0 })
                .collect(),
            density: scene.then_some(DensityActivation::Relu),
            colour: colour.into_iter().collect(),
            shading: Shading::PerSample,
        },
    )
}

/// Returns the number of values that an encoding has by the rules of the format.
fn encoded(e: &SinusoidalEncoding) -> u128 {
    u128::from(e.inputs) * (2 * u128::from(e.levels) + u128::from(e.identity))
}

/// Returns the numbers of inputs and outputs of each layer, in the order of their parameters.
fn layers(a: &Architecture) -> Vec<(u128, u128)> {
    let (mut layers, mut width) = (vec![], encoded(a.position.sinusoidal().expect("no grid")));
    for layer in &a.trunk {
        let skip = if layer.skip { encoded(a.position.sinusoidal().expect("no grid")) } else { 0 };
        layers.push((width + skip, u128::from(layer.width)));
        width = u128::from(layer.width);
    }
    if a.density.is_some() {
        layers.push((width, 1));
    }
    let mut seen = a.direction.as_ref().map_or(0, |it| encoded(it.sinusoidal().expect("no harmonics")));
    for &hidden in &a.colour {
        layers.push((width + seen, u128::from(hidden)));
        (width, seen) = (u128::from(hidden), 0);
    }
    layers.push((width + seen, 3));
    layers
}

proptest! {
    #![proptest_config(crate::drawn(2_000))]

    #[test]
    fn parameters_and_work_of_a_network_are_exact_and_fit_32_bits(a in architectures()) {
        prop_assert_eq!(a.check(), Ok(()));
        let (mut offset, mut work) = (0u128, 0u128);
        let mut found = a.layers().into_iter();
        for (inputs, outputs) in layers(&a) {
            let layer: Layer = found.next().expect("a layer");
            prop_assert_eq!(layer.inputs() as u128, inputs);
            prop_assert_eq!((layer.weights as u128, layer.bias as u128), (offset, offset + inputs * outputs));
            prop_assert_eq!(layer.macs() as u128, inputs * outputs);
            offset += inputs * outputs + outputs;
            work += inputs * outputs;
        }
        prop_assert!(found.next().is_none());
        prop_assert_eq!(a.parameters() as u128, offset);
        prop_assert_eq!((a.density_macs() + a.colour_macs()) as u128, work);
        prop_assert!(a.gradient_macs() as u128 <= 2 * work && a.density_parameters() as u128 <= offset);
        // A block of 64 through a network and back, in f32: far below what a 32-bit machine counts to.
        prop_assert!(64 * 2 * work < 1 << 32 && 4 * offset < 1 << 32);
    }

    #[test]
    fn bytes_of_an_occupancy_are_exact_or_as_many_as_can_be_counted(resolution in any::<[u16; 3]>()) {
        let cells: u128 = resolution.iter().map(|&side| u128::from(side)).product();
        let bytes = cells.div_ceil(8).min(usize::MAX as u128);
        prop_assert_eq!(StoredOccupancy::bytes(resolution) as u128, bytes);
    }

    #[test]
    fn lines_hold_their_values_and_saturate(count in prop_oneof![any::<usize>(), 0usize..1000]) {
        let exact = |size: u128| (count as u128 * size).div_ceil(64);
        // What saturates is more than any slice has, so that it is refused.
        let most = isize::MAX as u128 / 64;
        for (found, exact) in [(lines_for::<u8>(count), exact(1)), (lines_for::<[f32; 40]>(count), exact(160))] {
            prop_assert!(found as u128 == exact || (found as u128 > most && exact > most));
        }
    }
}

#[test]
fn saturated_sizes_can_be_added() {
    // The renderer adds fewer than 48 slices; on a machine of any width.
    assert!(lines_for::<[u8; 256]>(usize::MAX).checked_mul(48).is_some());
    assert!(lines_for::<[u8; 256]>(usize::MAX) > isize::MAX as usize / size_of::<Line>());
}

/// Returns scenes that together use every slice of a workspace.
fn recipes() -> [Recipe; 9] {
    [
        Recipe::LEARNED,
        Recipe::CONTRACTED,
        Recipe::LEARNED_INT8,
        Recipe::DEFERRED,
        Recipe::DEFERRED_LAYER,
        Recipe::PLAIN,
        Recipe::PROPOSAL,
        Recipe { trunk: (2, 512), ..Recipe::SKIP },
        Recipe::TINY,
    ]
}

#[test]
fn workspaces_up_to_the_most_rays_are_those_of_few_times_as_many() {
    for recipe in recipes() {
        let bytes = recipe.blob();
        let blob = Blob::open(&bytes).expect("a blob");
        for kernel in kernels() {
            let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
            let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
            for outputs in [
                Outputs::NONE,
                Outputs::RGB,
                Outputs { median_distance: true, normals: true, ..Outputs::ALL },
            ] {
                for samples in [1, 16, 64] {
                    for (antialiased, each_sample) in [(1, 0), (4, 0), (1, 4096)] {
                        let quality = Quality { samples: each_sample, ..Quality::EXACT };
                        let lines = |rays| {
                            let plan =
                                Plan::new(&blob, &quality, outputs, Batch { rays, samples }).expect("a plan");
                            let effects = Effects { anti_aliasing: antialiased, ..Effects::NONE };
                            let plan = plan.with_effects(effects).expect("effects");
                            renderer.workspace_lines(&plan) as u128
                        };
                        // 64 rays of anything are whole lines: from there on each 64 more take the same.
                        let (once, more) = (lines(64), lines(128) - lines(64));
                        for rays in [192, 1 << 12, 1 << 20, Batch::MAX_RAYS] {
                            let exact = once + (rays as u128 / 64 - 1) * more;
                            assert_eq!(lines(rays), exact, "{recipe:?}, {}, {rays} rays", kernel);
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn a_workspace_of_any_plan_is_enough_and_a_line_less_is_not() {
    let mut state = 37u64;
    let mut pick = |n: usize| (nerf_testing::noise::next(&mut state) >> 33) as usize % n;
    for round in 0..120 {
        let recipe = recipes()[round % 5];
        let bytes = recipe.blob();
        let blob = Blob::open(&bytes).expect("a blob");
        let all: Vec<Kernel> = kernels().collect();
        let kernel = all[pick(all.len())];
        let prepared = Renderer::prepared_lines(&blob, kernel);
        let mut memory = vec![Line::UNINIT; prepared];
        if let Some(short) = memory.get_mut(1..) {
            assert!(Renderer::new(blob.clone(), kernel, short).is_err(), "{prepared} lines");
        }
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
        let batch = Batch { rays: [1, 2, 63, 64, 65, 300][pick(6)], samples: 1 + pick(64) };
        let outputs = Outputs {
            rgb: pick(2) == 0,
            normals: pick(2) == 0,
            median_distance: pick(2) == 0,
            ..Outputs { opacity: true, ..Outputs::NONE }
        };
        let quality = Quality { samples: [0, 1, 7][pick(3)], proposal: pick(2) == 0, ..Quality::EXACT };
        let plan = Plan::new(&blob, &quality, outputs, batch).expect("a plan");
        let lines = renderer.workspace_lines(&plan);
        let mut workspace = vec![Line::UNINIT; lines];
        let (camera, rect) = (camera(9, 5), Rect { x: 1, y: 1, width: 7, height: 3 });
        let mut put = |_: u32, _: u32, _: &Pixel| {};
        let found = renderer.render(&plan, &camera, rect, &mut workspace[1..], &mut put);
        assert_eq!(found, Err(RenderError::Memory { expected: lines, found: lines - 1 }));
        let work = renderer.render(&plan, &camera, rect, &mut workspace, &mut put);
        assert!(work.is_ok_and(|work| work.rays == 21), "{recipe:?}, {batch:?}, {}", kernel);
    }
    // A 2D field: its batch has samples alone.
    let bytes = Recipe::PICTURE.blob();
    let blob = Blob::open(&bytes).expect("a blob");
    let renderer = Renderer::new(blob, Kernel::IN_PLACE, &mut []).expect("a renderer");
    let lines = |rays, samples| renderer.picture_workspace_lines(Batch { rays, samples });
    assert_eq!(lines(1, 17), lines(Batch::MAX_RAYS, 17));
    let mut workspace = vec![Line::UNINIT; lines(1, 17)];
    let rect = Rect { x: 0, y: 0, width: 5, height: 5 };
    let draw = |workspace: &mut [Line]| {
        let (math, batch) = (MathBackend::Polynomial, Batch { rays: 1, samples: 17 });
        renderer.render_picture(math, batch, [5, 5], rect, workspace, &mut |_: u32, _: u32, _: [f32; 3]| {})
    };
    assert!(draw(&mut workspace[1..]).is_err() && draw(&mut workspace).is_ok());
}
