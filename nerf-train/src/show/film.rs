//! A video as GIF or MP4.

use super::animation::{GifWriter, NO_FRAMES, check_rate};
use super::video::{Ffmpeg, Mp4Writer};
use crate::data::pictures::rgb::Picture;
use anyhow::bail;
use std::path::PathBuf;

/// A video that is written as its frames come; without [`finish`](Self::finish) nothing is left of it.
pub struct Film {
    path: PathBuf,
    /// Makes an MP4; without it the film is a GIF.
    ffmpeg: Option<Ffmpeg>,
    fps: f64,
    writer: Option<FilmWriter>,
}

enum FilmWriter {
    Gif(GifWriter),
    Mp4(Mp4Writer),
}

impl Film {
    /// A film of `fps` frames a second, an MP4 with an ffmpeg, else a GIF; its file is opened with the first frame, which
    /// knows its size.
    pub fn new(path: PathBuf, ffmpeg: Option<Ffmpeg>, fps: f64) -> anyhow::Result<Self> {
        check_rate(fps)?;
        Ok(Self { path, ffmpeg, fps, writer: None })
    }

    pub fn push(&mut self, frame: Picture) -> anyhow::Result<()> {
        let (path, width, height, fps) = (&self.path, frame.width, frame.height, self.fps);
        let writer = match (&mut self.writer, &self.ffmpeg) {
            (Some(writer), _) => writer,
            (none, Some(ffmpeg)) => {
                none.insert(FilmWriter::Mp4(Mp4Writer::create(ffmpeg, path, width, height, fps)?))
            }
            (none, None) => none.insert(FilmWriter::Gif(GifWriter::create(path, width, height, fps)?)),
        };
        match writer {
            FilmWriter::Gif(gif) => gif.push(frame),
            FilmWriter::Mp4(mp4) => mp4.push(&frame),
        }
    }

    /// Completes the file, and returns its path.
    pub fn finish(self) -> anyhow::Result<PathBuf> {
        match self.writer {
            None => bail!(NO_FRAMES),
            Some(FilmWriter::Gif(gif)) => gif.finish()?,
            Some(FilmWriter::Mp4(mp4)) => mp4.finish()?,
        }
        Ok(self.path)
    }
}
