//! Effects: what a frame does beyond one ray through each pixel's centre.

use crate::boundary::named;
use crate::failure::Failure;
use crate::render_options::{at_most, flag};
use nerf_core::plan;

/// The tone curve, on each linear channel, that brings light beyond 1 back into the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum ToneMap {
    /// None: what is beyond 1 is cut off where the colour is encoded.
    None = 0,
    /// `x / (1 + x)` (Reinhard et al. 2002).
    Reinhard = 1,
    /// A film's shoulder and toe (Narkowicz 2016's fit to the ACES curve).
    Filmic = 2,
}

/// The core's value for each number of [`ToneMap`]; `None` where it has none.
const TONE_MAPS: [Option<plan::ToneMap>; 3] =
    [Some(plan::ToneMap::None), Some(plan::ToneMap::Reinhard), Some(plan::ToneMap::Filmic)];

/// Effects: what a frame does beyond one ray through each pixel's centre. All zeros is none, and costs nothing.
///
/// An effect that this build of the library lacks is `NERF_STATUS_OPTIONS`.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Effects {
    /// 1: samples lie at random places in their bins, by `seed`. Else 0.
    pub jitter: u32,
    /// Rays a pixel, at most 256; 0 and 1 are one through its centre. More take more memory.
    pub anti_aliasing: u32,
    /// Read only where `jitter` is 1; places on the aperture depend on it, too.
    pub seed: u64,
    /// Radius of a thin lens' aperture, world units, at most 1e9; 0 is a pinhole.
    pub aperture_radius: f32,
    /// Distance from the camera to its plane of focus along the view axis, world units, 1e-6 to 1e9; read only where
    /// there is an aperture.
    pub focus_distance: f32,
    /// Doublings of the light, -32 to 32; 0 leaves it as it is.
    pub exposure: f32,
    /// A `nerf_tone_map`.
    pub tone_map: u32,
    /// 1: colour is linear light, unbounded above: each sample is decoded, and the background, before they are composited.
    /// Also of RGBA planes (premultiplied) and of queries. 0: display-encoded.
    pub linear: u32,
    /// Zeros.
    pub reserved: [u32; 5],
}

impl Effects {
    /// The effects as the renderer has them, which checks the ranges of what is no integer.
    pub(crate) fn read(&self) -> Result<plan::Effects, Failure> {
        if self.reserved != [0; 5] {
            return Err(Failure::Reserved("options.effects.reserved"));
        }
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
