//! Outputs of a rendered view (colour, opacity, distances, normals) as pictures and files.

use crate::data::pictures::rgb::{Picture, check_length, write_grey16_png, write_rgba_png};
use crate::measure::frame::{self, Frame};
use crate::show::colour_map::{depth_picture_with_legend, normal_picture};
use crate::system::output::mark::MARK;
use crate::system::output::write_atomic;
use anyhow::Context;
use clap::ValueEnum;
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage,
};
use std::ffi::OsStr;
use std::io::Cursor;
use std::path::Path;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Output {
    /// Colour, composited over the background.
    Rgb,
    /// Opacity, 16-bit grey, 0 to 1.
    Opacity,
    /// Distance along the ray, with a legend.
    RayDistance,
    /// Distance along the view axis, with a legend.
    ZDepth,
    /// Distance along the ray at which the accumulated opacity crosses 1/2, with a legend.
    MedianDistance,
    /// Normals in world space: red, green, blue are (x, y, z) / 2 + 1/2.
    Normals,
    /// All outputs.
    All,
}

impl Output {
    pub fn is_distance(self) -> bool {
        matches!(self, Self::RayDistance | Self::ZDepth | Self::MedianDistance)
    }

    /// Returns the output's name, such as `z_depth`, for the legend's title and the suffix of additional files.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Rgb | Self::All => "rgb",
            Self::Opacity => "opacity",
            Self::RayDistance => "ray_distance",
            Self::ZDepth => "z_depth",
            Self::MedianDistance => "median_distance",
            Self::Normals => "normals",
        }
    }

    /// Returns the values of a distance output, world units; for any other output the distance along the ray.
    pub fn distances(self, frame: &Frame) -> &[f32] {
        match self {
            Self::ZDepth => &frame.z_depth,
            Self::MedianDistance => &frame.median_distance,
            _ => &frame.ray_distance,
        }
    }
}

pub fn is_exr(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(OsStr::new("exr")))
}

/// Writes an output of a frame as PNG, or as EXR if `path` ends in `.exr`. `transparent`: whether colour has alpha.
/// `range`: distances at the two ends of the colour map, world units; `None`: chosen for the frame.
pub fn write_still(
    path: &Path,
    frame: &Frame,
    output: Output,
    range: Option<(f32, f32)>,
    transparent: bool,
) -> anyhow::Result<()> {
    match output {
        _ if is_exr(path) => {
            write_exr(path, frame.width, frame.height, &channels_of(frame, output, transparent))?;
        }
        Output::Rgb if transparent => {
            write_rgba_png(path, &frame.rgb, &frame.opacity, frame.width, frame.height)?;
        }
        Output::Opacity => {
            write_grey16_png(path, &frame.opacity, frame.width, frame.height, (0.0, 1.0))?;
        }
        _ => picture_of(frame, output, range)?.write_png(path)?,
    }
    Ok(())
}

/// Returns name and values of each channel of an output, for an EXR file, with the names of compositing programs.
fn channels_of(frame: &Frame, output: Output, transparent: bool) -> Vec<(&'static str, Vec<f32>)> {
    let axis = |of: &[[f32; 3]], axis: usize| of.iter().map(|value| value[axis]).collect();
    match output {
        Output::Rgb | Output::All => {
            let mut channels =
                vec![("R", axis(&frame.rgb, 0)), ("G", axis(&frame.rgb, 1)), ("B", axis(&frame.rgb, 2))];
            if transparent {
                channels.push(("A", frame.opacity.clone()));
            }
            channels
        }
        Output::Opacity => vec![("A", frame.opacity.clone())],
        Output::ZDepth => vec![("Z", frame.z_depth.clone())],
        Output::RayDistance | Output::MedianDistance => {
            vec![(output.suffix(), output.distances(frame).to_vec())]
        }
        Output::Normals => vec![
            ("N.X", axis(&frame.normals, 0)),
            ("N.Y", axis(&frame.normals, 1)),
            ("N.Z", axis(&frame.normals, 2)),
        ],
    }
}

/// Returns the RGB picture of an output. `range`: distances at the two ends of the colour map, as in [`write_still`].
pub fn picture_of(frame: &Frame, output: Output, range: Option<(f32, f32)>) -> anyhow::Result<Picture> {
    let size = (frame.width, frame.height);
    Ok(match output {
        Output::Rgb | Output::All => frame::picture(frame),
        Output::Opacity => {
            let grey = frame.opacity.iter().map(|&opacity| [opacity; 3]).collect();
            Picture::new(frame.width, frame.height, grey)?
        }
        Output::RayDistance | Output::ZDepth | Output::MedianDistance => {
            let title = format!("{}, world units", output.suffix());
            depth_picture_with_legend(output.distances(frame), &frame.opacity, size, range, &title)?
        }
        Output::Normals => normal_picture(&frame.normals, &frame.opacity, frame.width, frame.height)?,
    })
}

/// Writes an OpenEXR file of 32-bit floats. `channels`: names, such as `R` (linear light, by the format's convention)
/// or `Z`, and values, `[height * width]`.
pub fn write_exr(
    path: impl AsRef<Path>,
    width: usize,
    height: usize,
    channels: &[(&str, Vec<f32>)],
) -> anyhow::Result<()> {
    for (_, values) in channels {
        check_length("a channel of an EXR", width, height, values.len())?;
    }
    let channel =
        |(name, values): &(&str, Vec<f32>)| AnyChannel::new(*name, FlatSamples::F32(values.clone()));
    let attributes = LayerAttributes { comments: Some(MARK.into()), ..LayerAttributes::default() };
    let channels = AnyChannels::sort(channels.iter().map(channel).collect());
    let layer = Layer::new((width, height), attributes, Encoding::SMALL_LOSSLESS, channels);
    let mut bytes = Vec::new();
    let written = Image::from_layer(layer).write().non_parallel().to_buffered(Cursor::new(&mut bytes));
    written.context("cannot make the EXR")?;
    Ok(write_atomic(path, &bytes)?)
}
