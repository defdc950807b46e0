//! The header of a blob: the 32 bytes before the body. `docs/blob-format.md` specifies the header.

use super::BlobError;
use crate::errors::ensure;
use core::ops::Range;
use crc::{CRC_32_ISO_HDLC, Crc, Table};

/// First bytes of every blob. They contain a line ending, as in PNG: a copy in text mode changes the line ending, and
/// the damaged file is refused.
pub const MAGIC: [u8; 8] = *b"\x89NERF\r\n\x1a";
/// Format version that this build writes, and the only version that it reads: no earlier version was released.
pub const FORMAT_VERSION: u16 = 7;
/// Length of the header, bytes.
pub const HEADER_LEN: usize = 32;

const VERSION: Range<usize> = 8..10;
const ENDIAN: Range<usize> = 10..12;
const FLAGS: Range<usize> = 12..16;
const BODY_LENGTH: Range<usize> = 16..24;
/// Byte range of the CRC-32 (ISO-HDLC) in the header. The CRC covers header and body, with zeros in place of the
/// header's last 8 bytes.
const CHECKSUM: Range<usize> = 24..28;
const RESERVED: Range<usize> = 28..HEADER_LEN;

const ENDIAN_TAG: u16 = 0xfeff;
/// Number of the CRC's tables, 1 KiB each. With 16, a CRC takes a ninth of the time; microcontrollers have one.
const TABLES: usize = if cfg!(target_pointer_width = "64") { 16 } else { 1 };
const CRC: Crc<u32, Table<TABLES>> = Crc::<u32, Table<TABLES>>::new(&CRC_32_ISO_HDLC);

/// Returns the header, with checksum, of a blob whose body has the bytes `body`.
pub(super) fn write(body: &[u8]) -> [u8; HEADER_LEN] {
    let mut header = [0; HEADER_LEN];
    header[..MAGIC.len()].copy_from_slice(&MAGIC);
    header[VERSION].copy_from_slice(&FORMAT_VERSION.to_le_bytes());
    header[ENDIAN].copy_from_slice(&ENDIAN_TAG.to_le_bytes());
    header[BODY_LENGTH].copy_from_slice(&(body.len() as u64).to_le_bytes());
    let crc = checksum(&header, body);
    header[CHECKSUM].copy_from_slice(&crc.to_le_bytes());
    header
}

/// Checks the header of a blob, including the checksum over header and body, and returns the body.
pub(super) fn open(bytes: &[u8]) -> Result<&[u8], BlobError> {
    let found = bytes.len() as u64;
    let magic = bytes.len().min(MAGIC.len());
    ensure!(bytes[..magic] == MAGIC[..magic] && !bytes.is_empty(), BlobError::NotABlob);
    let Some((header, body)) = bytes.split_first_chunk::<HEADER_LEN>() else {
        return Err(BlobError::Truncated { expected: HEADER_LEN as u64, found });
    };
    let endian = u16::from_le_bytes(field(header, ENDIAN));
    ensure!(endian == ENDIAN_TAG, BlobError::Endian { found: endian });
    let version = u16::from_le_bytes(field(header, VERSION));
    ensure!(version == FORMAT_VERSION, BlobError::Version { expected: FORMAT_VERSION, found: version });
    let flags = u32::from_le_bytes(field(header, FLAGS));
    ensure!(flags == 0, BlobError::Flags { found: flags });
    let length = u64::from_le_bytes(field(header, BODY_LENGTH));
    let expected = length.saturating_add(HEADER_LEN as u64);
    ensure!(found >= expected, BlobError::Truncated { expected, found });
    ensure!(found <= expected, BlobError::TrailingBytes { expected, found });
    let stored = u32::from_le_bytes(field(header, CHECKSUM));
    let computed = checksum(header, body);
    ensure!(stored == computed, BlobError::Checksum { expected: stored, found: computed });
    let reserved = u32::from_le_bytes(field(header, RESERVED));
    ensure!(reserved == 0, BlobError::Reserved { found: reserved });
    Ok(body)
}

/// Returns a copy of the header's bytes in the range `at`.
fn field<const N: usize>(header: &[u8; HEADER_LEN], at: Range<usize>) -> [u8; N] {
    let mut bytes = [0; N];
    for (to, from) in bytes.iter_mut().zip(header.get(at).unwrap_or_default()) {
        *to = *from;
    }
    bytes
}

fn checksum(header: &[u8; HEADER_LEN], body: &[u8]) -> u32 {
    let mut digest = CRC.digest();
    digest.update(&header[..CHECKSUM.start]);
    digest.update(&[0; HEADER_LEN - CHECKSUM.start]);
    digest.update(body);
    digest.finalize()
}
