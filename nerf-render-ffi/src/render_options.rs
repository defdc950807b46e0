//! Options of a frame.

use crate::boundary::{by_width, check_zeros, named, number_of, read_or_zeros, versioned};
use crate::effects::Effects;
use crate::failure::Failure;
use nerf_core::MathBackend;
use nerf_core::blob::{Blob, MAX_SAMPLES};
use nerf_core::plan::{self, Batch, Outputs, Plan, Quality, Tone, ToneMap};

/// Largest `batch_rays`: the number of pixels of a 16x16 tile.
const MAX_RAYS: u32 = 256;

const FLAG: &str = "0 or 1";

/// Default of `transmittance_cut`: the image has no visible difference from one without a cut.
pub const NERF_TRANSMITTANCE_CUT_DEFAULT: f32 = 2e-2;
/// Default of `colour_cut`: the image has no visible difference from one without a cut.
pub const NERF_COLOUR_CUT_DEFAULT: f32 = 5e-3;
/// Default of `normal_blur`: one sample interval.
pub const NERF_NORMAL_BLUR_DEFAULT: f32 = 1.0;
/// Value of `transmittance_cut`, `colour_cut` or `normal_blur` that turns off the cut or blur.
pub const NERF_NONE: f32 = -1.0;

/// Implementation of the elementary functions (exp, sin, cos, powers).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Maths {
    /// The library's own polynomials, vectorised.
    Polynomial = 0,
    /// The Rust crate `libm`, one value at a time.
    Libm = 1,
    /// The Rust crate `micromath`: small code, low accuracy.
    Micromath = 2,
    /// As `NERF_MATHS_POLYNOMIAL`, but the positional encoding computes sin and cos of each frequency from the next
    /// lower one by angle doubling: errors grow with the frequency.
    Recurrence = 3,
}

/// Maths backend in `nerf-core` for each [`Maths`] number; `None` for a backend that this build lacks.
const MATHS: [Option<MathBackend>; 4] = [
    Some(MathBackend::Polynomial),
    #[cfg(feature = "libm")]
    Some(MathBackend::Libm),
    #[cfg(not(feature = "libm"))]
    None,
    #[cfg(feature = "micromath")]
    Some(MathBackend::Micromath),
    #[cfg(not(feature = "micromath"))]
    None,
    Some(MathBackend::Recurrence),
];

/// Options of a frame: quality settings, batch sizes, distances and effects.
///
/// NULL in place of options, or zeros in all fields except `struct_size`, selects the defaults: empty cells are
/// skipped, a ray ends once it is nearly opaque, and colours of low weight are not evaluated. The image has no visible
/// difference from the exact rendering. The exact rendering evaluates every sample in the scene box:
/// `transmittance_cut` and `colour_cut` are `NERF_NONE`, and `ignore_occupancy` is 1 unless the scene requires its
/// occupancy grid.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct RenderOptions {
    /// `sizeof(nerf_render_options)`.
    pub struct_size: usize,
    /// Number of samples per ray, at most 4096; 0 for the scene's own number. If samples lie in equal bins (`step` of
    /// `nerf_scene_info` is 0), this is the number of bins between near and far. If samples have a fixed step, this is
    /// the number of steps along the diagonal of the scene box. In an unbounded scene, this is the number of steps on
    /// the ray that is described at `samples` of `nerf_scene_info`. With a proposal network, this is the number of
    /// samples that the network places; evaluations of the proposal network are counted separately.
    pub samples: u32,
    /// Transmittance threshold, less than 1: once a ray's transmittance is below the threshold, the ray ends, and its
    /// opacity becomes 1. 0 for `NERF_TRANSMITTANCE_CUT_DEFAULT`; `NERF_NONE` (or any value below 0) ends no ray.
    pub transmittance_cut: f32,
    /// 1: samples in empty cells of the occupancy grid are evaluated, too. 0: these samples are skipped.
    pub ignore_occupancy: u32,
    /// Implementation of the elementary functions: a `nerf_maths`.
    pub maths: u32,
    /// 1: `background` replaces the scene's background. 0: the scene's background is used.
    pub background_set: u32,
    /// Background colour, display-encoded, in `[0, 1]`; read only if `background_set` is 1.
    pub background: [f32; 3],
    /// Number of rays that are rendered together, at most 256; 0 for a number that keeps vector units busy. A tile has
    /// at most this number of pixels. Affects memory and time, never the image.
    pub batch_rays: u32,
    /// Number of samples that the network evaluates together, at most 64; 0 for a number that keeps vector units busy.
    /// Used only by the portable kernel with f16 weights; all other kernels evaluate 64 samples together.
    pub batch_samples: u32,
    /// Weight threshold, less than 1. The weights of successive samples on a ray are summed until the sum exceeds the
    /// threshold. Only then is a colour evaluated: the last sample's, with the whole sum as its weight. 0 for
    /// `NERF_COLOUR_CUT_DEFAULT`; `NERF_NONE` evaluates every colour. Never affects opacity or distances.
    pub colour_cut: f32,
    /// Width of the blur of the density, in sample intervals: normals are computed from the gradient of the blurred
    /// density. The blur is a Gaussian of standard deviation width / sqrt(12), equal to that of a box filter of this
    /// width. 0 for `NERF_NORMAL_BLUR_DEFAULT`. `NERF_NONE` for no blur: normals are then mostly noise.
    pub normal_blur: f32,
    /// 1: samples are equally spaced even if the scene has a proposal network. 0: the network places the samples.
    pub ignore_proposal: u32,
    /// Nearest visible distance along a ray, world units; at least 0.
    pub near_distance: f32,
    /// Farthest visible distance along a ray, world units; 0 for no limit.
    pub far_distance: f32,
    /// 1: rays are sampled only between the scene's near and far distances, as in training. 0: the rest of the scene
    /// box is sampled, too. No effect if `step` of `nerf_scene_info` is not 0.
    pub own_bins: u32,
    /// Reserved; must be 0.
    pub reserved: u32,
    /// Jitter of samples, anti-aliasing, depth of field, exposure, tone curve, linear output; all zeros for none.
    pub effects: Effects,
}

versioned!(unsafe RenderOptions, "options", by_width(128, 136));

impl RenderOptions {
    pub(crate) fn with(self, quality: &Quality) -> Self {
        Self {
            samples: quality.samples.into(),
            transmittance_cut: or_none(quality.transmittance_cut),
            colour_cut: or_none(quality.colour_cut),
            ignore_occupancy: (!quality.occupancy).into(),
            maths: number_of(&MATHS, quality.math),
            ignore_proposal: (!quality.proposal).into(),
            ..self
        }
    }
}

/// Checked options of a frame (`frame`), and the numbers of rays and samples that are processed together (`batch`).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Settings {
    pub frame: plan::Settings,
    pub batch: Batch,
}

impl Settings {
    /// Reads and checks the options at `at`; NULL for the defaults.
    ///
    /// # Safety
    /// `at` is NULL or points to `struct_size` readable bytes.
    pub unsafe fn read(at: *const RenderOptions) -> Result<Self, Failure> {
        // SAFETY: `at` is valid, as this function's `# Safety` requires.
        let o = unsafe { read_or_zeros(at)? };
        check_zeros("options.reserved", &[o.reserved])?;
        for (name, expected, found, most) in [
            ("options.samples", "0 to 4096", o.samples, MAX_SAMPLES.into()),
            ("options.batch_rays", "0 to 256", o.batch_rays, MAX_RAYS),
            ("options.batch_samples", "0 to 64", o.batch_samples, Batch::FULL.samples as u32),
            ("options.ignore_occupancy", FLAG, o.ignore_occupancy, 1),
            ("options.ignore_proposal", FLAG, o.ignore_proposal, 1),
            ("options.background_set", FLAG, o.background_set, 1),
            ("options.own_bins", FLAG, o.own_bins, 1),
        ] {
            at_most(name, expected, found, most)?;
        }
        let quality = Quality {
            samples: o.samples as u16,
            transmittance_cut: or_default(o.transmittance_cut, NERF_TRANSMITTANCE_CUT_DEFAULT),
            colour_cut: or_default(o.colour_cut, NERF_COLOUR_CUT_DEFAULT),
            occupancy: o.ignore_occupancy == 0,
            math: named(&MATHS, "options.maths", "a nerf_maths of this build", o.maths)?,
            proposal: o.ignore_proposal == 0,
        };
        let frame = plan::Settings {
            quality,
            effects: o.effects.read()?,
            background: (o.background_set == 1).then_some(o.background),
            range: (o.near_distance, if o.far_distance == 0.0 { f32::MAX } else { o.far_distance }),
            normal_blur: or_default(o.normal_blur, NERF_NORMAL_BLUR_DEFAULT),
            own_bins: o.own_bins == 1,
        };
        let or = |asked: u32, default: usize| if asked == 0 { default } else { asked as usize };
        let rays = or(o.batch_rays, Batch::FULL.rays.min(MAX_RAYS as usize));
        Ok(Self { frame, batch: Batch { rays, samples: or(o.batch_samples, Batch::FULL.samples) } })
    }

    /// Makes the plan (stages and settings) of a scene's frames. `scale`: world units per unit of scene coordinates.
    pub fn plan<'a>(&self, blob: &Blob<'a>, outputs: Outputs, scale: f32) -> Result<Plan<'a>, Failure> {
        let (near, far) = self.frame.range;
        let of_scene = plan::Settings { range: (near / scale, far / scale), ..self.frame };
        Ok(of_scene.plan(blob, outputs, self.batch)?)
    }

    /// Returns an error if the options do not suit RGBA planes: a tone curve cannot be applied to premultiplied colour,
    /// and exposure needs linear output, since exposure multiplies light.
    pub fn check_tone_of_alpha(&self) -> Result<(), Failure> {
        let tone = self.frame.effects.tone;
        let fits = tone == Tone::NONE || (tone.linear && tone.map == ToneMap::None);
        if fits { Ok(()) } else { Err(Failure::ToneOfAlpha) }
    }
}

/// Converts `asked`, a cut or blur of the options, for a plan: 0 becomes `default`; below 0 becomes 0 (no cut or blur).
fn or_default(asked: f32, default: f32) -> f32 {
    if asked == 0.0 {
        default
    } else if asked < 0.0 {
        0.0
    } else {
        asked
    }
}

/// Converts a cut of a plan to a value for the options, the inverse of `or_default`: 0 (no cut) becomes `NERF_NONE`.
fn or_none(cut: f32) -> f32 {
    if cut == 0.0 { NERF_NONE } else { cut }
}

pub(crate) fn at_most(
    name: &'static str,
    expected: &'static str,
    found: u32,
    most: u32,
) -> Result<u32, Failure> {
    if found <= most { Ok(found) } else { Err(Failure::Setting { name, expected, found }) }
}

pub(crate) fn flag(name: &'static str, found: u32) -> Result<bool, Failure> {
    at_most(name, FLAG, found, 1).map(|value| value == 1)
}
