//! Tests of entropy-coded tables: values are read back as written, and invalid bytes are refused.

use super::grid::{contents, learned, shape};
use super::*;
use crate::blob::coded::{decode_tables, encode_tables};
use crate::encoding::GridEncoding;
use crate::testing::noise;
use std::vec::Vec;

fn encoded(grid: &GridEncoding, values: &[u8]) -> Vec<u8> {
    let mut symbols = vec![[0; 2]; 2 * values.len()];
    let mut out = vec![0; 4 * values.len() + 4];
    encode_tables(grid, values, &mut symbols, &mut out).expect("room for any values").to_vec()
}

fn decoded(grid: &GridEncoding, bytes: &[u8]) -> Result<Vec<u8>, BlobError> {
    let mut values = vec![];
    decode_tables(grid, bytes, |value| values.push(value)).map(|()| values)
}

fn of_features(features: u8) -> GridEncoding {
    GridEncoding { features, ..learned() }
}

/// Pseudo-random signed bytes of magnitude at most 40, mostly small.
fn small(count: usize) -> Vec<u8> {
    noise(count, 5).iter().map(|x| (40.0 * x * x * x) as i8 as u8).collect()
}

#[test]
fn values_are_decoded_as_they_were_encoded() {
    for features in [1, 2, 4] {
        let grid = of_features(features);
        let count = grid.values();
        let every_byte = (0..count).map(|i| (i * 37 % 256) as u8).collect();
        for values in [vec![0; count], vec![0x80; count], every_byte, small(count)] {
            let bytes = encoded(&grid, &values);
            assert_eq!(decoded(&grid, &bytes), Ok(values));
        }
    }
}

#[test]
fn small_values_take_fewer_bytes_and_zeros_next_to_none() {
    let resolutions = [[31, 31, 31]].into_iter().collect();
    let grid = GridEncoding { log2_entries: 16, resolutions, ..learned() };
    let count = grid.values();
    assert_eq!(count, 1 << 16);
    // Values uniform over 16 numbers take four bits each, and at most 3 % more while the models adapt.
    let even: Vec<u8> = noise(count, 3).iter().map(|x| (8.0 * x).floor() as i8 as u8).collect();
    let bytes = encoded(&grid, &even).len();
    assert!((count / 2..count / 2 * 103 / 100).contains(&bytes), "{bytes}");
    let bytes = encoded(&grid, &vec![0; count]).len();
    assert!(bytes < count / 300, "{bytes}");
    // One byte holds at most 6,100 values, as documented.
    assert!(count < 6100 * bytes);
}

#[test]
fn bytes_that_are_cut_are_an_error_at_every_length() {
    let grid = learned();
    let bytes = encoded(&grid, &small(grid.values()));
    for length in 0..bytes.len() {
        let error = decoded(&grid, &bytes[..length]).unwrap_err();
        assert!(
            matches!(error, BlobError::CodedEnd { .. } | BlobError::CodedRest { .. }),
            "{length}: {error}"
        );
    }
    assert_eq!(decoded(&grid, &bytes[..3]), Err(BlobError::CodedEnd { level: 0, index: 0 }));
}

#[test]
fn bytes_behind_the_last_value_are_an_error() {
    let grid = learned();
    let bytes = encoded(&grid, &small(grid.values()));
    for more in 1..5u64 {
        let extended = [&bytes[..], &[0; 4][..more as usize]].concat();
        let error = decoded(&grid, &extended).unwrap_err();
        assert_eq!(error, BlobError::CodedRest { state: 1 << 16, bytes: more });
        assert!(error.to_string().contains(&format!("{more} bytes more")), "{error}");
    }
}

#[test]
fn a_first_state_that_no_encoder_has_is_an_error() {
    let grid = learned();
    let mut bytes = encoded(&grid, &small(grid.values()));
    let rest = bytes.len() as u64 - 4;
    for state in [0, 1, (1 << 16) - 1] {
        bytes[..4].copy_from_slice(&u32::to_le_bytes(state));
        assert_eq!(decoded(&grid, &bytes), Err(BlobError::CodedRest { state, bytes: rest }));
    }
}

#[test]
fn whatever_decodes_is_what_an_encoder_writes() {
    let resolutions = [[1, 1, 0]].into_iter().collect();
    let grid = GridEncoding { inputs: 2, features: 1, resolutions, ..learned() };
    let bytes = encoded(&grid, &[0, 1, 255, 2]);
    assert_eq!(bytes.len(), 6);
    let (mut opened, mut refused) = (0, 0);
    let mut open = |bytes: &[u8]| match decoded(&grid, bytes) {
        Ok(values) => {
            opened += 1;
            assert_eq!(encoded(&grid, &values), bytes);
        }
        Err(_) => refused += 1,
    };
    for bit in 0..8 * bytes.len() {
        let mut flipped = bytes.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        open(&flipped);
    }
    // Pseudo-random streams of six bytes: about one in 2^16 decodes without an error.
    for seed in 0..1 << 20 {
        let any = u64::wrapping_mul(seed + 1, 0x9e37_79b9_7f4a_7c15);
        open(&any.to_be_bytes()[..6]);
    }
    assert!(opened > 0 && refused > 1 << 19, "{opened} opened, {refused} refused");
}

#[test]
fn coded_tables_are_opened_as_they_were_written_and_decoded_as_int8_has_them() {
    let a = shape(learned());
    let (weights, _) = contents(&a);
    let values = small(a.position.grid().unwrap().values());
    let coded = encoded(a.position.grid().unwrap(), &values);
    let scales = 0.5f32.to_le_bytes().repeat(2);
    let tables = Some(StoredTables::Coded { scales: &scales, bytes: &coded });
    let written = bytes(&Body { tables, ..body(a.clone(), None, &weights) });
    for shift in 0..4 {
        let mut moved = vec![0; shift];
        moved.extend(&written);
        let blob = Blob::open(&moved[shift..]).unwrap();
        let mut found = vec![0xaa; blob.decoded_len()];
        blob.decode_tables(&mut found).unwrap();
        assert_eq!((blob.tables(), &found), (tables, &values));
        assert_eq!(blob.tables().unwrap().name(), "coded");
    }
    let int8 = Some(StoredTables::Int8 { scales: &scales, bytes: &values });
    let in_place = bytes(&Body { tables: int8, ..body(a.clone(), None, &weights) });
    assert_eq!(Blob::open(&in_place).unwrap().decoded_len(), 0);
    // Errors of writing: scales for one of two levels, then coded bytes that end early.
    let tables = Some(StoredTables::Coded { scales: &scales[..4], bytes: &coded });
    let length = BlobError::Length { section: Section::TableScales, expected: 8, found: 4 };
    assert_eq!(refused(&Body { tables, ..body(a.clone(), None, &weights) }), length);
    let tables = Some(StoredTables::Coded { scales: &scales, bytes: &coded[..coded.len() - 2] });
    assert!(matches!(refused(&Body { tables, ..body(a, None, &weights) }), BlobError::CodedEnd { .. }));
}

/// Returns entropy-coded bytes of small values, and a file whose tables are these bytes.
fn coded_file() -> (Vec<u8>, Vec<u8>) {
    let a = shape(learned());
    let (weights, _) = contents(&a);
    let coded = encoded(a.position.grid().unwrap(), &small(266));
    let scales = 0.5f32.to_le_bytes().repeat(2);
    let tables = Some(StoredTables::Coded { scales: &scales, bytes: &coded });
    let file = bytes(&Body { tables, ..body(a, None, &weights) });
    (coded, file)
}

#[test]
fn a_damaged_stream_is_refused_by_whoever_decodes_it_and_few_bytes_ask_for_no_memory() {
    let (coded, file) = coded_file();
    let mut damaged = file[HEADER_LEN..].to_vec();
    *damaged.last_mut().unwrap() ^= 1;
    let reopened = |body: &[u8]| [&header::write(body)[..], body].concat();
    let file = reopened(&damaged);
    let expected = Blob::open(&file).unwrap_err();
    assert!(matches!(expected, BlobError::CodedRest { .. } | BlobError::CodedEnd { .. }), "{expected}");
    let blob = Blob::open_undecoded(&file).unwrap();
    assert_eq!(blob.decode_tables(&mut vec![0; blob.decoded_len()]), Err(expected));
    for kernel in [crate::Kernel::IN_PLACE, crate::Kernel::detect()] {
        let mut memory = vec![crate::Line::UNINIT; crate::Renderer::prepared_lines(&blob, kernel)];
        let error = crate::Renderer::new(blob.clone(), kernel, &mut memory).unwrap_err();
        assert_eq!(error, crate::render::RenderError::Tables(expected));
        assert_eq!(error.to_string(), expected.to_string());
    }
    #[cfg(feature = "std")]
    assert_eq!(crate::Scene::from_bytes(file).unwrap_err(), expected);
    // A grid of 2^24 values with few coded bytes is refused before memory is allocated.
    let scales = 1f32.to_le_bytes();
    let resolutions = [[511, 511, 127]].into_iter().collect();
    let a = shape(GridEncoding { log2_entries: 24, features: 1, resolutions, ..learned() });
    let weights = vec![0; 2 * a.parameters()];
    let tables = Some(StoredTables::Coded { scales: &scales, bytes: &coded });
    let length = BlobError::Length { section: Section::Tables, expected: 2751, found: coded.len() as u64 };
    assert_eq!(refused(&Body { tables, ..body(a, None, &weights) }), length);
}

#[test]
fn a_length_near_two_to_the_64_is_refused_by_its_section() {
    let (coded, file) = coded_file();
    let length = file.len() - coded.len() - 2;
    for last in [0x01, 0x7f] {
        let mut longer = file[HEADER_LEN..length].to_vec();
        longer.extend([0xff; 9]);
        longer.push(last);
        longer.extend(&coded);
        let mut fixed = header::write(&longer).to_vec();
        fixed.extend(longer);
        assert_eq!(Blob::open(&fixed).unwrap_err(), BlobError::Body(Section::Tables));
    }
}
