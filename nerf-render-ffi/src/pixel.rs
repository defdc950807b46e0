//! How a pixel lies in memory.

use nerf_core::plan::Outputs;
use nerf_core::volume;

/// How a pixel of a plane lies in memory; 8-bit channels are clamped and rounded half up.
///
/// RGB is composited over the background. RGBA is the scene alone, premultiplied by its opacity,
/// which is the alpha: `rgb + (1 - a) * background` is what RGB gives, in display-encoded values or in linear light, as
/// `options.effects.linear` says.
/// A picture (a 2D field) is opaque: its alpha is 1, and it shows no background.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum PixelFormat {
    /// Three bytes over the background.
    RgbU8 = 1,
    /// Three floats over the background.
    RgbF32 = 2,
    /// Four bytes, premultiplied, no background.
    RgbaU8 = 3,
    /// Four floats, premultiplied, no background.
    RgbaF32 = 4,
    /// One float: opacity and distances.
    F32 = 5,
    /// Three floats, x, y, z: normals.
    Vec3F32 = 6,
}

impl PixelFormat {
    /// The colour format of that number.
    fn colour(number: u32) -> Option<Self> {
        use PixelFormat::*;
        [RgbU8, RgbF32, RgbaU8, RgbaF32].into_iter().find(|&format| format as u32 == number)
    }

    /// The name of that number's, for messages.
    pub(crate) fn name_of(number: u32) -> Option<&'static str> {
        let names = [
            "NERF_FORMAT_RGB_U8",
            "NERF_FORMAT_RGB_F32",
            "NERF_FORMAT_RGBA_U8",
            "NERF_FORMAT_RGBA_F32",
            "NERF_FORMAT_F32",
            "NERF_FORMAT_VEC3_F32",
        ];
        names.get((number as usize).wrapping_sub(1)).copied()
    }

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
        match self {
            Self::RgbU8 | Self::RgbaU8 => 1,
            Self::RgbF32 | Self::RgbaF32 | Self::F32 | Self::Vec3F32 => 4,
        }
    }
}

/// What a plane takes of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Channel {
    Colour,
    Opacity,
    RayDistance,
    ZDepth,
    MedianDistance,
    Normal,
    /// Of points.
    Density,
    PointColour,
    /// Which are read.
    LimitRayDistance,
    LimitZDepth,
}

impl Channel {
    /// The plane's name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Colour => "target.rgb",
            Self::Opacity => "target.opacity",
            Self::RayDistance => "target.ray_distance",
            Self::ZDepth => "target.z_depth",
            Self::MedianDistance => "target.median_distance",
            Self::Normal => "target.normals",
            Self::Density => "points.sigma",
            Self::PointColour => "points.rgb",
            Self::LimitRayDistance => "target.limit_ray_distance",
            Self::LimitZDepth => "target.limit_z_depth",
        }
    }

    /// Whether these have it; what no output is needed for always is.
    pub fn is_in(self, outputs: &Outputs) -> bool {
        match self {
            Self::Colour | Self::PointColour => outputs.rgb,
            Self::Opacity => outputs.opacity,
            Self::RayDistance => outputs.ray_distance,
            Self::ZDepth => outputs.z_depth,
            Self::MedianDistance => outputs.median_distance,
            Self::Normal => outputs.normals,
            Self::Density | Self::LimitRayDistance | Self::LimitZDepth => true,
        }
    }

    /// The formats that suit, for messages.
    pub fn formats(self) -> &'static str {
        match self {
            Self::Colour => "NERF_FORMAT_RGB_U8, RGB_F32, RGBA_U8 or RGBA_F32",
            Self::Normal => "NERF_FORMAT_VEC3_F32",
            Self::PointColour => "NERF_FORMAT_RGB_F32",
            _ => "NERF_FORMAT_F32",
        }
    }

    /// The format of that number, if it suits.
    pub fn format(self, number: u32) -> Option<PixelFormat> {
        let only = match self {
            Self::Colour => return PixelFormat::colour(number),
            Self::Normal => PixelFormat::Vec3F32,
            Self::PointColour => PixelFormat::RgbF32,
            _ => PixelFormat::F32,
        };
        (number == only as u32).then_some(only)
    }
}

/// Writes one pixel.
///
/// # Safety
/// `to` is aligned for `format` and writable for its size.
#[inline]
pub(crate) unsafe fn put(to: *mut u8, format: PixelFormat, channel: Channel, pixel: &volume::Pixel) {
    let [r, g, b] = pixel.rgb;
    let value = match channel {
        Channel::RayDistance => pixel.ray_distance,
        Channel::ZDepth => pixel.z_depth,
        Channel::MedianDistance => pixel.median_distance,
        _ => pixel.opacity,
    };
    // SAFETY: the pointer is writable for a value of its format, as this function's `# Safety` has it.
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

/// A channel in 8 bits, rounded half up.
fn byte(x: f32) -> u8 {
    (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}
