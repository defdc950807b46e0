//! Errors of a scene file's header, compared with a second implementation of its rules: every 16-bit word of the
//! header's fields, every pair of bytes, and arbitrary bytes.

use crate::blob_damage::fix_checksum;
use nerf_core::blob::{Blob, BlobError, FORMAT_VERSION, HEADER_LEN, MAGIC};
use nerf_testing::scenes::Recipe;
use proptest::prelude::*;

/// Computes the CRC-32 (ISO-HDLC) of header and body, with the checksum field and the bytes after it set to 0.
fn checksum(blob: &[u8]) -> u32 {
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let mut digest = crc.digest();
    digest.update(&blob[..24]);
    digest.update(&[0; 8]);
    digest.update(&blob[HEADER_LEN..]);
    digest.finalize()
}

/// Returns the error that `docs/blob-format.md` requires for a header, computed without overflow; `None` for a valid
/// header.
fn expected(blob: &[u8]) -> Option<BlobError> {
    let found = blob.len() as u64;
    let magic = blob.len().min(8);
    if blob.is_empty() || blob[..magic] != MAGIC[..magic] {
        return Some(BlobError::NotABlob);
    }
    if blob.len() < HEADER_LEN {
        return Some(BlobError::Truncated { expected: 32, found });
    }
    let number = |at: usize, bytes: usize| {
        (0..bytes).fold(0u64, |number, i| number | u64::from(blob[at + i]) << (8 * i))
    };
    let (version, endian, flags) = (number(8, 2) as u16, number(10, 2) as u16, number(12, 4) as u32);
    if endian != 0xfeff {
        return Some(BlobError::Endian { found: endian });
    }
    if version != FORMAT_VERSION {
        return Some(BlobError::Version { expected: FORMAT_VERSION, found: version });
    }
    if flags != 0 {
        return Some(BlobError::Flags { found: flags });
    }
    let exact = u128::from(number(16, 8)) + 32;
    let expected = exact.min(u128::from(u64::MAX)) as u64;
    match u128::from(found).cmp(&exact) {
        std::cmp::Ordering::Less => return Some(BlobError::Truncated { expected, found }),
        std::cmp::Ordering::Greater => return Some(BlobError::TrailingBytes { expected, found }),
        std::cmp::Ordering::Equal => {}
    }
    let (stored, computed) = (number(24, 4) as u32, checksum(blob));
    if stored != computed {
        return Some(BlobError::Checksum { expected: stored, found: computed });
    }
    let reserved = number(28, 4) as u32;
    (reserved != 0).then_some(BlobError::Reserved { found: reserved })
}

/// Opens a scene file. Verifies that an invalid header gives exactly the expected error, and that a valid header gives
/// no error of the header.
fn check(blob: &[u8]) -> Result<(), BlobError> {
    let found = Blob::open(blob).map(|_| ());
    match (expected(blob), found) {
        (Some(expected), found) => assert_eq!(found, Err(expected), "{:02x?}", &blob[..blob.len().min(32)]),
        (None, Err(error)) => {
            assert!(!error.to_string().is_empty());
            assert!(
                !matches!(
                    error,
                    BlobError::NotABlob | BlobError::Truncated { .. } | BlobError::Checksum { .. }
                ),
                "{error}"
            );
        }
        (None, Ok(())) => {}
    }
    found
}

#[test]
fn every_word_of_version_endian_flags_and_reserve_is_what_the_format_says() {
    let mut blob = Recipe::TINY.blob();
    let right = blob.clone();
    let mut opened = 0;
    for at in [8, 10, 12, 14, 28, 30] {
        for word in 0..=u16::MAX {
            blob[at..at + 2].copy_from_slice(&word.to_le_bytes());
            fix_checksum(&mut blob);
            opened += u32::from(check(&blob).is_ok());
        }
        blob.copy_from_slice(&right);
    }
    // One right word for each of the six.
    assert_eq!(opened, 6);
}

#[test]
fn every_length_around_a_power_of_two_is_counted_without_wrapping() {
    let mut blob = Recipe::TINY.blob();
    let body = (blob.len() - HEADER_LEN) as u64;
    let powers = (0..64).map(|k| 1u64 << k);
    let near =
        powers.flat_map(|power| (0..40).flat_map(move |d| [power.wrapping_sub(d), power.wrapping_add(d)]));
    let all = near.chain((0..40).flat_map(|d| [u64::MAX - d, body - d, body + d]));
    for length in all {
        blob[16..24].copy_from_slice(&length.to_le_bytes());
        fix_checksum(&mut blob);
        assert_eq!(check(&blob).is_ok(), length == body, "{length}");
    }
}

#[test]
fn every_byte_and_every_pair_of_bytes_of_the_header_is_checked() {
    const FILLS: [u8; 12] = [0x00, 0x01, 0x02, 0x0a, 0x1a, 0x20, 0x7f, 0x80, 0x89, 0xfe, 0xfd, 0xff];
    let right = Recipe::TINY.blob();
    let mut blob = right.clone();
    for at in 0..HEADER_LEN {
        for value in 0..=u8::MAX {
            for fix in [false, true] {
                blob[at] = value;
                if fix {
                    fix_checksum(&mut blob);
                }
                assert_eq!(check(&blob).is_ok(), blob == right);
                blob.copy_from_slice(&right);
            }
        }
        for other in at + 1..HEADER_LEN {
            for pair in 0..FILLS.len() * FILLS.len() {
                (blob[at], blob[other]) = (FILLS[pair / FILLS.len()], FILLS[pair % FILLS.len()]);
                fix_checksum(&mut blob);
                assert_eq!(check(&blob).is_ok(), blob == right);
                blob.copy_from_slice(&right);
            }
        }
    }
}

proptest! {
    #![proptest_config(crate::drawn(4_000))]

    #[test]
    fn any_bytes_are_refused_or_opened_as_the_header_says(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = check(&bytes);
        let magic: Vec<u8> = MAGIC.iter().chain(&bytes).copied().collect();
        let _ = check(&magic);
    }

    #[test]
    fn any_body_behind_a_right_header_is_refused_by_type(body in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = check(&behind_a_header(&body));
    }

    /// Valid first bytes of a body, followed by arbitrary bytes: malformed architectures, scenes and occupancy grids.
    #[test]
    fn any_end_of_a_right_beginning_is_refused_by_type(
        kept in 0usize..240,
        recipe in 0usize..3,
        odd in prop::collection::vec(prop_oneof![any::<u8>(), Just(0xff), Just(0x80), Just(0)], 0..300),
    ) {
        let recipe = [Recipe::TINY, Recipe::TINY_PROPOSAL, Recipe::TINY_PICTURE][recipe].blob();
        let mut body = recipe[HEADER_LEN..].to_vec();
        body.truncate(kept);
        body.extend(&odd);
        let _ = check(&behind_a_header(&body));
    }
}

fn behind_a_header(body: &[u8]) -> Vec<u8> {
    let mut blob = Recipe::TINY.blob()[..HEADER_LEN].to_vec();
    blob[16..24].copy_from_slice(&(body.len() as u64).to_le_bytes());
    blob.extend_from_slice(body);
    fix_checksum(&mut blob);
    blob
}
