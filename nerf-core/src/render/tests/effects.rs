//! Tests of effects on whole frames.

use super::*;
use crate::plan::{Effects, Jitter, ThinLens, Tone, ToneMap};

const LENS: ThinLens = ThinLens { aperture_radius: 0.2, focus_distance: 3.5 };

/// Sets of effects: none, each effect of this build alone, and all effects together.
fn each() -> Vec<Effects> {
    let none = Effects::NONE;
    let (jitter, depth_of_field) = (Some(Jitter { seed: 3 }), Some(LENS));
    let tone = Tone { exposure: 0.5, map: ToneMap::Filmic, linear: false };
    let mut all = vec![none];
    let mut sum = none;
    if cfg!(feature = "jitter") {
        all.push(Effects { jitter, ..none });
        sum.jitter = jitter;
    }
    if cfg!(feature = "anti-aliasing") {
        all.push(Effects { anti_aliasing: 3, ..none });
        sum.anti_aliasing = 5;
    }
    if cfg!(feature = "depth-of-field") {
        all.push(Effects { depth_of_field, ..none });
        sum.depth_of_field = depth_of_field;
    }
    if cfg!(feature = "tone-map") {
        all.push(Effects { tone, ..none });
        sum.tone = tone;
    }
    all.push(sum);
    all
}

/// Blob of a scene with every kind of layer and an occupancy grid.
fn scene() -> Vec<u8> {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 31));
    bytes(&body(a, Some(StoredOccupancy { resolution: [2; 3], bits: &[0b1110_1011] }), &weights))
}

fn in_place<'a>(blob: &Blob<'a>) -> Renderer<'a> {
    Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap()
}

fn plan<'a>(blob: &Blob<'a>, effects: Effects) -> Plan<'a> {
    let plan = Plan::new(blob, &Quality::default(), Outputs::ALL, Batch::FULL).unwrap();
    plan.with_effects(effects).unwrap()
}

#[test]
fn tiles_batches_and_kernels_memory_change_no_bit_of_any_effect() {
    let bytes = scene();
    let blob = Blob::open(&bytes).unwrap();
    let camera = camera(11, 9);
    for kernel in kernels() {
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        for effects in each() {
            let quality = Quality::default();
            let plan = |batch| {
                Plan::new(&blob, &quality, Outputs::ALL, batch).unwrap().with_effects(effects).unwrap()
            };
            let whole = render(&renderer, &plan(Batch::FULL), &camera);
            for rays in [1, 5, 64] {
                let found = render(&renderer, &plan(Batch { rays, samples: BLOCK }), &camera);
                assert_eq!(found.pixels, whole.pixels, "{kernel:?} {effects:?} {rays} rays");
                assert_eq!(found.counters, whole.counters, "{kernel:?} {effects:?} {rays} rays");
            }
            let plan = plan(Batch::FULL);
            let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
            for tile in Rect::full(&camera).tiles(4, 3) {
                let mut check = |x: u32, y: u32, pixel: &Pixel| {
                    assert_eq!(*pixel, whole.pixels[(y * 11 + x) as usize], "{kernel:?} {effects:?}");
                };
                renderer.render(&plan, &camera, tile, &mut workspace, &mut check).unwrap();
            }
        }
    }
}

#[test]
fn what_is_off_costs_nothing_and_what_asks_for_nothing_is_off() {
    let bytes = scene();
    let blob = Blob::open(&bytes).unwrap();
    let renderer = in_place(&blob);
    let camera = camera(9, 8);
    let plain = Plan::new(&blob, &Quality::default(), Outputs::ALL, Batch::FULL).unwrap();
    let picture = render(&renderer, &plain, &camera);
    let pinhole = Some(ThinLens { aperture_radius: 0.0, focus_distance: 3.0 });
    for effects in [Effects::NONE, Effects { depth_of_field: pinhole, ..Effects::NONE }] {
        let plan = plain.with_effects(effects).unwrap();
        assert_eq!(renderer.workspace_lines(&plan), renderer.workspace_lines(&plain));
        let found = render(&renderer, &plan, &camera);
        assert_eq!((found.pixels, found.counters), (picture.pixels.clone(), picture.counters));
    }
    // Only anti-aliasing needs more memory and more rays.
    for effects in each() {
        let plan = plan(&blob, effects);
        let found = render(&renderer, &plan, &camera).counters;
        assert_eq!(found.rays, 72 * u64::from(effects.anti_aliasing));
        assert_eq!(found.samples_kept + found.samples_skipped, found.rays * 32);
        let grown = renderer.workspace_lines(&plan) > renderer.workspace_lines(&plain);
        assert_eq!(grown, effects.anti_aliasing > 1, "{effects:?}");
    }
}

#[cfg(feature = "tone-map")]
#[test]
fn a_frame_without_colour_has_no_tone_stage() {
    let bytes = scene();
    let blob = Blob::open(&bytes).unwrap();
    let renderer = in_place(&blob);
    let shape = Outputs { rgb: false, ..Outputs::ALL };
    let plain = Plan::new(&blob, &Quality::default(), shape, Batch::FULL).unwrap();
    let tone = Tone { exposure: 3.0, map: ToneMap::Reinhard, linear: true };
    let toned = plain.with_effects(Effects { tone, ..Effects::NONE }).unwrap();
    let stages = renderer.explain(&toned).stages();
    assert!(stages.iter().any(|stage| stage.name == "tone" && stage.switch == Switch::NotAskedFor));
    let camera = camera(5, 5);
    assert_eq!(render(&renderer, &toned, &camera).pixels, render(&renderer, &plain, &camera).pixels);
}

#[cfg(feature = "tone-map")]
fn decode(c: f64) -> f64 {
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// With linear output, fog and background are mixed in linear light, and one stop of exposure doubles the pixel.
#[cfg(feature = "tone-map")]
#[test]
fn linear_output_is_composited_as_light_and_a_stop_doubles_it() {
    let a = architecture(pi(3, 4), None, &[(4, false)], &[]);
    let raw = [0.0f32, 2.0, -1.0];
    let (weights, _) = halve(&constant(&a, 0.3, raw));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = in_place(&blob);
    let camera = camera(9, 9);
    let go = |tone| render(&renderer, &plan(&blob, Effects { tone, ..Effects::NONE }), &camera).pixels;
    let linear = go(Tone { linear: true, ..Tone::NONE });
    let doubled = go(Tone { linear: true, exposure: 1.0, ..Tone::NONE });
    let display = go(Tone::NONE);
    let (mut worst, mut other) = (0.0f64, 0.0f64);
    for ((display, linear), doubled) in display.iter().zip(&linear).zip(&doubled) {
        for (c, raw) in raw.into_iter().enumerate() {
            let colour = decode(1.0 / (1.0 + f64::from(-raw).exp()));
            let (opacity, background) = (f64::from(linear.opacity), f64::from(SCENE.background[c]));
            let expected = opacity * colour + (1.0 - opacity) * decode(background);
            worst = worst.max((f64::from(linear.rgb[c]) - expected).abs());
            other = other.max((f64::from(linear.rgb[c]) - decode(display.rgb[c].into())).abs());
            assert_eq!(doubled.rgb[c], 2.0 * linear.rgb[c]);
        }
        let rest = |p: &Pixel| (p.opacity, p.ray_distance, p.z_depth);
        assert_eq!((rest(linear), rest(doubled)), (rest(display), rest(display)));
    }
    std::println!("linear: {worst:e}; of the decoded display picture: {other:e}");
    assert!(worst <= 1e-6 && other > 0.01);
    let mapped = go(Tone { map: ToneMap::Filmic, exposure: 4.0, ..Tone::NONE });
    assert!(mapped.iter().flat_map(|pixel| pixel.rgb).all(|c| (0.0..=1.0).contains(&c)));
}

/// With linear output, every kernel decodes the colour of each point to linear light.
#[cfg(feature = "tone-map")]
#[test]
fn samples_of_linear_output_are_those_of_display_output_decoded() {
    let bytes = scene();
    let blob = Blob::open(&bytes).unwrap();
    for kernel in crate::Kernel::all() {
        let mut memory = vec![crate::Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        let points: Vec<[f32; 3]> = crate::testing::noise(3 * 200, 3).as_chunks().0.to_vec();
        let dirs = vec![[0.0, 0.6, -0.8]; points.len()];
        let go = |tone| {
            let plan = plan(&blob, Effects { tone, ..Effects::NONE });
            let mut workspace = vec![crate::Line::UNINIT; renderer.workspace_lines(&plan)];
            let (mut sigma, mut rgb) = (vec![0.0; points.len()], vec![[0.0; 3]; points.len()]);
            renderer.query(&plan, &points, &dirs, &mut workspace, &mut sigma, &mut rgb).unwrap();
            rgb
        };
        let (display, linear) = (go(Tone::NONE), go(Tone { linear: true, ..Tone::NONE }));
        for (display, linear) in display.as_flattened().iter().zip(linear.as_flattened()) {
            let off = (f64::from(*linear) - decode((*display).into())).abs();
            assert!(off <= 4e-7, "{kernel}: {display} {linear}");
        }
        assert!(display.as_flattened().iter().any(|c| *c > 0.5) && display.as_flattened().contains(&0.0));
    }
}

#[cfg(feature = "anti-aliasing")]
#[test]
fn the_mean_of_a_constant_field_is_that_field() {
    let a = architecture(pi(3, 4), None, &[(16, false)], &[]);
    // Empty space, and a fog in the colour of its background: each pixel has the background's colour.
    for (sigma, grey) in [(-1.0, [0.25, 0.5, 1.0]), (0.8, [0.5; 3])] {
        let (weights, _) = halve(&constant(&a, sigma, [0.0; 3]));
        let bytes = bytes(&body(a.clone(), None, &weights));
        let blob = Blob::open(&bytes).unwrap();
        for rays in [1, 2, 3, 16, 255, 256] {
            let effects = Effects { anti_aliasing: rays, ..Effects::NONE };
            let plan = plan(&blob, effects).with_background(grey).unwrap();
            for pixel in render(&in_place(&blob), &plan, &camera(3, 3)).pixels {
                for (seen, grey) in pixel.rgb.into_iter().zip(grey) {
                    // Tolerance: a few ulp for a ray of 32 samples, half an ulp for the compensated mean.
                    assert!((seen - grey).abs() <= 4e-7 * grey, "{rays} rays: {seen}");
                }
            }
        }
    }
}

#[cfg(feature = "anti-aliasing")]
#[test]
fn many_rays_a_pixel_converge_to_the_picture_of_many_pixels() {
    const FINE: u32 = 32;
    let bytes = scene();
    let blob = Blob::open(&bytes).unwrap();
    let renderer = in_place(&blob);
    let coarse = camera(6, 5);
    let i = *coarse.intrinsics();
    let scaled = Intrinsics {
        width: FINE * i.width,
        height: FINE * i.height,
        fx: FINE as f32 * i.fx,
        fy: FINE as f32 * i.fy,
        cx: FINE as f32 * i.cx,
        cy: FINE as f32 * i.cy,
    };
    let fine = Camera::new(scaled, Lens::NONE, *coarse.pose()).unwrap();
    let fine = render(&renderer, &plan(&blob, Effects::NONE), &fine).pixels;
    let mean = |x: u32, y: u32, channel: usize| {
        let pixels = (0..FINE * FINE).map(|k| {
            let (row, column) = (y * FINE + k / FINE, x * FINE + k % FINE);
            fine[(row * FINE * i.width + column) as usize].rgb[channel]
        });
        pixels.map(f64::from).sum::<f64>() / f64::from(FINE * FINE)
    };
    let error = |rays| {
        let effects = Effects { anti_aliasing: rays, ..Effects::NONE };
        let pixels = render(&renderer, &plan(&blob, effects), &coarse).pixels;
        let mut sum = 0.0;
        for (k, pixel) in (0..).zip(&pixels) {
            for c in 0..3 {
                sum += (f64::from(pixel.rgb[c]) - mean(k % i.width, k / i.width, c)).powi(2);
            }
        }
        (sum / (3 * pixels.len()) as f64).sqrt()
    };
    let errors = [1, 4, 16, 64, 256].map(error);
    std::println!("rms error of 1, 4, 16, 64, 256 rays: {errors:?}");
    // The error falls at least as fast as with random rays: by the square root of the number of rays.
    for (step, found) in (0..).zip(errors) {
        assert!(found <= errors[0] / f64::from(1 << step), "{errors:?}");
    }
}

#[cfg(feature = "jitter")]
#[test]
fn jittered_rays_are_those_of_a_row_of_pixels_in_every_batch() {
    let bytes = scene();
    let blob = Blob::open(&bytes).unwrap();
    let renderer = in_place(&blob);
    let camera = camera(41, 1);
    let rays: Vec<RaySegment> = (0..41).map(|x| camera.ray(x as f32 + 0.5, 0.5).into()).collect();
    let effects = Effects { jitter: Some(Jitter { seed: 3 }), ..Effects::NONE };
    let full = plan(&blob, effects);
    let row = render(&renderer, &full, &camera).pixels;
    assert_ne!(row, render(&renderer, &plan(&blob, Effects::NONE), &camera).pixels);
    for batch in [1, 5, 16, 64] {
        let batch = Batch { rays: batch, samples: BLOCK };
        let plan = Plan::new(&blob, &Quality::default(), Outputs::ALL, batch).unwrap();
        let plan = plan.with_effects(effects).unwrap();
        let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
        let mut worker = renderer.worker(&plan, &mut workspace).unwrap();
        let mut found = vec![Pixel::BLANK; rays.len()];
        let mut put = |i: usize, pixel: &Pixel| found[i] = *pixel;
        worker.render_rays(&rays, Some(camera.pose().forward()), &mut put).unwrap();
        assert_eq!(found, row, "{batch:?}");
    }
}

#[cfg(feature = "jitter")]
#[test]
fn the_expectation_of_jitter_is_the_integral() {
    // A fog of density ¾ in a box. Without jitter, the fog's length along a ray is rounded to whole bins.
    let a = architecture(pi(3, 4), None, &[(16, false)], &[]);
    let sigma = 0.75;
    let (weights, _) = halve(&constant(&a, sigma, [0.0; 3]));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = in_place(&blob);
    let camera = camera(6, 5);
    let bounds = SceneBox { min: Vec3::NEG_ONE, max: Vec3::ONE };
    const SEEDS: u64 = 400;
    let mut sums = vec![0.0f64; 30];
    for seed in 0..SEEDS {
        let effects = Effects { jitter: Some(Jitter { seed }), ..Effects::NONE };
        let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::FULL).unwrap();
        let picture = render(&renderer, &plan.with_effects(effects).unwrap(), &camera);
        for (sum, pixel) in sums.iter_mut().zip(&picture.pixels) {
            *sum += f64::from(pixel.opacity);
        }
    }
    // A bin that a face cuts at fraction p has its sample inside with probability p: the variance is p (1 − p), at most
    // ¼. Two such bins change the optical thickness by at most δ = 0.125 sigma each. The opacity's standard deviation
    // is thus below δ/√2, and five standard deviations of the mean of 400 seeds are 5 δ/√(2 · 400). Curvature adds at
    // most δ²/4.
    let delta = 0.125 * f64::from(sigma);
    let limit = 5.0 * delta / (2.0 * SEEDS as f64).sqrt() + delta * delta / 4.0;
    let plain = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::FULL).unwrap();
    let plain = render(&renderer, &plain, &camera).pixels;
    let (mut worst, mut worst_plain) = (0.0f64, 0.0f64);
    for (k, sum) in sums.iter().enumerate() {
        let ray = camera.ray((k % 6) as f32 + 0.5, (k / 6) as f32 + 0.5);
        let chord = bounds.clip(&ray, 2.0, 6.0).map_or(0.0, |(enter, exit)| f64::from(exit - enter));
        let truth = -(-f64::from(sigma) * chord).exp_m1();
        worst = worst.max((sum / SEEDS as f64 - truth).abs());
        worst_plain = worst_plain.max((f64::from(plain[k].opacity) - truth).abs());
    }
    std::println!(
        "mean over {SEEDS} seeds off by {worst:e}, limit {limit:e}; the middles by {worst_plain:e}"
    );
    assert!(worst <= limit && worst_plain > worst, "{worst:e}");
}

#[cfg(feature = "depth-of-field")]
#[test]
fn a_wide_aperture_blurs_what_is_out_of_focus_and_less_what_is_near_it() {
    let bytes = scene();
    let blob = Blob::open(&bytes).unwrap();
    let renderer = in_place(&blob);
    let camera = camera(12, 12);
    let rays = if cfg!(feature = "anti-aliasing") { 16 } else { 1 };
    let sharp = render(&renderer, &plan(&blob, Effects { anti_aliasing: rays, ..Effects::NONE }), &camera);
    let off = |focus_distance| {
        let lens = Some(ThinLens { aperture_radius: 0.15, focus_distance });
        let effects = Effects { anti_aliasing: rays, depth_of_field: lens, ..Effects::NONE };
        let seen = render(&renderer, &plan(&blob, effects), &camera).pixels;
        let square = |(a, b): (&Pixel, &Pixel)| f64::from(a.opacity - b.opacity).powi(2);
        seen.iter().zip(&sharp.pixels).map(square).sum::<f64>()
    };
    // The distance from the camera to the scene's middle is 4.0.
    let (focused, near) = (off(4.0), off(0.7));
    std::println!("off by {focused:e} in focus, {near:e} out of it");
    assert!(focused > 0.0 && near > 4.0 * focused);
}
