//! Tests of the batches' rays.

mod march;

use super::*;
use crate::data::demo;
use crate::model::config::Preset;
use nerf_core::space::SceneBox;

/// Ray bank without pixels, whose rays are divided into `samples` bins.
fn bank((near, far): (f32, f32), samples: u16, jitter: Jitter) -> RayBank<'static> {
    let mut config = Preset::Small.config();
    (config.sampling.samples, config.sampling.jitter) = (samples, jitter);
    let scene_box = SceneBox { min: -Vec3::ONE, max: Vec3::ONE };
    let bounds = Bounds { near, far, scene_box, contraction: None, empty_before: near };
    RayBank::new(&[], Background::Constant([0; 3]), bounds, &config).unwrap()
}

/// Ranges from near to far, each with a number of bins. In some of these ranges, samples near the end of a bin once
/// fell into the next bin.
const CUTS: [((f32, f32), u16); 8] = [
    ((2.0, 6.0), 1),
    ((2.0, 6.0), 2),
    ((2.0, 6.0), 64),
    ((2.0, 6.0), 4096),
    ((2.0, 6.1), 4096),
    ((0.0, 217.783_08), 473),
    ((6.590_017_3, 109.108_185), 399),
    ((1e4, 1e4 + 4.0), 4096),
];

#[test]
fn samples_of_training_lie_in_their_bins_and_evenly_over_the_jitter_s_width() {
    for (range, samples) in CUTS {
        let delta = bank(range, samples, Jitter::None).bins.delta();
        for jitter in [
            Jitter::Bin,
            Jitter::Width(0.0),
            Jitter::Width(0.02),
            Jitter::Width(delta),
            Jitter::Width(10.0 * delta),
        ] {
            let bank = bank(range, samples, jitter);
            let bins = bank.bins;
            let (mut sum, mut n) = (0.0, 0u32);
            for (step, index) in [(0, 0), (0, 1), (1, 0), (77, 4095), (200_000, 65_535)] {
                for bin in 0..bins.count() {
                    let t = bank.t(step, index, bin);
                    let own = bins.at(bin, 0.0)..bins.at(bin + 1, 0.0);
                    assert!(own.contains(&t), "{range:?}, {samples}, {jitter:?}: {t} of bin {bin}, {own:?}");
                    sum += f64::from((t - own.start) / delta);
                    n += 1;
                }
            }
            // The mean of n numbers, uniform from 0 to `width`, is within 5 standard deviations of `width / 2`, up to
            // the rounding of t.
            let width = match jitter {
                Jitter::Width(width) => f64::from(width / delta).min(1.0),
                _ => 1.0,
            };
            let rounding = f64::from(f32::EPSILON * range.1 / delta);
            let off = (sum / f64::from(n) - 0.5 * width).abs();
            let limit = 5.0 * width / (12.0 * f64::from(n)).sqrt() + rounding;
            assert!(off <= limit, "{range:?}, {samples}, {jitter:?}: {off}, at most {limit}");
        }
    }
}

#[test]
fn a_sample_lies_where_its_fraction_says_and_without_jitter_in_the_middle() {
    for (range, samples) in CUTS {
        let still = bank(range, samples, Jitter::None);
        let bins = still.bins;
        let width = bins.delta().min(0.02);
        for (jitter, width) in [(Jitter::Bin, None), (Jitter::Width(width), Some(width))] {
            let bank = bank(range, samples, jitter);
            for bin in 0..bins.count() {
                let u = uniform(bank.seed, Purpose::Jitter, 3, (17 << 12) + u64::from(bin));
                let u = width.map_or(u, |width| u * width / bins.delta());
                let (t, next) = (bins.at(bin, u), bins.at(bin + 1, 0.0));
                assert!(bank.t(3, 17, bin) == t || t >= next, "{range:?}, {samples}, {jitter:?}, bin {bin}");
                assert_eq!(still.t(3, 17, bin), bins.at(bin, 0.5));
            }
        }
    }
}

#[test]
fn every_step_ray_and_bin_of_training_has_a_fraction_of_its_own() {
    // Bins have length 1, so that t minus the bin's index is the fraction within the bin.
    for jitter in [Jitter::Bin, Jitter::Width(0.5), Jitter::Width(10.0)] {
        let bank = bank((0.0, 64.0), 64, jitter);
        let mut seen: Vec<u32> = Vec::new();
        for (step, index) in (0..4).flat_map(|step| (0..8).map(move |index| (step, index))) {
            seen.extend((0..64).map(|bin| (bank.t(step, index, bin) - bin as f32).to_bits()));
        }
        let count = seen.len();
        seen.sort_unstable();
        seen.dedup();
        // Beyond t = 32 a fraction takes only 2^18 values in f32, so that a few of the 2,048 fractions are equal by
        // chance.
        assert!(100 * seen.len() >= 99 * count, "{jitter:?}: {} of {count}", seen.len());
    }
}

#[test]
fn rays_of_a_line_pass_through_equally_spaced_pixels_that_no_mask_covers() {
    let mut views = demo::small(9, 1, 64).train;
    views[0].mask = Some((0..64 * 64).map(|pixel| pixel % 64 < 40).collect());
    let scene_box = Contraction::cube(Vec3::ZERO, 1.0);
    let contraction = Contraction::new(&scene_box, 1);
    let bounds = Bounds { near: 0.1, far: 100.0, scene_box, contraction, empty_before: 0.1 };
    let mut config = Preset::Grid.config().unbounded();
    let lines_of = |config: &Config| {
        let bank = RayBank::new(&views, Background::Unknown, bounds, config).unwrap();
        let (mut lines, rays) = (0, 403);
        for (step, first) in (0..20).flat_map(|step| (0..403).step_by(LINE).map(move |first| (step, first))) {
            let Some((view, pixels)) = bank.line(step, first, rays) else { continue };
            lines += 1;
            let sources = (0..LINE as u64).map(|k| bank.source(step, first + k, rays));
            assert!(sources.eq(pixels.iter().map(|&pixel| (view, pixel))), "{step}, {first}");
            let [(x, y), (next_x, next_y), ..] = pixels.map(|pixel| (pixel % 64, pixel / 64));
            assert!((next_x == x) != (next_y == y), "{pixels:?}");
            assert!(pixels.windows(2).all(|pair| pair[1] - pair[0] == pixels[1] - pixels[0]), "{pixels:?}");
            assert!(pixels.iter().all(|&pixel| views[view].counts(pixel)), "{view}: {pixels:?}");
            let dirs = pixels.map(|pixel| ray_of(&views[view].camera, pixel).dir);
            assert!(dirs[0].cross(dirs[1]).dot(dirs[3]).abs() < 1e-5, "{pixels:?}");
        }
        lines
    };
    // One in eight of 403 rays, in lines of four; some of those across the mask's edge are not drawn.
    let found = lines_of(&config);
    assert!((200..=240).contains(&found), "{found} lines");
    config.sampling.smoothness = 0.0;
    assert_eq!(lines_of(&config), 0);
    assert_eq!(pixels_on_line((5, 5), 24, 0), Some([21, 22, 23, 24]));
    assert_eq!(pixels_on_line((5, 5), 24, 4), Some([9, 14, 19, 24]));
    assert_eq!(pixels_on_line((5, 5), 24, 1), None);
}
