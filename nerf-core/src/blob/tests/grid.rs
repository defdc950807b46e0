//! Tests of blobs with a grid encoding: contents are read back as written, and invalid blobs are refused.

use super::*;
use crate::encoding::{
    DirectionEncoding, GridEncoding, MAX_GRID_LEVELS, MAX_GRID_RESOLUTION, PositionEncoding,
};
use crate::network::{DensityActivation, Shading, TrunkLayer};
use crate::testing::noise;
use std::vec::Vec;

pub(super) fn learned() -> GridEncoding {
    let resolutions = [[2, 3, 4], [9, 9, 9]].into_iter().collect();
    GridEncoding { inputs: 3, features: 2, log2_entries: 6, resolutions }
}

pub(super) fn shape(grid: GridEncoding) -> Architecture {
    Architecture {
        position: PositionEncoding::Grid(grid),
        direction: Some(DirectionEncoding::SphericalHarmonics { degree: 3 }),
        density: Some(DensityActivation::Exponential),
        ..architecture(pi(3, 0), None, &[(16, false)], &[8])
    }
}

/// Makes f16 weights and tables for an architecture with a valid grid encoding.
pub(super) fn contents(a: &Architecture) -> (Vec<u8>, Vec<u8>) {
    let values = a.position.grid().unwrap().values();
    (halve(&parameters(a, 1)).0, halve(&noise(values, 2)).0)
}

fn f16(bytes: &[u8]) -> Option<StoredTables<'_>> {
    Some(StoredTables::F16(bytes))
}

/// Returns the error of the scene with its grid altered by `change`. Weights and tables are empty, since the
/// architecture is checked before them.
fn grid_refused(change: impl FnOnce(&mut GridEncoding)) -> ArchitectureError {
    let mut grid = learned();
    change(&mut grid);
    match refused(&Body { tables: f16(&[]), ..body(shape(grid), None, &[]) }) {
        BlobError::Architecture(error) => error,
        other => panic!("{other}"),
    }
}

#[test]
fn tables_are_opened_as_they_were_written_at_any_alignment() {
    let a = shape(learned());
    let (weights, tables) = contents(&a);
    let written = bytes(&Body { tables: f16(&tables), ..body(a.clone(), None, &weights) });
    for shift in 0..4 {
        let mut moved = vec![0; shift];
        moved.extend(&written);
        let blob = Blob::open(&moved[shift..]).unwrap();
        assert_eq!((blob.architecture(), blob.tables(), blob.weights()), (&a, f16(&tables), &weights[..]));
    }
    // Position: tag 1, 3 inputs, 2 features, 2^6 entries, two levels. Direction: present, tag 1, degree 3.
    let expected = [1, 3, 2, 6, 2, 2, 3, 4, 9, 9, 9, 1, 1, 3];
    assert_eq!(written[HEADER_LEN..][..expected.len()], expected);
}

#[test]
fn grids_outside_the_caps_are_refused_by_field() {
    use ArchitectureError as E;
    for found in [0, 3, 5, 8] {
        assert_eq!(grid_refused(|g| g.features = found), E::GridFeatures { found });
    }
    assert_eq!(grid_refused(|g| g.log2_entries = 25), E::GridEntries { found: 25 });
    assert_eq!(grid_refused(|g| g.resolutions.clear()), E::GridLevels);
    for found in [0, MAX_GRID_RESOLUTION + 1, u16::MAX] {
        let error = grid_refused(|g| g.resolutions[1][2] = found);
        assert_eq!(error, E::GridResolution { level: 1, axis: 2, found });
        assert!(error.to_string().contains(&std::format!("found {found} along axis 2")), "{error}");
    }
    let inputs = E::EncodingInputs { field: "position", expected: 3, found: 2 };
    assert_eq!(grid_refused(|g| g.inputs = 2), inputs);
    // 32 levels of 2^24 hashed entries with 4 features each are more than 2^27 values.
    let error = grid_refused(|g| {
        g.log2_entries = 24;
        g.features = 4;
        g.resolutions = [[MAX_GRID_RESOLUTION; 3]; MAX_GRID_LEVELS].into_iter().collect();
    });
    let found = 32 * ((1 << 24) + u64::from(MAX_GRID_RESOLUTION)) * 4;
    assert_eq!(error, E::GridValues { found });
    let flat = PositionEncoding::Grid(GridEncoding { inputs: 2, ..learned() });
    let picture = Architecture { position: flat, ..architecture(pi(2, 0), None, &[(4, false)], &[]) };
    let solid = E::GridResolution { level: 0, axis: 2, found: 4 };
    assert_eq!(refused(&picture_body(picture, &[])), BlobError::Architecture(solid));
}

#[test]
fn shapes_that_do_not_go_with_a_grid_are_refused() {
    let mut a = shape(learned());
    a.trunk.push(TrunkLayer { width: 4, skip: true }).unwrap();
    let error = refused(&Body { tables: f16(&[]), ..body(a, None, &[]) });
    assert_eq!(error, BlobError::Architecture(ArchitectureError::SkipBesideGrid { layer: 1 }));
    for found in [0, 5, 255] {
        let direction = Some(DirectionEncoding::SphericalHarmonics { degree: found });
        let a = Architecture { direction, ..every_kind() };
        let error = BlobError::Architecture(ArchitectureError::HarmonicsDegree { found });
        assert_eq!(refused(&body(a, None, &[])), error);
    }
}

#[test]
fn a_grid_shaded_once_a_ray_may_do_without_a_trunk_and_nothing_else_may() {
    use ArchitectureError as E;
    let bare = |shading| Architecture { trunk: Default::default(), shading, ..shape(learned()) };
    let a = bare(Shading::PerRay);
    let (weights, tables) = contents(&a);
    let written = bytes(&Body { tables: f16(&tables), ..body(a.clone(), None, &weights) });
    assert_eq!(Blob::open(&written).unwrap().architecture(), &a);
    // The density head and the colour branch take the grid's four values as inputs.
    assert_eq!((a.h_rows(), a.density_parameters()), (4, 5));
    let error = refused(&Body { tables: f16(&[]), ..body(bare(Shading::PerSample), None, &[]) });
    assert_eq!(error, BlobError::Architecture(E::NoTrunk));
    assert!(error.to_string().contains("or none behind a position grid shaded once a ray"), "{error}");
    let sines = Architecture { trunk: Default::default(), shading: Shading::PerRay, ..every_kind() };
    assert_eq!(refused(&body(sines, None, &[])), BlobError::Architecture(E::NoTrunk));
    let flat = Architecture { shading: Shading::PerRay, ..architecture(pi(2, 0), None, &[(4, false)], &[]) };
    let error = refused(&picture_body(flat, &[]));
    assert_eq!(error, BlobError::Architecture(E::PerRayWithoutDensity));
    assert!(error.to_string().contains("shading: expected once a sample in a 2D field"), "{error}");
}

#[test]
fn tables_are_there_exactly_with_a_grid_and_of_its_length() {
    let a = shape(learned());
    let (weights, tables) = contents(&a);
    assert_eq!(refused(&body(a.clone(), None, &weights)), BlobError::Field(Section::Tables));
    let (sinusoidal, _) = halve(&parameters(&every_kind(), 1));
    let beside = Body { tables: f16(&tables), ..body(every_kind(), None, &sinusoidal) };
    assert_eq!(refused(&beside), BlobError::Field(Section::Tables));
    let expected = tables.len() as u64;
    for found in [0, 1, tables.len() - 2, tables.len() - 1] {
        let error = BlobError::Length { section: Section::Tables, expected, found: found as u64 };
        assert_eq!(
            refused(&Body { tables: f16(&tables[..found]), ..body(a.clone(), None, &weights) }),
            error
        );
    }
    // int8 tables take half as many bytes as f16 tables.
    let scales = [0, 0, 128, 63].repeat(2);
    for found in [0, tables.len() / 2 - 1, tables.len() / 2 + 1, tables.len()] {
        let int8 = Some(StoredTables::Int8 { scales: &scales, bytes: &tables[..found] });
        let (expected, found) = (expected / 2, found as u64);
        let error = BlobError::Length { section: Section::Tables, expected, found };
        assert_eq!(refused(&Body { tables: int8, ..body(a.clone(), None, &weights) }), error);
    }
}

#[test]
fn int8_tables_are_opened_as_they_were_written_at_any_alignment() {
    let a = shape(learned());
    let (weights, tables) = contents(&a);
    // The smallest and the largest valid scale: the smallest positive f32, and the largest f32 divided by 128.
    let scales: Vec<u8> =
        [1e-45, f32::MAX / 128.0].iter().flat_map(|scale: &f32| scale.to_le_bytes()).collect();
    let int8 = Some(StoredTables::Int8 { scales: &scales, bytes: &tables[..tables.len() / 2] });
    let written = bytes(&Body { tables: int8, ..body(a, None, &weights) });
    for shift in 0..4 {
        let mut moved = vec![0; shift];
        moved.extend(&written);
        assert_eq!(Blob::open(&moved[shift..]).unwrap().tables(), int8);
    }
    // Tables: present, tag 1 (int8), 8 bytes of scales; then the varint of 266, and 266 values of one byte.
    let end = &written[written.len() - 266 - 2 - 8 - 3..];
    assert_eq!((&end[..3], &end[3..11], &end[11..13]), (&[1, 1, 8][..], &scales[..], &[0x8a, 0x02][..]));
}

#[test]
fn scales_are_one_a_level_above_0_and_of_finite_values() {
    let a = shape(learned());
    let (weights, tables) = contents(&a);
    let error = |scales: &[f32]| {
        let scales: Vec<u8> = scales.iter().flat_map(|scale| scale.to_le_bytes()).collect();
        let tables = Some(StoredTables::Int8 { scales: &scales, bytes: &tables[..tables.len() / 2] });
        refused(&Body { tables, ..body(a.clone(), None, &weights) })
    };
    for (count, found) in [(0, 0), (1, 4), (3, 12)] {
        let length = BlobError::Length { section: Section::TableScales, expected: 8, found };
        assert_eq!(error(&vec![1.0; count]), length);
        assert!(length.to_string().starts_with("tables.scales: expected 8 bytes"), "{length}");
    }
    for bad in [0.0, -0.0, -1.0, f32::INFINITY, f32::NEG_INFINITY, (f32::MAX / 128.0).next_up()] {
        assert_eq!(error(&[1.0, bad]), BlobError::TableScale { level: 1, found: bad });
    }
    let nan = error(&[f32::NAN, 1.0]);
    assert!(matches!(nan, BlobError::TableScale { level: 0, .. }));
    assert!(nan.to_string().starts_with("tables.scales: level 0: expected"), "{nan}");
}

#[test]
fn a_value_that_is_not_finite_is_named_by_level_and_index() {
    let a = shape(learned());
    let (weights, mut tables) = contents(&a);
    // Level 0 has 60 dense entries of two values, level 1 has 2^6 + 9 hashed entries.
    for (at, level, index) in [(0, 0, 0), (119, 0, 119), (120, 1, 0), (265, 1, 145)] {
        let kept = [tables[2 * at], tables[2 * at + 1]];
        for bad in [[0x00, 0x7c], [0x00, 0xfc], [0x01, 0x7e]] {
            tables[2 * at..2 * at + 2].copy_from_slice(&bad);
            let error = refused(&Body { tables: f16(&tables), ..body(a.clone(), None, &weights) });
            assert_eq!(error, BlobError::TableValue { level, index });
        }
        tables[2 * at..2 * at + 2].copy_from_slice(&kept);
    }
    assert_eq!(tables.len(), 2 * 266);
}

#[test]
fn a_list_of_33_levels_is_refused_by_its_section() {
    let a = shape(learned());
    let (weights, tables) = contents(&a);
    let mut file = bytes(&Body { tables: f16(&tables), ..body(a, None, &weights) });
    // Sets the length of the list of levels to 33, and adds 31 levels to the two present.
    file[HEADER_LEN + 4] = 33;
    file.splice(HEADER_LEN + 5..HEADER_LEN + 5, [1; 31 * 3]);
    let rest = file.split_off(HEADER_LEN);
    let mut fixed = header::write(&rest).to_vec();
    fixed.extend(rest);
    let error = Blob::open(&fixed).unwrap_err();
    assert_eq!(error, BlobError::Body(Section::Position));
    assert!(error.to_string().starts_with("architecture.position"), "{error}");
}

#[test]
fn an_older_file_is_told_how_to_be_made_anew() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let mut file = bytes(&body(every_kind(), None, &weights));
    file[8] = 6;
    let error = Blob::open(&file).unwrap_err();
    assert_eq!(error, BlobError::Version { expected: FORMAT_VERSION, found: 6 });
    assert!(error.to_string().contains("fit or import the scene again"), "{error}");
}

/// Bytes of the second example in `docs/blob-format.md`, a 2D field with f16 tables. Another program made these bytes.
const RAMP: &str = "
    89 4e 45 52 46 0d 0a 1a 07 00 ff fe 00 00 00 00
    4b 00 00 00 00 00 00 00 eb ac e2 d6 00 00 00 00
    01 02 01 02 01 01 01 00 00 01 01 00 00 00 00 00
    02 01 00 00 00 04 72 61 6d 70 0e 62 6c 6f 62 2d
    66 6f 72 6d 61 74 2e 6d 64 00 00 00 00 00 08 10
    00 3c 00 00 00 3c 00 3c 00 3c 00 00 00 00 00 00
    01 00 08 00 00 00 3c 00 00 00 3c
";

/// Bytes of the third example in `docs/blob-format.md`: the 2D field of [`RAMP`] with int8 tables.
const RAMP_IN_INT8: &str = "
    89 4e 45 52 46 0d 0a 1a 07 00 ff fe 00 00 00 00
    4c 00 00 00 00 00 00 00 ca fd cc b0 00 00 00 00
    01 02 01 02 01 01 01 00 00 01 01 00 00 00 00 00
    02 01 00 00 00 04 72 61 6d 70 0e 62 6c 6f 62 2d
    66 6f 72 6d 61 74 2e 6d 64 00 00 00 00 00 08 10
    00 3c 00 00 00 3c 00 3c 00 3c 00 00 00 00 00 00
    01 01 04 00 00 80 3f 04 00 01 00 01
";

/// Bytes of the fourth example in `docs/blob-format.md`: the 2D field of [`RAMP`] with entropy-coded tables.
#[cfg(feature = "coded")]
const RAMP_CODED: &str = "
    89 4e 45 52 46 0d 0a 1a 07 00 ff fe 00 00 00 00
    4e 00 00 00 00 00 00 00 6d d2 e4 2d 00 00 00 00
    01 02 01 02 01 01 01 00 00 01 01 00 00 00 00 00
    02 01 00 00 00 04 72 61 6d 70 0e 62 6c 6f 62 2d
    66 6f 72 6d 61 74 2e 6d 64 00 00 00 00 00 08 10
    00 3c 00 00 00 3c 00 3c 00 3c 00 00 00 00 00 00
    01 02 04 00 00 80 3f 06 81 47 44 1b be 41
";

#[test]
fn the_ramps_of_the_specification_open_and_are_what_is_written() {
    is_the_ramp(RAMP, StoredTables::F16(&[0, 0, 0, 0x3c, 0, 0, 0, 0x3c]));
    is_the_ramp(RAMP_IN_INT8, StoredTables::Int8 { scales: &[0, 0, 0x80, 0x3f], bytes: &[0, 1, 0, 1] });
    #[cfg(feature = "coded")]
    is_the_ramp(
        RAMP_CODED,
        StoredTables::Coded { scales: &[0, 0, 0x80, 0x3f], bytes: &[0x81, 0x47, 0x44, 0x1b, 0xbe, 0x41] },
    );
}

fn is_the_ramp(file: &str, tables: StoredTables<'_>) {
    let file: Vec<u8> = file.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
    let blob = Blob::open(&file).unwrap();
    let provenance = blob.provenance().clone();
    let content = Content::Picture(PictureFacts { width: 2, height: 1 });
    let a = blob.architecture().clone();
    let tables = Some(tables);
    assert_eq!(blob.tables(), tables);
    assert_eq!(bytes(&Body { content, provenance, tables, ..picture_body(a, blob.weights()) }), file);

    let mut memory = [crate::Line::UNINIT; 1];
    let renderer = crate::Renderer::new(blob, crate::Kernel::IN_PLACE, &mut memory).unwrap();
    let (math, batch) = (crate::MathBackend::Polynomial, crate::Batch::SMALLEST);
    let mut workspace = [crate::Line::UNINIT; 16];
    assert!(renderer.picture_workspace_lines(batch) <= workspace.len());
    let (rect, mut found) = (crate::Rect { x: 0, y: 0, width: 2, height: 1 }, vec![]);
    let mut put = |_: u32, _: u32, rgb: [f32; 3]| found.push(rgb);
    renderer.render_picture(math, batch, [2, 1], rect, &mut workspace, &mut put).unwrap();
    for (rgb, x) in found.iter().zip([0.25f32, 0.75]) {
        let expected = 1.0 / (1.0 + (-x).exp());
        assert!(rgb.iter().all(|c| (c - expected).abs() < 1e-6), "{found:?}");
    }
}
