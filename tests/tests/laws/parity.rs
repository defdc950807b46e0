//! Results depend only on the scene and the request.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Counters, Rect, Renderer, Shares};
use nerf_core::simd::BLOCK;
use nerf_core::volume::Pixel;
use nerf_testing::error::worst_of;
use nerf_testing::scenes::{Recipe, camera, kernels};

const SIDE: u32 = 20;
/// Pairs of transmittance cut and colour cut of the tested images: the defaults, none, and large cuts.
const CUTS: [(f32, f32); 4] =
    [(Quality::TRANSMITTANCE_CUT, Quality::COLOUR_CUT), (0.0, 0.0), (0.0, 0.05), (0.3, 0.1)];
const RECIPES: [(&str, Recipe); 6] = [
    ("plain", Recipe::PLAIN),
    ("skip", Recipe::SKIP),
    ("occupancy", Recipe::OCCUPANCY),
    ("proposal", Recipe::PROPOSAL),
    ("deferred", Recipe::DEFERRED),
    ("deferred layer", Recipe::DEFERRED_LAYER),
];

fn full() -> Rect {
    Rect { x: 0, y: 0, width: SIDE, height: SIDE }
}

/// Returns the values of a pixel: r, g, b, opacity, ray_distance, z_depth.
fn numbers(pixel: &Pixel) -> [f32; 6] {
    let [r, g, b] = pixel.rgb;
    [r, g, b, pixel.opacity, pixel.ray_distance, pixel.z_depth]
}

/// Renders an image in tiles of `tile` pixels.
fn picture(
    blob: &[u8],
    kernel: Kernel,
    quality: Quality,
    batch: Batch,
    tile: (u32, u32),
) -> (Vec<[f32; 6]>, Counters) {
    let blob = Blob::open(blob).expect("a blob");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let plan = Plan::new(&blob, &quality, Outputs::ALL, batch).expect("a plan");
    let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let mut picture = vec![[f32::NAN; 6]; (SIDE * SIDE) as usize];
    let mut work = Counters::default();
    for rect in full().tiles(tile.0, tile.1) {
        let mut put = |x: u32, y: u32, pixel: &Pixel| picture[(y * SIDE + x) as usize] = numbers(pixel);
        work += renderer.render(&plan, &camera(SIDE, SIDE), rect, &mut workspace, &mut put).expect("a tile");
    }
    assert!(picture.iter().flatten().all(|x| x.is_finite()), "a pixel is missing or not finite");
    (picture, work)
}

fn whole(blob: &[u8], kernel: Kernel, quality: Quality) -> Vec<[f32; 6]> {
    picture(blob, kernel, quality, Batch::FULL, (SIDE, SIDE)).0
}

fn bits(picture: &[[f32; 6]]) -> Vec<[u32; 6]> {
    picture.iter().map(|pixel| pixel.map(f32::to_bits)).collect()
}

fn largest_difference(a: &[[f32; 6]], b: &[[f32; 6]], channels: std::ops::Range<usize>) -> f64 {
    let pairs = a.iter().zip(b).flat_map(|(a, b)| channels.clone().map(move |c| (a[c], b[c])));
    worst_of(pairs.map(|(a, b)| f64::from((a - b).abs())))
}

#[test]
fn batch_and_tile_sizes_change_no_bit() {
    sizes_change_no_bit(&RECIPES, &CUTS[..1], &[1, 3, 16, 17, 255]);
}

// In two, since tests run side by side, and by fewer sizes, since the cuts are what is new here; AddressSanitizer's
// run leaves them out (.ci/run).
#[test]
fn batch_and_tile_sizes_change_no_bit_under_other_cuts() {
    sizes_change_no_bit(&RECIPES[..2], &CUTS[1..], &[17]);
}

#[test]
fn batch_and_tile_sizes_change_no_bit_of_occupancies_and_proposals_under_other_cuts() {
    sizes_change_no_bit(&RECIPES[2..], &CUTS[1..], &[17]);
}

fn sizes_change_no_bit(recipes: &[(&str, Recipe)], cuts: &[(f32, f32)], rays: &[usize]) {
    let cases = kernels().flat_map(|kernel| recipes.iter().map(move |recipe| (kernel, recipe)));
    for ((kernel, (name, recipe)), cuts) in cases.flat_map(|case| cuts.iter().map(move |cuts| (case, cuts))) {
        let blob = recipe.blob();
        let &(transmittance_cut, colour_cut) = cuts;
        let quality = Quality { transmittance_cut, colour_cut, ..Quality::default() };
        let (expected, work) = picture(&blob, kernel, quality, Batch::FULL, (SIDE, SIDE));
        let expected = bits(&expected);
        let different = expected.iter().collect::<std::collections::BTreeSet<_>>().len();
        assert!(different > 100, "{name}: a flat picture proves nothing ({different} values)");
        let mut batches: Vec<(usize, usize)> = rays.iter().map(|&rays| (rays, BLOCK)).collect();
        if kernel == Kernel::IN_PLACE {
            batches.extend([(1, 1), (1, 7), (5, 2), (100, 16), (256, 63)]);
        }
        for (rays, samples) in batches {
            let small = if rays <= 3 { [(1, 1), (SIDE, 1)] } else { [(5, 3), (16, 16)] };
            for tile in small.into_iter().chain([(SIDE, SIDE)]) {
                let batch = Batch { rays, samples };
                let (found, same_work) = picture(&blob, kernel, quality, batch, tile);
                assert!(bits(&found) == expected, "{name}, {}, {batch:?}, tile {tile:?}", kernel);
                assert_eq!(same_work, work, "{name}, {}, {batch:?}, tile {tile:?}", kernel);
            }
        }
    }
}

#[test]
fn smallest_batch_in_place_changes_no_bit() {
    for (name, recipe) in RECIPES {
        let blob = recipe.blob();
        for quality in [Quality::default(), Quality { occupancy: true, ..Quality::EXACT }] {
            let expected = bits(&whole(&blob, Kernel::IN_PLACE, quality));
            let found = picture(&blob, Kernel::IN_PLACE, quality, Batch::SMALLEST, (SIDE, SIDE)).0;
            assert!(bits(&found) == expected, "{name}");
        }
    }
}

#[test]
fn thread_count_changes_no_bit() {
    for (kernel, (name, recipe)) in kernels().flat_map(|kernel| RECIPES.map(|recipe| (kernel, recipe))) {
        let bytes = recipe.blob();
        let expected = bits(&whole(&bytes, kernel, Quality::default()));
        let blob = Blob::open(&bytes).expect("a blob");
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let plan = Plan::new(&blob, &Quality::default(), Outputs::ALL, Batch::FULL).expect("a plan");
        let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
        for threads in [1, 2, 3, 5] {
            let (renderer, plan) = (&renderer, &plan);
            let tiles: Vec<Rect> = full().tiles(7, 5).collect();
            let parts: Vec<Vec<(usize, [u32; 6])>> = std::thread::scope(|scope| {
                let work = |mine: Vec<Rect>| {
                    scope.spawn(move || {
                        let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(plan)];
                        let mut pixels = Vec::new();
                        for rect in mine {
                            let mut put = |x: u32, y: u32, pixel: &Pixel| {
                                pixels.push(((y * SIDE + x) as usize, numbers(pixel).map(f32::to_bits)));
                            };
                            let camera = camera(SIDE, SIDE);
                            renderer.render(plan, &camera, rect, &mut workspace, &mut put).expect("a tile");
                        }
                        pixels
                    })
                };
                let share = |i: usize| tiles.iter().skip(i).step_by(threads).copied().collect();
                let workers: Vec<_> = (0..threads).map(|i| work(share(i))).collect();
                workers.into_iter().map(|worker| worker.join().expect("a worker")).collect()
            });
            let mut found = vec![[0; 6]; expected.len()];
            parts.into_iter().flatten().for_each(|(i, pixel)| found[i] = pixel);
            assert!(found == expected, "{name}, {}, {threads} threads", kernel);
        }
    }
}

#[test]
fn kernels_agree_with_the_oracle() {
    // A proposal's rounding moves the samples, in these fields of noise by more than a tolerance says: there
    // every kernel has an oracle of its own, bit for bit (`render/stages/proposal/tests.rs`).
    for (name, recipe) in RECIPES.into_iter().filter(|(_, recipe)| recipe.proposal.is_none()) {
        let blob = recipe.blob();
        // The cut may end a ray a sample sooner or later: that is its price, not a kernel's error.
        let quality = Quality { transmittance_cut: 0.0, colour_cut: 0.0, ..Quality::default() };
        let oracle = whole(&blob, Kernel::IN_PLACE, quality);
        for kernel in kernels() {
            let found = whole(&blob, kernel, quality);
            // A kernel that rounds to bf16 keeps 8 bits of each weight and activation; and a pixel whose opacity
            // is barely above its epsilon there may have no distance here.
            let (limit, numbers) = if kernel.rounds() { (5e-2, 4) } else { (1e-4, 6) };
            for (i, (a, b)) in found.iter().zip(&oracle).enumerate() {
                for (a, b) in a.iter().zip(b).take(numbers) {
                    let error = (a - b).abs() / b.abs().max(1.0);
                    assert!(error <= limit, "{name}, {}, pixel {i}: {a} instead of {b}", kernel);
                }
            }
            let worst = largest_difference(&found, &oracle, 0..numbers);
            println!("{name}, {}: largest difference {worst:e}", kernel);
        }
    }
}

#[test]
fn occupancy_of_ones_changes_no_bit_and_skips_nothing() {
    for kernel in kernels() {
        let with = Recipe { occupancy: Some((8, true)), ..Recipe::PLAIN };
        let on = Quality { occupancy: true, ..Quality::EXACT };
        let batch = Batch::FULL;
        let (expected, all) = picture(&with.blob(), kernel, Quality::EXACT, batch, (SIDE, SIDE));
        let (found, kept) = picture(&with.blob(), kernel, on, batch, (SIDE, SIDE));
        let without = whole(&Recipe::PLAIN.blob(), kernel, on);
        assert!(bits(&found) == bits(&expected) && bits(&without) == bits(&expected), "{}", kernel);
        assert_eq!(all, kept, "{}", kernel);
    }
}

#[test]
fn occupancy_saves_what_it_calls_empty() {
    let (blob, batch) = (Recipe::OCCUPANCY.blob(), Batch::FULL);
    let on = Quality { occupancy: true, ..Quality::EXACT };
    let (_, all) = picture(&blob, Kernel::IN_PLACE, Quality::EXACT, batch, (SIDE, SIDE));
    let (_, kept) = picture(&blob, Kernel::IN_PLACE, on, batch, (SIDE, SIDE));
    assert!(kept.samples_kept < all.samples_kept * 7 / 10, "{kept:?} of {all:?}");
    assert_eq!(kept.samples_kept + kept.samples_skipped, all.samples_kept + all.samples_skipped);
}

#[test]
fn transmittance_cut_costs_little_and_saves_work() {
    for (kernel, (name, recipe)) in kernels().flat_map(|kernel| RECIPES.map(|recipe| (kernel, recipe))) {
        let (blob, batch) = (recipe.blob(), Batch::FULL);
        let exact = Quality { transmittance_cut: 0.0, colour_cut: 0.0, ..Quality::default() };
        let (a, all) = picture(&blob, kernel, exact, batch, (SIDE, SIDE));
        let (b, cut) =
            picture(&blob, kernel, Quality { transmittance_cut: 1e-3, ..exact }, batch, (SIDE, SIDE));
        // What is behind the cut has weights that sum to less than it. A mean of h is rounded to bf16 in its turn.
        let opacity = largest_difference(&a, &b, 3..4);
        let colour = largest_difference(&a, &b, 0..3);
        let rounded = if recipe.per_ray && kernel.rounds() { 1e-2 } else { 0.0 };
        assert!(opacity <= 1.001e-3 && colour <= 1.001e-3 + rounded, "{name}, {}: {colour}", kernel);
        // Distances are weighted by t <= 6: 1e-3 of (6 + 6), with opacity near 1.
        let distance = largest_difference(&a, &b, 4..6);
        assert!(distance <= 1.3e-2, "{name}, {}: {distance}", kernel);
        assert!(cut.density_evaluations <= all.density_evaluations, "{name}: {cut:?}, {all:?}");
    }
}

#[test]
fn colour_cut_costs_little_saves_work_and_never_touches_the_shape() {
    for (kernel, (name, recipe)) in kernels().flat_map(|kernel| RECIPES.map(|recipe| (kernel, recipe))) {
        let (blob, batch) = (recipe.blob(), Batch::FULL);
        let exact = Quality { transmittance_cut: 0.0, colour_cut: 0.0, ..Quality::default() };
        let (a, all) = picture(&blob, kernel, exact, batch, (SIDE, SIDE));
        let mut before = all;
        for colour_cut in [1e-3, 1e-2, 0.1, 0.5] {
            let (b, cut) = picture(&blob, kernel, Quality { colour_cut, ..exact }, batch, (SIDE, SIDE));
            assert_eq!(largest_difference(&a, &b, 3..6), 0.0, "{name}: opacity or a distance");
            assert_eq!(cut.density_evaluations, all.density_evaluations);
            assert!(cut.colour_evaluations <= before.colour_evaluations, "{name}: {cut:?}, {before:?}");
            if colour_cut <= 1e-2 {
                // Noise is the worst case: no colour has anything to do with the one behind it.
                let worst = largest_difference(&a, &b, 0..3);
                println!("{name}, {}, {colour_cut}: {worst:e}", kernel);
                assert!(worst <= f64::from(20.0 * colour_cut), "{name}, {}: {worst}", kernel);
            }
            before = cut;
        }
        assert!(before.colour_evaluations < all.colour_evaluations, "{name}: nothing was saved");
    }
}

#[test]
fn without_colour_its_branch_is_never_asked_and_the_rest_is_the_same() {
    for (kernel, (name, recipe)) in kernels().flat_map(|kernel| RECIPES.map(|recipe| (kernel, recipe))) {
        let bytes = recipe.blob();
        let blob = Blob::open(&bytes).expect("a blob");
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
        let work = |rgb| {
            let outputs = Outputs { rgb, ..Outputs::ALL };
            let plan = Plan::new(&blob, &Quality::default(), outputs, Batch::FULL).expect("a plan");
            let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
            let mut put = |_: u32, _: u32, _: &Pixel| {};
            let found = renderer.render(&plan, &camera(SIDE, SIDE), full(), &mut workspace, &mut put);
            (found.expect("a picture"), workspace.len())
        };
        let ((with, large), (without, small)) = (work(true), work(false));
        assert_eq!((without.colour_evaluations, without.samples_kept), (0, with.samples_kept), "{name}");
        let shares = renderer.shares(&without);
        let Shares { direction, colour, .. } = renderer.shares(&with);
        assert_eq!((shares.direction, shares.colour), (0, 0), "{name}");
        assert_eq!(shares.density + shares.proposal, without.macs, "{name}");
        assert_eq!(renderer.shares(&with), Shares { direction, colour, ..shares }, "{name}");
        assert!(small < large, "{name}: no memory for colours either");
    }
}

#[test]
fn maths_backends_agree_in_a_picture() {
    let blob = Recipe::SKIP.blob();
    let exact = Quality { transmittance_cut: 0.0, ..Quality::default() };
    for kernel in kernels() {
        let reference = whole(&blob, kernel, exact);
        for (math, most) in
            [(MathBackend::Libm, 1e-4), (MathBackend::Recurrence, 0.3), (MathBackend::Micromath, 0.3)]
        {
            let found = whole(&blob, kernel, Quality { math, ..exact });
            let worst = largest_difference(&found, &reference, 0..4);
            assert!(worst <= most, "{math:?}, {}: {worst}", kernel);
        }
    }
}

/// Renders a 2D field at `size` pixels, in tiles of `tile` pixels, on `threads` threads.
fn field(
    renderer: &Renderer<'_>,
    batch: Batch,
    size: [u32; 2],
    tile: (u32, u32),
    threads: usize,
) -> Vec<u32> {
    let [width, height] = size;
    let tiles: Vec<Rect> = Rect { x: 0, y: 0, width, height }.tiles(tile.0, tile.1).collect();
    let draw = &|mine: usize| {
        let (mut workspace, mut pixels) =
            (vec![Line::UNINIT; renderer.picture_workspace_lines(batch)], Vec::new());
        let mut put = |x: u32, y: u32, rgb: [f32; 3]| pixels.push(((y * width + x) as usize, rgb));
        for &rect in tiles.iter().skip(mine).step_by(threads) {
            let math = MathBackend::Polynomial;
            renderer.render_picture(math, batch, size, rect, &mut workspace, &mut put).expect("a tile");
        }
        pixels
    };
    let mut picture = vec![[f32::NAN; 3]; (width * height) as usize];
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|mine| scope.spawn(move || draw(mine))).collect();
        let parts = workers.into_iter().flat_map(|worker| worker.join().expect("a worker"));
        parts.for_each(|(i, rgb)| picture[i] = rgb);
    });
    assert!(picture.iter().flatten().all(|c| c.is_finite()), "a pixel is missing or not finite");
    picture.iter().flatten().map(|c| c.to_bits()).collect()
}

#[test]
fn batches_tiles_and_threads_change_no_bit_of_a_2d_field() {
    let bytes = Recipe { skip: true, ..Recipe::PICTURE }.blob();
    let size = [70, 19];
    for kernel in kernels() {
        let blob = Blob::open(&bytes).expect("a blob");
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
        let expected = field(&renderer, Batch::FULL, size, (70, 19), 1);
        let different = expected.iter().collect::<std::collections::BTreeSet<_>>().len();
        assert!(different > 1000, "a flat picture proves nothing ({different} values)");
        for (samples, tile, threads) in
            [(1, (1, 1), 1), (7, (16, 16), 2), (64, (1, 19), 3), (64, (70, 1), 5), (63, (33, 4), 2)]
        {
            let batch = Batch { rays: 1, samples };
            let found = field(&renderer, batch, size, tile, threads);
            assert!(found == expected, "{}, {samples}, {tile:?}, {threads} threads", kernel);
        }
    }
}
