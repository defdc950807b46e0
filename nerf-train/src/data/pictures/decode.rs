//! Decodes picture files completely; a damaged file is an error.

use crate::system::input::{MAX_PICTURE_BYTES, read_limited};
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};
use std::io::{BufRead, BufReader, Cursor, Read, Seek};
use std::path::{Path, PathBuf};
use zune_jpeg::errors::DecodeErrors;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Maximum number of pixels of a picture (16,384 × 16,384), needed because a header of a few bytes may claim any size.
const MAX_PIXELS: u64 = 1 << 28;
/// Maximum width and height of a picture, pixels: the largest that a `.nerf` blob can state.
pub const MAX_SIDE: u32 = 65_535;

/// Number of bytes from the start of a file that suffice to recognise HEIF.
const HEAD_BYTES: u64 = 12;

pub(crate) const FORMATS: &str = "PNG, JPEG, WebP, TIFF, BMP or GIF";

const HEIF_ADVICE: &str = "turn them into JPEG first, with `heif-convert a.heic a.jpg` (libheif) or `magick mogrify -format jpg *.heic`";

#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    #[error("cannot read {file}: {source}")]
    Read { file: PathBuf, source: std::io::Error },
    #[error("{file}: expected a {FORMATS} picture, found another kind of file")]
    Format { file: PathBuf },
    #[error("{file}: expected a {FORMATS} picture, found HEIF (HEIC) or AVIF; {HEIF_ADVICE}")]
    Heif { file: PathBuf },
    #[error("{file}: expected a whole picture, found: {found}")]
    Damaged { file: PathBuf, found: String },
    #[error("{file}: expected a picture of another size, found {}x{}", found.0, found.1)]
    Size { file: PathBuf, found: (u32, u32) },
}

/// Source of a picture's bytes. All sources are used through a trait object, so that the decoders are compiled once.
pub(super) trait Source: BufRead + Seek {}
impl<S: BufRead + Seek> Source for S {}

pub(super) fn reader<'s>(source: impl Source + 's) -> ImageReader<Box<dyn Source + 's>> {
    ImageReader::new(Box::new(source))
}

/// Decodes a picture of any bit depth and channel count. The format is recognised by the file's content. The returned
/// EXIF orientation has not been applied. A truncated or damaged JPEG is an error, although most decoders fill the rest
/// with grey.
pub fn decode(file: &Path) -> Result<(DynamicImage, Orientation), DecodeError> {
    decode_of(file, |_| true)
}

/// Decodes a picture as [`decode`] does, if width and height in its header, pixels, satisfy `wanted`; otherwise fails.
pub fn decode_of(
    file: &Path,
    wanted: impl Fn((u32, u32)) -> bool,
) -> Result<(DynamicImage, Orientation), DecodeError> {
    let bytes = read_limited(file, MAX_PICTURE_BYTES)
        .map_err(|source| DecodeError::Read { file: file.into(), source })?;
    let damaged = |found: String| DecodeError::Damaged { file: file.into(), found };
    if is_heif(&bytes) {
        return Err(DecodeError::Heif { file: file.into() });
    }
    let format = image::guess_format(&bytes).map_err(|_| DecodeError::Format { file: file.into() })?;
    if !format.reading_enabled() {
        return Err(DecodeError::Format { file: file.into() });
    }
    let text = |error: image::ImageError| damaged(error.to_string());
    let mut reader = reader(Cursor::new(&bytes));
    reader.set_format(format);
    let mut decoder = reader.into_decoder().map_err(text)?;
    // Checked before decoding, because the decoder allocates whatever size the header states.
    let (width, height) = decoder.dimensions();
    if width.max(height) > MAX_SIDE || u64::from(width) * u64::from(height) > MAX_PIXELS {
        let most = format!("at most {MAX_SIDE} a side and {MAX_PIXELS} in all are read");
        return Err(damaged(format!("{width}x{height} pixels, where {most}")));
    }
    if !wanted((width, height)) {
        return Err(DecodeError::Size { file: file.into(), found: (width, height) });
    }
    if format == ImageFormat::Jpeg {
        check_jpeg(&bytes).map_err(damaged)?;
    }
    // An orientation tag that cannot be read is no reason to refuse the picture.
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    Ok((DynamicImage::from_decoder(decoder).map_err(text)?, orientation))
}

/// Reads the stored width and height of a picture, pixels, from its header; the EXIF orientation is not applied.
pub fn dimensions(file: &Path) -> Result<(u32, u32), DecodeError> {
    let unread = |source| DecodeError::Read { file: file.into(), source };
    let mut head = Vec::new();
    let opened = || std::fs::File::open(file).map_err(unread);
    opened()?.take(HEAD_BYTES).read_to_end(&mut head).map_err(unread)?;
    if is_heif(&head) {
        return Err(DecodeError::Heif { file: file.into() });
    }
    let reader = reader(BufReader::new(opened()?)).with_guessed_format().map_err(unread)?;
    if reader.format().is_none() {
        return Err(DecodeError::Format { file: file.into() });
    }
    let damaged =
        |found: image::ImageError| DecodeError::Damaged { file: file.into(), found: found.to_string() };
    reader.into_dimensions().map_err(damaged)
}

/// Whether a file begins with a box `ftyp` of a HEIF or AVIF brand.
fn is_heif(bytes: &[u8]) -> bool {
    const BRANDS: [&[u8; 4]; 10] =
        [b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1", b"avif", b"avis"];
    bytes.get(4..8) == Some(b"ftyp")
        && bytes.get(8..12).is_some_and(|brand| BRANDS.iter().any(|b| *b == brand))
}

/// Decodes a JPEG in strict mode, to find damage; the error describes the damage.
fn check_jpeg(bytes: &[u8]) -> Result<(), String> {
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX));
    match zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options).decode() {
        Ok(_) => Ok(()),
        // Extra bytes between headers violate the standard, but lose no data.
        Err(DecodeErrors::FormatStatic(text)) if text.contains("Extra bytes between headers") => Ok(()),
        Err(error) => Err(format!("{error:?}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::pictures::testing::png;

    /// Header of a BMP with 24 bits a pixel, without pixel data.
    fn bmp(width: i32, height: i32) -> Vec<u8> {
        let sizes = [54i32, 40, width, height].map(i32::to_le_bytes).concat();
        [&b"BM\x36\0\0\0\0\0\0\0"[..], &sizes, &[1, 0, 24, 0], &[0; 24]].concat()
    }

    #[test]
    fn pictures_of_a_few_bytes_take_no_memory_on_their_headers_word() {
        let folder = tempfile::tempdir().expect("a folder");
        for (width, height, expected) in [
            (1 << 14, (1 << 14) + 1, "16384x16385 pixels"),
            (60_000, 60_000, "60000x60000 pixels"),
            (1, 1, ""),
        ] {
            let file = folder.path().join("picture.png");
            std::fs::write(&file, bmp(width, height)).expect("room");
            let error = decode(&file).expect_err("a picture without pixels").to_string();
            assert!(
                error.contains("picture.png: expected a whole picture") && error.contains(expected),
                "{error}"
            );
        }
    }

    #[test]
    fn sides_are_refused_by_the_header() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("wide.png");
        // The header and the beginning of the pixel data.
        let whole = png(image::GrayImage::new(MAX_SIDE + 1, 1));
        std::fs::write(&file, &whole[..60]).expect("room");
        let error = decode(&file).expect_err("too wide").to_string();
        assert!(error.contains("65536x1 pixels") && error.contains("at most 65535 a side"), "{error}");
    }
}
