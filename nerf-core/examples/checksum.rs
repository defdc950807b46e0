//! Renders a blob without effects and then with each single effect or additional output. Prints a checksum of all bits
//! of the pixels for each image.
//!
//! Usage: `cargo run -p nerf-core --example checksum -- scene.nerf`. A printed line has kernel, name of the effect,
//! checksum, bytes of workspace and counters of the work; or `not built` if the build lacks the effect.
//! `tests/tests/laws/effects_cost.rs` compares the lines of builds with and without the features.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, CameraError, Intrinsics, Lens, Pose};
use nerf_core::memory::Line;
use nerf_core::plan::{
    Batch, EffectError, Effects, Jitter, Outputs, Plan, PlanError, Quality, ThinLens, Tone, ToneMap,
};
use nerf_core::render::{Rect, Renderer};
use nerf_core::volume::Pixel;
use std::error::Error;

/// Returns the images to render: name of the feature under test (`off` for none), and the settings that use the
/// feature.
fn cases() -> [(&'static str, Effects, Lens, Outputs); 8] {
    let (none, lens) = (Effects::NONE, Some(ThinLens { aperture_radius: 0.1, focus_distance: 4.0 }));
    let all = Outputs::ALL;
    let tone = Tone { exposure: 0.5, map: ToneMap::Filmic, linear: false };
    [
        ("off", none, Lens::NONE, all),
        ("jitter", Effects { jitter: Some(Jitter { seed: 1 }), ..none }, Lens::NONE, all),
        ("anti-aliasing", Effects { anti_aliasing: 4, ..none }, Lens::NONE, all),
        ("depth-of-field", Effects { depth_of_field: lens, ..none }, Lens::NONE, all),
        ("tone-map", Effects { tone, ..none }, Lens::NONE, all),
        ("lens", none, Lens { k1: 0.02, k2: -0.01, p1: 0.001, p2: -0.002, ..Lens::NONE }, all),
        ("median", none, Lens::NONE, Outputs { median_distance: true, ..all }),
        ("normals", none, Lens::NONE, Outputs { normals: true, ..all }),
    ]
}

/// Updates the FNV-1a `hash` with the four bytes of `bits`, least significant byte first.
fn mix(hash: &mut u64, bits: u32) {
    for byte in bits.to_le_bytes() {
        *hash = (*hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
    }
}

/// Renders an image with the given settings. Returns the text of its line after the name: checksum, workspace and work,
/// or `not built`.
fn line(
    renderer: &Renderer<'_>,
    effects: Effects,
    lens: Lens,
    outputs: Outputs,
) -> Result<String, Box<dyn Error>> {
    let eye = [1.5, 1.2, 3.4].into();
    let pose = Pose::look_at(eye, [0.0, 0.0, 0.1].into(), [0.0, 1.0, 0.0].into()).ok_or("no pose")?;
    let camera = match Camera::new(Intrinsics::centred(24, 20, 28.0), lens, pose) {
        Err(CameraError::LensNotBuilt { .. }) => return Ok("not built".into()),
        camera => camera?,
    };
    let batch = Batch::FULL;
    let plan = Plan::new(renderer.blob(), &Quality::default(), outputs, batch);
    let plan = match plan.and_then(|plan| plan.with_effects(effects)) {
        Err(PlanError::Effects(EffectError::NotBuilt { .. }) | PlanError::NotBuilt { .. }) => {
            return Ok("not built".into());
        }
        plan => plan?,
    };
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let mut hash = 0xcbf2_9ce4_8422_2325;
    let mut put = |x: u32, y: u32, pixel: &Pixel| {
        mix(&mut hash, y << 16 | x);
        let Pixel { rgb, opacity, ray_distance, z_depth, median_distance, normal } = *pixel;
        let values = [opacity, ray_distance, z_depth, median_distance];
        for value in rgb.into_iter().chain(values).chain(normal) {
            mix(&mut hash, value.to_bits());
        }
    };
    let work = renderer.render(&plan, &camera, Rect::full(&camera), &mut workspace, &mut put)?;
    Ok(format!("{hash:016x}, {} bytes, {work:?}", size_of_val(&*workspace)))
}

fn main() -> Result<(), Box<dyn Error>> {
    let file = std::env::args_os().nth(1).ok_or("usage: checksum SCENE.nerf")?;
    let bytes = std::fs::read(file)?;
    for kernel in Kernel::all() {
        let blob = Blob::open(&bytes)?;
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob, kernel, &mut memory)?;
        for (name, effects, lens, outputs) in cases() {
            println!("{} {name}: {}", kernel, line(&renderer, effects, lens, outputs)?);
        }
    }
    Ok(())
}
