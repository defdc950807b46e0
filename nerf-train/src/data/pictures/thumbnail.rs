//! Small copies of the views' pictures, so that one HTML page can hold a picture for every camera.

use crate::data::View;
use crate::data::pictures::rgb::Picture;
use anyhow::Context;
use base64::Engine as _;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};

/// Maximum total number of pixels of the thumbnails of a page. As JPEG in base64, each pixel takes 0.3 to 2.2 bytes.
const PIXEL_BUDGET: usize = 1_200_000;
/// Upper limit of a thumbnail's longest side, pixels.
const LARGEST: usize = 400;
/// Lower limit of a thumbnail's longest side, pixels: nothing can be seen on smaller ones.
const SMALLEST: usize = 16;
const QUALITY: u8 = 85;

/// A view's picture, reduced, display-encoded, and composited over a background colour.
#[derive(Clone, Debug, PartialEq)]
pub struct Thumbnail(pub Picture);

/// Returns the longest side of thumbnails, 16 to 400 pixels, with which `count` fit the pixel budget if possible.
pub fn side_for(count: usize) -> usize {
    ((PIXEL_BUDGET / count.max(1)) as f64).sqrt().floor().clamp(SMALLEST as f64, LARGEST as f64) as usize
}

impl Thumbnail {
    /// Composites the picture of `view` over `background`, and box-filters it to at most `side` pixels; never enlarges.
    pub fn of(view: &View, side: usize, background: [f32; 3]) -> Self {
        let (width, height) = view.size();
        let (width, height) = (width as usize, height as usize);
        let source = Picture { width, height, rgb: view.composite_over(background) };
        let scale = (side as f64 / width.max(height) as f64).min(1.0);
        let shrunk = |length: usize| ((length as f64 * scale).round() as usize).clamp(1, length.max(1));
        Self(source.box_filtered(shrunk(width), shrunk(height)))
    }

    /// Returns the picture as a JPEG in a URI for an HTML page: `data:image/jpeg;base64,…`.
    pub fn data_uri(&self) -> anyhow::Result<String> {
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, QUALITY)
            .write_image(
                &self.0.to_rgb8(),
                self.0.width as u32,
                self.0.height as u32,
                ExtendedColorType::Rgb8,
            )
            .context("cannot make the JPEG")?;
        Ok(format!("data:image/jpeg;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::demo;

    #[test]
    fn pictures_of_many_cameras_keep_to_the_budget() {
        for count in [1, 2, 10, 100, 200, 1000] {
            let side = side_for(count);
            assert!(
                (SMALLEST..=LARGEST).contains(&side)
                    && side * side * count <= PIXEL_BUDGET.max(LARGEST * LARGEST)
            );
        }
        assert_eq!(side_for(usize::MAX), SMALLEST);
        // Noise is the worst case for JPEG; 200 thumbnails of noise stay below 3 MB.
        let side = side_for(200);
        let noise = (0..side * side).map(|i| {
            [(i * 7919 % 256) as f32 / 255.0, (i * 104_729 % 251) as f32 / 250.0, (i * 31 % 7) as f32 / 6.0]
        });
        let uri = Thumbnail(Picture::new(side, side, noise.collect()).unwrap()).data_uri().unwrap();
        assert!(200 * uri.len() < 3_000_000, "{}", uri.len());
    }

    #[test]
    fn a_thumbnail_keeps_the_mean_and_the_aspect() {
        let view = &demo::small(1, 0, 24).train[0];
        assert_eq!(Thumbnail::of(view, 400, [1.0; 3]).0.rgb, view.composite_over([1.0; 3]));
        let small = Thumbnail::of(view, 12, [1.0; 3]).0;
        let mean = |rgb: &[[f32; 3]]| rgb.iter().map(|p| p[0]).sum::<f32>() / rgb.len() as f32;
        assert_eq!((small.width, small.height), (12, 12));
        assert!((mean(&small.rgb) - mean(&view.composite_over([1.0; 3]))).abs() < 1e-4);
        let wide = Picture::filled(100, 10, [0.5; 3]);
        assert_eq!(wide.box_filtered(7, 3).rgb, vec![[0.5; 3]; 21]);
    }
}
