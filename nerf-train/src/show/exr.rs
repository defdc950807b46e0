//! Floats as they are, in OpenEXR: for compositors and whoever measures.

use crate::data::pictures::rgb::check_length;
use crate::system::output::mark::MARK;
use crate::system::output::write_atomic;
use anyhow::Context;
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage,
};
use std::io::Cursor;
use std::path::Path;

/// Writes an OpenEXR file of 32-bit floats.
///
/// `channels`: names, such as `R` (linear light, by the format's custom) or `Z`, and `[height * width]` values each.
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
