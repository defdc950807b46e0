//! The format of a pixel in memory.

use crate::outputs::{
    NERF_OUTPUT_MEDIAN_DISTANCE, NERF_OUTPUT_NORMALS, NERF_OUTPUT_OPACITY, NERF_OUTPUT_RAY_DISTANCE,
    NERF_OUTPUT_RGB, NERF_OUTPUT_Z_DEPTH,
};
use core::fmt;
use nerf_core::volume;

/// Format of a plane's pixel in memory. An 8-bit channel maps [0, 1] to 0 to 255, clamped and rounded half up.
///
/// RGB is composited over the background. RGBA is the scene without background: alpha is the opacity, and the colour is
/// premultiplied by alpha. `rgb + (1 - alpha) * background` gives the colour of the RGB format. Values are linear light
/// if `options.effects.linear` is 1, else display-encoded. A 2D field is opaque: its alpha is 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum PixelFormat {
    /// Three bytes: colour over the background.
    RgbU8 = 1,
    /// Three floats: colour over the background.
    RgbF32 = 2,
    /// Four bytes: premultiplied colour and alpha, without background.
    RgbaU8 = 3,
    /// Four floats: premultiplied colour and alpha, without background.
    RgbaF32 = 4,
    /// One float: opacity, a distance or a density.
    F32 = 5,
    /// Three floats: x, y, z of a normal.
    Vec3F32 = 6,
}

impl PixelFormat {
    pub(crate) fn has_alpha(self) -> bool {
        matches!(self, Self::RgbaU8 | Self::RgbaF32)
    }

    pub(crate) fn size(self) -> usize {
        match self {
            Self::RgbU8 => 3,
            Self::RgbF32 | Self::Vec3F32 => 12,
            Self::RgbaU8 | Self::F32 => 4,
            Self::RgbaF32 => 16,
        }
    }

    pub(crate) fn align(self) -> usize {
        if matches!(self, Self::RgbU8 | Self::RgbaU8) { 1 } else { 4 }
    }
}

/// A number that the caller gave as a `nerf_format`; displayed as the format's name.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FormatNumber(pub u32);

impl fmt::Display for FormatNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = ["RGB_U8", "RGB_F32", "RGBA_U8", "RGBA_F32", "F32", "VEC3_F32"];
        match names.get((self.0 as usize).wrapping_sub(1)) {
            Some(name) => write!(f, "NERF_FORMAT_{name}"),
            None => write!(f, "{}, which is no nerf_format", self.0),
        }
    }
}

/// Quantity that a plane holds for each pixel, ray or point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Channel {
    Colour,
    Opacity,
    RayDistance,
    ZDepth,
    MedianDistance,
    Normal,
    /// Density at a point of `nerf_query`.
    Density,
    PointColour,
    /// Limit that the caller sets: distance along each ray at which the ray ends, world units.
    LimitRayDistance,
    LimitZDepth,
}

impl Channel {
    /// Returns the name of this channel's plane, and the `NERF_OUTPUT_*` flag that the plane needs; 0 if it needs none.
    fn about(self) -> (&'static str, u32) {
        match self {
            Self::Colour => ("target.rgb", NERF_OUTPUT_RGB),
            Self::Opacity => ("target.opacity", NERF_OUTPUT_OPACITY),
            Self::RayDistance => ("target.ray_distance", NERF_OUTPUT_RAY_DISTANCE),
            Self::ZDepth => ("target.z_depth", NERF_OUTPUT_Z_DEPTH),
            Self::MedianDistance => ("target.median_distance", NERF_OUTPUT_MEDIAN_DISTANCE),
            Self::Normal => ("target.normals", NERF_OUTPUT_NORMALS),
            Self::Density => ("points.sigma", 0),
            Self::PointColour => ("points.rgb", NERF_OUTPUT_RGB),
            Self::LimitRayDistance => ("target.limit_ray_distance", 0),
            Self::LimitZDepth => ("target.limit_z_depth", 0),
        }
    }

    pub fn name(self) -> &'static str {
        self.about().0
    }

    /// Returns whether `outputs`, `NERF_OUTPUT_*` or-ed, has this channel's flag; true if the channel needs no flag.
    pub fn is_in(self, outputs: u32) -> bool {
        self.about().1 & !outputs == 0
    }

    pub fn formats(self) -> &'static str {
        match self {
            Self::Colour => "NERF_FORMAT_RGB_U8, RGB_F32, RGBA_U8 or RGBA_F32",
            Self::Normal => "NERF_FORMAT_VEC3_F32",
            Self::PointColour => "NERF_FORMAT_RGB_F32",
            _ => "NERF_FORMAT_F32",
        }
    }

    /// Returns the format with this number; `None` if no format has the number or the format does not suit the channel.
    pub fn format(self, number: u32) -> Option<PixelFormat> {
        use PixelFormat::*;
        let suits: &[PixelFormat] = match self {
            Self::Colour => &[RgbU8, RgbF32, RgbaU8, RgbaF32],
            Self::Normal => &[Vec3F32],
            Self::PointColour => &[RgbF32],
            _ => &[F32],
        };
        suits.iter().copied().find(|&format| format as u32 == number)
    }
}

/// Writes the value of `channel` in `pixel` to address `to`, in the format `format`. A density is in `pixel.opacity`.
///
/// # Safety
/// `to` is aligned for `format` and writable for the size of `format`.
#[inline]
pub(crate) unsafe fn put(to: *mut u8, format: PixelFormat, channel: Channel, pixel: &volume::Pixel) {
    let [r, g, b] = pixel.rgb;
    let value = match channel {
        Channel::RayDistance => pixel.ray_distance,
        Channel::ZDepth => pixel.z_depth,
        Channel::MedianDistance => pixel.median_distance,
        _ => pixel.opacity,
    };
    // SAFETY: the pointer is writable for a value of its format, as this function's `# Safety` requires.
    unsafe {
        match format {
            PixelFormat::RgbU8 => to.cast::<[u8; 3]>().write([r, g, b].map(byte)),
            PixelFormat::RgbF32 => to.cast::<[f32; 3]>().write([r, g, b]),
            PixelFormat::RgbaU8 => to.cast::<[u8; 4]>().write([r, g, b, value].map(byte)),
            PixelFormat::RgbaF32 => to.cast::<[f32; 4]>().write([r, g, b, value]),
            PixelFormat::F32 => to.cast::<f32>().write(value),
            PixelFormat::Vec3F32 => to.cast::<[f32; 3]>().write(pixel.normal),
        }
    }
}

/// Converts red, green, blue or alpha from `[0, 1]` to 8 bits; clamps values outside, and rounds half up.
fn byte(x: f32) -> u8 {
    (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}
