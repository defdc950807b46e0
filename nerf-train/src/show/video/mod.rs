//! MP4 videos, encoded by an installed `ffmpeg`.
//!
//! Frames go to ffmpeg's standard input as raw RGB. The encoder is H.264 at CRF 16, or mpeg4 if ffmpeg has no libx264.
//! Chroma is 4:2:0, the only format that all players show. The file states that its colour matrix is BT.709; without
//! this entry, players guess the matrix from the picture's size.

use super::animation::{NO_FRAMES, check_rate, check_size};
use crate::data::pictures::rgb::{Picture, wrong_size};
use crate::system::child::{Heard, Helper, last_lines};
use crate::system::output::AtomicFile;
use crate::system::output::mark::MARK;
use anyhow::{anyhow, bail};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use std::{fs, io};

/// Time after which ffmpeg is killed if it reads nothing of a frame or, after the last frame, writes nothing.
pub const PATIENCE: Duration = Duration::from_secs(60);
/// Time in which ffmpeg must list its encoders.
const LISTING_PATIENCE: Duration = Duration::from_secs(10);
/// Time in which an ffmpeg that has stopped reading frames must exit with its error message.
const LAST_WORDS: Duration = Duration::from_millis(200);
/// Largest number of bytes kept of ffmpeg's list of encoders, which has about 20 KB.
const LISTING_BYTES: usize = 1 << 20;
/// Number of bytes kept from the end of ffmpeg's messages, which states why ffmpeg failed.
const KEPT_BYTES: usize = 8 << 10;

const X264: [&str; 4] = ["-c:v", "libx264", "-crf", "16"];
const MPEG4: [&str; 4] = ["-c:v", "mpeg4", "-q:v", "2"];

/// An ffmpeg that runs on this machine and has an encoder for MP4s.
#[derive(Clone, Debug)]
pub struct Ffmpeg {
    program: PathBuf,
    encoder: [&'static str; 4],
    patience: Duration,
}

impl Ffmpeg {
    /// Finds `program` (`None`: `ffmpeg` on `PATH`). Fails unless the program runs and has an encoder for MP4s.
    pub fn find(program: Option<&Path>) -> anyhow::Result<Self> {
        Self::find_within(program, LISTING_PATIENCE)
    }

    /// Does [`find`](Self::find). `patience`: time in which ffmpeg must list its encoders.
    fn find_within(program: Option<&Path>, patience: Duration) -> anyhow::Result<Self> {
        let program = program.unwrap_or(Path::new("ffmpeg"));
        let unusable = |reason| unusable(program, reason);
        let mut command = Command::new(program);
        command.args(["-hide_banner", "-encoders"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let listing = match Helper::spawn(&mut command) {
            Ok(listing) => listing,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                bail!("no ffmpeg found (looked for `{}`)", program.display());
            }
            Err(error) => return Err(unusable(&error.to_string())),
        };
        let (_, stdout, stderr) = listing.pipes();
        let (listed, said) = (Heard::of(stdout, LISTING_BYTES), Heard::of(stderr, KEPT_BYTES));
        let Some(status) = listing.wait(patience) else {
            listing.kill();
            let seconds = patience.as_secs_f64();
            return Err(unusable(&format!("it did not list its encoders within {seconds} s")));
        };
        if !status.success() {
            return Err(unusable(&format!("{} ({status})", last_lines(&said.text()))));
        }
        let listed = listed.text();
        let text = String::from_utf8_lossy(&listed);
        // A line of the list: " V....D libx264    libx264 H.264 / AVC …".
        let has = |name| text.lines().any(|line| line.split_whitespace().nth(1) == Some(name));
        let encoder = match (has("libx264"), has("mpeg4")) {
            (true, _) => X264,
            (false, true) => MPEG4,
            (false, false) => {
                bail!("`{}`: expected the encoder libx264 or mpeg4, found neither", program.display())
            }
        };
        Ok(Self { program: program.to_owned(), encoder, patience: PATIENCE })
    }
}

/// Writer of an MP4, frame by frame. The file appears only when [`finish`](Self::finish) succeeds.
/// If the writer is dropped before `finish`, ffmpeg is killed and no file remains.
#[derive(Debug)]
pub struct Mp4Writer {
    ffmpeg: Ffmpeg,
    helper: Helper,
    /// Standard input of ffmpeg; closed after the last frame.
    stdin: Option<ChildStdin>,
    messages: Heard,
    /// File that is being written; `None` once it has its final name.
    file: Option<AtomicFile>,
    size: (usize, usize),
    written: usize,
}

impl Mp4Writer {
    /// Starts ffmpeg for frames of `width` × `height` pixels; `fps`: frames per second. If `width` or `height` is odd,
    /// the last column or row is repeated, because 4:2:0 chroma needs even numbers.
    pub fn create(
        ffmpeg: &Ffmpeg,
        path: impl AsRef<Path>,
        width: usize,
        height: usize,
        fps: f64,
    ) -> anyhow::Result<Self> {
        /// The largest side that H.264 allows, pixels.
        const LIMIT: usize = 16_384;
        check_rate(fps)?;
        if width == 0 || height == 0 || width > LIMIT || height > LIMIT {
            return Err(wrong_size("MP4", (width, height), LIMIT));
        }
        let file = AtomicFile::create(path)?;
        let mut command = Command::new(&ffmpeg.program);
        command.args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        command.arg("-s").arg(format!("{}x{}", even(width), even(height)));
        command.arg("-r").arg(fps.to_string()).args(["-i", "-"]);
        command.args(["-vf", "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_int"]);
        command.args(["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"]);
        command.args(ffmpeg.encoder);
        command.arg("-metadata").arg(format!("comment={MARK}"));
        command.args(["-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4"]);
        // `file:` keeps ffmpeg from reading a colon in the name as a protocol, or a leading dash as an option.
        let mut place = OsString::from("file:");
        place.push(file.place());
        command.arg(place).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        let helper =
            Helper::spawn(&mut command).map_err(|error| unusable(&ffmpeg.program, &error.to_string()))?;
        let (stdin, _, stderr) = helper.pipes();
        let messages = Heard::of(stderr, KEPT_BYTES);
        let (ffmpeg, size) = (ffmpeg.clone(), (width, height));
        Ok(Self { ffmpeg, helper, stdin, messages, file: Some(file), size, written: 0 })
    }

    pub fn push(&mut self, frame: &Picture) -> anyhow::Result<()> {
        check_size(self.written, frame, self.size)?;
        let bytes = even_rgb8(frame);
        let Some(stdin) = &mut self.stdin else { return Err(self.failure()) };
        match self.helper.feed(stdin, &bytes, self.ffmpeg.patience) {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::TimedOut => {
                return Err(self.hangs("took nothing of a frame"));
            }
            Err(_) => return Err(self.failure()),
        }
        self.written += 1;
        Ok(())
    }

    /// Waits for ffmpeg to end, then gives the file its final name. Fails if ffmpeg fails, or if there was no frame.
    pub fn finish(mut self) -> anyhow::Result<()> {
        if self.written == 0 {
            bail!(NO_FRAMES);
        }
        drop(self.stdin.take());
        let Some(ended) = self.wait() else {
            return Err(self.hangs("wrote nothing after its last frame, and did not end,"));
        };
        let wrote = self.file.as_ref().is_some_and(|file| {
            fs::metadata(file.place()).is_ok_and(|metadata| !metadata.is_file() || metadata.len() > 0)
        });
        if !(wrote && ended.success()) {
            return Err(self.failure());
        }
        match self.file.take() {
            Some(file) => Ok(file.commit()?),
            None => Ok(()),
        }
    }

    /// Waits for ffmpeg to end; `None` if its output file has not changed for `ffmpeg.patience`. After the last frame,
    /// ffmpeg moves the index to the start of the file, which takes long for a long video.
    fn wait(&self) -> Option<ExitStatus> {
        /// Time between two checks whether ffmpeg has changed its output file, and so still works.
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

    fn path(&self) -> PathBuf {
        self.file.as_ref().map_or_else(PathBuf::new, |file| file.path().to_owned())
    }

    /// Waits [`LAST_WORDS`] for a failed ffmpeg to exit, else kills it. Returns an error with ffmpeg's last messages.
    fn failure(&mut self) -> anyhow::Error {
        drop(self.stdin.take());
        let status = self.helper.wait(LAST_WORDS).or_else(|| self.helper.kill());
        anyhow!(
            "`{}` could not write {}: {} ({})",
            self.ffmpeg.program.display(),
            self.path().display(),
            last_lines(&self.messages.text()),
            status.map_or_else(|| "no status".to_owned(), |status| status.to_string())
        )
    }

    fn hangs(&mut self, why: &'static str) -> anyhow::Error {
        self.helper.kill();
        anyhow!(
            "`{}` hangs and was ended: it {why} for {} s; {} is not written: {}",
            self.ffmpeg.program.display(),
            self.ffmpeg.patience.as_secs_f64(),
            self.path().display(),
            last_lines(&self.messages.text())
        )
    }
}

fn unusable(program: &Path, reason: &str) -> anyhow::Error {
    anyhow!("`{}` cannot be used as ffmpeg: {reason}", program.display())
}

fn even(side: usize) -> usize {
    side.next_multiple_of(2)
}

/// Returns the RGB bytes of a frame; if its width or height is odd, the last column or row is repeated.
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
