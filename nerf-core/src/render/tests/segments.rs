//! Tests of the visible range of a ray, which the caller's ray, a camera's limit or the plan can set. All three give
//! the same pixels.

use super::*;
use crate::blob::{Body, Content, SceneFacts, SceneSampling};
use crate::plan::Plan;
use crate::render::{Limit, RaySegment};

const SIZE: u32 = 20;

pub(super) fn scenes() -> Vec<Vec<u8>> {
    let a = every_kind();
    scenes_of(&a, &parameters(&a, 7), 0b1110_1101)
}

/// Blobs of one field, one for each kind of sampling. `all`: parameters of the network. `bits`: which of the 2³ cells
/// of the occupancy grid are occupied; scenes with bins have no grid.
fn scenes_of(a: &Architecture, all: &[f32], bits: u8) -> Vec<Vec<u8>> {
    let (weights, _) = halve(all);
    let bits = [bits];
    let of = |sampling, occupied: bool| {
        let facts = SceneFacts { sampling, ..SCENE };
        let occupancy = occupied.then_some(StoredOccupancy { resolution: [2; 3], bits: &bits });
        bytes(&Body { content: Content::Scene(facts), ..body(a.clone(), occupancy, &weights) })
    };
    [
        of(SceneSampling::Bins(32), false),
        of(SceneSampling::March(0.11), true),
        #[cfg(feature = "contraction")]
        of(SceneSampling::Contracted { step: 0.07, power: 2 }, true),
    ]
    .into()
}

pub(super) fn segments(t_min: f32, t_max: f32) -> Vec<RaySegment> {
    let camera = camera(SIZE, SIZE);
    let ray = |i: u32| camera.ray((i % SIZE) as f32 + 0.5, (i / SIZE) as f32 + 0.5);
    (0..SIZE * SIZE).map(|i| RaySegment { ray: ray(i), t_min, t_max }).collect()
}

/// Returns the `count` pixels that `render` draws with a worker of `file`. `t_min` and `t_max`: range of the worker's
/// plan.
pub(super) fn pixels(
    file: &[u8],
    kernel: Kernel,
    (t_min, t_max): (f32, f32),
    count: usize,
    render: impl Fn(&mut Worker<'_>, &mut dyn FnMut(usize, &Pixel)),
) -> Vec<Pixel> {
    let blob = Blob::open(file).unwrap();
    let outputs = Outputs { median_distance: cfg!(feature = "median"), ..Outputs::ALL };
    let quality = Quality { occupancy: true, ..Quality::EXACT };
    let plan = Plan::new(&blob, &quality, outputs, Batch::FULL).unwrap().with_range(t_min, t_max).unwrap();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob, kernel, &mut memory).unwrap();
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let mut worker = renderer.worker(&plan, &mut workspace).unwrap();
    let mut found = vec![Pixel::BLANK; count];
    render(&mut worker, &mut |i, pixel| found[i] = *pixel);
    found
}

pub(super) fn of_rays(file: &[u8], kernel: Kernel, rays: &[RaySegment]) -> Vec<Pixel> {
    let forward = camera(SIZE, SIZE).pose().forward();
    pixels(file, kernel, (0.0, f32::INFINITY), rays.len(), |worker, put| {
        worker.render_rays(rays, Some(forward), &mut |i, pixel: &Pixel| put(i, pixel)).unwrap();
    })
}

fn of_camera(
    file: &[u8],
    kernel: Kernel,
    range: (f32, f32),
    limit: impl Fn(u32, u32) -> Limit,
) -> Vec<Pixel> {
    let camera = camera(SIZE, SIZE);
    pixels(file, kernel, range, (SIZE * SIZE) as usize, |worker, put| {
        let mut target = |x: u32, y: u32, pixel: &Pixel| put((y * SIZE + x) as usize, pixel);
        worker.render_limited(&camera, Rect::full(&camera), &limit, &mut target).unwrap();
    })
}

#[test]
fn a_ray_s_own_range_gives_the_bits_of_the_plan_s() {
    for file in scenes() {
        for kernel in kernels() {
            let whole = of_camera(&file, kernel, (0.0, f32::INFINITY), |_, _| Limit::NONE);
            let mut cut = 0;
            for range in [
                (0.0, f32::INFINITY),
                (0.0, 4.1),
                (3.3, f32::INFINITY),
                (3.77, 4.4),
                (4.0, 4.0),
                (90.0, 99.0),
            ] {
                let expected = of_camera(&file, kernel, range, |_, _| Limit::NONE);
                assert_eq!(
                    of_rays(&file, kernel, &segments(range.0, range.1)),
                    expected,
                    "{kernel} {range:?}"
                );
                if range.0 == 0.0 {
                    let limited = |_, _| Limit::RayDistance(range.1);
                    let found = of_camera(&file, kernel, (0.0, f32::INFINITY), limited);
                    assert_eq!(found, expected, "{kernel} {range:?}");
                }
                cut += expected.iter().zip(&whole).filter(|(a, b)| a.opacity != b.opacity).count();
            }
            assert!(cut > 300, "{kernel}: {cut} pixels");
        }
    }
}

#[test]
fn a_limit_of_each_pixel_is_the_end_of_its_ray() {
    let camera = camera(SIZE, SIZE);
    let depth = |x: u32, y: u32| 2.5 + 0.11 * (x + y) as f32;
    for (file, kernel) in scenes().iter().flat_map(|file| kernels().map(move |kernel| (file, kernel))) {
        let mut rays = segments(0.0, 0.0);
        for (i, segment) in rays.iter_mut().enumerate() {
            let z = depth(i as u32 % SIZE, i as u32 / SIZE);
            segment.t_max = z / segment.ray.dir.dot(camera.pose().forward());
        }
        let all = (0.0, f32::INFINITY);
        let found = of_camera(file, kernel, all, |x, y| Limit::ZDepth(depth(x, y)));
        assert_eq!(found, of_rays(file, kernel, &rays), "{kernel}");
        // Limits that cut nothing, and limits that leave nothing.
        let whole = of_camera(file, kernel, all, |_, _| Limit::NONE);
        for none in [Limit::ZDepth(f32::INFINITY), Limit::ZDepth(f32::NAN), Limit::RayDistance(f32::NAN)] {
            assert_eq!(of_camera(file, kernel, all, |_, _| none), whole, "{kernel} {none:?}");
        }
        for nothing in [Limit::ZDepth(0.0), Limit::RayDistance(-1.0), Limit::RayDistance(f32::NEG_INFINITY)] {
            let found = of_camera(file, kernel, all, |_, _| nothing);
            assert!(found.iter().all(|pixel| pixel.opacity == 0.0), "{kernel} {nothing:?}");
        }
    }
}

/// The transmittances of a ray through fog in front of and behind a distance multiply to the transmittance of the whole
/// ray, even if the distance cuts a bin. Opacity is continuous in the distance.
#[test]
fn both_parts_of_a_ray_let_through_what_the_whole_does() {
    let a = architecture(pi(3, 4), None, &[(4, false)], &[]);
    for file in scenes_of(&a, &constant(&a, 0.75, [0.0, 2.0, -1.0]), 0xff) {
        let kernel = Kernel::detect();
        let whole = of_rays(&file, kernel, &segments(0.0, f32::INFINITY));
        let mut before: Option<Vec<Pixel>> = None;
        for step in 0..60 {
            let t = 2.0 + 0.06 * step as f32;
            let front = of_rays(&file, kernel, &segments(0.0, t));
            let behind = of_rays(&file, kernel, &segments(t, f32::INFINITY));
            for ((front, behind), whole) in front.iter().zip(&behind).zip(&whole) {
                let through = (1.0 - front.opacity) * (1.0 - behind.opacity);
                assert!((through - (1.0 - whole.opacity)).abs() < 3e-6, "{t}: {through} {}", whole.opacity);
                // A bin that is cut keeps its sample, which may lie up to half a bin outside the cut.
                let slack = 0.5 * 4.0 / 32.0 + 1e-4;
                let inside = |from: f32, to: f32, pixel: &Pixel| {
                    pixel.opacity == 0.0 || (from - slack..=to + slack).contains(&pixel.ray_distance)
                };
                assert!(
                    inside(0.0, t, front) && inside(t, f32::INFINITY, behind),
                    "{t}: {front:?} {behind:?}"
                );
            }
            if let Some(before) = before {
                for (a, b) in before.iter().zip(&front) {
                    assert!(
                        (b.opacity - a.opacity).abs() < 0.75 * 0.0601,
                        "{t}: {} {}",
                        a.opacity,
                        b.opacity
                    );
                }
            }
            before = Some(front);
        }
    }
}
