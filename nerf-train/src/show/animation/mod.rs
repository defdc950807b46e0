//! Animated GIFs.
//!
//! Each frame has its own palette of up to 256 colours. The palette is exact if the frame has at most 256 colours;
//! otherwise variance-based cutting and k-means find it. Palettes of single frames suit a turntable, which shows other
//! colours from each side. They also let all cores encode frames, without the whole animation in memory. Frames are not
//! dithered: the grain would flicker from frame to frame and double the file's size. Smooth gradients therefore show
//! slight banding (1 to 2 of 255 levels rms), so judge quality by PNG frames.

mod palette;

use crate::data::pictures::rgb::{Picture, check_length, wrong_size};
use crate::system::output::AtomicFile;
use crate::system::output::mark::MARK;
use anyhow::{Context, bail};
use gif::{AnyExtension, Encoder, Extension, Frame, Repeat};
use rayon::prelude::*;
use std::path::Path;

const CANNOT: &str = "cannot make the GIF";
pub(crate) const NO_FRAMES: &str = "cannot make the animation: it has no frames";

/// The longest delay of a frame in a GIF, hundredths of a second.
const LONGEST_DELAY: f64 = 65_535.0;

/// Writer of an endlessly looping GIF, frame by frame. The file appears only when [`finish`](Self::finish) succeeds.
/// Buffers at most two frames per thread.
pub struct GifWriter {
    encoder: Encoder<AtomicFile>,
    width: u16,
    height: u16,
    fps: f64,
    written: usize,
    /// Buffered frames, encoded together once there are enough for all cores.
    waiting: Vec<Picture>,
}

impl GifWriter {
    /// Opens the file at `path`, for frames of `width` × `height` pixels.
    ///
    /// `fps`: frames per second. GIF counts delays in hundredths of a second. If 100 / `fps` is not a whole number,
    /// delays of different lengths alternate, so that their mean is right. If `fps` is above 50, delays are those of 50
    /// frames per second: viewers play files with shorter delays much more slowly.
    pub fn create(path: impl AsRef<Path>, width: usize, height: usize, fps: f64) -> anyhow::Result<Self> {
        check_rate(fps)?;
        let side = |pixels| u16::try_from(pixels).ok().filter(|&side| side > 0);
        let (Some(gif_width), Some(gif_height)) = (side(width), side(height)) else {
            return Err(wrong_size("GIF", (width, height), u16::MAX.into()));
        };
        let file = AtomicFile::create(path)?;
        let mut encoder = Encoder::new(file, gif_width, gif_height, &[]).context(CANNOT)?;
        encoder.set_repeat(Repeat::Infinite).context(CANNOT)?;
        let comment = AnyExtension(Extension::Comment as u8);
        encoder.write_raw_extension(comment, &[MARK.as_bytes()]).context(CANNOT)?;
        Ok(Self { encoder, width: gif_width, height: gif_height, fps, written: 0, waiting: Vec::new() })
    }

    pub fn push(&mut self, frame: Picture) -> anyhow::Result<()> {
        let index = self.written + self.waiting.len();
        check_size(index, &frame, (usize::from(self.width), usize::from(self.height)))?;
        self.waiting.push(frame);
        if self.waiting.len() < 2 * rayon::current_num_threads().max(1) {
            Ok(())
        } else {
            self.write_waiting()
        }
    }

    /// Writes the buffered frames and gives the file its final name. Fails if there was no frame.
    pub fn finish(mut self) -> anyhow::Result<()> {
        self.write_waiting()?;
        if self.written == 0 {
            bail!(NO_FRAMES);
        }
        Ok(self.encoder.into_inner().context(CANNOT)?.commit()?)
    }

    fn write_waiting(&mut self) -> anyhow::Result<()> {
        let (width, height, fps, first) = (self.width, self.height, self.fps, self.written);
        let quantise = |(i, picture): (usize, &Picture)| {
            let quantised = palette::quantise(&picture.to_rgb8());
            let mut frame =
                Frame::from_palette_pixels(width, height, quantised.indices, quantised.palette, None);
            frame.delay = delay(first + i, fps);
            frame.make_lzw_pre_encoded();
            frame
        };
        let frames: Vec<Frame<'static>> = self.waiting.par_iter().enumerate().map(quantise).collect();
        for frame in &frames {
            self.encoder.write_lzw_pre_encoded_frame(frame).context(CANNOT)?;
        }
        self.written += frames.len();
        self.waiting.clear();
        Ok(())
    }
}

pub(crate) fn check_rate(fps: f64) -> anyhow::Result<()> {
    if fps > 0.0 && fps.is_finite() {
        return Ok(());
    }
    bail!("cannot make the animation: {fps} frames per second is not a rate")
}

/// Checks that frame `index` has the `expected` width and height, and that its number of pixels is width × height.
pub(crate) fn check_size(index: usize, frame: &Picture, expected: (usize, usize)) -> anyhow::Result<()> {
    if (frame.width, frame.height) != expected {
        let (width, height) = expected;
        bail!(
            "cannot make the animation: frame {index} is {}×{}, the first is {width}×{height}",
            frame.width,
            frame.height
        );
    }
    check_length("a frame", frame.width, frame.height, frame.rgb.len())
}

/// Returns the delay of frame `index` at `fps` frames per second: hundredths of a second, at least 2.
fn delay(index: usize, fps: f64) -> u16 {
    let at = |i: usize| (i as f64 * 100.0 / fps).round();
    // Differences of rounded absolute times, so that rounding errors do not accumulate.
    (at(index + 1) - at(index)).clamp(2.0, LONGEST_DELAY) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a picture of a shaded, coloured ball on white, moved to the right by `shift` pixels.
    fn frame(shift: usize) -> Picture {
        let pixel = |i: usize| {
            let x = (i % 200) as f32 / 100.0 - 0.7 - shift as f32 / 100.0;
            let y = (i / 200) as f32 / 100.0 - 1.0;
            let height = 0.4 - x * x - y * y;
            if height < 0.0 { [1.0; 3] } else { [height.sqrt(), 0.5 + x * 0.5, 0.3 + 0.2 * y] }
        };
        Picture::new(200, 200, (0..40_000).map(pixel).collect()).unwrap()
    }

    /// Writes `frames`, all of the first frame's size, as a GIF. Returns its path.
    fn write_gif(
        path: impl AsRef<Path>,
        mut frames: impl Iterator<Item = Picture>,
        fps: f64,
    ) -> anyhow::Result<std::path::PathBuf> {
        let mut film = crate::show::writer::Film::new(path.as_ref().to_owned(), None, fps)?;
        frames.try_for_each(|frame| film.push(frame))?;
        film.finish()
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
