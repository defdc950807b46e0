//! Scene files that describe shapes beyond every limit: each is refused with the right error, whatever sizes it claims.

use crate::blob_damage::fix_checksum;
use nerf_core::blob::{Blob, BlobError, HEADER_LEN, Section};
use nerf_core::network::ArchitectureError;
use nerf_testing::scenes::Recipe;

/// Returns the file of [`Recipe::TINY`] with `bytes` in place of `count` bytes of its body from `at`, and with a valid
/// header.
fn with(at: usize, count: usize, bytes: &[u8]) -> Vec<u8> {
    let right = Recipe::TINY.blob();
    let mut body = right[HEADER_LEN..].to_vec();
    body.splice(at..at + count, bytes.iter().copied());
    let mut blob = right[..HEADER_LEN].to_vec();
    blob[16..24].copy_from_slice(&(body.len() as u64).to_le_bytes());
    blob.extend_from_slice(&body);
    fix_checksum(&mut blob);
    blob
}

fn refused(at: usize, count: usize, bytes: &[u8]) -> BlobError {
    let error = Blob::open(&with(at, count, bytes)).expect_err("a body beyond every cap was opened");
    assert!(!error.to_string().is_empty());
    error
}

/// Encodes a number as postcard does.
fn varint(mut number: u64) -> Vec<u8> {
    let mut bytes = vec![];
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
    bytes
}

/// Offset of the trunk in the body: number of layers, then width and skip flag of each layer.
const TRUNK: usize = 6;
/// Offset of the occupancy grid in the body: its resolution comes first.
const OCCUPANCY: usize = 63;
/// Offset of the first text of the provenance in the body, behind an occupancy grid of eight cells, no front and no
/// proposal network.
const TEXT: usize = 70;

#[test]
fn the_bytes_are_where_the_specification_has_them() {
    let blob = Recipe::TINY.blob();
    let body = &blob[HEADER_LEN..];
    assert_eq!(body[TRUNK..TRUNK + 3], [1, 2, 0]);
    assert_eq!(body[OCCUPANCY - 1..OCCUPANCY + 4], [1, 2, 2, 2, 1]);
    assert_eq!(body[TEXT..TEXT + 6], *b"\x05noise");
    assert_eq!(with(TRUNK, 3, &[1, 2, 0]), blob);
}

#[test]
fn networks_of_300_layers_of_none_and_of_odd_widths_are_refused() {
    let layers =
        |count: usize, layer: &[u8]| [&varint(count as u64), layer.repeat(count).as_slice()].concat();
    for count in [17, 300, 70_000] {
        assert_eq!(
            refused(TRUNK, 3, &layers(count, &[2, 0])),
            BlobError::Body(Section::Architecture),
            "{count} layers"
        );
        // As many are announced, and none is there.
        assert_eq!(
            refused(TRUNK, 3, &varint(count as u64)),
            BlobError::Body(Section::Architecture),
            "{count} layers"
        );
    }
    assert_eq!(refused(TRUNK, 1, &varint(u64::MAX)), BlobError::Body(Section::Architecture));
    // The format's most: only the weights are too few.
    let most = [&[16, 2, 0], [2, 1].repeat(15).as_slice()].concat();
    let short = refused(TRUNK, 3, &most);
    assert!(matches!(short, BlobError::Length { section: Section::Weights, .. }), "{short}");
    let architecture = BlobError::Architecture;
    assert_eq!(refused(TRUNK, 3, &[0]), architecture(ArchitectureError::NoTrunk));
    for found in [0u16, 513, u16::MAX] {
        let width = ArchitectureError::Width { field: "trunk", index: 0, found };
        assert_eq!(refused(TRUNK + 1, 1, &varint(u64::from(found))), architecture(width));
    }
    assert_eq!(refused(TRUNK + 1, 1, &varint(1 << 16)), BlobError::Body(Section::Architecture), "no u16");
}

#[test]
fn skips_are_a_flag_that_the_first_layer_has_not() {
    let first = BlobError::Architecture(ArchitectureError::SkipAtFirstLayer);
    assert_eq!(refused(TRUNK + 2, 1, &[1]), first);
    // Which layer it comes from or goes to cannot be said: 2 or more is no flag.
    for later in 2..=u8::MAX {
        assert_eq!(refused(TRUNK + 2, 1, &[later]), BlobError::Body(Section::Architecture), "{later}");
    }
}

#[test]
fn occupancies_of_2_to_the_20_cells_a_side_are_refused_unmeasured() {
    for side in [1 << 16, 1 << 20, 1 << 32, u64::MAX] {
        assert_eq!(
            refused(OCCUPANCY, 3, &varint(side).repeat(3)),
            BlobError::Body(Section::Occupancy),
            "{side}"
        );
    }
    for side in [0, 513, 65_535] {
        let error = refused(OCCUPANCY, 3, &varint(side).repeat(3));
        assert_eq!(error, BlobError::Field(Section::OccupancyResolution), "{side}");
    }
    let length = BlobError::Length { section: Section::OccupancyBits, expected: 1 << 24, found: 1 };
    assert_eq!(refused(OCCUPANCY, 3, &varint(512).repeat(3)), length);
}

#[test]
fn lengths_up_to_2_to_the_64_reach_nothing() {
    let blob = Recipe::TINY.blob();
    let weights = blob.len() - HEADER_LEN - Blob::open(&blob).expect("a blob").weights().len() - 2;
    for at in [OCCUPANCY + 3, TEXT, weights] {
        let found = u64::from(blob[HEADER_LEN + at]);
        let left = (blob.len() - HEADER_LEN - at) as u64;
        for length in (0..64).flat_map(|k| [(1 << k) - 1, 1 << k, u64::MAX - (1 << k), u64::MAX]) {
            if length != found {
                let error = refused(at, 1, &varint(length));
                // What ends within the body may have another meaning; what does not is no body.
                assert!(length < left || matches!(error, BlobError::Body(_)), "{length} at {at}: {error}");
            }
        }
    }
}
