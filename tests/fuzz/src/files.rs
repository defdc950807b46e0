//! Files of the formats that are imported, whole or spoilt.

use arbitrary::{Result, Unstructured};
use std::fmt::Write;

/// A folder in memory, which ends with the process.
pub fn folder() -> tempfile::TempDir {
    let shared = std::path::Path::new("/dev/shm");
    if shared.is_dir() { tempfile::tempdir_in(shared) } else { tempfile::tempdir() }.expect("a folder")
}

/// A tensor to be written; its shape may be a lie.
pub struct Named {
    pub name: String,
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

impl Named {
    /// A tensor of this shape, its values around `value`.
    pub fn new(name: String, shape: &[usize], value: f32) -> Self {
        let count = shape.iter().product();
        let values = (0..count).map(|i| value * ((i * 7 % 11) as f32 - 5.0)).collect();
        Self { name, shape: shape.into(), values }
    }

    /// Its values as `f2`, `f4` or `f8` would have them.
    fn bytes(&self, size: usize) -> Vec<u8> {
        let each = |value: &f32| match size {
            8 => f64::from(*value).to_le_bytes().to_vec(),
            4 => value.to_le_bytes().to_vec(),
            _ => ((value.to_bits() >> 16) as u16).to_le_bytes().to_vec(),
        };
        self.values.iter().flat_map(each).collect()
    }
}

/// One `.npy`: header and data.
pub fn npy(descr: &str, fortran: bool, shape: &[usize], data: &[u8]) -> Vec<u8> {
    let sides: String = shape.iter().map(|side| format!("{side},")).collect();
    let order = if fortran { "True" } else { "False" };
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': ({sides}), }}");
    while (text.len() + 11) % 64 != 0 {
        text.push(' ');
    }
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.extend(data);
    bytes
}

/// A zip archive of stored entries.
pub fn zip(entries: &[(String, Vec<u8>)]) -> Vec<u8> {
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let (mut bytes, mut directory) = (Vec::new(), Vec::new());
    for (name, data) in entries {
        let mut common = [20u16, 0, 0, 0, 0x21].map(u16::to_le_bytes).concat();
        common.extend(crc.checksum(data).to_le_bytes());
        common.extend((data.len() as u32).to_le_bytes());
        common.extend((data.len() as u32).to_le_bytes());
        common.extend((name.len() as u16).to_le_bytes());
        common.extend(0u16.to_le_bytes());
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&common);
        directory.extend([0; 10]);
        directory.extend((bytes.len() as u32).to_le_bytes());
        directory.extend(name.as_bytes());
        bytes.extend(b"PK\x03\x04");
        bytes.extend(common);
        bytes.extend(name.as_bytes());
        bytes.extend(data);
    }
    let (at, count) = (bytes.len() as u32, entries.len() as u16);
    bytes.extend(&directory);
    bytes.extend(b"PK\x05\x06\0\0\0\0");
    bytes.extend([count, count].map(u16::to_le_bytes).concat());
    bytes.extend([directory.len() as u32, at].map(u32::to_le_bytes).concat());
    bytes.extend([0; 2]);
    bytes
}

/// Flips bytes here and there, and cuts the end off, in one file of four.
pub fn spoil(mut bytes: Vec<u8>, u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
    if u.ratio(1, 4)? && !bytes.is_empty() {
        for _ in 0..u.int_in_range(1..=6u8)? {
            let at = u.choose_index(bytes.len())?;
            bytes[at] = u.arbitrary()?;
        }
        if u.ratio(1, 4)? {
            bytes.truncate(u.choose_index(bytes.len())?);
        }
    }
    Ok(bytes)
}

/// A `.npz` of the tensors.
pub fn npz(tensors: &[Named], u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
    let size = *u.choose(&[4usize, 4, 8, 2])?;
    let descr = if u.ratio(1, 16)? { "<i4".into() } else { format!("<f{size}") };
    let fortran = u.ratio(1, 8)?;
    let entry = |tensor: &Named| {
        (format!("{}.npy", tensor.name), npy(&descr, fortran, &tensor.shape, &tensor.bytes(size)))
    };
    spoil(zip(&tensors.iter().map(entry).collect::<Vec<_>>()), u)
}

/// A `.safetensors` of the tensors.
pub fn safetensors(tensors: &[Named], u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
    let size = *u.choose(&[4usize, 4, 8, 2])?;
    let dtype = match size {
        8 => "F64",
        4 => "F32",
        _ => *u.choose(&["F16", "BF16"])?,
    };
    let (mut header, mut data) = (String::from("{"), Vec::new());
    for (i, tensor) in tensors.iter().enumerate() {
        let bytes = tensor.bytes(size);
        let (start, end) = (data.len(), data.len() + bytes.len());
        let comma = if i == 0 { "" } else { "," };
        let (name, shape) = (&tensor.name, &tensor.shape);
        let _ = write!(
            header,
            "{comma}{name:?}:{{\"dtype\":\"{dtype}\",\"shape\":{shape:?},\"data_offsets\":[{start},{end}]}}"
        );
        data.extend(bytes);
    }
    header.push('}');
    while header.len() % 8 != 0 {
        header.push(' ');
    }
    let length = if u.ratio(1, 32)? { u.arbitrary()? } else { header.len() as u64 };
    let mut bytes = length.to_le_bytes().to_vec();
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    spoil(bytes, u)
}
