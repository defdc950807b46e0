//! MP4s, encoded by the `ffmpeg` program where there is one.
//!
//! Frames go to ffmpeg's standard input as raw RGB; what it writes appears under the final name only
//! when it has ended well. The choices: H.264 at CRF 16 (mpeg4 where this ffmpeg has no libx264), 4:2:0
//! chroma because players show nothing else, and the BT.709 matrix, named in the file, because an
//! unnamed one is guessed from the picture's size.

use super::animation::{check_rate, check_size};
use super::error::ReportError;
use super::picture::Picture;
use crate::output::AtomicFile;
use crate::output::mark::MARK;
use std::ffi::OsString;
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;

/// What is kept of ffmpeg's messages, bytes: the last ones say why it failed.
const KEPT_BYTES: usize = 8 << 10;
/// Lines of them that an error shows.
const SHOWN_LINES: usize = 4;

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
}

impl Ffmpeg {
    /// Tries out `program`; `ffmpeg` from `PATH` where it is `None`.
    ///
    /// # Errors
    /// [`VideoError::Missing`], [`VideoError::Unusable`], [`VideoError::NoEncoder`].
    pub fn find(program: Option<&Path>) -> Result<Self, VideoError> {
        let program = program.unwrap_or(Path::new("ffmpeg")).to_owned();
        let unusable = |reason| VideoError::Unusable { program: program.clone(), reason };
        let listed = Command::new(&program).args(["-hide_banner", "-encoders"]).stdin(Stdio::null()).output();
        let listed = match listed {
            Ok(listed) => listed,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Err(VideoError::Missing { program });
            }
            Err(error) => return Err(unusable(error.to_string())),
        };
        if !listed.status.success() {
            return Err(unusable(format!("{} ({})", last_lines(&listed.stderr), listed.status)));
        }
        let text = String::from_utf8_lossy(&listed.stdout);
        // " V....D libx264    libx264 H.264 / AVC …"
        let has = |name| text.lines().any(|line| line.split_whitespace().nth(1) == Some(name));
        match (has("libx264"), has("mpeg4")) {
            (true, _) => Ok(Self { program, encoder: Encoder::X264 }),
            (false, true) => Ok(Self { program, encoder: Encoder::Mpeg4 }),
            (false, false) => Err(VideoError::NoEncoder { program }),
        }
    }
}

/// An MP4 that is written frame by frame, whole or not at all.
///
/// Without [`finish`](Self::finish) ffmpeg is ended and nothing is left.
#[derive(Debug)]
pub struct Mp4Writer {
    program: PathBuf,
    child: Child,
    /// Closed to say that there are no more frames.
    stdin: Option<ChildStdin>,
    /// Reads ffmpeg's messages all the time, so that it never waits for somebody to do so.
    messages: Option<JoinHandle<Vec<u8>>>,
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
        let program = ffmpeg.program.clone();
        let mut child = command
            .spawn()
            .map_err(|error| VideoError::Unusable { program: program.clone(), reason: error.to_string() })?;
        let stdin = child.stdin.take();
        let messages = child.stderr.take().map(|stderr| std::thread::spawn(move || tail(stderr)));
        Ok(Self { program, child, stdin, messages, file: Some(file), size: (width, height), written: 0 })
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// [`ReportError::Animation`] where its size is not that of the file; [`VideoError::Failed`] where
    /// ffmpeg no longer takes frames.
    pub fn push(&mut self, frame: &Picture) -> Result<(), ReportError> {
        check_size(self.written, frame, self.size)?;
        let bytes = even_rgb8(frame);
        let taken = self.stdin.as_mut().is_some_and(|stdin| stdin.write_all(&bytes).is_ok());
        if !taken {
            return Err(self.failure().into());
        }
        self.written += 1;
        Ok(())
    }

    /// Waits for ffmpeg and puts the file in place.
    ///
    /// # Errors
    /// [`ReportError::Animation`] where there is no frame; [`VideoError::Failed`]; [`ReportError::Output`].
    pub fn finish(mut self) -> Result<(), ReportError> {
        if self.written == 0 {
            return Err(ReportError::Animation("it has no frames".to_owned()));
        }
        drop(self.stdin.take());
        let ended = self.child.wait();
        let wrote = self.file.as_ref().is_some_and(|file| {
            fs::metadata(file.place()).is_ok_and(|metadata| !metadata.is_file() || metadata.len() > 0)
        });
        if !(wrote && ended.is_ok_and(|status| status.success())) {
            return Err(self.failure().into());
        }
        match self.file.take() {
            Some(file) => Ok(file.commit()?),
            None => Ok(()),
        }
    }

    /// Ends ffmpeg; how it ended and the last it said.
    fn stop(&mut self) -> (Option<ExitStatus>, Vec<u8>) {
        drop(self.stdin.take());
        // One that is about to say why it failed gets the time to do so.
        let mut status = self.child.try_wait().ok().flatten();
        for _ in 0..20 {
            if status.is_some() {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(10));
            status = self.child.try_wait().ok().flatten();
        }
        if status.is_none() {
            let _ = self.child.kill();
            status = self.child.wait().ok();
        }
        let said = self.messages.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        (status, said)
    }

    fn failure(&mut self) -> VideoError {
        let (status, said) = self.stop();
        let path = self.file.as_ref().map_or_else(PathBuf::new, |file| file.path().to_owned());
        let status = status.map_or_else(|| "no status".to_owned(), |status| status.to_string());
        VideoError::Failed { program: self.program.clone(), path, said: last_lines(&said), status }
    }
}

impl Drop for Mp4Writer {
    fn drop(&mut self) {
        // Also after an end without a failure: nobody waits for it twice.
        if self.messages.is_some() {
            let _ = self.child.kill();
            let _ = self.child.wait();
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

/// Reads to the end, keeps the last bytes.
fn tail(mut stream: impl Read) -> Vec<u8> {
    let (mut kept, mut buffer) = (Vec::new(), [0; 4096]);
    loop {
        match stream.read(&mut buffer) {
            Ok(count @ 1..) => kept.extend_from_slice(&buffer[..count]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Ok(0) | Err(_) => return kept,
        }
        kept.drain(..kept.len().saturating_sub(KEPT_BYTES));
    }
}

/// The last lines that are not empty, on one line.
fn last_lines(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    match lines.len() {
        0 => "it said nothing".to_owned(),
        count => lines[count.saturating_sub(SHOWN_LINES)..].join("; "),
    }
}

#[cfg(test)]
mod tests;
