//! A video as GIF or MP4.

use super::animation::{GifWriter, check_rate};
use super::video::{Ffmpeg, Mp4Writer};
use crate::data::pictures::rgb::Picture;
use crate::data::pictures::rgb::ReportError;
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
    ///
    /// # Errors
    /// [`ReportError::Animation`] where `fps` is not a positive number.
    pub fn new(path: PathBuf, ffmpeg: Option<Ffmpeg>, fps: f64) -> Result<Self, ReportError> {
        check_rate(fps)?;
        Ok(Self { path, ffmpeg, fps, writer: None })
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// As [`GifWriter`] and [`Mp4Writer`].
    pub fn push(&mut self, frame: Picture) -> Result<(), ReportError> {
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
    ///
    /// # Errors
    /// [`ReportError::Animation`] without a frame, and as [`push`](Self::push).
    pub fn finish(self) -> Result<PathBuf, ReportError> {
        match self.writer {
            None => return Err(ReportError::Animation("it has no frames".to_owned())),
            Some(FilmWriter::Gif(gif)) => gif.finish()?,
            Some(FilmWriter::Mp4(mp4)) => mp4.finish()?,
        }
        Ok(self.path)
    }
}
