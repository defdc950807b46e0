//! Effects through the C interface: same results as in Rust, and errors that name the invalid field.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Effects, Jitter, Outputs, Plan, Quality, ThinLens, Tone, ToneMap};
use nerf_core::render::{Rect, Renderer};
use nerf_core::volume::Pixel;
use nerf_render as ffi;
use nerf_render::{PixelFormat, Status};
use nerf_testing::call::{self, Message, Opened, plane};
use nerf_testing::memory::Guarded;
use nerf_testing::scenes::{Recipe, camera};
use std::ptr::{null, null_mut};

const SIDE: u32 = 18;
const RGB: u32 = ffi::NERF_OUTPUT_RGB;

/// Returns options with the effects that `effects` sets.
fn options(effects: impl FnOnce(&mut ffi::Effects)) -> ffi::RenderOptions {
    let mut options = call::render_options();
    effects(&mut options.effects);
    options
}

/// Renders an image in RGB or RGBA floats. Returns status, message and image.
fn render(opened: &Opened, options: &ffi::RenderOptions, format: PixelFormat) -> (Status, String, Vec<f32>) {
    let channels = if format == PixelFormat::RgbaF32 { 4 } else { 3 };
    let mut picture = vec![f32::NAN; (SIDE * SIDE * channels) as usize];
    let (seen, target) =
        (call::camera(&camera(SIDE, SIDE)), call::target(plane(picture.as_mut_ptr().cast(), format)));
    let (mut workspace, mut message) = (Guarded::new(1 << 20, 0), Message::default());
    let (at, size, text) = (workspace.at(), workspace.size(), message.0.as_mut_ptr());
    // SAFETY: everything lives until the call returns.
    let status = unsafe {
        call::render(
            opened.scene,
            &seen,
            options,
            null(),
            &target,
            at,
            size,
            None,
            null_mut(),
            null_mut(),
            text,
            256,
        )
    };
    (status, message.text(), picture)
}

/// Renders the image with the Rust renderer, with the exact quality plus the occupancy grid.
fn reference(blob: &[u8], effects: Effects) -> Vec<f32> {
    let blob = Blob::open(blob).expect("a blob");
    let quality = Quality { occupancy: true, ..Quality::EXACT };
    let outputs = Outputs { opacity: false, ray_distance: false, z_depth: false, ..Outputs::ALL };
    let plan = Plan::new(&blob, &quality, outputs, Batch::FULL).expect("a plan");
    let plan = plan.with_effects(effects).expect("effects in range");
    let renderer = Renderer::new(blob, Kernel::IN_PLACE, &mut []).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let (camera, mut picture) = (camera(SIDE, SIDE), vec![0.0; (SIDE * SIDE * 3) as usize]);
    let mut put = |x: u32, y: u32, pixel: &Pixel| {
        picture[(y * SIDE + x) as usize * 3..][..3].copy_from_slice(&pixel.rgb);
    };
    renderer.render(&plan, &camera, Rect::full(&camera), &mut workspace, &mut put).expect("a picture");
    picture
}

#[test]
fn effects_in_c_are_those_of_rust_bit_for_bit() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let none = Effects::NONE;
    let lens = Some(ThinLens { aperture_radius: 0.1, focus_distance: 4.0 });
    let filmic = Tone { exposure: 1.5, map: ToneMap::Filmic, linear: false };
    let reinhard = Tone { exposure: 0.0, map: ToneMap::Reinhard, linear: true };
    let seed = u64::MAX - 6;
    let cases = [
        (options(|_| ()), none),
        (options(|e| (e.jitter, e.seed) = (1, seed)), Effects { jitter: Some(Jitter { seed }), ..none }),
        (options(|e| e.seed = seed), none),
        (options(|e| e.anti_aliasing = 1), none),
        (options(|e| e.anti_aliasing = 6), Effects { anti_aliasing: 6, ..none }),
        (
            options(|e| (e.aperture_radius, e.focus_distance) = (0.1, 4.0)),
            Effects { depth_of_field: lens, ..none },
        ),
        (options(|e| (e.exposure, e.tone_map) = (1.5, 2)), Effects { tone: filmic, ..none }),
        (options(|e| (e.linear, e.tone_map) = (1, 1)), Effects { tone: reinhard, ..none }),
    ];
    let plain = reference(&opened.blob, none);
    for (options, effects) in cases {
        let (status, message, picture) = render(&opened, &options, PixelFormat::RgbF32);
        assert_eq!(status, Status::Ok, "{message}");
        assert!(picture == reference(&opened.blob, effects), "{effects:?}");
        assert_eq!(picture == plain, effects == none, "{effects:?} must be seen");
    }
}

#[test]
fn effects_out_of_range_are_refused_by_the_name_of_their_field() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    type Spoil = fn(&mut ffi::Effects);
    let cases: [(&str, Spoil); 11] = [
        ("jitter", |e| e.jitter = 2),
        ("anti_aliasing", |e| e.anti_aliasing = 257),
        ("anti_aliasing", |e| e.anti_aliasing = 65_537),
        ("aperture_radius", |e| e.aperture_radius = -1.0),
        ("aperture_radius", |e| e.aperture_radius = f32::NAN),
        ("focus_distance", |e| e.aperture_radius = 1.0),
        ("exposure", |e| e.exposure = 33.0),
        ("exposure", |e| e.exposure = f32::INFINITY),
        ("tone_map", |e| e.tone_map = 3),
        ("linear", |e| e.linear = 2),
        ("reserved", |e| e.reserved[4] = 1),
    ];
    for (name, spoil) in cases {
        let (status, message, picture) = render(&opened, &options(spoil), PixelFormat::RgbF32);
        let expected = if name == "reserved" { Status::Reserved } else { Status::Options };
        assert_eq!(status, expected, "{name}: {message}");
        assert!(message.contains("effects") && message.contains(name), "{name}: {message}");
        assert!(picture.iter().all(|c| c.is_nan()), "{name}: something was written");
    }
}

#[test]
fn premultiplied_planes_have_no_tone_stage_but_linear_light_and_all_other_effects() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let tones: [fn(&mut ffi::Effects); 3] =
        [|e| (e.linear, e.tone_map) = (1, 1), |e| e.tone_map = 1, |e| e.exposure = -1.0];
    for tone in tones {
        let (status, message, picture) = render(&opened, &options(tone), PixelFormat::RgbaF32);
        assert_eq!(status, Status::Target, "{message}");
        assert!(message.contains("RGBA") && picture.iter().all(|c| c.is_nan()), "{message}");
    }
    // RGB is premultiplied light over the background's.
    let linear = options(|e| (e.linear, e.exposure) = (1, 1.0));
    let [over, alone] = [PixelFormat::RgbF32, PixelFormat::RgbaF32].map(|format| {
        let (status, message, picture) = render(&opened, &linear, format);
        assert_eq!(status, Status::Ok, "{message}");
        picture
    });
    let decode = |c: f32| if c <= 0.040_45 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
    let background = super::proposal::describe(&opened).background;
    for (over, alone) in over.as_chunks::<3>().0.iter().zip(alone.as_chunks::<4>().0) {
        for c in 0..3 {
            let expected = alone[c] + (1.0 - alone[3]) * 2.0 * decode(background[c]);
            assert!((over[c] - expected).abs() <= 2e-6, "{over:?} {alone:?}");
        }
    }
    let others = options(|e| {
        (e.jitter, e.anti_aliasing, e.aperture_radius, e.focus_distance) = (1, 3, 0.1, 4.0);
    });
    let (status, message, picture) = render(&opened, &others, PixelFormat::RgbaF32);
    assert!(status == Status::Ok && picture.iter().all(|c| c.is_finite()), "{message}");
}

#[test]
fn only_several_rays_a_pixel_take_workspace() {
    let opened = call::open(Recipe::OCCUPANCY.blob(), Kernel::IN_PLACE);
    let plain = opened.workspace(Some(&options(|_| ())), RGB).size();
    let rich = options(|e| {
        (e.jitter, e.anti_aliasing, e.aperture_radius, e.focus_distance) = (1, 1, 0.1, 4.0);
        (e.exposure, e.tone_map, e.linear) = (1.0, 2, 1);
    });
    assert_eq!(opened.workspace(Some(&rich), RGB).size(), plain);
    let grown = opened.workspace(Some(&options(|e| e.anti_aliasing = 2)), RGB).size();
    assert!(grown > plain);
    assert_eq!(opened.workspace(Some(&options(|e| e.anti_aliasing = 256)), RGB).size(), grown);
}
