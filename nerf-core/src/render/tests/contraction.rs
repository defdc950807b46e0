//! Tests of frames of unbounded scenes, compared with a reference in f64.

use super::*;
use crate::blob::{Body, Content, SceneFacts, SceneSampling};
use crate::camera::Ray;
use crate::memory::Line;
use crate::plan::Span;
use crate::sampling::SampleInterval;
use crate::space::Contraction;
use crate::testing::noise;
use crate::volume::OPACITY_EPSILON;

const CENTRE: Vec3 = Vec3::new(0.5, -1.0, 0.25);
const RADIUS: f32 = 2.0;
const SIDE: u32 = 12;

fn facts(sampling: SceneSampling) -> SceneFacts {
    let cube = Contraction::cube(CENTRE, RADIUS);
    let (near, far) = (0.1 * RADIUS, 100.0 * RADIUS);
    SceneFacts { min: cube.min.into(), max: cube.max.into(), near, far, sampling, ..SCENE }
}

/// Blob of an unbounded scene with density `sigma` everywhere, or in the occupied cells of `occupancy`.
fn fog(sigma: f32, facts: &SceneFacts, occupancy: Option<StoredOccupancy<'_>>) -> Vec<u8> {
    let a = architecture(pi(3, 0), None, &[(4, false)], &[]);
    let (weights, _) = halve(&constant(&a, sigma, [0.0, 2.0, -1.0]));
    bytes(&Body { content: Content::Scene(facts.clone()), ..body(a, occupancy, &weights) })
}

/// Renders all outputs. Evaluates every sample in an occupied cell. `change`: adapts the plan.
fn draw(file: &[u8], kernel: Kernel, camera: &Camera, change: impl Fn(Plan<'_>) -> Plan<'_>) -> Picture {
    let blob = Blob::open(file).unwrap();
    let quality = Quality { occupancy: true, ..Quality::EXACT };
    let plan = change(Plan::new(&blob, &quality, outputs(), Batch::FULL).unwrap());
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
    render(&renderer, &plan, camera)
}

fn outputs() -> Outputs {
    Outputs { median_distance: cfg!(feature = "median"), ..Outputs::ALL }
}

fn camera_at(eye: Vec3, target: Vec3) -> Camera {
    let pose = Pose::look_at(eye, target, Vec3::new(0.0, 1.0, 0.1)).unwrap();
    Camera::new(Intrinsics::centred(SIDE, SIDE, SIDE as f32), Lens::NONE, pose).unwrap()
}

/// Five cameras. Distances from the centre and view directions: at the centre; at 0.7 radii facing the centre; at 1.5
/// radii looking past it; at 100 radii facing it; at 100 radii facing away.
fn cameras() -> [Camera; 5] {
    let dir = Vec3::new(0.3, 0.5, 0.8).normalize();
    [
        camera_at(CENTRE, CENTRE + dir),
        camera_at(CENTRE + 0.7 * RADIUS * dir, CENTRE),
        camera_at(CENTRE + 1.5 * RADIUS * dir, CENTRE + 3.0 * RADIUS * Vec3::X),
        camera_at(CENTRE + 100.0 * RADIUS * dir, CENTRE),
        camera_at(CENTRE + 100.0 * RADIUS * dir, CENTRE + 101.0 * RADIUS * dir),
    ]
}

fn rays(camera: &Camera) -> impl Iterator<Item = Ray> {
    (0..SIDE * SIDE).map(|i| camera.ray((i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5))
}

/// Reference in f64 for the edges and samples of a ray's bins. Positions are values of `s`, which
/// [`Contraction::distance`](crate::space::Contraction::distance) converts to distances.
struct Steps {
    power: f64,
    step: f64,
    origin: [f64; 3],
    dir: [f64; 3],
    /// Distance from the ray's origin to the ray's point nearest to the centre; 0 if that point is behind the origin.
    start: f64,
    enter: f64,
    end: f64,
    /// Position `s` of the scene's far end. The bin that contains it is cut there, and has its sample in the middle, in
    /// `s`, of the part in front of the cut.
    far: f64,
}

impl Steps {
    /// Reference for the part of `ray` between the distances `t_min` and `t_max`.
    fn of(ray: &Ray, facts: &SceneFacts, t_min: f64, t_max: f64) -> Self {
        let SceneSampling::Contracted { step, power } = facts.sampling else { panic!("{facts:?}") };
        let (origin, dir) = (ray.origin.to_array().map(f64::from), ray.dir.to_array().map(f64::from));
        let centre = CENTRE.to_array().map(f64::from);
        let start = (0..3).map(|i| (centre[i] - origin[i]) * dir[i]).sum::<f64>().max(0.0);
        let zero = Self {
            power: power.into(),
            step: step.into(),
            origin,
            dir,
            start,
            enter: 0.0,
            end: 0.0,
            far: 0.0,
        };
        let enter = zero.step_at(f64::from(facts.near).max(t_min) - start);
        let far = zero.step_at(facts.far.into());
        Self { enter, end: far.min(zero.step_at(t_max - start)), far, ..zero }
    }

    fn distance(&self, s: f64) -> f64 {
        let base = 1.0 - (s.abs() - 1.0).max(0.0) / self.power;
        let size = if s.abs() <= 1.0 { s.abs() } else { base.powf(-self.power) };
        size.copysign(s) * f64::from(RADIUS)
    }

    fn step_at(&self, distance: f64) -> f64 {
        let size = (distance / f64::from(RADIUS)).abs();
        let steps = 1.0 + self.power * (1.0 - size.powf(-1.0 / self.power));
        (if size <= 1.0 { size } else { steps }).copysign(distance)
    }

    /// Positions `s` of the beginning, the end and the sample of each bin.
    fn bins(&self) -> impl Iterator<Item = [f64; 3]> {
        let edge = |i: f64| -1.0 - self.power + i * self.step;
        let first = ((self.enter + 1.0 + self.power) / self.step).floor();
        (0..).map(move |i| first + f64::from(i)).take_while(move |&i| edge(i) < self.end).map(move |i| {
            let (from, to) = (edge(i), edge(i + 1.0));
            [from.max(self.enter), to.min(self.end), 0.5 * (from + to.min(self.far))]
        })
    }

    /// Length of the used part of the ray, world units.
    fn way(&self) -> f64 {
        (self.distance(self.end) - self.distance(self.enter)).max(0.0)
    }

    /// Mean `ray_distance` in a fog of density `sigma`.
    fn mean(&self, sigma: f64) -> f64 {
        let (mut tau, mut sum, mut total) = (0.0f64, 0.0, 0.0);
        for [from, to, at] in self.bins() {
            let thickness = sigma * (self.distance(to) - self.distance(from));
            let weight = (-tau).exp() * -(-thickness).exp_m1();
            sum += weight * self.distance(at.clamp(from, to));
            total += weight;
            tau += thickness;
        }
        self.start + sum / total
    }

    /// The contracted point of the ray at position `s`.
    fn point(&self, s: f64) -> [f64; 3] {
        let t = self.start + self.distance(s);
        let centre = CENTRE.to_array().map(f64::from);
        let q: [f64; 3] =
            core::array::from_fn(|i| (self.origin[i] + t * self.dir[i] - centre[i]) / f64::from(RADIUS));
        let r = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        let shrink = if r <= 1.0 { 1.0 } else { (2.0 - 1.0 / r) / r };
        core::array::from_fn(|i| centre[i] + q[i] * shrink * f64::from(RADIUS))
    }
}

fn contracted(step: f32, power: u8) -> SceneSampling {
    SceneSampling::Contracted { step, power }
}

/// The optical thickness of a ray through a fog is density times length, for any direction and range of the ray.
#[test]
fn a_fog_everywhere_is_as_thick_as_the_way_through_it() {
    let sigma = 0.0078125;
    for (power, kernel) in
        Contraction::POWERS.into_iter().flat_map(|p| kernels().map(move |kernel| (p, kernel)))
    {
        let facts = facts(contracted(1.0 / 32.0, power));
        let file = fog(sigma, &facts, None);
        let ranges = [0.0, 0.3, 1.9, 37.0].into_iter().flat_map(|min: f32| {
            [0.31, 2.0, 2.01, 37.5, 150.0, 199.0, 250.0, f32::INFINITY].map(|max| (min, max))
        });
        for (t_min, t_max) in ranges.filter(|(min, max)| min < max) {
            for (k, camera) in cameras().iter().enumerate() {
                let found = draw(&file, kernel, camera, |plan| plan.with_range(t_min, t_max).unwrap());
                for (pixel, ray) in found.pixels.iter().zip(rays(camera)) {
                    let steps = Steps::of(&ray, &facts, t_min.into(), t_max.into());
                    // Bound on two rounding errors: of positions, and of the point from which positions are counted.
                    let far = steps.distance(steps.end).abs().max(steps.distance(steps.enter).abs());
                    let digits = 20.0
                        * f64::from(f32::EPSILON)
                        * (far * far / f64::from(RADIUS)).max(far + steps.start);
                    let thickness = -f64::from(1.0 - pixel.opacity).ln();
                    let error = (thickness - f64::from(sigma) * steps.way()).abs();
                    // Bound on the rounding of opacity, as an optical thickness; the bound grows as the transmittance
                    // falls.
                    let opacity = 2e-7 * thickness.exp();
                    assert!(
                        error <= f64::from(sigma) * digits + opacity,
                        "{power} {k} {t_min}..{t_max}: {error:e}"
                    );
                    assert!(pixel.ray_distance <= t_max);
                    if pixel.opacity > OPACITY_EPSILON {
                        let error = (f64::from(pixel.ray_distance) - steps.mean(sigma.into())).abs();
                        assert!(
                            error <= digits + 1e-3 * far.min(steps.way()),
                            "{power} {k} {t_min}..{t_max}: distance off {error:e}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn no_occupied_cell_is_missed_and_no_other_asked() {
    let resolution = [9, 16, 7];
    let noise = noise(9 * 16 * 7 / 8, 3);
    let bits: Vec<u8> =
        noise.iter().map(|x| if *x > 0.3 { 0 } else { (x * 1e4) as i32 as u8 & 0x51 }).collect();
    let occupied = |cell: [usize; 3]| {
        let index = (cell[0] * 16 + cell[1]) * 7 + cell[2];
        bits[index / 8] >> (index % 8) & 1 == 1
    };
    let (mut kept, mut unclear) = (0, 0);
    for power in Contraction::POWERS {
        let facts = facts(contracted(1.0 / 64.0, power));
        let file = fog(0.0078125, &facts, Some(StoredOccupancy { resolution, bits: &bits }));
        for camera in cameras() {
            let (mut least, mut most) = (0, 0);
            for ray in rays(&camera) {
                let steps = Steps::of(&ray, &facts, 0.0, f64::INFINITY);
                for [from, to, at] in steps.bins() {
                    let p = steps.point(at);
                    let mut cell = [0; 3];
                    // `clear`: whether f32 must find the same cell. Next to a cell's face, or in a bin cut very short,
                    // it may find another.
                    let mut clear = to - from > 1e-4;
                    for axis in 0..3 {
                        let low = f64::from(facts.min[axis]);
                        let x = (p[axis] - low) / f64::from(4.0 * RADIUS) * f64::from(resolution[axis]);
                        clear &= (x - x.round()).abs() > 1e-4;
                        cell[axis] = (x as usize).min(usize::from(resolution[axis]) - 1);
                    }
                    least += u64::from(clear && occupied(cell));
                    most += u64::from(!clear || occupied(cell));
                }
            }
            for kernel in kernels() {
                let found = draw(&file, kernel, &camera, |plan| plan).counters.samples_kept;
                assert!((least..=most).contains(&found), "{power} {kernel:?}: {least} <= {found} <= {most}");
            }
            (kept, unclear) = (kept + least, unclear + most - least);
        }
    }
    assert!(kept > 10_000 && unclear < kept / 20, "{kept} clear, {unclear} not");
}

/// A field that is occupied only inside the ball looks the same in an unbounded and in a bounded scene, except that the
/// positions of samples differ. The range of both plans begins at `near`; otherwise the bounded scene's march would
/// begin at the camera, in front of `near`.
#[test]
fn what_lies_in_the_ball_is_seen_as_in_a_bounded_scene() {
    let a = architecture(pi(3, 0), Some(pi(3, 2)), &[(24, false), (20, false)], &[12]);
    let (weights, _) = halve(&parameters(&a, 21));
    let side = 16;
    let mut bits = vec![0u8; side * side * side / 8];
    for cell in 0..side * side * side {
        let at = |i: usize| (i as f32 + 0.5) / 4.0 - 2.0;
        let p = Vec3::new(at(cell / side / side), at(cell / side % side), at(cell % side));
        // Corners of a cell are 0.22 from its middle: these cells are inside the ball.
        if p.length() < 0.75 {
            bits[cell / 8] |= 1 << (cell % 8);
        }
    }
    let occupancy = Some(StoredOccupancy { resolution: [side as u16; 3], bits: &bits });
    let file = |sampling| {
        let content = Content::Scene(facts(sampling));
        bytes(&Body { content, ..body(a.clone(), occupancy.clone(), &weights) })
    };
    for (power, samples) in [(1, 256.0f32), (2, 256.0), (4, 256.0), (1, 500.0)] {
        let step = 1.0 / samples;
        let pictures = [contracted(step, power), SceneSampling::March(step * RADIUS)].map(|sampling| {
            draw(&file(sampling), Kernel::detect(), &cameras()[1], |plan| {
                plan.with_range(0.1 * RADIUS, f32::MAX).unwrap()
            })
            .pixels
        });
        let (mut worst, mut distance, mut seen) = (0.0f32, 0.0f32, 0);
        for (found, expected) in pictures[0].iter().zip(&pictures[1]) {
            seen += u32::from(expected.opacity > 0.1);
            for (a, b) in found.rgb.iter().zip(expected.rgb) {
                worst = worst.worse((a - b).abs());
            }
            worst = worst.worse((found.opacity - expected.opacity).abs());
            if expected.opacity > 0.1 {
                distance = distance.worse((found.ray_distance - expected.ray_distance).abs());
            }
        }
        std::println!("power {power}, {samples} steps: {worst:e}, distances {distance:e}, {seen} seen");
        let exact = if Kernel::detect().rounds() { 0.02 } else { 0.0 };
        assert!(worst <= 0.2 * step + exact && distance <= step * RADIUS + exact, "{worst} {distance}");
        assert!(seen > 30);
    }
}

/// Blob, parameters and facts of a scene that is opaque behind a plane. The plane crosses the view axis at `radii` ball
/// radii from the centre. `tilt`: x and y of the plane's normal, whose z is −1. `power`: power of the contraction.
fn plane(radii: f64, tilt: [f32; 2], power: u8) -> (Vec<u8>, Vec<f32>, SceneFacts) {
    let rim = if radii <= 1.0 { radii } else { 2.0 - 1.0 / radii };
    // With power 1, the distances beyond 1,000 radii span only 1/1,000 in `s`, so that bins must be shorter.
    let step = if power == 1 { 1.0 / 1024.0 } else { 1.0 / 400.0 };
    let facts = SceneFacts { near: 0.01, far: 2e4 * RADIUS, ..facts(contracted(step, power)) };
    let a = architecture(pi(3, 0), None, &[(4, false)], &[]);
    let mut all = constant(&a, 0.0, [0.0; 3]);
    for layer in &a.layers() {
        let steep = 1e6;
        match layer.role {
            // Density rises along the view direction −z, tilted.
            Role::Trunk(0) => {
                let centre = CENTRE;
                let normal = Vec3::new(tilt[0], tilt[1], -1.0);
                for axis in 0..3 {
                    all[layer.weights + axis] = normal[axis];
                }
                all[layer.bias] = (-f64::from(normal.dot(centre)) - rim * f64::from(RADIUS)) as f32;
            }
            Role::Density => all[layer.weights] = steep,
            _ => {}
        }
    }
    let (weights, _) = halve(&constant(&a, 0.0, [0.0; 3]));
    (bytes(&Body { content: Content::Scene(facts.clone()), ..body(a, None, &weights) }), all, facts)
}

/// Renders a scene that is opaque behind a flat surface, from the centre of the scene's ball. Each output distance lies
/// in the bin that contains the surface, or because of rounding in a neighbouring bin. The output normal is opposite to
/// the density gradient at the sample. Distances and normal are in world space.
#[test]
fn distances_and_normals_of_a_plane_are_the_world_s() {
    for (power, radii) in Contraction::POWERS.into_iter().flat_map(|p| [0.1, 1.0, 10.0, 1e3].map(|r| (p, r)))
    {
        for tilt in [[0.0, 0.0], [0.3, -0.2]] {
            let (file, all, facts) = plane(radii, tilt, power);
            let blob = Blob::open(&file).unwrap();
            let camera = {
                let pose = Pose::look_at(CENTRE, CENTRE + Vec3::NEG_Z, Vec3::Y).unwrap();
                Camera::new(Intrinsics::centred(1, 1, 1.0), Lens::NONE, pose).unwrap()
            };
            for kernel in kernels().filter(|kernel| !kernel.rounds()) {
                let Some(renderer) = Renderer::with_parameters(blob.clone(), kernel, &all, None) else {
                    panic!()
                };
                let outputs = Outputs { normals: cfg!(feature = "normals"), ..outputs() };
                let plan = Plan::new(&blob, &Quality::EXACT, outputs, Batch::FULL).unwrap();
                let plan = plan.with_normal_blur(0.0).unwrap();
                let pixel = render(&renderer, &plan, &camera).pixels[0];
                let ray = camera.ray(0.5, 0.5);
                let steps = Steps::of(&ray, &facts, 0.0, f64::INFINITY);
                let exact = radii * f64::from(RADIUS);
                let s = steps.step_at(exact);
                // The bin that contains the plane, or because of rounding a neighbouring bin.
                let [low, high] =
                    [-1.5, 1.5].map(|bins| steps.distance((s + bins * steps.step).min(steps.end)));
                for (name, found) in [
                    ("ray_distance", pixel.ray_distance),
                    ("z_depth", pixel.z_depth),
                    (
                        "median_distance",
                        if cfg!(feature = "median") { pixel.median_distance } else { exact as f32 },
                    ),
                ] {
                    assert!(
                        (low..=high).contains(&f64::from(found)),
                        "{power} {radii}: {name} {low} {found} {high}"
                    );
                }
                assert!(pixel.opacity > 0.999, "{power} {radii}: {pixel:?}");
                if !cfg!(feature = "normals") {
                    continue;
                }
                // The contraction scales the gradient at the sample by 1/r² along the view axis and by (2 − 1/r)/r
                // across it.
                let r = f64::from(pixel.ray_distance) / f64::from(RADIUS);
                let [across, along] = if r <= 1.0 { [1.0; 2] } else { [(2.0 - 1.0 / r) / r, 1.0 / (r * r)] };
                let expected = [-f64::from(tilt[0]) * across, -f64::from(tilt[1]) * across, along];
                let length = expected.iter().map(|x| x * x).sum::<f64>().sqrt();
                for (found, expected) in pixel.normal.iter().zip(expected) {
                    let error = (f64::from(*found) - expected / length).abs();
                    assert!(error < 1e-5 + 2e-6 * r, "{power} {radii} {kernel:?}: {pixel:?}, {error:e}");
                }
            }
        }
    }
}

#[test]
fn from_inside_something_opaque_it_is_all_there_is() {
    for power in Contraction::POWERS {
        let facts = facts(contracted(1.0 / 64.0, power));
        let file = fog(65_504.0, &facts, None);
        for camera in cameras() {
            let found = draw(&file, Kernel::detect(), &camera, |plan| plan);
            for (pixel, ray) in found.pixels.iter().zip(rays(&camera)) {
                let steps = Steps::of(&ray, &facts, 0.0, f64::INFINITY);
                // End of the second bin, since the first may be cut very short.
                let [_, to, _] = steps.bins().nth(1).unwrap();
                // Bound on the distance error, world units, that rounding of the camera's position causes.
                let digits = 20.0 * f64::from(f32::EPSILON) * (1.0 + steps.start.powi(2) / f64::from(RADIUS));
                let first = f64::from(facts.near) - digits..=steps.start + steps.distance(to) + digits;
                assert_eq!(pixel.opacity, 1.0);
                assert!(first.contains(&f64::from(pixel.ray_distance)), "{pixel:?}, {first:?}");
            }
        }
    }
}

#[test]
fn points_are_asked_for_anywhere_but_nowhere() {
    let file = fog(0.5, &facts(contracted(0.01, 1)), None);
    let blob = Blob::open(&file).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::SMALLEST).unwrap();
    let mut memory = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let there = [0.0, 1e-30, 1e6, -1e30, f32::MAX, f32::INFINITY, f32::NEG_INFINITY];
    for (x, expected) in there.map(|x| (x, 0.5)).into_iter().chain([(f32::NAN, 0.0)]) {
        for axis in 0..3 {
            let (mut p, mut sigma) = ([1.0; 3], [f32::NAN]);
            p[axis] = x;
            renderer
                .query(&plan, &[p], &[[0.0, 0.0, 1.0]], &mut memory, &mut sigma, &mut [[0.0; 3]])
                .unwrap();
            assert_eq!(sigma, [expected], "{p:?}");
        }
    }
    // A ray from the largest f32 coordinates, or from a point that is not finite, has no samples.
    for origin in [[f32::MAX; 3], [f32::NAN, 0.0, 0.0], [f32::INFINITY, 0.0, 0.0]] {
        let ray = Ray { origin: origin.into(), dir: -Vec3::ONE.normalize() };
        assert!(Span::new(&plan, &plan.bounds, &ray, plan.range.into()).is_none(), "{ray:?}");
    }
}

/// No output distance is below `near`, whatever the rounding. A thousand radii away, rounding of positions `s` changes
/// distances by a ten-thousandth of their value.
#[test]
fn no_distance_from_far_away_is_in_front_of_near() {
    for power in Contraction::POWERS {
        let mut rounded = false;
        for radii in [30.0, 1e3, 3e4, 1e6, 1e7] {
            let dir = Vec3::new(0.3, 0.5, 0.8).normalize();
            let camera = camera_at(CENTRE + radii * RADIUS * dir, CENTRE);
            let facts = facts(contracted(1.0 / 128.0, power));
            let file = fog(1.0, &facts, None);
            let blob = Blob::open(&file).unwrap();
            let plan = Plan::new(&blob, &Quality::EXACT, outputs(), Batch::SMALLEST).unwrap();
            let contraction = plan.contraction.unwrap();
            for ray in rays(&camera) {
                let span = Span::new(&plan, &plan.bounds, &ray, plan.range.into()).unwrap();
                let (bins, first) = (plan.bins.with(span.ends), span.bins.start);
                let [_, from, _] = bins.edges_around(bins.ends.parts(), bins.at(first, 0.5));
                rounded |= span.start + contraction.distance(from) < facts.near;
            }
            // Tolerance: rounding of the distance from the camera to the centre and back.
            let least = facts.near - f32::EPSILON * radii * RADIUS;
            for pixel in &draw(&file, Kernel::IN_PLACE, &camera, |plan| plan).pixels {
                let Pixel { opacity, ray_distance, median_distance, .. } = *pixel;
                assert!(opacity > 0.99 && ray_distance >= least, "{radii}: {pixel:?}");
                assert!(cfg!(not(feature = "median")) || median_distance >= least, "{radii}: {pixel:?}");
            }
        }
        assert!(rounded, "{power}: nothing to test");
    }
}

/// The intervals of a ray's samples tile the range from near to far, in world units.
#[test]
fn bins_tile_the_ray() {
    for power in Contraction::POWERS {
        let facts = SceneFacts { near: 1e-4, far: 1e6, ..facts(contracted(1.0 / 128.0, power)) };
        let file = fog(0.5, &facts, None);
        let blob = Blob::open(&file).unwrap();
        let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::SMALLEST).unwrap();
        let contraction = plan.contraction.unwrap();
        for ray in cameras().iter().flat_map(rays) {
            let span = Span::new(&plan, &plan.bounds, &ray, plan.range.into()).unwrap();
            let bins = plan.bins.with(span.ends);
            let (mut before, mut first) = (f32::NAN, f32::NAN);
            for bin in span.bins.clone() {
                let t = bins.at(bin, 0.5);
                let edges = bins.edges_around(bins.ends.parts(), t);
                let [at, from, to] = edges.map(|s| contraction.distance(s));
                assert!(from < to && from <= at && at <= to, "{power} {bin}: {from} {at} {to}");
                if bin == span.bins.start {
                    first = from;
                } else {
                    assert_eq!(from, before, "{power} {bin}");
                }
                // Rounding may put a bin's edge in front of `near`; intervals are clamped to `near`.
                let [at, from, to] = [at, from, to].map(|t| t.max(plan.near - span.start));
                let interval = plan.interval(&span.ends, span.start, plan.range.0, t);
                let delta = to - from;
                assert_eq!(interval, SampleInterval { t: at, mid: from + 0.5 * delta, delta });
                before = to;
            }
            let start = f64::from(span.start);
            // Bound on two rounding errors: of the first position, and of the point from which positions are counted.
            let near = 20.0 * f64::from(f32::EPSILON) * (start + start * start / f64::from(RADIUS)) + 1e-9;
            assert!((start + f64::from(first) - 1e-4).abs() <= near, "{power}: {first} from {start}");
            assert!((f64::from(before) / 1e6 - 1.0).abs() < 0.2, "{power}: {before}");
        }
    }
}

/// A scene scaled to other units has the same image. The output distances are scaled with the scene.
#[cfg(feature = "grid")]
#[test]
fn the_scene_in_other_units_gives_the_same_picture() {
    use crate::blob::StoredTables;
    use crate::encoding::{GridEncoding, PositionEncoding};
    let resolutions = [[4; 3], [9; 3]].into_iter().collect();
    let grid = GridEncoding { inputs: 3, features: 2, log2_entries: 9, resolutions };
    let a = architecture(PositionEncoding::Grid(grid.clone()), Some(pi(3, 2)), &[(16, false)], &[8]);
    let (tables, _) = halve(&noise(grid.values(), 5));
    let picture = |unit: f32, power| {
        let (near, far) = (0.1 * RADIUS * unit, 100.0 * RADIUS * unit);
        let cube = Contraction::cube(CENTRE * unit, RADIUS * unit);
        let facts = SceneFacts {
            min: cube.min.into(),
            max: cube.max.into(),
            near,
            far,
            sampling: contracted(1.0 / 64.0, power),
            ..SCENE
        };
        let mut all = parameters(&a, 7);
        for layer in &a.layers() {
            if layer.role == Role::Density {
                all[layer.weights..layer.bias + 1].iter_mut().for_each(|x| *x /= unit);
            }
        }
        let (weights, _) = halve(&parameters(&a, 7));
        let tables_of = Some(StoredTables::F16(&tables));
        let file = bytes(&Body {
            content: Content::Scene(facts),
            tables: tables_of,
            ..body(a.clone(), None, &weights)
        });
        let blob = Blob::open(&file).unwrap();
        let renderer = Renderer::with_parameters(blob.clone(), Kernel::IN_PLACE, &all, None).unwrap();
        let plan = Plan::new(&blob, &Quality::EXACT, outputs(), Batch::SMALLEST).unwrap();
        let eye = CENTRE + 0.9 * RADIUS * Vec3::new(0.3, 0.5, 0.8).normalize();
        render(&renderer, &plan, &camera_at(eye * unit, CENTRE * unit)).pixels
    };
    for power in Contraction::POWERS {
        let own = picture(1.0, power);
        assert!(own.iter().any(|p| p.opacity > 0.9));
        for unit in [1e-3f32, 1e3] {
            for (p, q) in own.iter().zip(picture(unit, power)) {
                for (a, b) in p.rgb.into_iter().chain([p.opacity]).zip(q.rgb.into_iter().chain([q.opacity])) {
                    assert!((a - b).abs() < 2e-4, "{power} {unit}: {p:?} {q:?}");
                }
                for (a, b) in [(p.ray_distance, q.ray_distance), (p.z_depth, q.z_depth)] {
                    assert!((b / unit / a - 1.0).abs() < 1e-3, "{power} {unit}: {p:?} {q:?}");
                }
            }
        }
    }
}
