//! Animated GIFs.
//!
//! The quality choice: each frame has its own palette of up to 256 colours, exact where the frame
//! has no more than that, else cut by variance and refined; no dithering. Frames have own palettes
//! because a turntable shows other colours from each side, and because they can then be written as
//! they come, on all cores, without holding the whole animation. There is no dithering because its
//! grain crawls from frame to frame and doubles the file. The price is slight banding in smooth
//! gradients (1 to 2 of 255 levels rms): look at PNG frames to judge quality.

mod palette;

use super::error::{ReportError, check_length};
use super::picture::Picture;
use crate::output::AtomicFile;
use gif::{Encoder, Frame, Repeat};
use rayon::prelude::*;
use std::path::Path;

/// The longest delay of a frame in a GIF, hundredths of a second.
const LONGEST_DELAY: f64 = 65_535.0;

/// Writes an endlessly looping GIF, whole or not at all.
///
/// All frames have the size of the first. `fps`: frames per second; GIF counts time in hundredths of a
/// second, so that delays alternate where the rate does not divide 100 and the mean rate is kept.
/// Above 50 the file plays at 50, as viewers slow down anything faster.
///
/// # Errors
/// [`ReportError::Animation`] where there is no frame, where frames differ in size or where `fps` is
/// not a positive number; [`ReportError::Size`] above 65,535 pixels a side; [`ReportError::Output`].
pub fn write_gif(
    path: impl AsRef<Path>,
    frames: impl Iterator<Item = Picture>,
    fps: f64,
) -> Result<(), ReportError> {
    if !(fps > 0.0 && fps.is_finite()) {
        return Err(ReportError::Animation(format!("{fps} frames per second is not a rate")));
    }
    let mut frames = frames.enumerate().peekable();
    let Some((width, height)) = frames.peek().map(|(_, frame)| (frame.width, frame.height)) else {
        return Err(ReportError::Animation("it has no frames".to_owned()));
    };
    let (Ok(gif_width), Ok(gif_height)) = (u16::try_from(width), u16::try_from(height)) else {
        return Err(wrong_size(width, height));
    };
    if gif_width == 0 || gif_height == 0 {
        return Err(wrong_size(width, height));
    }

    // The file is opened only now: a wrong call leaves no trace.
    let file = AtomicFile::create(path)?;
    let mut encoder = Encoder::new(file, gif_width, gif_height, &[]).map_err(encode_error)?;
    encoder.set_repeat(Repeat::Infinite).map_err(encode_error)?;
    let batch_size = 2 * rayon::current_num_threads().max(1);
    loop {
        let batch: Vec<(usize, Picture)> = frames.by_ref().take(batch_size).collect();
        if batch.is_empty() {
            break;
        }
        let quantise = |(index, picture): (usize, Picture)| -> Result<Frame<'static>, ReportError> {
            if (picture.width, picture.height) != (width, height) {
                return Err(ReportError::Animation(format!(
                    "frame {index} is {}×{}, the first is {width}×{height}",
                    picture.width, picture.height
                )));
            }
            check_length("a frame", width, height, picture.rgb.len())?;
            let quantised = palette::quantise(&picture.to_rgb8());
            let mut frame =
                Frame::from_palette_pixels(gif_width, gif_height, quantised.indices, quantised.palette, None);
            frame.delay = delay(index, fps);
            frame.make_lzw_pre_encoded();
            Ok(frame)
        };
        let done: Result<Vec<_>, _> = batch.into_par_iter().map(quantise).collect();
        for frame in done? {
            encoder.write_lzw_pre_encoded_frame(&frame).map_err(encode_error)?;
        }
    }
    Ok(encoder.into_inner().map_err(ReportError::encode("GIF"))?.commit()?)
}

/// Hundredths of a second for which frame `index` stands.
fn delay(index: usize, fps: f64) -> u16 {
    let at = |i: usize| (i as f64 * 100.0 / fps).round();
    // From absolute times, so that rounding does not add up.
    (at(index + 1) - at(index)).clamp(2.0, LONGEST_DELAY) as u16
}

fn wrong_size(width: usize, height: usize) -> ReportError {
    ReportError::Size { format: "GIF", width, height, limit: usize::from(u16::MAX) }
}

fn encode_error(error: gif::EncodingError) -> ReportError {
    ReportError::encode("GIF")(error)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A shaded, coloured ball that wanders over a white page.
    fn frame(shift: usize) -> Picture {
        let pixel = |i: usize| {
            let x = (i % 200) as f32 / 100.0 - 0.7 - shift as f32 / 100.0;
            let y = (i / 200) as f32 / 100.0 - 1.0;
            let height = 0.4 - x * x - y * y;
            if height < 0.0 { [1.0; 3] } else { [height.sqrt(), 0.5 + x * 0.5, 0.3 + 0.2 * y] }
        };
        Picture::new(200, 200, (0..40_000).map(pixel).collect()).unwrap()
    }

    fn decode(path: &Path) -> (Vec<(u16, Vec<u8>)>, Repeat) {
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(std::fs::File::open(path).unwrap()).unwrap();
        let mut frames = Vec::new();
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            frames.push((frame.delay, frame.buffer.to_vec()));
        }
        (frames, decoder.repeat())
    }

    #[test]
    fn an_animation_keeps_frames_rate_and_colours() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        let start = std::time::Instant::now();
        write_gif(&path, (0..60).map(frame), 30.0).unwrap();
        let elapsed = start.elapsed();
        let (frames, repeat) = decode(&path);
        assert_eq!(repeat, Repeat::Infinite);
        assert_eq!(frames.len(), 60);
        assert_eq!(frames.iter().map(|f| u32::from(f.0)).sum::<u32>(), 200);
        let truth = frame(7).to_rgb8();
        let squares: f64 = truth
            .chunks_exact(3)
            .zip(frames[7].1.chunks_exact(4))
            .flat_map(|(p, q)| (0..3).map(move |c| (f64::from(p[c]) - f64::from(q[c])).powi(2)))
            .sum();
        let rms = (squares / truth.len() as f64).sqrt();
        println!("60 frames of 200×200 in {elapsed:?}, {rms:.2} levels rms");
        assert!(rms < 2.0, "{rms} levels off");
        let corners: Vec<u8> = frames.iter().map(|frame| frame.1[0]).collect();
        assert!(corners.iter().all(|&level| level == 255), "the page flickers: {corners:?}");
    }

    #[test]
    fn frames_of_few_colours_are_exact() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        let pixel = |i: usize| [(i % 16) as f32 / 15.0, (i / 16) as f32 / 15.0, 0.25];
        let picture = Picture::new(16, 16, (0..256).map(pixel).collect()).unwrap();
        write_gif(&path, std::iter::once(picture.clone()), 1.0).unwrap();
        let (frames, _) = decode(&path);
        let rgb: Vec<u8> = frames[0].1.chunks_exact(4).flat_map(|p| p[..3].to_vec()).collect();
        assert_eq!(rgb, picture.to_rgb8());
    }

    #[test]
    fn wrong_calls_are_refused_and_leave_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        let small = || Picture::filled(4, 4, [0.5; 3]);
        let wrong = Picture { width: 4, height: 4, rgb: vec![] };
        assert!(write_gif(&path, std::iter::empty(), 10.0).is_err());
        assert!(write_gif(&path, [small()].into_iter(), 0.0).is_err());
        assert!(write_gif(&path, [small()].into_iter(), f64::NAN).is_err());
        assert!(write_gif(&path, [Picture::filled(0, 4, [0.0; 3])].into_iter(), 10.0).is_err());
        assert!(write_gif(&path, [Picture::filled(70_000, 1, [0.0; 3])].into_iter(), 10.0).is_err());
        assert!(write_gif(&path, [wrong].into_iter(), 10.0).is_err());
        let error =
            write_gif(&path, [small(), Picture::filled(5, 4, [0.0; 3])].into_iter(), 10.0).unwrap_err();
        assert!(error.to_string().contains("frame 1 is 5×4"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn delays_keep_the_mean_rate() {
        assert_eq!((0..4).map(|i| delay(i, 30.0)).collect::<Vec<_>>(), [3, 4, 3, 3]);
        assert_eq!(delay(5, 1e9), 2);
        assert_eq!(delay(0, 1e-9), 65_535);
    }
}
