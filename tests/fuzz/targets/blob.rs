//! A blob's bytes, damaged under a sound checksum: what opens is canonical, and renders as the laws say.
#![no_main]

use arbitrary::Unstructured;
use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};
use nerf_core::Kernel;
use nerf_core::blob::{self, Blob, HEADER_LEN, SceneSampling};
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Counters, Rect, RenderError, Renderer};
use nerf_core::volume::Pixel;
use nerf_fuzz::damage::{RECIPES, body_of, edit, fix_header};
use nerf_fuzz::laws::check_pixel;
use nerf_testing::scenes;

/// Multiply-adds one input may cost: what is dearer is drawn with fewer samples, or not at all.
const MAX_MACS: u64 = 30_000_000;
const SIZE: [u32; 2] = [5, 3];

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let mut random = seed;
    let mut next = || {
        random = random.wrapping_mul(0x9e37_79b1).rotate_left(15) ^ 0x85eb_ca6b;
        random
    };
    if size < HEADER_LEN + 8 || next() % 64 == 0 {
        let whole = RECIPES[next() as usize % RECIPES.len()].blob();
        if whole.len() <= max_size {
            data[..whole.len()].copy_from_slice(&whole);
            return whole.len();
        }
    }
    if next() % 2 == 0 {
        let bytes: Vec<u8> = (0..64).flat_map(|_| next().to_le_bytes()).collect();
        if let Some(other) =
            edit(&data[..size], &mut Unstructured::new(&bytes)).filter(|b| b.len() <= max_size)
        {
            data[..other.len()].copy_from_slice(&other);
            return other.len();
        }
    }
    // Header and all, one time in sixteen.
    if next() % 16 == 0 {
        return fuzzer_mutate(data, size, max_size);
    }
    let length =
        HEADER_LEN + fuzzer_mutate(&mut data[HEADER_LEN..], size - HEADER_LEN, max_size - HEADER_LEN);
    fix_header(&mut data[..length]);
    length
});

fuzz_target!(|data: &[u8]| {
    let blob = match Blob::open(data) {
        Ok(blob) => blob,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    let body = body_of(data).expect("what opens can be read");
    let mut again = vec![0; blob::encoded_len(&body).expect("what opens can be written")];
    assert!(blob::write(&body, &mut again) == Ok(data), "not canonical");

    // The rest of what is asked follows from the blob's own bytes.
    let mut choice =
        data.iter().fold(data.len() as u32, |hash, &b| (hash ^ u32::from(b)).wrapping_mul(0x0100_0193));
    let mut choose = |n: usize| {
        choice = choice.wrapping_mul(0x9e37_79b1).rotate_left(13);
        choice as usize % n
    };
    let kernels: Vec<Kernel> = scenes::kernels().collect();
    let kernel = kernels[choose(kernels.len())];
    let math = [MathBackend::Polynomial, MathBackend::Libm, MathBackend::Micromath][choose(3)];
    let batch = if kernel == Kernel::IN_PLACE && choose(2) == 0 { Batch::SMALLEST } else { Batch::FULL };
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    if let Some((_, short)) = memory.split_last_mut() {
        let refused = Renderer::new(blob.clone(), kernel, short).map(drop);
        assert!(matches!(refused, Err(RenderError::Memory { .. })), "{refused:?}");
    }
    let renderer =
        Renderer::new(blob.clone(), kernel, &mut memory).expect("memory of the size that was asked for");
    let shape = blob.architecture();
    let macs = (shape.density_macs() + shape.colour_macs() + shape.gradient_macs()) as u64;
    if blob.picture().is_some() {
        if macs * 64 < MAX_MACS {
            picture(&renderer, math, batch, [SIZE, [1, 1 << 23]][choose(2)]);
        }
        return;
    }

    let scene = blob.scene().expect("no picture");
    let coarse =
        blob.proposal().map_or(0, |it| it.architecture().density_macs() as u64 * u64::from(it.samples));
    let rays = u64::from(SIZE[0] * SIZE[1]);
    let Some(affordable) = (MAX_MACS / rays).checked_sub(coarse).map(|left| left / macs.max(1)) else {
        return;
    };
    let samples = u64::from(scene.samples()).min(affordable) as u16;
    // A full block is evaluated whatever its samples.
    if samples == 0 || macs * 64 > MAX_MACS {
        return;
    }
    let exact = Quality::exact(&blob);
    let quality = match choose(3) {
        0 => Quality { samples, math, ..exact },
        1 => Quality { samples, math, ..Quality::default() },
        _ => Quality { samples, math, proposal: false, colour_cut: 0.3, ..Quality::default() },
    };
    let outputs = [Outputs::ALL, Outputs { median_distance: true, normals: true, ..Outputs::ALL }][choose(2)];
    // Fewer samples than the scene's make wider bins, which fit wherever its own do.
    let plan = Plan::new(&blob, &quality, outputs, batch).expect("what opens can be planned");
    let camera = view(&blob, choose(3));
    let lines = renderer.workspace_lines(&plan);
    let mut workspace = vec![Line::UNINIT; lines];
    let mut pixels = 0u64;
    let far = plan.far_from(camera.pose().position);
    let mut put = |_: u32, _: u32, pixel: &Pixel| {
        pixels += 1;
        check_pixel(pixel, outputs, 0.0, far);
    };
    let rect = Rect::full(&camera);
    let short = renderer.render(&plan, &camera, rect, &mut workspace[..lines - 1], &mut put);
    assert_eq!(short, Err(RenderError::Memory { expected: lines, found: lines - 1 }));
    let work = renderer
        .render(&plan, &camera, rect, &mut workspace, &mut put)
        .expect("a workspace of the size asked for");
    assert_eq!((pixels, work.rays), (rays, rays), "each pixel comes once");
    let proposed = blob.proposal().filter(|_| quality.proposal).map_or(0, |it| u64::from(it.samples));
    let Counters { samples_kept, samples_skipped, .. } = work;
    let expected = rays * (u64::from(samples) + proposed);
    // A ray whose way through the box is longer than `near..far` has more samples than the scene's.
    assert!(samples_kept + samples_skipped >= expected && samples_skipped <= expected, "{work:?}");
    let inside = blob.scene_box().map_or(0.0, |b| (b.max - b.min).length());
    let room = (scene.far - scene.near) * (1.0 - 3.0 / f32::from(samples));
    if matches!(scene.sampling, SceneSampling::Bins(_)) && inside < room {
        assert_eq!(samples_kept + samples_skipped, expected, "{work:?}");
    }
    assert!(work.density_evaluations == samples_kept && work.colour_evaluations <= samples_kept, "{work:?}");
});

/// Pixels of a 2D field, at the far end of the picture.
fn picture(renderer: &Renderer<'_>, math: MathBackend, batch: Batch, size: [u32; 2]) {
    let [width, height] = [size[0].min(5), size[1].min(3)];
    let rect = Rect { x: size[0] - width, y: size[1] - height, width, height };
    let lines = renderer.picture_workspace_lines(batch);
    let mut workspace = vec![Line::UNINIT; lines];
    let mut pixels = 0;
    let mut put = |_: u32, _: u32, rgb: [f32; 3]| {
        pixels += 1;
        assert!(rgb.iter().all(|c| (0.0..=1.0).contains(c)), "{rgb:?}");
    };
    let short = renderer.render_picture(math, batch, size, rect, &mut workspace[..lines - 1], &mut put);
    assert_eq!(short, Err(RenderError::Memory { expected: lines, found: lines - 1 }));
    let work = renderer.render_picture(math, batch, size, rect, &mut workspace, &mut put).expect("a picture");
    assert_eq!((pixels, work.colour_evaluations), (width * height, u64::from(width * height)));
}

/// A camera that sees the scene from inside, from outside, or from where nobody stood.
fn view(blob: &Blob<'_>, which: usize) -> Camera {
    let intrinsics = Intrinsics::centred(SIZE[0], SIZE[1], 4.0);
    if let (0 | 1, Some(bounds), Some(scene)) = (which, blob.scene_box(), blob.scene()) {
        let centre = bounds.min + 0.5 * (bounds.max - bounds.min);
        let middle = scene.near + 0.5 * (scene.far - scene.near);
        let back = glam::Vec3::new(0.3, 0.2, 1.0).normalize() * if which == 0 { 0.0 } else { middle };
        if let Some(mut pose) = Pose::look_at(glam::Vec3::new(0.3, 0.2, 1.0), glam::Vec3::ZERO, glam::Vec3::Y)
        {
            pose.position = centre + back;
            if let Ok(camera) = Camera::new(intrinsics, Lens::NONE, pose) {
                return camera;
            }
        }
    }
    scenes::camera(SIZE[0], SIZE[1])
}
