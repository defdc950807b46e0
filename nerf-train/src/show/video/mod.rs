//! MP4s, encoded by the `ffmpeg` program where there is one.
//!
//! Frames go to ffmpeg's standard input as raw RGB; what it writes appears under the final name only
//! when it has ended well. The choices: H.264 at CRF 16 (mpeg4 where this ffmpeg has no libx264), 4:2:0
//! chroma because players show nothing else, and the BT.709 matrix, named in the file, because an
//! unnamed one is guessed from the picture's size. An ffmpeg that hangs is ended after [`PATIENCE`].

use super::animation::{check_rate, check_size};
use crate::data::pictures::rgb::Picture;
use crate::data::pictures::rgb::ReportError;
use crate::system::child::{Heard, Helper, last_lines};
use crate::system::output::AtomicFile;
use crate::system::output::mark::MARK;
use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// An ffmpeg that has taken nothing of a frame, or after the last frame has written nothing, for this long hangs: it
/// is ended.
pub const PATIENCE: Duration = Duration::from_secs(60);
/// How long it may take to list its encoders.
const LISTING_PATIENCE: Duration = Duration::from_secs(10);
/// How long an ffmpeg that no longer takes frames has to say why.
const LAST_WORDS: Duration = Duration::from_millis(200);
/// What is kept of the list of encoders, bytes: it has about 20 KB.
const LISTING_BYTES: usize = 1 << 20;
/// What is kept of ffmpeg's messages, bytes: the last ones say why it failed.
const KEPT_BYTES: usize = 8 << 10;

/// Why there is no MP4.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VideoError {
    /// No such program.
    #[error("no ffmpeg found (looked for `{}`)", program.display())]
    Missing {
        /// What was looked for.
        program: PathBuf,
    },
    /// A program that does not start, or does not list its encoders as ffmpeg does.
    #[error("`{}` cannot be used as ffmpeg: {reason}", program.display())]
    Unusable {
        /// What was run.
        program: PathBuf,
        /// What happened.
        reason: String,
    },
    /// An ffmpeg without any encoder that this project uses.
    #[error("`{}`: expected the encoder libx264 or mpeg4, found neither", program.display())]
    NoEncoder {
        /// What was run.
        program: PathBuf,
    },
    /// It ended before it should, or with an error.
    #[error("`{}` could not write {}: {said} ({status})", program.display(), path.display())]
    Failed {
        /// What was run.
        program: PathBuf,
        /// The file it was to become.
        path: PathBuf,
        /// Its last messages.
        said: String,
        /// How it ended.
        status: String,
    },
    /// It hung, and was ended.
    #[error(
        "`{}` hangs and was ended: it {why} for {seconds} s; {} is not written: {said}",
        program.display(), path.display()
    )]
    Hangs {
        /// What was run.
        program: PathBuf,
        /// The file it was to become.
        path: PathBuf,
        /// Which sign of life was missing.
        why: &'static str,
        /// For how long, s.
        seconds: f64,
        /// Its last messages.
        said: String,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoder {
    X264,
    Mpeg4,
}

/// An ffmpeg that runs on this machine and has an encoder for MP4s.
#[derive(Clone, Debug)]
pub struct Ffmpeg {
    program: PathBuf,
    encoder: Encoder,
    /// How long it may take nothing and write nothing.
    patience: Duration,
}

impl From<VideoError> for ReportError {
    fn from(error: VideoError) -> Self {
        Self::Video(error.into())
    }
}

impl Ffmpeg {
    /// Tries out `program`; `ffmpeg` from `PATH` where it is `None`.
    ///
    /// # Errors
    /// [`VideoError::Missing`], [`VideoError::Unusable`], [`VideoError::NoEncoder`].
    pub fn find(program: Option<&Path>) -> Result<Self, VideoError> {
        Self::find_within(program, LISTING_PATIENCE)
    }

    /// As [`find`](Self::find); how long it may take to answer.
    fn find_within(program: Option<&Path>, patience: Duration) -> Result<Self, VideoError> {
        let program = program.unwrap_or(Path::new("ffmpeg")).to_owned();
        let unusable = |reason| VideoError::Unusable { program: program.clone(), reason };
        let mut command = Command::new(&program);
        command.args(["-hide_banner", "-encoders"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let listing = match Helper::spawn(&mut command) {
            Ok(listing) => listing,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Err(VideoError::Missing { program });
            }
            Err(error) => return Err(unusable(error.to_string())),
        };
        let (_, stdout, stderr) = listing.pipes();
        let (listed, said) = (Heard::of(stdout, LISTING_BYTES), Heard::of(stderr, KEPT_BYTES));
        let Some(status) = listing.wait(patience) else {
            listing.kill();
            let seconds = patience.as_secs_f64();
            return Err(unusable(format!("it did not list its encoders within {seconds} s")));
        };
        if !status.success() {
            return Err(unusable(format!("{} ({status})", last_lines(&said.text()))));
        }
        let listed = listed.text();
        let text = String::from_utf8_lossy(&listed);
        // " V....D libx264    libx264 H.264 / AVC …"
        let has = |name| text.lines().any(|line| line.split_whitespace().nth(1) == Some(name));
        match (has("libx264"), has("mpeg4")) {
            (true, _) => Ok(Self { program, encoder: Encoder::X264, patience: PATIENCE }),
            (false, true) => Ok(Self { program, encoder: Encoder::Mpeg4, patience: PATIENCE }),
            (false, false) => Err(VideoError::NoEncoder { program }),
        }
    }

    /// The same, given up when it shows no sign of life for this long instead of [`PATIENCE`].
    pub fn with_patience(self, patience: Duration) -> Self {
        Self { patience, ..self }
    }
}

/// An MP4 that is written frame by frame, whole or not at all.
///
/// Without [`finish`](Self::finish) ffmpeg is ended and nothing is left.
#[derive(Debug)]
pub struct Mp4Writer {
    ffmpeg: Ffmpeg,
    helper: Helper,
    /// Closed to say that there are no more frames.
    stdin: Option<ChildStdin>,
    messages: Heard,
    /// `None` once in place.
    file: Option<AtomicFile>,
    size: (usize, usize),
    written: usize,
}

impl Mp4Writer {
    /// Starts ffmpeg. All frames have this size, pixels; `fps`: frames per second.
    ///
    /// An odd side gets its last column or row twice, as 4:2:0 chroma needs even ones.
    ///
    /// # Errors
    /// [`ReportError::Animation`] where `fps` is not a positive number; [`ReportError::Size`] without
    /// pixels; [`ReportError::Output`]; [`ReportError::Video`] where ffmpeg does not start.
    pub fn create(
        ffmpeg: &Ffmpeg,
        path: impl AsRef<Path>,
        width: usize,
        height: usize,
        fps: f64,
    ) -> Result<Self, ReportError> {
        /// The largest side that H.264 allows, pixels.
        const LIMIT: usize = 16_384;
        check_rate(fps)?;
        if width == 0 || height == 0 || width > LIMIT || height > LIMIT {
            return Err(ReportError::Size { format: "MP4", width, height, limit: LIMIT });
        }
        let file = AtomicFile::create(path)?;
        let mut command = Command::new(&ffmpeg.program);
        command.args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        command.arg("-s").arg(format!("{}x{}", even(width), even(height)));
        command.arg("-r").arg(fps.to_string()).args(["-i", "-"]);
        command.args(["-vf", "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_int"]);
        command.args(["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"]);
        command.args(match ffmpeg.encoder {
            Encoder::X264 => ["-c:v", "libx264", "-crf", "16"],
            Encoder::Mpeg4 => ["-c:v", "mpeg4", "-q:v", "2"],
        });
        command.arg("-metadata").arg(format!("comment={MARK}"));
        command.args(["-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4"]);
        // `file:` keeps a name with a colon or a leading dash a name.
        let mut place = OsString::from("file:");
        place.push(file.place());
        command.arg(place).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        let unusable = |error: io::Error| VideoError::Unusable {
            program: ffmpeg.program.clone(),
            reason: error.to_string(),
        };
        let helper = Helper::spawn(&mut command).map_err(unusable)?;
        let (stdin, _, stderr) = helper.pipes();
        let messages = Heard::of(stderr, KEPT_BYTES);
        let (ffmpeg, size) = (ffmpeg.clone(), (width, height));
        Ok(Self { ffmpeg, helper, stdin, messages, file: Some(file), size, written: 0 })
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// [`ReportError::Animation`] where its size is not that of the file; [`VideoError::Failed`] where
    /// ffmpeg no longer takes frames, [`VideoError::Hangs`] where it neither takes them nor ends.
    pub fn push(&mut self, frame: &Picture) -> Result<(), ReportError> {
        check_size(self.written, frame, self.size)?;
        let bytes = even_rgb8(frame);
        let Some(stdin) = &mut self.stdin else { return Err(self.failure().into()) };
        match self.helper.feed(stdin, &bytes, self.ffmpeg.patience) {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::TimedOut => {
                return Err(self.hangs("took nothing of a frame").into());
            }
            Err(_) => return Err(self.failure().into()),
        }
        self.written += 1;
        Ok(())
    }

    /// Waits for ffmpeg and puts the file in place.
    ///
    /// # Errors
    /// [`ReportError::Animation`] where there is no frame; [`VideoError::Failed`], [`VideoError::Hangs`];
    /// [`ReportError::Output`].
    pub fn finish(mut self) -> Result<(), ReportError> {
        if self.written == 0 {
            return Err(ReportError::Animation("it has no frames".to_owned()));
        }
        drop(self.stdin.take());
        let Some(ended) = self.wait() else {
            return Err(self.hangs("wrote nothing after its last frame, and did not end,").into());
        };
        let wrote = self.file.as_ref().is_some_and(|file| {
            fs::metadata(file.place()).is_ok_and(|metadata| !metadata.is_file() || metadata.len() > 0)
        });
        if !(wrote && ended.success()) {
            return Err(self.failure().into());
        }
        match self.file.take() {
            Some(file) => Ok(file.commit()?),
            None => Ok(()),
        }
    }

    /// Waits as long as its file changes: a long film takes a while to put its index in front.
    fn wait(&self) -> Option<ExitStatus> {
        /// Between two looks at the file.
        const LOOK_EVERY: Duration = Duration::from_millis(100);
        let state = || {
            let metadata = self.file.as_ref().and_then(|file| fs::metadata(file.place()).ok());
            metadata.map(|metadata| (metadata.len(), metadata.modified().ok()))
        };
        let (mut last, mut changed) = (state(), Instant::now());
        loop {
            let status = self.helper.wait(LOOK_EVERY.min(self.ffmpeg.patience));
            if status.is_some() {
                return status;
            }
            let now = state();
            if now != last {
                (last, changed) = (now, Instant::now());
            } else if changed.elapsed() >= self.ffmpeg.patience {
                return None;
            }
        }
    }

    /// The file's name, for messages.
    fn path(&self) -> PathBuf {
        self.file.as_ref().map_or_else(PathBuf::new, |file| file.path().to_owned())
    }

    /// Ends it: it has failed, and is about to say why if it has not done so.
    fn failure(&mut self) -> VideoError {
        drop(self.stdin.take());
        let status = self.helper.wait(LAST_WORDS).or_else(|| self.helper.kill());
        VideoError::Failed {
            program: self.ffmpeg.program.clone(),
            path: self.path(),
            said: last_lines(&self.messages.text()),
            status: status.map_or_else(|| "no status".to_owned(), |status| status.to_string()),
        }
    }

    fn hangs(&mut self, why: &'static str) -> VideoError {
        self.helper.kill();
        VideoError::Hangs {
            program: self.ffmpeg.program.clone(),
            path: self.path(),
            why,
            seconds: self.ffmpeg.patience.as_secs_f64(),
            said: last_lines(&self.messages.text()),
        }
    }
}

fn even(side: usize) -> usize {
    side.next_multiple_of(2)
}

/// The bytes of a frame, red, green, blue; the last column and row twice where their number is odd.
fn even_rgb8(frame: &Picture) -> Vec<u8> {
    let bytes = frame.to_rgb8();
    if frame.width.is_multiple_of(2) && frame.height.is_multiple_of(2) {
        return bytes;
    }
    let mut padded = Vec::with_capacity(even(frame.width) * even(frame.height) * 3);
    for row in bytes.chunks_exact(frame.width * 3) {
        padded.extend_from_slice(row);
        if !frame.width.is_multiple_of(2) {
            padded.extend_from_slice(&row[row.len() - 3..]);
        }
    }
    if !frame.height.is_multiple_of(2) {
        padded.extend_from_within(padded.len() - even(frame.width) * 3..);
    }
    padded
}

#[cfg(test)]
mod tests;
