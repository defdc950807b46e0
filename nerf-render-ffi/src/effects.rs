//! Effects of a frame: jitter of samples, anti-aliasing, depth of field, exposure, tone curve, linear output.

use crate::boundary::{check_zeros, named};
use crate::failure::Failure;
use crate::render_options::{at_most, flag};
use nerf_core::plan;

/// Tone curve, which maps light above 1 into the displayable range; applied to each linear colour channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum ToneMap {
    /// No curve: light above 1 is clipped when the colour is encoded.
    None = 0,
    /// `x / (1 + x)` (Reinhard et al. 2002).
    Reinhard = 1,
    /// Curve with a film's shoulder and toe (Narkowicz 2016's fit to the ACES curve).
    Filmic = 2,
}

const TONE_MAPS: [Option<plan::ToneMap>; 3] =
    [Some(plan::ToneMap::None), Some(plan::ToneMap::Reinhard), Some(plan::ToneMap::Filmic)];

/// Effects of a frame: jitter, anti-aliasing, depth of field, exposure, tone. All zeros turn every effect off.
///
/// An effect that this build of the library lacks is refused with `NERF_STATUS_OPTIONS`.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Effects {
    /// 1: each sample lies at a random position in its interval, drawn from `seed`. 0: in the middle of its interval.
    pub jitter: u32,
    /// Rays per pixel, at most 256; 0 and 1 are one ray through the pixel's centre. More rays take more memory.
    pub anti_aliasing: u32,
    /// Seed of the random positions of samples, and of random points on the aperture; read only if `jitter` is 1. If
    /// `jitter` is 0, the points on the aperture are drawn from seed 0, so that every frame has the same points.
    pub seed: u64,
    /// Radius of the aperture of a thin lens, world units, at most 1e9; 0 is a pinhole.
    pub aperture_radius: f32,
    /// Distance from the camera to the plane of focus along the view axis, world units, 1e-6 to 1e9; read only if
    /// `aperture_radius` is not 0.
    pub focus_distance: f32,
    /// Exposure, -32 to 32 stops; each stop doubles the light; 0 for no change.
    pub exposure: f32,
    /// Tone curve: a `nerf_tone_map`.
    pub tone_map: u32,
    /// 1: RGB planes, RGBA planes and colours of `nerf_query` are linear light, unbounded above. The colours of samples
    /// and background are converted to linear light before compositing. 0: colours are display-encoded throughout.
    pub linear: u32,
    /// Reserved; must be zeros.
    pub reserved: [u32; 5],
}

impl Effects {
    /// Converts the effects to the renderer's type. Checks only the integers: the renderer checks the floats.
    pub(crate) fn read(&self) -> Result<plan::Effects, Failure> {
        check_zeros("options.effects.reserved", &self.reserved)?;
        let most = plan::Effects::MAX_RAYS.into();
        let rays = at_most("options.effects.anti_aliasing", "0 to 256", self.anti_aliasing, most)?;
        let jitter = flag("options.effects.jitter", self.jitter)?;
        Ok(plan::Effects {
            jitter: jitter.then_some(plan::Jitter { seed: self.seed }),
            anti_aliasing: rays.max(1) as u16,
            depth_of_field: Some(plan::ThinLens {
                aperture_radius: self.aperture_radius,
                focus_distance: self.focus_distance,
            }),
            tone: plan::Tone {
                exposure: self.exposure,
                map: named(&TONE_MAPS, "options.effects.tone_map", "a nerf_tone_map", self.tone_map)?,
                linear: flag("options.effects.linear", self.linear)?,
            },
        })
    }
}
