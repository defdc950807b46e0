//! COLMAP's binary files: little-endian numbers without padding.
//!
//! Files are read from beginning to end. No stated number of items is trusted: memory is allocated only for bytes read.

use super::model::{Camera, Kind};
use super::{Encoding, Model, NO_POINT, Points, Registered};
use crate::data::DatasetError;
use crate::system::input::open_regular;
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read, sink};
use std::path::{Path, PathBuf};

/// Maximum length of a photograph's name, bytes: the maximum length of a path on Linux.
const MAX_NAME: usize = 4096;

struct Bytes {
    file: PathBuf,
    stream: BufReader<File>,
    at: u64,
}

impl Bytes {
    fn open(file: &Path) -> Result<Self, DatasetError> {
        let stream = open_regular(file).map_err(|source| DatasetError::io(file, source))?;
        Ok(Self { file: file.into(), stream: BufReader::with_capacity(1 << 16, stream), at: 0 })
    }

    fn value(&self, field: &str, expected: impl Into<String>, found: impl Into<String>) -> DatasetError {
        let place = format!("{field} (byte {})", self.at);
        DatasetError::value(&self.file, place, expected.into(), found.into())
    }

    fn cut(&self, field: &str, bytes: u64, error: &std::io::Error) -> DatasetError {
        if error.kind() == std::io::ErrorKind::UnexpectedEof {
            return self.value(field, format!("{bytes} more bytes"), "the end of the file");
        }
        self.value(field, format!("{bytes} more bytes"), error.to_string())
    }

    fn array<const N: usize>(&mut self, field: &str) -> Result<[u8; N], DatasetError> {
        let mut bytes = [0; N];
        self.stream.read_exact(&mut bytes).map_err(|error| self.cut(field, N as u64, &error))?;
        self.at += N as u64;
        Ok(bytes)
    }

    fn u64(&mut self, field: &str) -> Result<u64, DatasetError> {
        self.array(field).map(u64::from_le_bytes)
    }

    fn u32(&mut self, field: &str) -> Result<u32, DatasetError> {
        self.array(field).map(u32::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self, field: &str) -> Result<[f64; N], DatasetError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = f64::from_le_bytes(self.array(field)?);
        }
        Ok(numbers)
    }

    fn skip(&mut self, field: &str, count: u64, size: u64) -> Result<(), DatasetError> {
        if let Some(bytes) = count.checked_mul(size) {
            let read = std::io::copy(&mut self.stream.by_ref().take(bytes), &mut sink())
                .map_err(|error| self.cut(field, bytes, &error))?;
            if read == bytes {
                self.at += bytes;
                return Ok(());
            }
        }
        Err(self.value(field, format!("{count} times {size} more bytes"), "the end of the file"))
    }

    /// Reads a name of at most [`MAX_NAME`] bytes, which ends with a zero byte. `field`: name of the field in errors.
    fn name(&mut self, field: &str) -> Result<String, DatasetError> {
        let mut name = Vec::new();
        loop {
            match self.array::<1>(field)? {
                [0] => break,
                [byte] if name.len() < MAX_NAME => name.push(byte),
                _ => return Err(self.value(field, format!("at most {MAX_NAME} bytes and a zero"), "more")),
            }
        }
        String::from_utf8(name).map_err(|_| self.value(field, "UTF-8", "other bytes"))
    }

    fn end(mut self) -> Result<(), DatasetError> {
        let mut byte = [0];
        match self.stream.read(&mut byte) {
            Ok(0) => Ok(()),
            Ok(_) => Err(self.value("its end", "no more bytes than its counts say", "more")),
            Err(source) => Err(DatasetError::Io { path: self.file, source }),
        }
    }
}

/// Reads the number of photographs that an images.bin states.
pub(crate) fn count(file: &Path) -> Result<u64, DatasetError> {
    Bytes::open(file)?.u64("number of photographs")
}

pub(crate) fn model(folder: &Path) -> Result<Model, DatasetError> {
    let cameras = cameras(&Encoding::Binary.file(folder, "cameras"))?;
    let images = images(&Encoding::Binary.file(folder, "images"))?;
    Ok(Model { cameras, images })
}

fn cameras(file: &Path) -> Result<HashMap<u32, Camera>, DatasetError> {
    let mut bytes = Bytes::open(file)?;
    let mut cameras = HashMap::new();
    for index in 0..bytes.u64("number of cameras")? {
        let field = |what: &str| format!("camera number {index}, {what}");
        let number = bytes.u32(&field("id"))?;
        let id = i32::from_le_bytes(bytes.array(&field("model"))?);
        // An unknown camera model cannot be skipped: the length of its parameters is not known.
        let kind = Kind::by_id(id)
            .ok_or_else(|| bytes.value(&field("model"), "the number of a model, 0 to 17", id.to_string()))?;
        let (width, height) = (bytes.u64(&field("width"))?, bytes.u64(&field("height"))?);
        let mut parameter = |_| bytes.f64s(&field("parameters")).map(|[value]| value);
        let parameters = (0..kind.parameters).map(&mut parameter).collect::<Result<_, _>>()?;
        cameras.extend(Camera::new(kind, width, height, parameters).map(|camera| (number, camera)));
    }
    if cameras.is_empty() {
        return Err(bytes.value("number of cameras", "at least one", "none"));
    }
    bytes.end()?;
    Ok(cameras)
}

fn images(file: &Path) -> Result<Vec<Registered>, DatasetError> {
    let mut bytes = Bytes::open(file)?;
    let mut images = Vec::new();
    for index in 0..bytes.u64("number of photographs")? {
        let field = |what: &str| format!("photograph number {index}, {what}");
        bytes.u32(&field("id"))?;
        let rotation = bytes.f64s(&field("quaternion"))?;
        let translation = bytes.f64s(&field("translation"))?;
        let camera = bytes.u32(&field("camera"))?;
        let name = bytes.name(&field("name"))?;
        let (mut key_points, of_points) = (Vec::new(), field("points"));
        for _ in 0..bytes.u64(&field("number of points"))? {
            let (at, number) = (bytes.f64s(&of_points)?, bytes.u64(&of_points)?);
            if number != NO_POINT {
                key_points.push((at, number));
            }
        }
        images.push(Registered { name, camera, rotation, translation, key_points });
    }
    if images.is_empty() {
        return Err(bytes.value("number of photographs", "at least one", "none"));
    }
    bytes.end()?;
    Ok(images)
}

pub(crate) fn points(file: &Path, points: &mut Points) -> Result<(), DatasetError> {
    let mut bytes = Bytes::open(file)?;
    for index in 0..bytes.u64("number of points")? {
        let field = format!("point number {index}");
        let number = bytes.u64(&field)?;
        let position = bytes.f64s(&field)?;
        // Skips the colour.
        bytes.array::<3>(&field)?;
        let [error] = bytes.f64s(&field)?;
        let track = bytes.u64(&field)?;
        bytes.skip(&field, track, 8)?;
        points.push(number, position, error, track)?;
    }
    bytes.end()
}
