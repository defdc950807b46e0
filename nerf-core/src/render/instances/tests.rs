//! Tests of several fields in one frame: one field alone, two fields in one place, and one field behind another.

extern crate std;

use super::Instance;
use crate::blob::{Blob, Body, Content, SceneFacts, SceneSampling, StoredOccupancy};
use crate::camera::{Camera, Intrinsics, Lens, Pose, Ray};
use crate::memory::Line;
use crate::network::Role;
use crate::plan::{Batch, Outputs, Plan, Quality};
use crate::render::tests::{camera, constant, kernels};
use crate::render::{Counters, Limit, RaySegment, Rect, RenderError, Renderer, Worker};
use crate::sampling::random::{Purpose, uniform};
use crate::space::{Placement, PlacementError};
use crate::testing::{SCENE, body, bytes, every_kind, halve, parameters};
use crate::volume::Pixel;
use crate::{Isa, Kernel, Storage};
use glam::{Mat3, Vec3};
use std::vec;
use std::vec::Vec;

const SIZE: u32 = 18;
const OUTPUTS: Outputs = Outputs { median_distance: true, normals: true, ..Outputs::ALL };
const UNCUT: Quality = Quality { occupancy: true, ..Quality::EXACT };
/// Occupancy bits of a grid of 2 × 2 × 2 cells, six of them occupied.
const CELLS: u8 = 0b1110_1101;

/// Blob of a field with random parameters. `thick`: factor of the density layer's parameters.
fn noise_of(sampling: SceneSampling, seed: u32, thick: f32) -> Vec<u8> {
    let a = every_kind();
    let mut all = parameters(&a, seed);
    for layer in a.layers().iter().filter(|layer| layer.role == Role::Density) {
        all[layer.weights..layer.bias + 1].iter_mut().for_each(|x| *x *= thick);
    }
    let (weights, _) = halve(&all);
    let content = Content::Scene(SceneFacts { sampling, ..SCENE });
    let occupancy = Some(StoredOccupancy { resolution: [2; 3], bits: &[CELLS] });
    bytes(&Body { content, ..body(a, occupancy, &weights) })
}

/// Blob of a field with density `sigma` and colour `sigmoid(raw)` everywhere in its box.
fn fog(sigma: f32, raw: [f32; 3]) -> Vec<u8> {
    let a = every_kind();
    let (weights, _) = halve(&constant(&a, sigma, raw));
    let content = Content::Scene(SceneFacts { sampling: SceneSampling::March(0.11), ..SCENE });
    bytes(&Body { content, ..body(a, None, &weights) })
}

fn samplings() -> Vec<SceneSampling> {
    [
        SceneSampling::Bins(32),
        SceneSampling::March(0.09),
        #[cfg(feature = "contraction")]
        SceneSampling::Contracted { step: 0.07, power: 2 },
    ]
    .into()
}

/// Placement that rotates by `angle` about a fixed axis, scales by `scale` and translates by `at`.
fn placed(angle: f32, scale: f32, at: [f32; 3]) -> Placement {
    let turn = Mat3::from_axis_angle(Vec3::new(1.0, 2.0, -0.5).normalize(), angle);
    let row = |r: usize| [scale * turn.x_axis[r], scale * turn.y_axis[r], scale * turn.z_axis[r], at[r]];
    Placement::from_rows([row(0), row(1), row(2)]).unwrap()
}

struct Seen {
    pixels: Vec<Pixel>,
    counters: Counters,
}

/// Makes a worker of the placed `fields`, and passes the worker or the error to `use_it`.
fn with_worker<T>(
    fields: &[(&[u8], Placement)],
    kernel: Kernel,
    quality: &Quality,
    use_it: impl FnOnce(Result<Worker<'_>, RenderError>) -> T,
) -> T {
    let blobs: Vec<Blob<'_>> = fields.iter().map(|(file, _)| Blob::open(file).unwrap()).collect();
    let plan = |blob| Plan::new(blob, quality, OUTPUTS, Batch::FULL).unwrap();
    let plans: Vec<Plan<'_>> = blobs.iter().map(plan).collect();
    let memory = |blob| vec![Line::UNINIT; Renderer::prepared_lines(blob, kernel)];
    let mut memories: Vec<_> = blobs.iter().map(memory).collect();
    let renderers: Vec<_> = blobs
        .iter()
        .zip(&mut memories)
        .map(|(blob, memory)| Renderer::new(blob.clone(), kernel, memory).unwrap())
        .collect();
    let each = renderers.iter().zip(&plans).zip(fields);
    let instances: Vec<Instance<'_>> =
        each.map(|((renderer, plan), &(_, placement))| Instance { renderer, plan, placement }).collect();
    let lines = Worker::instances_lines(renderers.iter(), &plans[plans.len() - 1]);
    use_it(Worker::of_instances(&instances, &mut vec![Line::UNINIT; lines]))
}

fn view_of(worker: &mut Worker<'_>, camera: &Camera) -> Seen {
    let mut pixels = vec![Pixel::BLANK; (SIZE * SIZE) as usize];
    let mut put = |x: u32, y: u32, pixel: &Pixel| pixels[(y * SIZE + x) as usize] = *pixel;
    let counters = worker.render(camera, Rect::full(camera), &mut put).unwrap();
    Seen { pixels, counters }
}

fn seen(fields: &[(&[u8], Placement)], kernel: Kernel, camera: &Camera) -> Seen {
    with_worker(fields, kernel, &UNCUT, |worker| view_of(&mut worker.unwrap(), camera))
}

/// Renders one field, without a placement, by [`Renderer::worker`].
fn alone(file: &[u8], kernel: Kernel, camera: &Camera) -> Seen {
    let blob = Blob::open(file).unwrap();
    let plan = Plan::new(&blob, &UNCUT, OUTPUTS, Batch::FULL).unwrap();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob, kernel, &mut memory).unwrap();
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    view_of(&mut renderer.worker(&plan, &mut workspace).unwrap(), camera)
}

/// Largest differences of two images in colour and opacity, in distances and in normals. Differences of distances are
/// divided by the `ray_distance` in `a`, or by 1 if that is larger. Distances and normals are compared at pixels of
/// opacity above 0.1.
fn differences(a: &[Pixel], b: &[Pixel]) -> [f32; 3] {
    let mut worst = [0.0f32; 3];
    for (a, b) in a.iter().zip(b) {
        let mut look = |kind: usize, a: f32, b: f32| worst[kind] = worst[kind].max((a - b).abs());
        (0..3).for_each(|c| look(0, a.rgb[c], b.rgb[c]));
        look(0, a.opacity, b.opacity);
        if a.opacity > 0.1 {
            let unit = a.ray_distance.max(1.0);
            look(1, a.ray_distance / unit, b.ray_distance / unit);
            look(1, a.z_depth / unit, b.z_depth / unit);
            look(1, a.median_distance / unit, b.median_distance / unit);
            (0..3).for_each(|c| look(2, a.normal[c], b.normal[c]));
        }
    }
    worst
}

/// Distances of two fields in one place, of which one has no density, do not depend on the order of the instances.
#[test]
fn distances_do_not_depend_on_where_in_the_list_a_field_without_density_is() {
    let (dense, empty) = (fog(2.0, [0.5, 0.0, -0.5]), fog(0.0, [0.0; 3]));
    for kernel in kernels() {
        let of = |fields: [&[u8]; 2]| {
            seen(&fields.map(|file| (file, placed(0.0, 1.0, [0.0; 3]))), kernel, &camera(SIZE, SIZE))
        };
        let (last, first) = (of([&dense, &empty]), of([&empty, &dense]));
        assert!(last.pixels.iter().any(|pixel| pixel.opacity > 0.1), "{kernel:?}");
        for (last, first) in last.pixels.iter().zip(&first.pixels) {
            assert_eq!(last.ray_distance.to_bits(), first.ray_distance.to_bits(), "{kernel:?}");
            assert_eq!(last.z_depth.to_bits(), first.z_depth.to_bits(), "{kernel:?}");
        }
    }
}

#[test]
fn one_field_where_it_was_is_that_field() {
    for sampling in samplings() {
        let file = noise_of(sampling, 7, 1.0);
        for kernel in kernels() {
            let (found, expected) = (
                seen(&[(&file, Placement::IDENTITY)], kernel, &camera(SIZE, SIZE)),
                alone(&file, kernel, &camera(SIZE, SIZE)),
            );
            assert_eq!(found.pixels, expected.pixels, "{kernel}, {sampling:?}");
            assert_eq!(found.counters, expected.counters, "{kernel}, {sampling:?}");
        }
    }
}

/// Two instances of a field in one place equal the field of twice the density. Overlapping fogs mix their colours by
/// density, in either order of the instances.
#[test]
fn two_in_one_place_are_one_of_both_densities() {
    let kernel = Kernel::new(Isa::Portable, Storage::F32);
    for sampling in &samplings()[..2] {
        let (once, twice) = (noise_of(*sampling, 7, 1.0), noise_of(*sampling, 7, 2.0));
        let expected = alone(&twice, kernel, &camera(SIZE, SIZE));
        let place = placed(0.0, 1.0, [0.0; 3]);
        let found = seen(&[(&once, place), (&once, place)], kernel, &camera(SIZE, SIZE));
        let worst = differences(&found.pixels, &expected.pixels);
        assert!(worst.iter().all(|&worst| worst < 1e-3), "{sampling:?}: {worst:?}");
    }
    // A red fog of density 3 and a blue fog of density 1.
    let (red, blue) = (fog(3.0, [9.0, -9.0, -9.0]), fog(1.0, [-9.0, -9.0, 9.0]));
    let one = placed(0.0, 1.0, [0.0; 3]);
    for fields in [[(&red[..], one), (&blue[..], one)], [(&blue[..], one), (&red[..], one)]] {
        for pixel in seen(&fields, kernel, &camera(SIZE, SIZE)).pixels {
            let through = 1.0 - pixel.opacity;
            let colour: [f32; 3] = core::array::from_fn(|c| pixel.rgb[c] - through * SCENE.background[c]);
            assert!((colour[0] - 0.75 * pixel.opacity).abs() < 1e-3, "{pixel:?}");
            assert!((colour[2] - 0.25 * pixel.opacity).abs() < 1e-3, "{pixel:?}");
        }
    }
}

#[test]
fn a_field_is_the_same_wherever_it_stands_and_however_large_it_is() {
    let (file, kernel) = (noise_of(SceneSampling::March(0.09), 7, 1.0), Kernel::detect());
    let at_home = seen(&[(&file, Placement::IDENTITY)], kernel, &camera(SIZE, SIZE));
    for (angle, scale, at) in [
        (0.0, 4.0, [0.0; 3]),
        (1.1, 1.0, [3.0, -2.0, 0.7]),
        (1.1, 0.05, [3.0, -2.0, 0.7]),
        (-2.5, 100.0, [1e3, 5e2, -9e2]),
    ] {
        let placement = placed(angle, scale, at);
        let home = camera(SIZE, SIZE);
        let pose = home.pose();
        // The camera moves with the field, so that the image must not change.
        let turned = |v: Vec3| placement.dir_in_world(v);
        let rotation = Mat3::from_cols(
            turned(pose.rotation.x_axis),
            turned(pose.rotation.y_axis),
            turned(pose.rotation.z_axis),
        );
        let position = Vec3::from(at) + scale * turned(pose.position);
        let there = Camera::new(
            Intrinsics::centred(SIZE, SIZE, SIZE as f32),
            Lens::NONE,
            Pose { rotation, position },
        )
        .unwrap();
        let mut found = seen(&[(&file, placement)], kernel, &there);
        for pixel in &mut found.pixels {
            for distance in [&mut pixel.ray_distance, &mut pixel.z_depth, &mut pixel.median_distance] {
                *distance /= scale;
            }
            let back = rotation.transpose() * Vec3::from(pixel.normal);
            pixel.normal = (pose.rotation * back).to_array();
        }
        let worst = differences(&found.pixels, &at_home.pixels);
        assert!(worst[0] < 2e-3 && worst[1] < 2e-2 && worst[2] < 0.1, "scale {scale}: {worst:?}");
    }
}

/// The nearer of two boxes hides the farther one, from either side and in either order of the instances.
#[test]
fn what_stands_in_front_hides_what_is_behind() {
    let (red, blue) = (fog(0.8, [9.0, -9.0, -9.0]), fog(0.6, [-9.0, -9.0, 9.0]));
    let kernel = Kernel::new(Isa::Portable, Storage::F32);
    let (here, there) = (placed(0.0, 1.0, [0.0; 3]), placed(0.0, 1.0, [0.0, 0.0, -3.0]));
    let ray = |z: f32, dir: f32| Ray { origin: Vec3::new(0.1, 0.2, z), dir: Vec3::new(0.0, 0.0, dir) };
    for fields in [[(&red[..], here), (&blue[..], there)], [(&blue[..], there), (&red[..], here)]] {
        with_worker(&fields, kernel, &UNCUT, |worker| {
            let mut worker = worker.unwrap();
            worker.show_background(false);
            let (a_red, a_blue) = (1.0 - (-1.6f32).exp(), 1.0 - (-1.2f32).exp());
            let mut found = vec![];
            let rays = [ray(5.0, -1.0), ray(-9.0, 1.0), ray(-1.5, -1.0), ray(0.0, 1.0), ray(2.0, 1.0)];
            let rays = rays.map(RaySegment::from);
            worker
                .render_rays(&rays, None, &mut |_, pixel| found.push((pixel.rgb[0], pixel.rgb[2])))
                .unwrap();
            let half_red = 1.0 - (-0.8f32).exp();
            let expected = [
                (a_red, (1.0 - a_red) * a_blue),
                ((1.0 - a_blue) * a_red, a_blue),
                (0.0, a_blue),
                (half_red, 0.0),
                (0.0, 0.0),
            ];
            for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
                let off = (found.0 - expected.0).abs().max((found.1 - expected.1).abs());
                assert!(off < 1e-3, "ray {i}: expected {expected:?}, found {found:?}");
            }
            // Rays that end in front of the red box, in its middle, and between the two boxes.
            let mut cut = vec![];
            let segments = [4.0, 5.0, 6.5].map(|t_max| RaySegment { t_max, ..rays[0] });
            worker.render_rays(&segments, None, &mut |_, pixel| cut.push(pixel.opacity)).unwrap();
            for (found, expected) in cut.iter().zip([0.0, half_red, a_red]) {
                assert!((found - expected).abs() < 1e-3, "expected {expected}, found {found}");
            }
        });
    }
}

#[test]
fn a_field_that_is_hidden_is_not_asked() {
    let (wall, blue) = (fog(500.0, [9.0, -9.0, -9.0]), fog(0.6, [-9.0, -9.0, 9.0]));
    let behind = placed(0.0, 0.2, [0.0, 0.0, -3.0]);
    let quality = Quality { transmittance_cut: 0.02, ..UNCUT };
    let ray = Ray { origin: Vec3::new(0.01, 0.02, 5.0), dir: Vec3::NEG_Z };
    let asked = |fields: &[(&[u8], Placement)]| {
        with_worker(fields, Kernel::detect(), &quality, |worker| {
            worker.unwrap().render_rays(&[ray.into()], None, &mut |_, _| {}).unwrap().density_evaluations
        })
    };
    let (alone, both) =
        (asked(&[(&wall, Placement::IDENTITY)]), asked(&[(&blue, behind), (&wall, Placement::IDENTITY)]));
    assert_eq!((alone, both), (1, 1));
}

#[test]
fn rays_limits_and_points_are_the_world_s() {
    let (a, b) = (noise_of(SceneSampling::March(0.09), 7, 1.0), noise_of(SceneSampling::Bins(32), 8, 1.0));
    let fields = [(&a[..], placed(0.4, 0.7, [0.2, 0.0, 0.1])), (&b[..], placed(-1.0, 1.3, [0.0, 0.3, -0.4]))];
    for kernel in kernels() {
        let view = camera(SIZE, SIZE);
        let frame = seen(&fields, kernel, &view).pixels;
        with_worker(&fields, kernel, &UNCUT, |worker| {
            let mut worker = worker.unwrap();
            let ray = |i: u32| RaySegment::from(view.ray((i % SIZE) as f32 + 0.5, (i / SIZE) as f32 + 0.5));
            let rays: Vec<_> = (0..SIZE * SIZE).map(ray).collect();
            let axis = Some(view.pose().forward());
            let put = &mut |i: usize, pixel: &Pixel| assert_eq!(*pixel, frame[i], "{kernel}, ray {i}");
            worker.render_rays(&rays, axis, put).unwrap();
            // A call with a single ray gives the same pixel.
            for (i, ray) in rays.iter().enumerate().step_by(41) {
                let put =
                    &mut |_: usize, pixel: &Pixel| assert_eq!(*pixel, frame[i], "{kernel}, ray {i} alone");
                worker.render_rays(&[*ray], axis, put).unwrap();
            }
            // A camera's limit has the effect of a ray's `t_max`.
            let mut limited = vec![Pixel::BLANK; rays.len()];
            let limit = |x: u32, y: u32| Limit::RayDistance(2.5 + 0.05 * (x + y) as f32);
            let mut put = |x: u32, y: u32, pixel: &Pixel| limited[(y * SIZE + x) as usize] = *pixel;
            worker.render_limited(&view, Rect::full(&view), limit, &mut put).unwrap();
            let cut: Vec<_> = (0..SIZE * SIZE)
                .map(|i| RaySegment { t_max: 2.5 + 0.05 * (i % SIZE + i / SIZE) as f32, ..rays[i as usize] })
                .collect();
            worker.render_rays(&cut, axis, &mut |i, pixel| assert_eq!(*pixel, limited[i])).unwrap();
            // Densities at points add up, and colours are averaged by density.
            let points: Vec<[f32; 3]> =
                (0..40).map(|i| [-0.8 + 0.04 * i as f32, 0.1, 0.02 * i as f32]).collect();
            let dirs = vec![[0.0, 0.0, -1.0]; 40];
            let (mut sigma, mut rgb) = (vec![0.0; 40], vec![[0.0; 3]; 40]);
            worker.query(&points, &dirs, &mut sigma, &mut rgb).unwrap();
            let mut sums = vec![(0.0f32, Vec3::ZERO); 40];
            for field in &fields {
                with_worker(&[*field], kernel, &UNCUT, |worker| {
                    let (mut own, mut colour) = (vec![0.0; 40], vec![[0.0; 3]; 40]);
                    worker.unwrap().query(&points, &dirs, &mut own, &mut colour).unwrap();
                    for (sum, (own, colour)) in sums.iter_mut().zip(own.into_iter().zip(colour)) {
                        *sum = (sum.0 + own, sum.1 + own * Vec3::from(colour));
                    }
                });
            }
            assert!(sums.iter().filter(|sum| sum.0 > 0.0).count() > 10);
            for (i, (total, colour)) in sums.into_iter().enumerate() {
                assert!((sigma[i] - total).abs() <= 1e-5 * total, "{kernel}, point {i}");
                let off = (total * Vec3::from(rgb[i]) - colour).abs().max_element();
                assert!(off <= 1e-5 * total.max(1.0), "{kernel}, point {i}");
            }
        });
    }
}

#[test]
fn the_mean_of_collisions_in_both_is_what_both_composite() {
    let (a, b) = (noise_of(SceneSampling::March(0.09), 7, 0.5), noise_of(SceneSampling::March(0.13), 8, 0.5));
    let fields = [(&a[..], placed(0.4, 0.9, [0.2, 0.0, 0.1])), (&b[..], placed(-1.0, 1.1, [0.0, 0.3, -0.4]))];
    let view = camera(SIZE, SIZE);
    let rays: Vec<RaySegment> =
        (0..300).map(|i| view.ray((i % SIZE) as f32 + 0.5, (i / SIZE) as f32 + 0.5).into()).collect();
    with_worker(&fields, Kernel::detect(), &UNCUT, |worker| {
        let mut worker = worker.unwrap();
        let mut exact = vec![Pixel::BLANK; 300];
        worker.render_rays(&rays, None, &mut |i, pixel| exact[i] = *pixel).unwrap();
        let (mut sums, mut squares) = (vec![[0.0f64; 3]; 300], vec![[0.0f64; 3]; 300]);
        for draw in 0..1024 {
            let random: Vec<f32> = (0..300).map(|i| uniform(5, Purpose::Pixel, draw, i)).collect();
            let put = &mut |i: usize, pixel: &Pixel| {
                for c in 0..3 {
                    sums[i][c] += f64::from(pixel.rgb[c]);
                    squares[i][c] += f64::from(pixel.rgb[c]).powi(2);
                }
            };
            worker.sample_rays(&rays, &random, None, put).unwrap();
        }
        let mut scores = vec![];
        // Only rays of opacity 0.01 to 0.99: 1,024 draws are too few to estimate the variance of rarer events.
        for (i, exact) in exact.iter().enumerate().filter(|(_, exact)| (0.01..0.99).contains(&exact.opacity))
        {
            for c in 0..3 {
                let mean = sums[i][c] / 1024.0;
                let error = ((squares[i][c] / 1024.0 - mean * mean).max(0.0) / 1023.0).sqrt();
                let off = (mean - f64::from(exact.rgb[c])).abs();
                assert!(off <= 4.5 * error + 1e-4, "ray {i}: off by {off}, error {error}");
                if error > 1e-5 {
                    scores.push((off / error).powi(2));
                }
            }
        }
        let score = scores.iter().sum::<f64>() / scores.len() as f64;
        assert!(scores.len() > 300 && (0.8..1.2).contains(&score), "{score} of {}", scores.len());
    });
}

#[test]
fn transforms_that_are_none_are_refused() {
    let row = |x: f32, y: f32, z: f32| [x, y, z, 0.0];
    let rows = |a, b, c| Placement::from_rows([a, b, c]);
    let (x, y, z) = (row(1.0, 0.0, 0.0), row(0.0, 1.0, 0.0), row(0.0, 0.0, 1.0));
    assert_eq!(rows(x, y, row(0.0, 0.0, f32::NAN)), Err(PlacementError::NotFinite));
    assert_eq!(rows(x, y, [0.0, 0.0, 1.0, f32::INFINITY]), Err(PlacementError::NotFinite));
    assert_eq!(
        rows(row(0.0, 0.0, 0.0), row(0.0, 0.0, 0.0), row(0.0, 0.0, 0.0)),
        Err(PlacementError::Singular)
    );
    assert_eq!(rows(x, y, row(0.0, 0.0, 0.0)), Err(PlacementError::Sheared));
    assert_eq!(rows(x, y, row(0.0, 0.0, 2.0)), Err(PlacementError::Sheared));
    assert_eq!(rows(row(1.0, 0.3, 0.0), y, z), Err(PlacementError::Sheared));
    assert_eq!(rows(x, y, row(0.0, 0.0, -1.0)), Err(PlacementError::Mirrored));
    assert!(rows(row(1e-4, 0.0, 0.0), row(0.0, 1e-4, 0.0), row(0.0, 0.0, 1e-4)).is_ok());
}

#[test]
fn instances_that_do_not_go_together_are_refused_by_index() {
    assert!(matches!(Worker::of_instances(&[], &mut []), Err(RenderError::NoInstances)));
    #[cfg(feature = "contraction")]
    {
        use super::InstanceProblem;
        use std::string::ToString;
        let room = noise_of(SceneSampling::Contracted { step: 0.07, power: 2 }, 7, 1.0);
        let thing = noise_of(SceneSampling::March(0.09), 7, 1.0);
        let one = Placement::IDENTITY;
        let refused = |fields: &[(&[u8], Placement)]| {
            with_worker(fields, Kernel::detect(), &UNCUT, |worker| worker.err())
        };
        let unbounded = RenderError::Instance { index: 0, problem: InstanceProblem::Unbounded };
        assert_eq!(refused(&[(&thing, one), (&room, one)]), None);
        assert_eq!(refused(&[(&room, one), (&thing, one)]), Some(unbounded));
        assert_eq!(refused(&[(&room, one), (&room, one)]), Some(unbounded));
        assert!(unbounded.to_string().starts_with("instances[0]: expected an unbounded scene as the last"));
    }
}
