//! Writers of a rendering: a picture, a video, or a folder of numbered pictures.

use super::animation::{GifWriter, NO_FRAMES, check_rate};
use super::video::{Ffmpeg, Mp4Writer};
use crate::data::pictures::rgb::Picture;
use crate::measure::frame::Frame;
use crate::show::view::{Output, picture_of, write_still};
use anyhow::bail;
use std::path::{Path, PathBuf};

pub struct Writer {
    pub output: Output,
    /// Distances at the two ends of the colour map, world units. If `None`, each picture gets its own range.
    pub range: Option<(f32, f32)>,
    /// Whether colour is written with alpha; videos never have alpha.
    pub transparent: bool,
    pub sink: Sink,
}

pub enum Sink {
    Still(PathBuf),
    Film(Box<Film>),
    /// Folder of pictures such as `frame_0000.png`: path, number of the next frame, increment from frame to frame.
    Frames(PathBuf, usize, usize),
}

#[derive(Debug)]
pub struct Written {
    pub path: PathBuf,
    /// Number of the frame after this run's last frame, if the folder has a picture of that number from an earlier run.
    /// `None` if there is no picture of that number, or if several processes write frames to the folder.
    pub older_from: Option<usize>,
}

impl Writer {
    pub fn push(&mut self, frame: &Frame) -> anyhow::Result<()> {
        let (output, range) = (self.output, self.range);
        match &mut self.sink {
            Sink::Still(path) => write_still(path, frame, output, range, self.transparent)?,
            Sink::Film(film) => film.push(picture_of(frame, output, range)?)?,
            Sink::Frames(folder, number, every) => {
                write_still(&numbered(folder, *number), frame, output, range, self.transparent)?;
                *number += *every;
            }
        }
        Ok(())
    }

    pub fn finish(self) -> anyhow::Result<Written> {
        Ok(match self.sink {
            Sink::Still(path) => Written { path, older_from: None },
            Sink::Film(film) => Written { path: film.finish()?, older_from: None },
            Sink::Frames(folder, next, every) => {
                // With several shards, later frames in the folder may be from another shard.
                let older_from = (every == 1 && numbered(&folder, next).exists()).then_some(next);
                Written { path: folder, older_from }
            }
        })
    }
}

fn numbered(folder: &Path, index: usize) -> PathBuf {
    folder.join(format!("frame_{index:04}.png"))
}

/// Writer of a video, frame by frame. The file appears only when [`finish`](Self::finish) succeeds.
pub struct Film {
    path: PathBuf,
    /// Encoder for an MP4; `None`: the video is a GIF.
    ffmpeg: Option<Ffmpeg>,
    fps: f64,
    writer: Option<FilmWriter>,
}

enum FilmWriter {
    Gif(GifWriter),
    Mp4(Mp4Writer),
}

impl Film {
    /// Creates a video of `fps` (above 0) frames per second: an MP4 if there is an `ffmpeg`, else a GIF. The first
    /// frame opens the file and sets the size of all frames.
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

    /// Completes the file, and returns its path. Fails if there was no frame.
    pub fn finish(self) -> anyhow::Result<PathBuf> {
        match self.writer {
            None => bail!(NO_FRAMES),
            Some(FilmWriter::Gif(gif)) => gif.finish()?,
            Some(FilmWriter::Mp4(mp4)) => mp4.finish()?,
        }
        Ok(self.path)
    }
}
