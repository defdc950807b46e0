//! A picture file, decoded whole or refused.

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, metadata::Orientation};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use zune_jpeg::errors::DecodeErrors;
use zune_jpeg::zune_core::options::DecoderOptions;

/// A picture file that cannot be decoded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The file cannot be read.
    #[error("cannot read {file}: {source}")]
    Read {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Its content is none of the formats that are read.
    #[error("{file}: expected a PNG, JPEG, WebP, TIFF, BMP or GIF picture, found another kind of file")]
    Format {
        /// The file.
        file: PathBuf,
    },
    /// It is damaged, or of a kind that its format's decoder does not know.
    #[error("{file}: expected a whole picture, found: {found}")]
    Damaged {
        /// The file.
        file: PathBuf,
        /// What the decoder said.
        found: String,
    },
}

/// Decodes a picture of any bit depth and channel count, as it is stored, with its EXIF orientation.
///
/// The format is told from the content, whatever the extension says.
///
/// # Errors
/// [`DecodeError`] names the file. A JPEG that ends early or whose data is damaged is refused too: most
/// decoders fill the rest with grey and say nothing.
pub fn decode(file: &Path) -> Result<(DynamicImage, Orientation), DecodeError> {
    let bytes = std::fs::read(file).map_err(|source| DecodeError::Read { file: file.into(), source })?;
    let damaged = |found: String| DecodeError::Damaged { file: file.into(), found };
    let format = image::guess_format(&bytes).map_err(|_| DecodeError::Format { file: file.into() })?;
    if !format.reading_enabled() {
        return Err(DecodeError::Format { file: file.into() });
    }
    if format == ImageFormat::Jpeg {
        check_jpeg(&bytes).map_err(damaged)?;
    }
    let picture = |bytes: &[u8]| -> Result<_, image::ImageError> {
        let mut decoder = ImageReader::with_format(Cursor::new(bytes), format).into_decoder()?;
        // A tag that cannot be read is no reason to refuse the picture.
        let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
        Ok((DynamicImage::from_decoder(decoder)?, orientation))
    };
    picture(&bytes).map_err(|error| damaged(error.to_string()))
}

/// Decodes a JPEG once more, strictly.
fn check_jpeg(bytes: &[u8]) -> Result<(), String> {
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX));
    match zune_jpeg::JpegDecoder::new_with_options(Cursor::new(bytes), options).decode() {
        Ok(_) => Ok(()),
        // Against the letter of the standard, but nothing is lost.
        Err(DecodeErrors::FormatStatic(text)) if text.contains("Extra bytes between headers") => Ok(()),
        Err(error) => Err(format!("{error:?}")),
    }
}
