//! Rendering of one view of a scene, row by row, and checksums of its pixels.
//!
//! `tests/tests/hosts/firmware.rs` includes this file and compares the image rendered on the host with the
//! microcontroller's.

use nerf_core::Kernel;
use nerf_core::MathBackend;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Effects, Jitter, Outputs, Plan, Quality, ThinLens, Tone, ToneMap};
use nerf_core::render::{Rect, Renderer};
use nerf_core::volume::Pixel;

/// Camera-to-world matrix. The camera is 3.2 units from the origin and looks at the origin; +Z is up. `c/main.c` has
/// the same matrix.
const C2W: [[f32; 4]; 3] = [
    [0.661622, -0.315121, 0.680408, 2.176],
    [0.749838, 0.278048, -0.60036, -1.92],
    [0.0, 0.907407, 0.420252, 1.344],
];

/// Settings of the image: size, maths backend, and effects.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Width and height of the image, pixels.
    pub side: u16,
    /// Tag ([`MathBackend::tag`]) of the backend that computes elementary functions.
    pub math: u8,
    /// Whether the image uses all effects and all outputs.
    pub effects: bool,
}

/// Work and memory of a rendered image.
#[derive(Clone, Copy, Debug)]
pub struct Work {
    /// Number of samples at which the network was evaluated.
    pub samples: u64,
    /// Size of the workspace that the plan needs, bytes.
    pub workspace: usize,
    /// Density at the origin, 1/world unit, if `View::effects` is set; else 0.
    pub density: f32,
}

/// Draws the scene of `blob` and passes each pixel to `put`, row by row. Renders one ray at a time, in blocks of one
/// sample.
///
/// # Errors
/// Name of the step that failed. Returns no error of `nerf-core`, since its message would link code that formats
/// numbers.
pub fn draw(
    blob: &[u8],
    view: View,
    workspace: &mut [Line],
    put: &mut impl FnMut(&Pixel),
) -> Result<Work, &'static str> {
    // `let … else` instead of `map_err`, which would put a second copy of these large values on the stack.
    let Ok(blob) = Blob::open(blob) else { return Err("the blob does not open") };
    let (math, side) = (MathBackend::from_tag(view.math).ok_or("no such maths")?, f32::from(view.side));
    let quality = Quality { math, ..Quality::default() };
    let (mut outputs, mut effects, mut lens) = (Outputs::ALL, Effects::NONE, Lens::NONE);
    if view.effects {
        outputs = Outputs { median_distance: true, normals: true, ..outputs };
        effects = Effects {
            jitter: Some(Jitter { seed: 1 }),
            anti_aliasing: 2,
            depth_of_field: Some(ThinLens { aperture_radius: 0.02, focus_distance: 3.2 }),
            tone: Tone { exposure: 0.5, map: ToneMap::Filmic, linear: false },
        };
        lens = Lens { k1: 0.02, k2: -0.01, p1: 0.001, p2: -0.002, ..Lens::NONE };
    }
    let plan = Plan::new(&blob, &quality, outputs, Batch::SMALLEST).map_err(|_| "no plan")?;
    let plan = plan.with_effects(effects).map_err(|_| "an effect is not built in")?;
    let intrinsics = Intrinsics::centred(view.side.into(), view.side.into(), 1.3 * side);
    let camera = Camera::new(intrinsics, lens, Pose::from_rows(C2W)).map_err(|_| "no camera")?;

    let Ok(renderer) = Renderer::new(blob, Kernel::IN_PLACE, &mut []) else { return Err("no renderer") };
    let lines = renderer.workspace_lines(&plan);
    let mut put = |_: u32, _: u32, pixel: &Pixel| put(pixel);
    let work = renderer.render(&plan, &camera, Rect::full(&camera), workspace, &mut put);
    let work = work.map_err(|_| "the workspace is too small")?;
    let (mut density, mut colour) = ([0.0], [[0.0; 3]]);
    if view.effects {
        let asked =
            renderer.query(&plan, &[[0.0; 3]], &[[0.0, 0.0, -1.0]], workspace, &mut density, &mut colour);
        asked.map_err(|_| "no answer")?;
    }
    Ok(Work { samples: work.samples_kept, workspace: lines * size_of::<Line>(), density: density[0] })
}

/// CRC-32 (ISO-HDLC) of a sequence of 32-bit words, each least significant byte first. Computed without a table.
#[derive(Clone, Copy, Debug)]
pub struct Checksum(u32);

impl Checksum {
    /// Checksum of an empty sequence.
    pub const NONE: Self = Self(!0);

    /// Appends `word` to the sequence.
    pub fn add(&mut self, word: u32) {
        self.0 ^= word;
        for _ in 0..32 {
            self.0 = self.0 >> 1 ^ if self.0 & 1 == 1 { 0xedb8_8320 } else { 0 };
        }
    }

    /// Returns the checksum of all words appended so far.
    pub fn value(self) -> u32 {
        !self.0
    }
}

/// Two checksums of an image: one of colour, one of `z_depth` and the outputs that `View::effects` adds.
#[derive(Clone, Copy, Debug)]
pub struct Checksums {
    /// Checksum of `rgb` of all pixels.
    pub colour: Checksum,
    /// Checksum of `z_depth` of all pixels; if `View::effects` is set, also of `median_distance` and `normal`.
    pub depth: Checksum,
}

impl Checksums {
    /// Checksums of an image without pixels.
    pub const NONE: Self = Self { colour: Checksum::NONE, depth: Checksum::NONE };

    /// Appends the outputs of `pixel` to the checksums.
    pub fn add(&mut self, view: View, pixel: &Pixel) {
        pixel.rgb.into_iter().for_each(|c| self.colour.add(c.to_bits()));
        self.depth.add(pixel.z_depth.to_bits());
        if view.effects {
            let [x, y, z] = pixel.normal;
            [pixel.median_distance, x, y, z].into_iter().for_each(|value| self.depth.add(value.to_bits()));
        }
    }
}

/// Returns an ASCII character for a brightness: from a space at `value` 0 to `@` at 0.9 and above.
pub fn shade(value: f32) -> u8 {
    const RAMP: &[u8] = b" .:-=+*#%@";
    // `as` saturates, and converts NaN to 0.
    let step = (value * RAMP.len() as f32) as usize;
    RAMP.get(step).or(RAMP.last()).copied().unwrap_or(b' ')
}
