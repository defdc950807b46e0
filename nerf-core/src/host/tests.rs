use super::*;
use crate::Kernel;
use crate::camera::{Camera, Intrinsics, Lens, Pose, Ray};
use crate::encoding::PositionEncoding;
use crate::math::MathBackend;
use crate::memory::Line;
use crate::plan::{Batch, Outputs, Plan, Quality, Settings};
use crate::render::RaySegment;
use crate::render::{MAX_RENDER_SIDE, Rect, RenderError, Renderer, Worker};
use crate::testing::{architecture, body, bytes, every_kind, halve, parameters, pi, picture_body};
use crate::volume::Pixel;
use crate::{Blob, Effects};
use glam::Vec3;
use std::format;
use std::num::NonZeroUsize;
use std::string::ToString;
use std::vec;
use std::vec::Vec;

const SIZE: (u32, u32) = (37, 21);

fn camera() -> Camera {
    let pose = Pose::look_at(Vec3::new(1.0, 2.0, 3.3), Vec3::new(0.1, 0.0, -0.1), Vec3::Y).unwrap();
    Camera::new(Intrinsics::centred(SIZE.0, SIZE.1, 30.0), Lens::NONE, pose).unwrap()
}

fn file(seed: u32) -> Vec<u8> {
    let a = every_kind();
    bytes(&body(a.clone(), None, &halve(&parameters(&a, seed)).0))
}

fn all() -> Outputs {
    Outputs { median_distance: cfg!(feature = "median"), normals: cfg!(feature = "normals"), ..Outputs::ALL }
}

fn threads(n: usize) -> NonZeroUsize {
    NonZeroUsize::new(n).unwrap()
}

/// Pixels of a frame, row by row, from a borrowing [`Renderer`] on one thread.
fn by_hand(bytes: &[u8], kernel: Kernel) -> Vec<Pixel> {
    let blob = Blob::open(bytes).unwrap();
    let mut prepared = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut prepared).unwrap();
    let plan = Plan::new(&blob, &Quality::default(), all(), Batch { rays: 50, samples: 64 }).unwrap();
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let mut pixels = vec![Pixel::BLANK; (SIZE.0 * SIZE.1) as usize];
    let mut put = |x: u32, y: u32, pixel: &Pixel| pixels[(y * SIZE.0 + x) as usize] = *pixel;
    let camera = camera();
    renderer.render(&plan, &camera, Rect::full(&camera), &mut workspace, &mut put).unwrap();
    pixels
}

#[test]
fn an_owned_scene_gives_the_borrowed_ones_bits_on_any_number_of_threads() {
    let bytes = file(3);
    for kernel in Kernel::all() {
        let expected = by_hand(&bytes, kernel);
        let scene = Scene::for_kernel(bytes.clone(), kernel).unwrap();
        for n in [1, 2, 3, 16] {
            let image = scene.request().outputs(all()).threads(threads(n)).render(&camera()).unwrap();
            assert_eq!((image.width as u32, image.height as u32), SIZE);
            for (i, pixel) in expected.iter().enumerate() {
                let found = Pixel {
                    rgb: image.rgb[i],
                    opacity: image.opacity[i],
                    ray_distance: image.ray_distance[i],
                    z_depth: image.z_depth[i],
                    median_distance: image.median_distance.get(i).copied().unwrap_or_default(),
                    normal: image.normals.get(i).copied().unwrap_or_default(),
                };
                assert_eq!(found, *pixel, "{} on {n} threads, pixel {i}", kernel);
            }
            assert_eq!(image.counters.rays, expected.len() as u64);
        }
    }
}

#[test]
fn a_cameras_rays_as_the_callers_own_give_its_pixels() {
    let bytes = file(5);
    let scene = Scene::from_bytes(bytes.clone()).unwrap();
    let camera = camera();
    let rays: Vec<RaySegment> = (0..SIZE.0 * SIZE.1)
        .map(|i| camera.ray((i % SIZE.0) as f32 + 0.5, (i / SIZE.0) as f32 + 0.5).into())
        .collect();
    let expected = by_hand(&bytes, Kernel::detect());
    assert!(
        expected.iter().any(|pixel| pixel.opacity > 0.01)
            && expected.iter().any(|pixel| pixel.opacity == 0.0)
    );
    let request = scene.request().outputs(all()).threads(threads(2));
    let along = Some(camera.pose().forward());
    assert_eq!(request.render_rays(&rays, along).unwrap(), expected);
    // Without an axis `z_depth` is 0. The other values do not change.
    let found = request.render_rays(&rays, None).unwrap();
    for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
        assert_eq!(*found, Pixel { z_depth: 0.0, ..*expected }, "ray {i}");
    }
    assert_eq!(request.render_rays(&rays[400..401], None).unwrap(), found[400..401]);
    assert!(request.render_rays(&[], None).unwrap().is_empty());
}

#[cfg(feature = "jitter")]
#[test]
fn jittered_rays_are_those_of_a_row_of_pixels_on_any_number_of_threads() {
    let scene = Scene::from_bytes(file(5)).unwrap();
    let row = Camera::new(Intrinsics::centred(777, 1, 300.0), Lens::NONE, *camera().pose()).unwrap();
    let rays: Vec<RaySegment> = (0..777).map(|x| row.ray(x as f32 + 0.5, 0.5).into()).collect();
    let effects = Effects { jitter: Some(crate::plan::Jitter { seed: 3 }), ..Effects::NONE };
    for n in [1, 3] {
        let settings = Settings { effects, ..Settings::default() };
        let request = scene.request().outputs(all()).settings(settings).threads(threads(n));
        let image = request.render(&row).unwrap();
        let found = request.render_rays(&rays, Some(row.pose().forward())).unwrap();
        for (i, pixel) in found.iter().enumerate() {
            let expected = (image.rgb[i], image.opacity[i], image.ray_distance[i]);
            assert_eq!((pixel.rgb, pixel.opacity, pixel.ray_distance), expected, "ray {i}, {n} threads");
        }
    }
}

#[test]
fn rays_that_are_none_are_refused_naming_the_first() {
    let scene = Scene::from_bytes(file(5)).unwrap();
    let good = Ray { origin: Vec3::new(0.0, 0.0, 4.0), dir: Vec3::NEG_Z };
    let mut rays = vec![RaySegment::from(good); 600];
    for bad in [
        Ray { dir: Vec3::ZERO, ..good },
        Ray { dir: Vec3::new(0.0, 0.0, -2.0), ..good },
        Ray { dir: Vec3::NAN, ..good },
        Ray { origin: Vec3::new(0.0, f32::INFINITY, 0.0), ..good },
    ] {
        rays[513] = bad.into();
        let error = scene.request().threads(threads(1)).render_rays(&rays, None).unwrap_err();
        assert!(matches!(error, HostError::Render(RenderError::Ray { index: 513 })), "{bad:?}: {error}");
    }
    for (t_min, t_max) in
        [(-1.0, 2.0), (2.0, 1.0), (f32::NAN, 1.0), (0.0, f32::NAN), (f32::INFINITY, f32::INFINITY)]
    {
        rays[514] = RaySegment { ray: good, t_min, t_max };
        let error = scene.request().threads(threads(2)).render_rays(&rays[510..], None).unwrap_err();
        assert!(error.to_string().contains("rays[3]: expected a finite origin"), "{error}");
        rays[513] = good.into();
        let error = scene.request().threads(threads(1)).render_rays(&rays, None).unwrap_err();
        assert!(error.to_string().contains("rays[514]: expected 0 <= t_min <= t_max"), "{error}");
        rays[513] = RaySegment { ray: Ray { dir: Vec3::NAN, ..good }, t_min: 0.0, t_max: 1.0 };
    }
    rays[513] = good.into();
    rays[514] = good.into();
    let error = scene.request().render_rays(&rays, Some(Vec3::ONE)).unwrap_err();
    assert!(error.to_string().contains("axis: expected a vector of unit length"), "{error}");
    #[cfg(feature = "anti-aliasing")]
    {
        let effects = Effects { anti_aliasing: 4, ..Effects::NONE };
        let settings = Settings { effects, ..Settings::default() };
        let error = scene.request().settings(settings).render_rays(&rays, None).unwrap_err();
        assert!(matches!(error, HostError::Render(RenderError::CameraEffects)), "{error}");
    }
    assert_eq!(Effects::NONE.anti_aliasing, 1);
}

#[test]
fn a_worker_keeps_nothing_from_call_to_call() {
    let bytes = file(7);
    let scene = Scene::from_bytes(bytes).unwrap();
    let (renderer, camera) = (scene.renderer(), camera());
    let plan =
        Plan::new(renderer.blob(), &Quality::default(), all(), Batch { rays: 64, samples: 64 }).unwrap();
    let mut memory = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let mut worker = renderer.worker(&plan, &mut memory).unwrap();
    let frame = |worker: &mut Worker<'_>, rect: Rect| {
        let mut pixels = Vec::new();
        let mut put = |x: u32, y: u32, pixel: &Pixel| pixels.push((x, y, *pixel));
        let counters = worker.render(&camera, rect, &mut put).unwrap();
        (pixels, counters)
    };
    let point = |worker: &mut Worker<'_>| {
        let (mut sigma, mut rgb) = ([0.0], [[0.0; 3]]);
        let counters = worker.query(&[[0.1, 0.2, 0.3]], &[[0.0, 0.0, 1.0]], &mut sigma, &mut rgb).unwrap();
        (sigma, rgb, counters)
    };
    let full = Rect::full(&camera);
    let (first, asked) = (frame(&mut worker, full), point(&mut worker));
    frame(&mut worker, Rect { x: 3, y: 2, width: 5, height: 9 });
    assert_eq!(point(&mut worker), asked);
    assert_eq!(frame(&mut worker, full), first);
    let outside = Rect { x: 30, ..full };
    let error = worker.render(&camera, outside, &mut |_, _, _: &Pixel| panic!("a pixel")).unwrap_err();
    assert!(matches!(error, RenderError::Rect { .. }), "{error}");
}

#[test]
fn a_plan_of_another_scene_is_refused() {
    let [one, other] = [11, 12].map(|seed| Scene::from_bytes(file(seed)).unwrap());
    let (renderer, blob) = (one.renderer(), other.blob());
    let plan = Plan::new(&blob, &Quality::default(), Outputs::RGB, Batch::SMALLEST).unwrap();
    let mut memory = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let found = render(&renderer, &plan, &camera(), threads(2));
    assert_eq!(found.unwrap_err(), RenderError::OtherScene);
    assert_eq!(renderer.worker(&plan, &mut memory).err(), Some(RenderError::OtherScene));
}

#[test]
fn a_2d_field_is_the_same_picture_on_any_number_of_threads() {
    let a = architecture(PositionEncoding::from(pi(2, 5)), None, &[(24, false)], &[12]);
    let bytes = bytes(&picture_body(a.clone(), &halve(&parameters(&a, 9)).0));
    let scene = Scene::from_bytes(bytes).unwrap();
    let one = scene.request().threads(threads(1)).render_picture(31, 29).unwrap();
    assert_eq!(one.len(), 31 * 29);
    assert_eq!(scene.request().threads(threads(5)).render_picture(31, 29).unwrap(), one);
    let mut rows = 0;
    render_picture(&scene.renderer(), MathBackend::Polynomial, [31, 29], threads(2), |n| rows += n).unwrap();
    assert_eq!(rows, 29);
    let error = scene.render(&camera()).unwrap_err();
    assert!(error.to_string().contains("expected a scene, found a 2D field"), "{error}");
    assert!(scene.request().render_picture(0, 29).is_err());
}

#[test]
fn files_that_are_no_scenes_are_refused_by_name() {
    let missing = Scene::open("/nonexistent/a scene.nerf").unwrap_err();
    assert!(missing.to_string().starts_with("/nonexistent/a scene.nerf: "), "{missing}");
    let path = std::env::temp_dir().join(format!("nerf-core-host-{}.nerf", std::process::id()));
    std::fs::write(&path, b"no scene").unwrap();
    let found = Scene::open(&path).unwrap_err();
    std::fs::write(&path, file(1)).unwrap();
    assert_eq!(Scene::open(&path).unwrap().blob().weights().len(), every_kind().parameters() * 2);
    std::fs::remove_file(&path).unwrap();
    assert!(
        matches!(found, HostError::Open { .. }) && found.to_string().contains("nerf-core-host"),
        "{found}"
    );
}

/// Requests an image and a 2D field of the largest valid size, 2^46 pixels.
#[test]
fn an_image_beyond_all_memory_is_refused() {
    const SIDE: u32 = MAX_RENDER_SIDE;
    let pose = *camera().pose();
    let camera = Camera::new(Intrinsics::centred(SIDE, SIDE, 1e7), Lens::NONE, pose).unwrap();
    let scene = Scene::from_bytes(file(1)).unwrap();
    let error = scene.request().outputs(Outputs::RGB).render(&camera).unwrap_err();
    assert!(matches!(error, HostError::Render(RenderError::ImageMemory { .. })), "{error}");
    assert_eq!(error.to_string(), "image: expected free memory for 8388608x8388608 pixels, found less");
    let a = architecture(PositionEncoding::from(pi(2, 5)), None, &[(24, false)], &[12]);
    let picture = Scene::from_bytes(bytes(&picture_body(a.clone(), &halve(&parameters(&a, 9)).0))).unwrap();
    let error = picture.request().render_picture(SIDE, SIDE).unwrap_err();
    assert!(matches!(error, HostError::Render(RenderError::ImageMemory { .. })), "{error}");
}

#[test]
fn colours_become_bytes_by_rounding() {
    let mut image = Image::new(2, 1, &Outputs::RGB).unwrap();
    image.rgb = vec![[0.0, 0.5, 1.0], [-1.0, 2.0, 0.998]];
    assert_eq!(image.rgb8(), [0, 128, 255, 0, 255, 254]);
    assert!(image.z_depth.is_empty() && image.opacity.len() == 2);
}
