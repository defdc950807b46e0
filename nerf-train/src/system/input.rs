//! Reading of whole files, each up to a size limit. All whole files are read here.
//!
//! A path on the command line may name an endless device, a pipe, a growing file or a huge sparse file. Reading here
//! fails with an error that states the limit, before memory runs out. Archives (`.npz`) and arrays (`.npy`) are not
//! read whole: `data::layouts::npz` limits each array. The kernel's files under `/proc` are read elsewhere.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::str::FromStr;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

/// Size limit of a scene file, bytes: twice the size of the largest grid tables of the format (2^27 f16 values).
pub const MAX_BLOB_BYTES: u64 = 512 << 20;
/// Size limit of a JSON file, bytes: enough for about 400,000 frames of a `transforms.json`.
pub const MAX_JSON_BYTES: u64 = 256 << 20;
pub const MAX_TOML_BYTES: u64 = 1 << 20;
/// Size limit of an image file, bytes: more than 16,384² uncompressed pixels of three bytes.
pub const MAX_PICTURE_BYTES: u64 = 1 << 30;
/// Size limit of a checkpoint, bytes: above the size of any checkpoint that this program writes.
pub const MAX_CHECKPOINT_BYTES: u64 = 3 << 30;

/// Longest wait for a byte from a pipe or device, the first byte included. After this time, reading fails.
const MAX_SILENCE: Duration = Duration::from_secs(60);
const PIECE_BYTES: usize = 1 << 16;

/// Returns the bytes of a file, pipe or device; more than `limit` bytes are an error.
///
/// A pipe or device is read only once: a second read may find no bytes. Reading stops soon after `limit`, with
/// [`io::ErrorKind::FileTooLarge`], or with [`io::ErrorKind::TimedOut`] if a pipe or device sends nothing for a minute.
/// No error names the file: the caller has to add the name.
pub fn read_limited(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let metadata = std::fs::metadata(path)?;
    if !metadata.is_file() && !metadata.is_dir() {
        return read_stream(path, limit, MAX_SILENCE);
    }
    if metadata.is_file() && metadata.len() > limit {
        return Err(too_large(limit, &format!("{} bytes", metadata.len())));
    }
    read_to_limit(File::open(path)?, limit)
}

/// Returns the bytes of a file as [`read_limited`] does; a pipe or device is an error.
pub fn read_regular(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    drop(open_regular(path)?);
    read_limited(path, limit)
}

/// Returns the name of `choice` as it is written on the command line.
pub fn value_name(choice: &impl clap::ValueEnum) -> String {
    choice.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

/// Parses exactly `N` numbers separated by commas; any other text is an error.
pub fn parse_numbers<const N: usize, T: FromStr>(text: &str) -> Result<[T; N], String> {
    let numbers: Option<Vec<T>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    let numbers = numbers.and_then(|numbers| numbers.try_into().ok());
    numbers.ok_or_else(|| format!("expected {N} numbers with commas between them"))
}

/// Returns the UTF-8 text of a file of at most `limit` bytes, without a leading byte order mark.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    let mut bytes = read_limited(path, limit)?;
    let mark = bytes.len() - without_mark(&bytes).len();
    bytes.drain(..mark);
    String::from_utf8(bytes).map_err(|error| {
        let found = error.utf8_error().valid_up_to() + mark;
        io::Error::new(io::ErrorKind::InvalidData, format!("expected UTF-8, found another byte at {found}"))
    })
}

/// Returns `bytes` without a leading UTF-8 byte order mark.
pub fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// Opens a file for random access. A device, or a pipe, which could block, is [`io::ErrorKind::InvalidInput`].
pub fn open_regular(path: &Path) -> io::Result<File> {
    let metadata = std::fs::metadata(path)?;
    if metadata.is_file() || metadata.is_dir() {
        return File::open(path);
    }
    let text = "expected a file that can be read in any order, found a pipe or device";
    Err(io::Error::new(io::ErrorKind::InvalidInput, text))
}

/// Returns a TOML error's message on one line, with line and column in `text`. The parser's message has several lines.
pub fn toml_message(text: &str, error: &toml::de::Error) -> String {
    let said = error.message().lines().map(str::trim).collect::<Vec<_>>().join("; ");
    let Some(before) = error.span().and_then(|span| text.get(..span.start)) else {
        // The error has no position if its value was merged from several texts. Its own text then names the tables.
        return error.to_string().lines().map(str::trim).collect::<Vec<_>>().join(" ").trim().to_owned();
    };
    let start = before.rfind('\n').map_or(0, |end| end + 1);
    let (row, column) = (before.matches('\n').count() + 1, before[start..].chars().count() + 1);
    let shown: String = text[start..].lines().next().unwrap_or_default().chars().take(80).collect();
    format!("line {row}, column {column}: {said} (in `{}`)", shown.trim())
}

/// Reads at most `limit` bytes of a pipe or device. More bytes, or a wait of `silence` without a byte, are an error.
/// Another thread opens and reads, because both may block. A blocked thread ends with the process.
fn read_stream(path: &Path, limit: u64, silence: Duration) -> io::Result<Vec<u8>> {
    let (sender, pieces) = mpsc::sync_channel::<io::Result<Vec<u8>>>(16);
    let path = path.to_owned();
    std::thread::Builder::new().name("pipe".into()).spawn(move || {
        let mut file = match File::open(path) {
            Ok(file) => file,
            Err(error) => return drop(sender.send(Err(error))),
        };
        let mut piece = vec![0; PIECE_BYTES];
        loop {
            let read = match file.read(&mut piece) {
                Ok(0) => return,
                Ok(count) => Ok(piece[..count].to_vec()),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => Err(error),
            };
            let failed = read.is_err();
            // Fails if the receiver has given up: at the limit, or after a timeout.
            if sender.send(read).is_err() || failed {
                return;
            }
        }
    })?;
    let mut bytes = Vec::new();
    loop {
        match pieces.recv_timeout(silence) {
            Ok(piece) => bytes.extend(piece?),
            Err(RecvTimeoutError::Disconnected) => return Ok(bytes),
            Err(RecvTimeoutError::Timeout) => {
                let text = format!(
                    "expected a pipe that somebody writes, found none: {} bytes, then nothing for {} s",
                    bytes.len(),
                    silence.as_secs_f64()
                );
                return Err(io::Error::new(io::ErrorKind::TimedOut, text));
            }
        }
        if bytes.len() as u64 > limit {
            return Err(too_large(limit, "more"));
        }
    }
}

/// Reads a file; fails beyond `limit` bytes, as the file may have grown since its size was checked.
fn read_to_limit(file: File, limit: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let length = file.metadata()?.len().min(limit) as usize;
    bytes.try_reserve_exact(length + 1).map_err(|_| io::Error::from(io::ErrorKind::OutOfMemory))?;
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit { Err(too_large(limit, "more")) } else { Ok(bytes) }
}

fn too_large(limit: u64, found: &str) -> io::Error {
    let limit = match limit {
        limit if limit.is_multiple_of(1 << 30) => format!("{} GiB", limit >> 30),
        limit if limit.is_multiple_of(1 << 20) => format!("{} MiB", limit >> 20),
        limit => format!("{limit} bytes"),
    };
    io::Error::new(io::ErrorKind::FileTooLarge, format!("expected at most {limit}, found {found}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_its_limit_and_no_further() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a");
        std::fs::write(&path, b"\xef\xbb\xbfhello").expect("written");
        assert_eq!(read_limited(&path, 8).expect("whole"), b"\xef\xbb\xbfhello");
        assert_eq!(read_text(&path, 8).expect("text"), "hello");
        let error = read_limited(&path, 7).expect_err("a byte too long");
        assert_eq!(
            (error.kind(), error.to_string().as_str()),
            (io::ErrorKind::FileTooLarge, "expected at most 7 bytes, found 8 bytes")
        );
        std::fs::write(&path, b"a\xff").expect("written");
        assert!(read_text(&path, 8).expect_err("no UTF-8").to_string().contains("another byte at 1"));
        // A sparse file of a terabyte, which uses no disk space.
        File::create(&path).and_then(|file| file.set_len(1 << 40)).expect("a sparse file");
        let error = read_limited(&path, MAX_JSON_BYTES).expect_err("too long").to_string();
        assert_eq!(error, "expected at most 256 MiB, found 1099511627776 bytes");
        assert!(
            read_limited(folder.path(), 8).is_err() && read_limited(&folder.path().join("b"), 8).is_err()
        );
    }

    #[cfg(unix)]
    #[test]
    fn a_device_without_end_and_a_pipe_without_writer_are_given_up() {
        let error = read_limited(Path::new("/dev/zero"), 1 << 20).expect_err("no end").to_string();
        assert_eq!(error, "expected at most 1 MiB, found more");
        assert_eq!(read_limited(Path::new("/dev/null"), 8).expect("empty"), b"");
        assert!(open_regular(Path::new("/dev/zero")).is_err());
        let folder = tempfile::tempdir().expect("a folder");
        let pipe = folder.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo");
        assert!(made.success() && open_regular(&pipe).is_err());
        let error = read_stream(&pipe, 8, Duration::from_millis(50)).expect_err("silence");
        assert!(error.kind() == io::ErrorKind::TimedOut && error.to_string().contains("0 bytes"), "{error}");
    }

    #[test]
    fn errors_of_toml_are_one_line_with_their_place() {
        let text = "seed = 1\n  steps = = 2\n";
        let error = toml::from_str::<toml::Table>(text).expect_err("no TOML");
        let said = toml_message(text, &error);
        assert!(said.starts_with("line 2, column ") && said.ends_with("(in `steps = = 2`)"), "{said}");
        assert!(!said.contains('\n'));
    }
}
