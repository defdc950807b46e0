//! Arrays from an untrusted `.npz` or `.npy`.
//!
//! The array headers are parsed here, not by the crate npyz, which multiplies the sides of a shape without a check for
//! overflow and allocates what a header claims. This module allocates memory only for bytes that were read.

use crate::data::DatasetError;
use crate::data::cameras::pose::{BOTTOM_ROW, bottom_row_fault};
use crate::system::input::open_regular;
use std::fmt::Display;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use zip::ZipArchive;

pub(crate) struct Archive {
    pub(crate) file: PathBuf,
    zip: ZipArchive<BufReader<File>>,
    max_array_bytes: u64,
}

/// One array in C order (last index fastest).
pub(crate) struct Array {
    pub(crate) shape: Vec<usize>,
    dtype: Dtype,
    data: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Dtype {
    kind: u8,
    size: usize,
    big_endian: bool,
}

/// Default size limit of an unpacked array, bytes.
const MAX_ARRAY: u64 = 4 << 30;
/// Longest array header that is read, bytes; numpy usually writes 128.
const MAX_HEADER: usize = 1 << 16;
/// Maximum number of dimensions of an array: numpy's own limit.
const MAX_DIMENSIONS: usize = 32;
const NUMBERS: &str = "f2, f4, f8, b1 or a plain integer";

impl Archive {
    pub(crate) fn open(file: &Path, max_array_bytes: Option<u64>) -> Result<Self, DatasetError> {
        let stream = open_regular(file).map_err(|source| DatasetError::io(file, source))?;
        let zip = ZipArchive::new(BufReader::new(stream))
            .map_err(|error| not_an_archive(file, format!("damage or another format ({error})")))?;
        Ok(Self { file: file.into(), zip, max_array_bytes: max_array_bytes.unwrap_or(MAX_ARRAY) })
    }

    /// Returns the names of the arrays in the order of the archive; a name that occurs twice is listed twice.
    pub(crate) fn names(&mut self) -> Result<Vec<String>, DatasetError> {
        let mut names = Vec::new();
        for index in 0..self.zip.len() {
            let entry = self.zip.by_index_raw(index);
            let entry = entry.map_err(|error| not_an_archive(&self.file, format!("damage ({error})")))?;
            names.extend(entry.name().strip_suffix(".npy").map(str::to_owned));
        }
        Ok(names)
    }

    pub(crate) fn has(&self, key: &str) -> bool {
        self.zip.file_names().any(|name| name.strip_suffix(".npy") == Some(key))
    }

    pub(crate) fn array(&mut self, key: &str) -> Result<Array, DatasetError> {
        if !self.has(key) {
            let mut present = self.names()?;
            present.sort();
            let fault = format!("expected an array named `{key}`, found only [{}]", present.join(", "));
            return Err(DatasetError::fault(&self.file, fault));
        }
        let (file, limit) = (self.file.clone(), self.max_array_bytes);
        let entry = self.zip.by_name(&format!("{key}.npy"));
        let mut entry = entry.map_err(|error| fault(&file, key, "a readable zip entry", error))?;
        read_array(&mut entry, &file, key, limit)
    }

    /// Reads the only element of the array `key`, as f64. An array with another number of elements is an error.
    pub(crate) fn scalar(&mut self, key: &str) -> Result<f64, DatasetError> {
        let array = self.array(key)?;
        match array.data.len() / array.dtype.size {
            1 => self.numbers(key, &array).map(|numbers| numbers[0]),
            _ => Err(self.shape_error(key, "()", &array)),
        }
    }

    /// Reads the array `key` as row-major camera-to-world matrices. Its shape must be `[n, 3, 4]` or `[n, 4, 4]`. A
    /// fourth row must be 0 0 0 1, and is not returned.
    pub(crate) fn matrices(&mut self, key: &str) -> Result<Vec<[[f64; 4]; 3]>, DatasetError> {
        let array = self.array(key)?;
        let &[_, rows @ (3 | 4), 4] = array.shape.as_slice() else {
            return Err(self.shape_error(key, "[n, 4, 4] or [n, 3, 4]", &array));
        };
        let numbers = self.numbers(key, &array)?;
        for (index, matrix) in numbers.chunks_exact(rows * 4).enumerate() {
            let rows: Vec<&[f64]> = matrix.chunks_exact(4).collect();
            if let Some(found) = bottom_row_fault(&rows) {
                let place = format!("view `{key}[{index}]`");
                return Err(DatasetError::value(&self.file, place, BOTTOM_ROW, found));
            }
        }
        Ok(numbers
            .chunks_exact(rows * 4)
            .map(|m| std::array::from_fn(|i| std::array::from_fn(|j| m[4 * i + j])))
            .collect())
    }

    fn numbers(&self, key: &str, array: &Array) -> Result<Vec<f64>, DatasetError> {
        array.numbers().ok_or_else(|| self.dtype_error(key, NUMBERS, array))
    }

    pub(crate) fn dtype_error(&self, key: &str, expected: &str, array: &Array) -> DatasetError {
        fault(&self.file, key, format!("dtype {expected}"), array.dtype.name())
    }

    pub(crate) fn shape_error(&self, key: &str, expected: &str, array: &Array) -> DatasetError {
        fault(&self.file, key, format!("shape {expected}"), format!("{:?}", array.shape))
    }
}

fn not_an_archive(file: &Path, found: String) -> DatasetError {
    DatasetError::fault(file, format!("expected a whole .npz (zip) archive, found {found}"))
}

pub(crate) fn fault(file: &Path, key: &str, expected: impl Display, found: impl Display) -> DatasetError {
    DatasetError::value(file, format!("array `{key}`"), expected, found)
}

/// Reads the array of a `.npy` file; error messages name the array by the file's stem.
pub(crate) fn read_npy(file: &Path, max_array_bytes: Option<u64>) -> Result<Array, DatasetError> {
    let stream = open_regular(file).map_err(|source| DatasetError::io(file, source))?;
    let key = file.file_stem().unwrap_or_default().to_string_lossy();
    read_array(&mut BufReader::new(stream), file, &key, max_array_bytes.unwrap_or(MAX_ARRAY))
}

fn read_array(stream: &mut impl Read, file: &Path, key: &str, limit: u64) -> Result<Array, DatasetError> {
    let bad = |expected: &str, found: String| fault(file, key, expected, found);
    let (dtype, fortran, shape) =
        read_header(stream).map_err(|found| bad("a .npy header of plain numbers", found))?;
    let too_large = |bytes: u64| fault(file, key, format!("at most {limit} bytes"), bytes);
    let bytes = shape
        .iter()
        .try_fold(dtype.size, |bytes, &side| bytes.checked_mul(side))
        .ok_or_else(|| too_large(u64::MAX))?;
    if bytes as u64 > limit {
        return Err(too_large(bytes as u64));
    }
    let whole = format!("{bytes} bytes for shape {shape:?}");
    let mut data = Vec::new();
    // Reads one byte more than announced, to notice trailing data; the buffer grows with the bytes that arrive.
    let read = stream.take(bytes as u64 + 1).read_to_end(&mut data);
    read.map_err(|error| bad(&whole, format!("{} bytes, then: {error}", data.len())))?;
    if data.len() != bytes {
        let found = if data.len() > bytes { "more".into() } else { data.len().to_string() };
        return Err(bad(&whole, found));
    }
    let data = if fortran { to_c_order(&data, &shape, dtype.size) } else { data };
    Ok(Array { shape, dtype, data })
}

impl Array {
    /// Returns the display values of `count` elements from index `start` on, as bytes. Elements of type u8 are
    /// unchanged; floats are scaled by 255 and rounded. `Some(Err(value))` if a float is NaN or outside [0, 1] by more
    /// than 0.01. `None` for another dtype.
    pub(crate) fn display_bytes(&self, start: usize, count: usize) -> Option<Result<Vec<u8>, f64>> {
        let size = self.dtype.size;
        let bytes = &self.data[start * size..(start + count) * size];
        match (self.dtype.kind, size) {
            (b'u', 1) => Some(Ok(bytes.to_vec())),
            (b'f', _) => {
                let to_byte = |chunk| {
                    let value = self.dtype.value(chunk).unwrap_or(f64::NAN);
                    // Tolerance for resampled pictures, which overshoot a little.
                    let fits = (-0.01..=1.01).contains(&value);
                    if fits { Ok((value * 255.0).round().clamp(0.0, 255.0) as u8) } else { Err(value) }
                };
                Some(bytes.chunks_exact(size).map(to_byte).collect())
            }
            _ => None,
        }
    }

    pub(crate) fn is_float(&self) -> bool {
        self.dtype.kind == b'f'
    }

    /// Returns the elements in C order, booleans as 0 and 1; `None` if the dtype is not a number.
    pub(crate) fn numbers(&self) -> Option<Vec<f64>> {
        self.data.chunks_exact(self.dtype.size).map(|chunk| self.dtype.value(chunk)).collect()
    }
}

impl Dtype {
    /// Parses numpy's name of a dtype, such as `<f4`; `None` if it is not supported.
    fn parse(name: &str) -> Option<Self> {
        let &[order, kind @ (b'u' | b'i' | b'f' | b'b'), ref digits @ ..] = name.as_bytes() else {
            return None;
        };
        let big_endian = match order {
            b'<' | b'|' | b'=' => false,
            b'>' => true,
            _ => return None,
        };
        let size = match (kind, digits) {
            (b'u' | b'i' | b'b', b"1") => 1,
            (b'u' | b'i' | b'f', b"2") => 2,
            (b'u' | b'i' | b'f', b"4") => 4,
            (b'u' | b'i' | b'f', b"8") => 8,
            _ => return None,
        };
        Some(Self { kind, size, big_endian })
    }

    fn name(self) -> String {
        format!("{}{}", self.kind as char, self.size)
    }

    /// Returns the number in the bytes `chunk`; integers beyond 2^53 are rounded. `None` if the dtype is not a number.
    fn value(self, chunk: &[u8]) -> Option<f64> {
        let mut bytes = [0u8; 8];
        bytes[..self.size].copy_from_slice(chunk);
        if self.big_endian {
            bytes[..self.size].reverse();
        }
        let bits = u64::from_le_bytes(bytes);
        let unused = 64 - 8 * self.size as u32;
        match (self.kind, self.size) {
            (b'u', _) => Some(bits as f64),
            (b'b', _) => Some(f64::from(u8::from(bits != 0))),
            (b'i', _) => Some(((bits << unused) as i64 >> unused) as f64),
            (b'f', 2) => Some(half::f16::from_bits(bits as u16).to_f64()),
            (b'f', 4) => Some(f64::from(f32::from_bits(bits as u32))),
            (b'f', 8) => Some(f64::from_bits(bits)),
            _ => None,
        }
    }
}

/// Reads a `.npy` header: dtype, whether in Fortran order, and shape.
fn read_header(stream: &mut impl Read) -> Result<(Dtype, bool, Vec<usize>), String> {
    let mut start = [0u8; 10];
    stream.read_exact(&mut start).map_err(|error| error.to_string())?;
    if &start[..6] != b"\x93NUMPY" {
        return Err("another magic number".into());
    }
    let mut length = usize::from(u16::from_le_bytes([start[8], start[9]]));
    if start[6] > 1 {
        let mut high = [0u8; 2];
        stream.read_exact(&mut high).map_err(|error| error.to_string())?;
        length |= usize::from(u16::from_le_bytes(high)) << 16;
    }
    if !(1..=3).contains(&start[6]) || length > MAX_HEADER {
        return Err(format!("version {}, header of {length} bytes", start[6]));
    }
    let mut text = vec![0u8; length];
    stream.read_exact(&mut text).map_err(|error| error.to_string())?;
    let text = String::from_utf8(text).map_err(|error| error.to_string())?;
    parse_header(&text).ok_or_else(|| format!("{:?}", text.trim_end()))
}

/// Parses a header dictionary as numpy writes it: dtype, whether in Fortran order, and shape; `None` if malformed.
fn parse_header(text: &str) -> Option<(Dtype, bool, Vec<usize>)> {
    let after = |key: &str| text.split_once(&format!("'{key}':")).map(|(_, rest)| rest.trim_start());
    let dtype = Dtype::parse(after("descr")?.strip_prefix('\'')?.split_once('\'')?.0)?;
    let order = after("fortran_order")?;
    let fortran = order.starts_with("True");
    if !fortran && !order.starts_with("False") {
        return None;
    }
    let (sides, _) = after("shape")?.strip_prefix('(')?.split_once(')')?;
    let sides = sides.split(',').map(str::trim).filter(|side| !side.is_empty());
    let shape: Vec<usize> = sides.map(|side| side.parse().ok()).collect::<Option<_>>()?;
    (shape.len() <= MAX_DIMENSIONS).then_some((dtype, fortran, shape))
}

/// Reorders the elements of an array, `size` bytes each, from Fortran order (first index fastest) to C order.
fn to_c_order(data: &[u8], shape: &[usize], size: usize) -> Vec<u8> {
    let mut strides = Vec::with_capacity(shape.len());
    let mut stride = size;
    for side in shape {
        strides.push(stride);
        stride *= side;
    }
    let mut sorted = Vec::with_capacity(data.len());
    let mut index = vec![0usize; shape.len()];
    while sorted.len() < data.len() {
        let at: usize = index.iter().zip(&strides).map(|(i, stride)| i * stride).sum();
        sorted.extend_from_slice(&data[at..at + size]);
        for (i, side) in index.iter_mut().zip(shape).rev() {
            *i += 1;
            if *i < *side {
                break;
            }
            *i = 0;
        }
    }
    sorted
}
