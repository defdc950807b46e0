//! Damaged scene files: any damage gives a typed error, never a panic or an image.

use nerf_core::Kernel;
use nerf_core::blob::{
    Blob, BlobError, Body, Content, HEADER_LEN, PictureFacts, SceneFacts, SceneSampling, Section,
    encoded_len, write,
};
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Rect, Renderer};
use nerf_core::volume::Pixel;
use nerf_testing::scenes::{Recipe, camera};

/// Scenes and 2D fields that are small enough to damage every byte.
const BLOBS: [Recipe; 4] = [Recipe::TINY, Recipe::TINY_PROPOSAL, Recipe::TINY_PICTURE, TINY_CODED];

/// 2D field with a learned grid whose tables are entropy-coded.
const TINY_CODED: Recipe =
    Recipe { coded: true, int8: true, levels: 1, trunk: (1, 2), ..Recipe::LEARNED_PICTURE };

/// Writes the correct checksum, so that the checks behind the checksum are reached.
pub(crate) fn fix_checksum(blob: &mut [u8]) {
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let mut digest = crc.digest();
    digest.update(&blob[..24]);
    digest.update(&[0; 8]);
    digest.update(&blob[HEADER_LEN..]);
    blob[24..28].copy_from_slice(&digest.finalize().to_le_bytes());
}

/// Returns a file with a valid header and checksum for `body`, which may be invalid.
fn with_body(body: &[u8]) -> Vec<u8> {
    let mut blob = Recipe::TINY.blob()[..HEADER_LEN].to_vec();
    blob[16..24].copy_from_slice(&(body.len() as u64).to_le_bytes());
    blob.extend_from_slice(body);
    fix_checksum(&mut blob);
    blob
}

fn error(blob: &[u8]) -> BlobError {
    let error = Blob::open(blob).expect_err("a damaged blob was opened");
    assert!(!error.to_string().is_empty());
    error
}

#[test]
fn checksum_helper_agrees_with_the_writer() {
    let blob = Recipe::TINY.blob();
    assert_eq!(with_body(&blob[HEADER_LEN..]), blob);
}

#[test]
fn every_truncation_is_an_error() {
    assert_eq!(error(&[]), BlobError::NotABlob);
    for blob in BLOBS.map(|recipe| recipe.blob()) {
        for length in 1..blob.len() {
            assert!(matches!(error(&blob[..length]), BlobError::Truncated { .. }), "{length} bytes");
            // Cut with a header that admits it: the body itself ends early.
            if length >= HEADER_LEN {
                error(&with_body(&blob[HEADER_LEN..length]));
            }
        }
    }
}

#[test]
fn every_flipped_bit_is_an_error() {
    for blob in BLOBS.map(|recipe| recipe.blob()) {
        for bit in 0..8 * blob.len() {
            let mut flipped = blob.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            let error = error(&flipped);
            if bit / 8 >= HEADER_LEN {
                assert!(matches!(error, BlobError::Checksum { .. }), "bit {bit}: {error}");
            }
        }
    }
}

/// Returns whether one pixel of the scene or 2D field can be rendered.
fn draws(blob: Blob<'_>) -> bool {
    let (batch, rect) = (Batch::SMALLEST, Rect { x: 0, y: 0, width: 1, height: 1 });
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, Kernel::IN_PLACE)];
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut memory).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; 1 << 12];
    let drawn = if blob.picture().is_some() {
        let mut put = |_: u32, _: u32, _: [f32; 3]| {};
        renderer.render_picture(MathBackend::Polynomial, batch, [1, 1], rect, &mut workspace, &mut put)
    } else {
        let plan = Plan::new(&blob, &Quality::default(), Outputs::ALL, batch).expect("a plan");
        let mut put = |_: u32, _: u32, _: &Pixel| {};
        renderer.render(&plan, &camera(1, 1), rect, &mut workspace, &mut put)
    };
    drawn.is_ok()
}

#[test]
fn flipped_bits_and_bytes_with_a_right_checksum_never_panic() {
    for recipe in BLOBS {
        damage_everywhere(&recipe.blob());
    }
}

fn damage_everywhere(blob: &[u8]) {
    let scene = Blob::open(blob).expect("a blob").scene().is_some();
    let (mut opened, mut refused) = (0, 0);
    let mut open = |blob: &mut [u8]| {
        fix_checksum(blob);
        match Blob::open(blob) {
            // What opens is another blob, whole and usable.
            Ok(other) => {
                opened += 1;
                assert_eq!(other.weights().len(), 2 * other.architecture().parameters());
                assert_eq!((other.scene().is_some(), other.picture().is_some()), (scene, !scene));
                assert!(draws(other));
            }
            Err(error) => refused += usize::from(!error.to_string().is_empty()),
        }
    };
    for bit in 0..8 * blob.len() {
        let mut flipped = blob.to_vec();
        flipped[bit / 8] ^= 1 << (bit % 8);
        open(&mut flipped);
    }
    for byte in HEADER_LEN..blob.len() {
        for value in [0x00, 0x01, 0x7f, 0x80, 0xff] {
            let mut changed = blob.to_vec();
            changed[byte] = value;
            open(&mut changed);
            // And with the rest of the body pushed aside.
            let mut grown = blob.to_vec();
            grown.insert(byte, value);
            let length = (grown.len() - HEADER_LEN) as u64;
            grown[16..24].copy_from_slice(&length.to_le_bytes());
            open(&mut grown);
        }
    }
    assert!(opened > 100 && refused > 300, "{opened} opened, {refused} refused");
}

#[test]
fn headers_are_checked_field_by_field() {
    let blob = Recipe::TINY.blob();
    let change = |at: usize, bytes: &[u8]| {
        let mut changed = blob.clone();
        changed[at..at + bytes.len()].copy_from_slice(bytes);
        fix_checksum(&mut changed);
        error(&changed)
    };
    assert_eq!(change(0, b"PK"), BlobError::NotABlob);
    // A text-mode copy: CR LF became LF.
    let mut text = blob.clone();
    text.remove(5);
    assert_eq!(error(&text), BlobError::NotABlob);
    for found in [0, 1, 2, 3, 4, 5, 6, 8, u16::MAX] {
        assert_eq!(change(8, &found.to_le_bytes()), BlobError::Version { expected: 7, found });
    }
    let old = change(8, &[1, 0]).to_string();
    assert!(old.contains("reads version 7, found 1 (older: fit or import the scene again"), "{old}");
    assert_eq!(change(10, &[0xfe, 0xff]), BlobError::Endian { found: 0xfffe });
    assert_eq!(change(12, &[0, 0, 0, 0x80]), BlobError::Flags { found: 0x8000_0000 });
    let (found, body) = (blob.len() as u64, (blob.len() - HEADER_LEN) as u64);
    assert_eq!(change(16, &(body + 1).to_le_bytes()), BlobError::Truncated { expected: found + 1, found });
    assert_eq!(
        change(16, &(body - 1).to_le_bytes()),
        BlobError::TrailingBytes { expected: found - 1, found }
    );
    assert_eq!(change(16, &[0xff; 8]), BlobError::Truncated { expected: u64::MAX, found });
    assert_eq!(change(28, &[1]), BlobError::Reserved { found: 1 });
    let mut trailing = blob.clone();
    trailing.push(0);
    assert_eq!(error(&trailing), BlobError::TrailingBytes { expected: found, found: found + 1 });
    // Bytes within the announced length, but behind the body.
    let mut inside = blob[HEADER_LEN..].to_vec();
    inside.push(0);
    assert_eq!(error(&with_body(&inside)), BlobError::Form { expected: body, found: body + 1 });
}

#[test]
fn non_canonical_numbers_are_refused() {
    let blob = Recipe::TINY.blob();
    // The last section but one is the weights: a varint length, then the bytes; then no tables.
    let length = Blob::open(&blob).expect("a blob").weights().len();
    assert!(length < 128);
    let at = blob.len() - length - 2;
    assert_eq!(usize::from(blob[at]), length);
    let mut body = blob[HEADER_LEN..at].to_vec();
    body.extend([length as u8 | 0x80, 0x00]);
    body.extend_from_slice(&blob[at + 1..]);
    let found = body.len() as u64;
    assert_eq!(error(&with_body(&body)), BlobError::Form { expected: found - 1, found });
    // A length of 2^64 - 1, and one that no varint has.
    for prefix in [[0xff; 9].as_slice(), [0xff; 10].as_slice()] {
        let mut body = blob[HEADER_LEN..at].to_vec();
        body.extend_from_slice(prefix);
        body.push(1);
        body.extend_from_slice(&blob[at + 1..]);
        assert_eq!(error(&with_body(&body)), BlobError::Body(Section::Weights));
    }
}

#[test]
fn weights_that_are_not_finite_are_named() {
    let blob = Recipe::TINY.blob();
    let length = Blob::open(&blob).expect("a blob").weights().len();
    let first = blob.len() - length - 1;
    let layers = Recipe::TINY.architecture().layers();
    for (index, bits) in (0..length / 2).zip([0x7c00u16, 0xfc00, 0x7e01, 0x7fff].into_iter().cycle()) {
        let mut changed = blob.clone();
        changed[first + 2 * index..][..2].copy_from_slice(&bits.to_le_bytes());
        fix_checksum(&mut changed);
        let layer = layers.iter().rev().find(|layer| layer.weights <= index).expect("a layer");
        let expected = BlobError::Weight {
            section: Section::Weights,
            role: layer.role,
            index: (index - layer.weights) as u32,
        };
        assert_eq!(error(&changed), expected);
    }
}

#[test]
fn writing_refuses_what_opening_refuses() {
    let blob = Recipe::PLAIN.blob();
    let opened = Blob::open(&blob).expect("a blob");
    let body = Body {
        architecture: opened.architecture().clone(),
        content: Content::Scene(opened.scene().expect("a scene").clone()),
        occupancy: None,
        front: Default::default(),
        proposal: None,
        provenance: opened.provenance().clone(),
        weights: opened.weights(),
        tables: None,
    };
    let mut out = vec![0; blob.len()];
    assert_eq!(encoded_len(&body), Ok(blob.len()));
    assert_eq!(write(&body, &mut out), Ok(blob.as_slice()));
    let (expected, found) = (blob.len() as u64, blob.len() as u64 - 1);
    assert_eq!(write(&body, &mut out[1..]), Err(BlobError::Space { expected, found }));

    let scene = |change: &dyn Fn(&mut SceneFacts)| {
        let mut facts = opened.scene().expect("a scene").clone();
        change(&mut facts);
        let wrong = Body { content: Content::Scene(facts), ..body.clone() };
        encoded_len(&wrong).expect_err("a wrong scene was written");
    };
    scene(&|s| s.sampling = SceneSampling::Bins(0));
    scene(&|s| s.sampling = SceneSampling::Bins(4097));
    scene(&|s| s.sampling = SceneSampling::March(0.0));
    scene(&|s| s.sampling = SceneSampling::March(1e-4));
    // The box is no cube.
    scene(&|s| s.sampling = SceneSampling::Contracted { step: 0.1, power: 1 });
    scene(&|s| s.far = s.near);
    scene(&|s| s.near = -1.0);
    scene(&|s| s.far = f32::INFINITY);
    scene(&|s| s.max[1] = s.min[1]);
    scene(&|s| s.min[2] = f32::NAN);
    scene(&|s| s.background[0] = 1.5);
    scene(&|s| s.occupancy_required = true);
    let picture = Content::Picture(PictureFacts { width: 1, height: 1 });
    let picture = Body { content: picture, ..body.clone() };
    assert!(matches!(encoded_len(&picture), Err(BlobError::Kind { .. })));
    let mut short = body.clone();
    short.weights = &opened.weights()[2..];
    assert!(matches!(encoded_len(&short), Err(BlobError::Length { .. })));
    for (resolution, bytes) in [([0, 1, 1], 1), ([513, 1, 1], 65), ([2, 2, 2], 2), ([3, 1, 1], 1)] {
        let mut wrong = body.clone();
        let bits = vec![0xff; bytes];
        wrong.occupancy = Some(nerf_core::blob::StoredOccupancy { resolution, bits: &bits });
        encoded_len(&wrong).expect_err("a wrong occupancy grid was written");
    }
}
