extern crate std;

use super::*;
use std::string::ToString;

/// One request for each effect, with the feature that brings it and whether this build has it.
fn each() -> [(&'static str, bool, Effects); 6] {
    let lens = ThinLens { aperture_radius: 0.1, focus_distance: 4.0 };
    let tone = |tone| Effects { tone, ..Effects::NONE };
    [
        ("jitter", jitter::BUILT, Effects { jitter: Some(Jitter { seed: 7 }), ..Effects::NONE }),
        ("anti-aliasing", anti_aliasing::BUILT, Effects { anti_aliasing: 2, ..Effects::NONE }),
        ("depth-of-field", depth_of_field::BUILT, Effects { depth_of_field: Some(lens), ..Effects::NONE }),
        ("tone-map", tone::BUILT, tone(Tone { exposure: 1.0, ..Tone::NONE })),
        ("tone-map", tone::BUILT, tone(Tone { map: ToneMap::Filmic, ..Tone::NONE })),
        ("tone-map", tone::BUILT, tone(Tone { linear: true, ..Tone::NONE })),
    ]
}

#[test]
fn what_this_build_lacks_is_refused_by_the_name_of_its_feature() {
    assert_eq!(Effects::NONE.checked(), Ok(Effects::NONE));
    for (feature, built, effects) in each() {
        if built {
            assert_eq!(effects.checked(), Ok(effects), "{feature}");
        } else {
            let error = effects.checked().unwrap_err();
            assert_eq!(error, EffectError::NotBuilt { feature });
            assert!(error.to_string().contains(feature), "{error}");
        }
    }
    assert_eq!(jitter::BUILT, cfg!(feature = "jitter"));
    assert_eq!(anti_aliasing::BUILT, cfg!(feature = "anti-aliasing"));
    assert_eq!(depth_of_field::BUILT, cfg!(feature = "depth-of-field"));
    assert_eq!(tone::BUILT, cfg!(feature = "tone-map"));
}

#[test]
fn settings_out_of_range_are_refused_by_name() {
    for found in [0, 257, u16::MAX] {
        let error = Effects { anti_aliasing: found, ..Effects::NONE }.checked().unwrap_err();
        assert_eq!(error, EffectError::AntiAliasing { found });
        assert!(error.to_string().contains("anti_aliasing: expected 1 to 256"), "{error}");
    }
    let lens = |aperture_radius, focus_distance| Effects {
        depth_of_field: Some(ThinLens { aperture_radius, focus_distance }),
        ..Effects::NONE
    };
    for found in [-1e-9, 1.1e9, f32::INFINITY] {
        assert_eq!(lens(found, 1.0).checked(), Err(EffectError::Aperture { found }));
        assert_eq!(lens(1.0, found).checked(), Err(EffectError::Focus { found }));
    }
    assert_eq!(lens(1.0, 0.0).checked(), Err(EffectError::Focus { found: 0.0 }));
    assert!(lens(f32::NAN, 1.0).checked().unwrap_err().to_string().contains("aperture_radius"));
    assert!(lens(1.0, f32::NAN).checked().unwrap_err().to_string().contains("focus_distance"));
    let exposure = |exposure| Effects { tone: Tone { exposure, ..Tone::NONE }, ..Effects::NONE };
    for found in [-32.5, 33.0, f32::INFINITY] {
        assert_eq!(exposure(found).checked(), Err(EffectError::Exposure { found }));
    }
    assert!(exposure(f32::NAN).checked().unwrap_err().to_string().contains("exposure"));
}

#[test]
fn a_lens_without_aperture_is_a_pinhole_in_every_build() {
    // Its focus does not matter, not even as a number.
    for focus_distance in [1.0, 0.0, f32::NAN] {
        let pinhole = Some(ThinLens { aperture_radius: 0.0, focus_distance });
        let effects = Effects { depth_of_field: pinhole, ..Effects::NONE };
        assert_eq!(effects.checked(), Ok(Effects::NONE));
    }
}

#[cfg(feature = "jitter")]
mod jittered {
    use super::*;
    use crate::ray::{Ray, SceneBox};
    use crate::sampling::{Bins, OccupancyGrid};
    use crate::testing::noise;
    use glam::Vec3;
    use std::vec::Vec;

    fn place(seed: u64, x: u32, y: u32, ray: u32) -> jitter::SampleJitter {
        jitter::SampleJitter::of(&Effects { jitter: Some(Jitter { seed }), ..Effects::NONE }, x, y, ray)
    }

    #[test]
    fn samples_lie_in_their_bins_in_order_and_evenly() {
        for count in [1, 3, 64, 4096] {
            let bins = Bins::new(2.0, 6.0, count).unwrap();
            let (mut sum, mut n) = (0.0, 0);
            for pixel in 0..40 {
                let place = place(1, pixel, 2 * pixel, pixel % 3);
                let t: Vec<f32> = (0..count).map(|bin| place.t(&bins, bin)).collect();
                assert!(t.is_sorted());
                for (bin, &t) in t.iter().enumerate() {
                    let bin_of_it = bin as u32;
                    assert!((bins.at(bin_of_it, 0.0)..bins.at(bin_of_it + 1, 0.0)).contains(&t));
                    assert_eq!(bins.middle_around(t), bins.at(bin_of_it, 0.5));
                    sum += f64::from((t - 2.0) / bins.delta()) - bin as f64;
                    n += 1;
                }
            }
            // The mean of n uniform numbers is within 5 deviations of ½; t itself rounds.
            let off = (sum / f64::from(n) - 0.5).abs();
            assert!(off < 5.0 / (12.0 * f64::from(n)).sqrt() + 1e-3, "{count} bins: {off}");
        }
    }

    #[test]
    fn a_fraction_of_nearly_one_stays_in_its_bin() {
        // (bin + u) rounds to bin + 1 from some 64 bins on, and what lies on an edge is of the next bin.
        for (near, far, count) in
            [(2.0, 6.0, 4096), (2.0, 6.1, 4096), (0.0, 217.78308, 473), (6.5900173, 109.108185, 399)]
        {
            let bins = Bins::new(near, far, count).unwrap();
            for bin in 0..count {
                for u in [0.0, 0.5, 1.0f32.next_down()] {
                    let t = bins.within(bin, u);
                    assert!((bins.at(bin, 0.0)..bins.at(bin + 1, 0.0)).contains(&t), "{u} of {bin}: {t}");
                    assert_eq!(bins.middle_around(t), bins.at(bin, 0.5), "{u} of {bin}");
                }
            }
        }
    }

    #[test]
    fn every_pixel_ray_bin_and_seed_has_a_number_of_its_own() {
        // A bin is 1 long: the fraction is what is left of t.
        let bins = Bins::new(0.0, 64.0, 64).unwrap();
        let mut seen: Vec<u32> = Vec::new();
        for seed in [0, 1, u64::MAX] {
            for (x, y, ray) in [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1 << 20, 3, 255)] {
                let place = place(seed, x, y, ray);
                seen.extend((0..64).map(|bin| (place.t(&bins, bin) - bin as f32).to_bits()));
            }
        }
        let count = seen.len();
        seen.sort_unstable();
        seen.dedup();
        // Of 2^18 numbers that a fraction behind 32 can be, 960 meet once or twice by chance.
        assert!(100 * seen.len() >= 99 * count, "{} of {count}", seen.len());
    }

    #[test]
    fn the_walk_through_the_occupancy_grid_finds_the_first_jittered_sample_that_is_live() {
        let bounds = SceneBox { min: Vec3::new(-1.0, -2.0, -1.0), max: Vec3::new(1.0, 1.0, 3.0) };
        let numbers = noise(3000, 5);
        let (mut found_some, mut passed) = (0, 0);
        for (case, n) in numbers.chunks_exact(6).enumerate() {
            let resolution = [[2, 3, 4], [7, 5, 9], [32, 32, 32]][case % 3];
            let cells = resolution.iter().map(|&side| usize::from(side)).product::<usize>();
            let bits: Vec<u8> =
                (0..cells.div_ceil(8)).map(|i| ((i * 31 + case) % 17 / 12) as u8 * 5).collect();
            let occupancy = OccupancyGrid::new(bounds, resolution, &bits);
            let bins = Bins::new(0.5, 9.0, [16, 200, 1500][case / 3 % 3]).unwrap();
            let origin = Vec3::new(n[0], n[1], n[2]) * 4.0;
            let Some(dir) = (Vec3::new(n[3], n[4], n[5]) - origin).try_normalize() else { continue };
            let (ray, place) = (Ray { origin, dir }, place(9, case as u32, 3, 0));
            let t = |bin| place.t(&bins, bin);
            let end = bins.count();
            let mut from = 0;
            for _ in 0..20 {
                let naive = (from..end).find(|&bin| occupancy.occupied(ray.at(t(bin)))).unwrap_or(end);
                assert_eq!(
                    occupancy.first_occupied_at(&ray, &bins, from, end, t),
                    naive,
                    "case {case} from {from}"
                );
                found_some += usize::from(naive < end);
                passed += naive - from;
                from = (naive + 1).min(end);
            }
            // What the box leaves over holds no live sample either.
            if let Some((enter, exit)) = bounds.clip(&ray, 0.5, 9.0) {
                let inside = bins.overlapping(enter, exit);
                let outside = (0..end).filter(|bin| !inside.contains(bin));
                assert!(outside.clone().all(|bin| !bounds.contains(ray.at(t(bin)))));
            }
        }
        assert!(found_some > 100 && passed > 10_000, "{found_some} {passed}");
    }
}

#[cfg(feature = "anti-aliasing")]
mod several_rays {
    use super::*;
    use crate::kernels::{Arena, Line, Measure};
    use crate::volume::Pixel;
    use anti_aliasing::{Sums, offset};
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn one_ray_is_the_centre_s_and_several_spread_evenly_around_it() {
        for n in [1u16, 2, 3, 4, 6, 16, 37, 64, 256] {
            let effects = Effects { anti_aliasing: n, ..Effects::NONE };
            let points: Vec<(f32, f32)> = (0..n.into()).map(|ray| offset(&effects, ray)).collect();
            assert!(n > 1 || points == [(0.5, 0.5)]);
            // Every row and every column has one.
            for (right, axis) in [|p: &(f32, f32)| p.0, |p: &(f32, f32)| p.1].into_iter().enumerate() {
                let mut cells: Vec<u16> = points.iter().map(|p| (axis(p) * f32::from(n)) as u16).collect();
                cells.sort_unstable();
                assert!(cells.into_iter().eq(0..n), "{n} rays, axis {right}");
            }
            // Any rectangle from the corner holds its share, but for log n / n: random points have 1/√n.
            let mut worst = 0.0f32;
            for (a, b) in (1..=8).flat_map(|a| (1..=8).map(move |b| (a as f32 / 8.0, b as f32 / 8.0))) {
                let inside = points.iter().filter(|(x, y)| *x < a && *y < b).count();
                worst = worst.max((inside as f32 / f32::from(n) - a * b).abs());
            }
            std::println!("{n} rays: discrepancy {worst}");
            assert!(worst <= (f32::from(n).ln() + 1.0) / f32::from(n), "{n}: {worst}");
        }
    }

    fn lines(effects: &Effects, surface: bool, pixels: usize) -> usize {
        let mut measure = Measure::default();
        Sums::lay_out(&mut measure, effects, surface, pixels);
        measure.lines
    }

    #[test]
    fn a_mean_weights_distances_by_opacity_and_leaves_out_what_has_no_surface() {
        let effects = Effects { anti_aliasing: 4, ..Effects::NONE };
        let mut memory = vec![Line::UNINIT; lines(&effects, false, 2)];
        let mut sums = Sums::lay_out(&mut Arena::new(&mut memory), &effects, false, 2);
        let pixel = |grey, opacity, ray_distance| Pixel {
            rgb: [grey; 3],
            opacity,
            ray_distance,
            z_depth: 0.5 * ray_distance,
            ..Pixel::BLANK
        };
        // Two tiles: what the first has left behind does not matter.
        for _ in 0..2 {
            let rays =
                [pixel(1.0, 1.0, 2.0), pixel(0.5, 0.25, 4.0), pixel(0.0, 0.0, 9.0), pixel(0.5, 5e-5, 9.0)];
            for (ray, seen) in rays.into_iter().enumerate() {
                let empty = pixel(0.25, 5e-5, 9.0);
                let none = sums.add(&effects, 0, ray as u32, empty, 9.0);
                let mean = sums.add(&effects, 1, ray as u32, seen, 9.0);
                assert!(ray == 3 || none.is_none() && mean.is_none());
                if let (Some(none), Some(mean)) = (none, mean) {
                    assert_eq!(none, Pixel { ray_distance: 9.0, z_depth: 9.0, ..empty });
                    assert_eq!(mean.rgb, [0.5; 3]);
                    assert!((mean.opacity - 1.250_05 / 4.0).abs() < 1e-7);
                    assert!((mean.ray_distance - 3.0 / 1.25).abs() < 1e-6);
                    assert!((mean.z_depth - 1.5 / 1.25).abs() < 1e-6);
                }
            }
        }
        assert_eq!(lines(&Effects::NONE, true, 1 << 20), 0, "no memory for one ray a pixel");
    }

    #[test]
    fn a_median_needs_half_of_the_rays_and_normals_turn_with_opacity() {
        let effects = Effects { anti_aliasing: 4, ..Effects::NONE };
        let mut memory = vec![Line::UNINIT; lines(&effects, true, 1)];
        let mut sums = Sums::lay_out(&mut Arena::new(&mut memory), &effects, true, 1);
        let pixel =
            |opacity, median_distance, normal| Pixel { opacity, median_distance, normal, ..Pixel::BLANK };
        let mut mean = |rays: [Pixel; 4]| {
            let add = |(ray, pixel)| sums.add(&effects, 0, ray as u32, pixel, 9.0);
            rays.into_iter().enumerate().filter_map(add).next().unwrap()
        };
        let (x, y) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        let edge =
            mean([pixel(1.0, 3.0, x), pixel(0.75, 4.0, y), pixel(0.0, 9.0, [0.0; 3]), pixel(0.0, 9.0, y)]);
        assert_eq!(edge.median_distance, 3.5, "half of the rays have one");
        assert!((edge.normal[0] - 0.8).abs() < 1e-6 && (edge.normal[1] - 0.6).abs() < 1e-6, "{edge:?}");
        let thin = mean([pixel(1.0, 3.0, x), pixel(0.25, 9.0, x), pixel(0.0, 9.0, x), pixel(0.0, 9.0, x)]);
        assert_eq!((thin.median_distance, thin.normal), (9.0, x), "one of four");
        let across =
            mean([pixel(0.5, 0.0, x), pixel(0.5, 0.0, [-1.0, 0.0, 0.0]), Pixel::BLANK, Pixel::BLANK]);
        assert_eq!((across.median_distance, across.normal), (0.0, [0.0; 3]), "not asked for; cancelled");
    }
}

#[cfg(feature = "depth-of-field")]
mod thin_lens {
    use super::*;
    use crate::camera::{Camera, Intrinsics, Pose};
    use crate::lens::Lens;
    use glam::Vec3;

    fn camera(eye: Vec3) -> Camera {
        let pose = Pose::look_at(eye, eye + Vec3::new(-1.0, -2.0, 0.5), Vec3::Y).unwrap();
        Camera::new(Intrinsics::centred(40, 30, 35.0), Lens::NONE, pose).unwrap()
    }

    fn through(camera: &Camera, lens: ThinLens, rays: u16, ray: u32, x: u32, y: u32) -> crate::ray::Ray {
        let effects = Effects { depth_of_field: Some(lens), anti_aliasing: rays, ..Effects::NONE };
        let pinhole = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
        let area = depth_of_field::area(&effects, ray);
        depth_of_field::through_lens(&effects, camera.pose(), pinhole, (x, y), area)
    }

    #[test]
    fn all_rays_of_an_image_point_meet_in_the_plane_of_focus() {
        for (eye, aperture_radius, focus_distance) in
            [(Vec3::ZERO, 0.1, 4.0), (Vec3::new(3.0, -1.0, 2.0), 2.0, 0.5), (Vec3::ONE * 100.0, 5.0, 300.0)]
        {
            let camera = camera(eye);
            let lens = ThinLens { aperture_radius, focus_distance };
            let forward = camera.pose().forward();
            let size = eye.length() + aperture_radius + 2.0 * focus_distance;
            for (x, y) in [(0, 0), (20, 15), (39, 29), (5, 22)] {
                let pinhole = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
                let meeting = pinhole.at(focus_distance / pinhole.dir.dot(forward));
                for ray in 0..16 {
                    let seen = through(&camera, lens, 16, ray, x, y);
                    assert!((seen.dir.length() - 1.0).abs() < 3e-7);
                    let offset = seen.origin - eye;
                    assert!(offset.length() <= aperture_radius * (1.0 + 1e-6) + 2e-7 * size);
                    assert!(offset.dot(forward).abs() <= 5e-7 * size, "the aperture is flat");
                    // z_depth is t times the cosine: in the plane of focus it is the focus' distance.
                    let t = focus_distance / camera.z_per_distance(&seen);
                    assert!((seen.at(t) - meeting).length() <= 2e-6 * size, "{lens:?} ({x}, {y})");
                }
            }
        }
    }

    #[test]
    fn the_aperture_is_covered_evenly_whatever_the_number_of_rays() {
        let camera = camera(Vec3::ZERO);
        let lens = ThinLens { aperture_radius: 1.0, focus_distance: 4.0 };
        for rays in [1u16, 4, 64] {
            let (mut sum, mut square, mut n) = (Vec3::ZERO, 0.0f64, 0.0f64);
            for pixel in 0..1200 {
                for ray in 0..rays.into() {
                    let at = through(&camera, lens, rays, ray, pixel % 40, pixel / 40).origin;
                    sum += at;
                    square += f64::from(at.length_squared());
                    n += 1.0;
                }
            }
            // Uniform over the unit disc: mean 0, mean square ½; five deviations of independent pixels.
            let limit = 5.0 / (4.0 * 1200.0f64).sqrt();
            assert!(f64::from(sum.length()) / n <= limit * 1.5 && (square / n - 0.5).abs() <= limit);
        }
    }
}
