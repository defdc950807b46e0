//! Tests of deferred shading beyond the colour and opacity of frames: queried points, normals, linear colour and
//! collisions.

use super::*;
use crate::render::RaySegment;

/// Random points in the box, each with a random direction.
fn points(count: usize) -> Vec<([f32; 3], [f32; 3])> {
    let of = |seed| noise(3 * count, seed).chunks_exact(3).map(Vec3::from_slice).collect::<Vec<_>>();
    of(70).into_iter().zip(of(71)).map(|(p, dir)| (p.to_array(), dir.normalize().to_array())).collect()
}

#[test]
fn a_point_has_the_network_of_its_own_h() {
    for a in [d11(), d00()] {
        let Field { file, oracle } = field(&a, 6, 1.0, None);
        let (positions, dirs): (Vec<_>, Vec<_>) = points(75).into_iter().unzip();
        for (kernel, batch) in kernels().flat_map(|k| [(k, Batch::FULL), (k, Batch::SMALLEST)]) {
            let (mut sigma, mut rgb) = ([0.0; 75], [[0.0; 3]; 75]);
            with(&file, kernel, |blob, renderer| {
                let plan = Plan::new(blob, &Quality::EXACT, Outputs::ALL, batch).unwrap();
                let mut memory = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
                let counters =
                    renderer.query(&plan, &positions, &dirs, &mut memory, &mut sigma, &mut rgb).unwrap();
                assert_eq!((counters.density_evaluations, counters.colour_evaluations), (75, 75));
            });
            let mut off = 0.0;
            for i in 0..75 {
                let (h, raw) = oracle.at(positions[i].map(f64::from));
                let expected = oracle.sigma(raw);
                off = ((f64::from(sigma[i]) - expected).abs() / expected.max(1.0)).worse(off);
                for (found, expected) in rgb[i].iter().zip(oracle.network(&h, dirs[i].into())) {
                    off = (f64::from(*found) - expected).abs().worse(off);
                }
            }
            assert!(off <= tolerance(kernel, 5e-6) * 4.0, "{kernel:?}: {off:e}");
        }
    }
}

#[test]
#[cfg(feature = "normals")]
fn the_gradient_is_that_of_differences() {
    use crate::network::{GradientScratch, Scratch};
    for a in [d11(), d00()] {
        let Field { file, oracle } = field(&a, 6, 1.0, None);
        let mut positions = [0.0; 48];
        for (i, (p, _)) in points(16).iter().enumerate() {
            crate::memory::put_column(&mut positions, 16, i, *p);
        }
        let expected: Vec<f64> = (0..48)
            .map(|k| {
                let (axis, i) = (k / 16, k % 16);
                let raw = |step: f64| {
                    let mut p = [0, 1, 2].map(|axis| f64::from(positions[axis * 16 + i]));
                    p[axis] += step;
                    oracle.at(p).1
                };
                (raw(1e-6) - raw(-1e-6)) / 2e-6
            })
            .collect();
        let size = expected.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        assert!(size > 1.0, "something to see");
        for kernel in kernels() {
            let off = with(&file, kernel, |_, renderer| {
                let network = renderer.network();
                let rows = network.activation_rows().max(network.encoded_rows());
                let [mut encoded, mut front, mut back, mut way] = [(); 4].map(|()| vec![0.0; 16 * rows]);
                let mut signs = vec![0; network.sign_words(16)];
                let mut scratch =
                    Scratch { stride: 16, encoded: &mut encoded, front: &mut front, back: &mut back };
                let mut memory = GradientScratch { signs: &mut signs, encoded: &mut way };
                let mut found = [0.0; 48];
                let math = MathBackend::Polynomial;
                network.gradient(math, &mut scratch, &mut memory, &positions, 0.0, &mut found);
                found.iter().zip(&expected).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, Worse::worse)
            });
            assert!(off <= tolerance(kernel, 1e-5) * size, "{kernel:?}: {off:e} of {size}");
        }
    }
}

#[test]
fn int8_tables_of_the_same_values_draw_the_same_bits() {
    let a = d11();
    let (weights, _) = halve(&parameters(&a, 3));
    let grid = a.position.grid().unwrap().clone();
    let steps: Vec<i8> = noise(grid.values(), 5).iter().map(|x| (8.0 * x).round() as i8).collect();
    let stored: Vec<u8> = steps.iter().map(|&step| step as u8).collect();
    let scales = 0.125f32.to_le_bytes().repeat(grid.resolutions.len());
    let (halves, _) = halve(&steps.iter().map(|&step| 0.125 * f32::from(step)).collect::<Vec<_>>());
    let file = |tables| bytes(&Body { tables: Some(tables), ..body(a.clone(), None, &weights) });
    let files =
        [file(StoredTables::F16(&halves)), file(StoredTables::Int8 { scales: &scales, bytes: &stored })];
    for kernel in kernels() {
        let [f16, int8] =
            files.each_ref().map(|f| draw(f, kernel, &Quality::default(), ALL, Batch::FULL).pixels);
        assert!(f16.iter().any(|pixel| pixel.opacity > 0.5));
        assert_eq!(f16, int8, "{kernel:?}");
    }
}

#[test]
#[cfg(feature = "tone-map")]
fn linear_output_decodes_the_network_s_colour_and_the_background() {
    use crate::plan::{Effects, Tone};
    let decode = |c: f64| if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
    let Field { file, oracle } = field(&d11(), 3, 1.0, None);
    with(&file, Kernel::detect(), |blob, renderer| {
        let tone = Tone { linear: true, ..Tone::NONE };
        let plan = Plan::new(blob, &Quality::EXACT, Outputs::ALL, Batch::FULL).unwrap();
        let plan = plan.with_effects(Effects { tone, ..Effects::NONE }).unwrap();
        let found = render(renderer, &plan, &camera(20, 13)).pixels;
        let expected: Vec<_> = rays(20, 13)
            .map(|ray| {
                let (rgb, opacity) = oracle.pixel(&ray, &Quality::EXACT);
                let linear = [0, 1, 2].map(|c| {
                    let behind = f64::from(SCENE.background[c]);
                    let own = if opacity > 0.0 { (rgb[c] - (1.0 - opacity) * behind) / opacity } else { 0.0 };
                    opacity * decode(own) + (1.0 - opacity) * decode(behind)
                });
                (linear, opacity)
            })
            .collect();
        let off = worst(&found, expected.iter());
        assert!(off <= tolerance(Kernel::detect(), 5e-6) * 4.0, "{off:e}");
    });
}

/// The colour of a collision is the colour of its sample's `h`, and its probability is the sample's weight. The mean
/// colour of collisions is thus the mean of samples' colours. The frame's colour differs: the colour branch is not
/// linear.
#[test]
fn a_collision_has_the_colour_of_its_one_sample() {
    const DRAWS: usize = 2000;
    let kernel = Kernel::IN_PLACE;
    let (mut seen, mut apart) = (0, 0.0f64);
    for a in [d11(), d00()] {
        let Field { file, oracle } = field(&a, 3, 0.3, None);
        for ray in rays(6, 5) {
            let samples = oracle.samples(&ray);
            let own: Vec<_> = samples.iter().map(|s| oracle.network(&s.h, ray.dir)).collect();
            let mut mean = [0.0; 3];
            let segments = [RaySegment::from(ray); DRAWS];
            let random: Vec<f32> = (0..DRAWS).map(|i| (i as f32 + 0.5) / DRAWS as f32).collect();
            with(&file, kernel, |blob, renderer| {
                let plan = Plan::new(blob, &Quality::default(), Outputs::ALL, Batch::FULL).unwrap();
                let mut memory = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
                let mut worker = renderer.worker(&plan, &mut memory).unwrap();
                let mut put = |_: usize, pixel: &Pixel| {
                    let rgb = pixel.rgb.map(f64::from);
                    mean = [0, 1, 2].map(|c| mean[c] + rgb[c] / DRAWS as f64);
                    let t = f64::from(pixel.ray_distance);
                    let Some(i) = samples.iter().position(|s| (s.t - t).abs() < 0.0625 - 1e-5) else {
                        return;
                    };
                    let off = (0..3).map(|c| (rgb[c] - own[i][c]).abs()).fold(0.0, Worse::worse);
                    assert!(pixel.opacity == 1.0 && off < 2e-5, "{off:e}");
                    seen += 1;
                };
                let counters = worker.sample_rays(&segments, &random, None, &mut put).unwrap();
                assert!(counters.colour_evaluations <= DRAWS as u64, "one network a collision");
            });
            let (mut left, mut expected) = (1.0, [0.0; 3]);
            for (s, own) in samples.iter().zip(&own) {
                let weight = left * (1.0 - (-s.sigma * 0.125).exp());
                left -= weight;
                expected = [0, 1, 2].map(|c| expected[c] + weight * own[c]);
            }
            expected = [0, 1, 2].map(|c| expected[c] + left * f64::from(SCENE.background[c]));
            let drawn = oracle.pixel(&ray, &Quality::EXACT).0;
            for c in 0..3 {
                // The number of draws of a sample is proportional to the sample's weight, within one draw.
                let bound = (samples.len() + 1) as f64 / DRAWS as f64;
                let off = (mean[c] - expected[c]).abs();
                assert!(off <= bound, "{off} of {bound}");
                apart = apart.max((mean[c] - drawn[c]).abs() / bound);
            }
        }
    }
    assert!(seen > 10_000 && apart > 2.0, "{seen} collisions, the mean is {apart} bounds from the frame");
}

#[test]
#[cfg(all(feature = "anti-aliasing", feature = "contraction"))]
fn several_rays_a_pixel_of_an_unbounded_scene_are_the_same_in_every_batch() {
    use crate::blob::{Content, SceneSampling};
    use crate::plan::Effects;
    for a in [d11(), d00()] {
        let (weights, _) = halve(&parameters(&a, 3));
        let (tables, _) = halve(&noise(a.position.grid().unwrap().values(), 5));
        let sampling = SceneSampling::Contracted { step: 0.07, power: 2 };
        let content = Content::Scene(crate::blob::SceneFacts { sampling, ..SCENE });
        let tables = Some(StoredTables::F16(&tables));
        let file = bytes(&Body { content, tables, ..body(a.clone(), None, &weights) });
        for kernel in kernels() {
            let draw = |batch| {
                with(&file, kernel, |blob, renderer| {
                    let plan = Plan::new(blob, &Quality::default(), ALL, batch).unwrap();
                    let plan = plan.with_effects(Effects { anti_aliasing: 4, ..Effects::NONE }).unwrap();
                    render(renderer, &plan, &camera(9, 7))
                })
            };
            let (expected, other) = (draw(Batch::FULL), draw(Batch { rays: 5, samples: BLOCK }));
            assert_eq!((expected.pixels, expected.counters), (other.pixels, other.counters), "{kernel:?}");
            assert!(expected.counters.colour_evaluations > 100 && expected.counters.invalid_samples == 0);
        }
    }
}
