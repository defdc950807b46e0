//! A video as GIF, as MP4, or as both from the same frames.

use super::animation::{GifWriter, check_rate};
use super::video::{Ffmpeg, Mp4Writer};
use crate::data::pictures::rgb::Picture;
use crate::data::pictures::rgb::ReportError;
use std::path::{Path, PathBuf};

/// The files a film becomes.
#[derive(Clone, Debug)]
pub enum Files {
    /// A GIF alone.
    Gif(PathBuf),
    /// An MP4 alone.
    Mp4(PathBuf, Ffmpeg),
    /// A GIF, and beside it, under the same name with `.mp4`, an MP4 that may fail.
    Both(PathBuf, Ffmpeg),
}

impl Files {
    /// A GIF, and an MP4 beside it where there is an ffmpeg.
    pub fn gif(path: PathBuf, ffmpeg: Option<&Ffmpeg>) -> Self {
        match ffmpeg {
            Some(ffmpeg) => Self::Both(path, ffmpeg.clone()),
            None => Self::Gif(path),
        }
    }
}

/// A video that is written as its frames come; without [`finish`](Self::finish) nothing is left of it.
pub struct Film {
    files: Files,
    fps: f64,
    gif: Option<GifWriter>,
    mp4: Option<Mp4Writer>,
    /// Why the MP4 beside the GIF was given up.
    given_up: Option<ReportError>,
}

/// What a film has become.
#[derive(Debug)]
pub struct Finished {
    /// What was written.
    pub files: Vec<PathBuf>,
    /// Why there is no MP4 beside the GIF, where there was to be one.
    pub given_up: Option<ReportError>,
}

impl Film {
    /// A film of `fps` frames a second; its files are opened with the first frame, which knows its size.
    ///
    /// # Errors
    /// [`ReportError::Animation`] where `fps` is not a positive number.
    pub fn new(files: Files, fps: f64) -> Result<Self, ReportError> {
        check_rate(fps)?;
        Ok(Self { files, fps, gif: None, mp4: None, given_up: None })
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// As [`GifWriter`] and [`Mp4Writer`], except for an MP4 beside a GIF: that is given up.
    pub fn push(&mut self, frame: Picture) -> Result<(), ReportError> {
        let first = self.gif.is_none() && self.mp4.is_none();
        if first {
            self.open(frame.width, frame.height)?;
        }
        if let Some(mp4) = &mut self.mp4 {
            let pushed = mp4.push(&frame);
            self.keep_or_give_up(pushed)?;
        }
        self.gif.as_mut().map_or(Ok(()), |gif| gif.push(frame))
    }

    /// Completes the files.
    ///
    /// # Errors
    /// [`ReportError::Animation`] without a frame, and as [`push`](Self::push).
    pub fn finish(mut self) -> Result<Finished, ReportError> {
        if self.gif.is_none() && self.mp4.is_none() {
            return Err(ReportError::Animation("it has no frames".to_owned()));
        }
        let mut files = Vec::new();
        if let Some(gif) = self.gif.take() {
            gif.finish()?;
            files.extend(self.gif_path().map(Path::to_owned));
        }
        if let Some(mp4) = self.mp4.take() {
            let finished = mp4.finish();
            let path = self.mp4_path().filter(|_| finished.is_ok());
            self.keep_or_give_up(finished)?;
            files.extend(path);
        }
        Ok(Finished { files, given_up: self.given_up })
    }

    fn open(&mut self, width: usize, height: usize) -> Result<(), ReportError> {
        if let Some(path) = self.gif_path() {
            self.gif = Some(GifWriter::create(path, width, height, self.fps)?);
        }
        if let (Some(path), Files::Mp4(_, ffmpeg) | Files::Both(_, ffmpeg)) = (self.mp4_path(), &self.files) {
            match Mp4Writer::create(ffmpeg, path, width, height, self.fps) {
                Ok(mp4) => self.mp4 = Some(mp4),
                Err(error) => self.keep_or_give_up(Err(error))?,
            }
        }
        Ok(())
    }

    /// An MP4 alone must not fail; beside a GIF, which is whole without it, it is given up.
    fn keep_or_give_up(&mut self, result: Result<(), ReportError>) -> Result<(), ReportError> {
        match (result, &self.files) {
            (Err(error), Files::Both(..)) => {
                self.mp4 = None;
                self.given_up = Some(error);
                Ok(())
            }
            (result, _) => result,
        }
    }

    fn gif_path(&self) -> Option<&Path> {
        match &self.files {
            Files::Gif(path) | Files::Both(path, _) => Some(path),
            Files::Mp4(..) => None,
        }
    }

    fn mp4_path(&self) -> Option<PathBuf> {
        match &self.files {
            Files::Gif(_) => None,
            Files::Mp4(path, _) => Some(path.clone()),
            Files::Both(path, _) => Some(beside(path)),
        }
    }
}

/// The name of the MP4 beside a GIF.
pub fn beside(gif: &Path) -> PathBuf {
    gif.with_extension("mp4")
}
