//! Arbitrary bits as intrinsics, lens and pose: refused with a reason, or every ray and pixel is sound.
#![no_main]

use arbitrary::{Result, Unstructured};
use glam::{Mat3, Vec3};
use libfuzzer_sys::{Corpus, fuzz_target};
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose, Projection};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Effects, Jitter, Outputs, Plan, Quality, ThinLens, Tone};
use nerf_core::render::{Rect, Renderer};
use nerf_core::volume::Pixel;
use nerf_fuzz::damage::RECIPES;
use nerf_fuzz::laws::check_pixel;
use nerf_fuzz::values::{any_f32, any_vec3, mostly};
use std::sync::LazyLock;

/// Those of scenes: a camera sees no picture.
static BLOBS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let scene = |bytes: &Vec<u8>| Blob::open(bytes).expect("a blob").scene().is_some();
    RECIPES.iter().map(|recipe| recipe.blob()).filter(scene).collect()
});

fuzz_target!(|data: &[u8]| -> Corpus {
    // Bytes that end early make no camera.
    if camera(&mut Unstructured::new(data)).is_ok() { Corpus::Keep } else { Corpus::Reject }
});

fn camera(u: &mut Unstructured<'_>) -> Result<()> {
    let size = |u: &mut Unstructured<'_>| {
        let side = *u.choose(&[1u32, 2, 7, 64, 65_535, 1 << 23, u32::MAX, 0])?;
        if side == 0 { u.arbitrary() } else { Ok(side) }
    };
    let (width, height) = (size(u)?, size(u)?);
    let focal = mostly(u, 1.2 * width as f32)?;
    let intrinsics = Intrinsics {
        width,
        height,
        fx: focal,
        fy: mostly(u, focal)?,
        cx: mostly(u, width as f32 / 2.0)?,
        cy: mostly(u, height as f32 / 2.0)?,
    };
    let lens = match u.int_in_range(0..=5u8)? {
        0 => Lens::NONE,
        1 => Lens { k1: any_f32(u)?, k2: any_f32(u)?, p1: any_f32(u)?, p2: any_f32(u)?, ..Lens::NONE },
        2 => {
            let [k1, k2, k3, k4] = [any_f32(u)?, any_f32(u)?, any_f32(u)?, any_f32(u)?];
            Lens { k1, k2, k3, k4, projection: Projection::Fisheye, ..Lens::NONE }
        }
        3 => {
            let [k1, k2, k3, k4, k5, k6, p1, p2] = u.arbitrary::<[i8; 8]>()?.map(|k| f32::from(k) / 512.0);
            let projection = if u.arbitrary()? { Projection::Fisheye } else { Projection::Perspective };
            let [k5, k6, p1, p2] =
                if projection == Projection::Fisheye { [0.0; 4] } else { [k5, k6, p1, p2] };
            Lens { k1, k2, p1, p2, k3, k4, k5, k6, projection }
        }
        _ => {
            let [k1, k2, p1, p2] = u.arbitrary::<[i8; 4]>()?.map(|k| f32::from(k) / 512.0);
            Lens { k1, k2, p1, p2, ..Lens::NONE }
        }
    };
    check_lens(&lens, u)?;
    let Some(camera) = pose(u)?.and_then(|pose| match Camera::new(intrinsics, lens, pose) {
        Ok(camera) => Some(camera),
        Err(error) => {
            assert!(!error.to_string().is_empty());
            None
        }
    }) else {
        return Ok(());
    };
    check_rays(&camera, u)?;
    let thin = camera.thinned(u.int_in_range(0..=u32::MAX)?, u.int_in_range(0..=9)?);
    check_rays(&thin, u)?;
    check_pixels(&camera, u)
}

fn pose(u: &mut Unstructured<'_>) -> Result<Option<Pose>> {
    if u.ratio(1, 4)? {
        let rows = [any_vec3(u)?, any_vec3(u)?, any_vec3(u)?].map(Vec3::from);
        return Ok(Some(Pose {
            rotation: Mat3::from_cols(rows[0], rows[1], rows[2]),
            position: any_vec3(u)?.into(),
        }));
    }
    let (eye, target, up) = (any_vec3(u)?.into(), any_vec3(u)?.into(), any_vec3(u)?.into());
    let Some(mut pose) = Pose::look_at(eye, target, up) else { return Ok(None) };
    // What it makes is a camera's pose, unless the eye is out of bounds or the view axis rounds to one of `up`.
    if eye.abs().max_element() <= 1e9 {
        let made = Camera::new(Intrinsics::centred(2, 2, 2.0), Lens::NONE, pose);
        assert!(made.is_ok(), "look_at({eye}, {target}, {up}): {made:?}");
    }
    // Within what counts as a rotation.
    pose.rotation *= 1.0 + f32::from(u.arbitrary::<i8>()?) / 128.0 * 4e-4;
    Ok(Some(pose))
}

/// What is undistorted, and distorted again, is where it was.
fn check_lens(lens: &Lens, u: &mut Unstructured<'_>) -> Result<()> {
    let (xd, yd) = (any_f32(u)?, any_f32(u)?);
    if let Some((x, y)) = lens.undistort(xd, yd).filter(|_| *lens != Lens::NONE) {
        let (fx, fy) = lens.distort(x, y);
        let scale = [x, y, xd, yd].into_iter().fold(1.0f32, |a, b| a.max(b.abs()));
        let off = (fx - xd).abs().max((fy - yd).abs());
        // A fisheye's angle goes through its tangent and back: as exact as the lens is flat there.
        let (limit, moved) = match lens.projection {
            Projection::Fisheye => {
                let (mx, my) = lens.distort(x * (1.0 + 1e-6), y * (1.0 + 1e-6));
                (1e-3, (mx - fx).abs().max((my - fy).abs()))
            }
            Projection::Perspective => (1e-6, 0.0),
        };
        let flat = x.abs().max(y.abs()) > 1e3 && lens.projection == Projection::Fisheye;
        assert!(
            flat || off <= limit * scale + moved,
            "{lens:?} at ({xd}, {yd}): ({x}, {y}) is seen {off} away"
        );
    }
    Ok(())
}

/// Rays of the corners, the middle, and some point of the image.
fn check_rays(camera: &Camera, u: &mut Unstructured<'_>) -> Result<()> {
    let i = camera.intrinsics();
    let (w, h) = (i.width as f32, i.height as f32);
    let (a, b) = (f32::from(u.arbitrary::<u16>()?) / 65535.0, f32::from(u.arbitrary::<u16>()?) / 65535.0);
    for (x, y) in [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h), (0.5 * w, 0.5 * h), (a * w, b * h), (0.5, h - 0.5)]
    {
        let ray = camera.ray(x, y);
        let length = ray.dir.length();
        assert!(ray.origin.is_finite() && (length - 1.0).abs() < 1e-6, "({x}, {y}) of {camera:?}: {ray:?}");
        let cosine = camera.z_per_distance(&ray);
        assert!(cosine.abs() <= 1.0 + 1e-6, "({x}, {y}) of {camera:?}: cosine {cosine}");
    }
    Ok(())
}

/// A few pixels somewhere in the image, with effects.
fn check_pixels(camera: &Camera, u: &mut Unstructured<'_>) -> Result<()> {
    let bytes = u.choose(&BLOBS)?;
    let blob = Blob::open(bytes).expect("a blob");
    let i = camera.intrinsics();
    let (width, height) = (i.width.min(3), i.height.min(2));
    let rect = Rect {
        x: u.int_in_range(0..=i.width - width)?,
        y: u.int_in_range(0..=i.height - height)?,
        width,
        height,
    };
    let effects = Effects {
        jitter: u.arbitrary::<Option<u64>>()?.map(|seed| Jitter { seed }),
        anti_aliasing: u.int_in_range(1..=4)?,
        depth_of_field: if u.ratio(1, 4)? {
            Some(ThinLens { aperture_radius: any_f32(u)?, focus_distance: any_f32(u)? })
        } else {
            None
        },
        tone: Tone::NONE,
    };
    let outputs = Outputs { median_distance: true, normals: u.ratio(1, 4)?, ..Outputs::ALL };
    let plan = Plan::new(&blob, &Quality { samples: 8, ..Quality::default() }, outputs, Batch::SMALLEST);
    let plan = match plan.expect("a plan").with_effects(effects) {
        Ok(plan) => plan,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return Ok(());
        }
    };
    // Coded tables are decoded into memory; what is read in place asks for none.
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, Kernel::IN_PLACE)];
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut memory).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let far = plan.far_from(camera.pose().position);
    let mut put = |_: u32, _: u32, pixel: &Pixel| check_pixel(pixel, outputs, 0.0, far);
    renderer.render(&plan, camera, rect, &mut workspace, &mut put).expect("a picture");
    Ok(())
}
