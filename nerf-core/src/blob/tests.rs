extern crate std;

use super::*;
use crate::encoding::{AngleScale, SinusoidalEncoding};
use crate::network::{Architecture, ArchitectureError, Role};
use crate::space::BoundsError;
use crate::testing::{
    PROVENANCE, SCENE, architecture, body, bytes, every_kind, halve, parameters, pi, picture_body,
};
use core::f32::consts::TAU;
use std::format;
use std::string::ToString;
use std::vec;

mod builds;
#[cfg(feature = "coded")]
mod coded;
mod front;
#[cfg(feature = "grid")]
mod grid;
mod proposal;

const VIEWPOINT: Viewpoint =
    Viewpoint { eye: [4.0, 0.0, 0.0], target: [0.0; 3], up: [0.0, 0.0, 1.0], arc: 1.0 };

/// Returns the error of writing `body`, after a check that `encoded_len` gives the same error.
fn refused(body: &Body<'_>) -> BlobError {
    let mut out = vec![0; 1 << 16];
    let error = write(body, &mut out).map(drop).unwrap_err();
    assert_eq!(encoded_len(body).unwrap_err().to_string(), error.to_string());
    assert!(out.iter().all(|&byte| byte == 0), "nothing is written");
    error
}

/// Returns the error of writing the tests' scene with its facts altered by `change`.
fn scene_refused(change: impl FnOnce(&mut SceneFacts)) -> BlobError {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let mut scene = SCENE;
    change(&mut scene);
    refused(&Body { content: Content::Scene(scene), ..body(every_kind(), None, &weights) })
}

#[test]
fn what_is_written_is_what_is_opened() {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 1));
    let bits = [0xa5, 0x03];
    let provenance = Provenance {
        data: "a scene, näher beschrieben",
        made_by: "test",
        steps: u32::MAX,
        seed: u64::MAX,
        psnr_db: Some(-3.5),
        psnr_convention: "black",
        quantisation_loss_db: Some(0.01),
        trained_parameters: 7,
    };
    let scene = SceneFacts { occupancy_required: true, sampling: SceneSampling::Bins(MAX_SAMPLES), ..SCENE };
    let occupancy = Some(StoredOccupancy { resolution: [1, 5, 2], bits: &bits });
    let body =
        Body { content: Content::Scene(scene.clone()), provenance, ..body(a.clone(), occupancy, &weights) };
    let bytes = bytes(&body);
    assert_eq!(bytes.len(), encoded_len(&body).unwrap());
    // A blob can begin at any alignment.
    for shift in 0..4 {
        let mut moved = vec![0; shift];
        moved.extend(&bytes);
        let blob = Blob::open(&moved[shift..]).unwrap();
        assert_eq!(blob.architecture(), &a);
        assert_eq!(blob.layers(), a.layers());
        assert_eq!((blob.scene(), blob.picture()), (Some(&scene), None));
        assert_eq!(blob.scene_box().unwrap().max.x, 1.0);
        assert_eq!(blob.provenance(), &body.provenance);
        assert_eq!(blob.weights(), &weights);
        let occupancy = blob.occupancy().unwrap();
        assert_eq!(occupancy.resolution(), [1, 5, 2]);
        assert!((0..10).all(|i| occupancy.bit(i) == (0x03a5 >> i & 1 == 1)));
    }
}

#[test]
fn a_picture_round_trips_without_scene_facts() {
    let a = architecture(pi(2, 8), None, &[(16, false)], &[8]);
    let (weights, _) = halve(&parameters(&a, 2));
    let most = MAX_PICTURE_SIDE;
    for (width, height) in [(30, 20), (1, 1), (most, 1), (1, most), (most, most)] {
        let picture = PictureFacts { width, height };
        let content = Content::Picture(picture);
        let bytes = bytes(&Body { content, ..picture_body(a.clone(), &weights) });
        let blob = Blob::open(&bytes).unwrap();
        assert_eq!((blob.architecture(), blob.picture()), (&a, Some(picture)));
        assert!(blob.scene().is_none() && blob.scene_box().is_none() && blob.occupancy().is_none());
    }
}

#[test]
fn pictures_without_pixels_or_beyond_the_cap_are_refused() {
    let a = architecture(pi(2, 8), None, &[(16, false)], &[8]);
    let (weights, _) = halve(&parameters(&a, 2));
    for (width, height) in [(0, 20), (30, 0), (65_536, 1), (1, 65_536), (u32::MAX, u32::MAX)] {
        let content = Content::Picture(PictureFacts { width, height });
        let error = refused(&Body { content, ..picture_body(a.clone(), &weights) });
        assert_eq!(error, BlobError::PictureSize { width, height });
        let text = error.to_string();
        assert!(text.contains("65535") && text.contains(&std::format!("{width}x{height}")), "{text}");
    }
}

#[test]
fn a_buffer_one_byte_short_is_refused_and_a_longer_one_is_not_filled() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let body = body(every_kind(), None, &weights);
    let expected = encoded_len(&body).unwrap();
    let mut out = vec![7; expected + 5];
    let space = |found: usize| BlobError::Space { expected: expected as u64, found: found as u64 };
    assert_eq!(write(&body, &mut out[..expected - 1]), Err(space(expected - 1)));
    assert_eq!(write(&body, &mut []), Err(space(0)));
    assert_eq!(write(&body, &mut out).unwrap().len(), expected);
    assert_eq!(out[expected..], [7; 5]);
}

#[test]
fn texts_are_limited_and_figures_finite() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let longest = "x".repeat(MAX_TEXT);
    let longer = "x".repeat(MAX_TEXT + 1);
    let with = |provenance| Body { provenance, ..body(every_kind(), None, &weights) };
    let ok = with(Provenance { data: &longest, made_by: &longest, psnr_convention: &longest, ..PROVENANCE });
    assert!(encoded_len(&ok).is_ok());
    for provenance in [
        Provenance { data: &longer, ..PROVENANCE },
        Provenance { made_by: &longer, ..PROVENANCE },
        Provenance { psnr_convention: &longer, ..PROVENANCE },
        Provenance { psnr_db: Some(f32::INFINITY), ..PROVENANCE },
        Provenance { quantisation_loss_db: Some(f32::NAN), ..PROVENANCE },
    ] {
        assert_eq!(refused(&with(provenance)), BlobError::Field(Section::Provenance));
    }
}

#[test]
fn scenes_that_hold_nothing_are_refused() {
    let inverted = scene_refused(|s| s.min = [2.0; 3]);
    assert!(matches!(inverted, BlobError::Bounds(BoundsError::Box { .. })), "{inverted}");
    for (near, far) in [(2.0, 2.0), (-1.0, 2.0), (f32::NAN, 2.0), (0.0, f32::INFINITY)] {
        let error = scene_refused(|s| (s.near, s.far) = (near, far));
        assert!(matches!(error, BlobError::Bounds(BoundsError::Range { .. })), "{error}");
    }
    for samples in [0, MAX_SAMPLES + 1] {
        let error = scene_refused(|s| s.sampling = SceneSampling::Bins(samples));
        assert_eq!(error, BlobError::Field(Section::Samples));
    }
    // The box's diagonal is 3.46. The maximum of 4096 steps covers 3.48 if a step is 8.5e-4, but only 3.44 if it is
    // 8.4e-4.
    let weights = halve(&parameters(&every_kind(), 1)).0;
    let scene = SceneFacts { sampling: SceneSampling::March(8.5e-4), ..SCENE };
    bytes(&Body { content: Content::Scene(scene), ..body(every_kind(), None, &weights) });
    for found in [0.0, -0.1, 8.4e-4, 1e-45, f32::INFINITY, f32::NAN] {
        let error = scene_refused(|s| s.sampling = SceneSampling::March(found));
        assert!(matches!(error, BlobError::Step { .. }), "{found}: {error}");
        assert!(error.to_string().contains("scene.sampling: expected a finite step above 0, at most 4096"));
    }
    for channel in [-0.1, 1.1, f32::NAN] {
        assert_eq!(scene_refused(|s| s.background[1] = channel), BlobError::Field(Section::Background));
    }
    assert_eq!(scene_refused(|s| s.occupancy_required = true), BlobError::Field(Section::OccupancyRequired));
}

#[test]
fn viewpoints_that_place_no_camera_are_refused() {
    let weights = halve(&parameters(&every_kind(), 1)).0;
    let bytes_of = |viewpoint| {
        let content = Content::Scene(SceneFacts { viewpoint, ..SCENE });
        bytes(&Body { content, ..body(every_kind(), None, &weights) })
    };
    let none = bytes_of(None).len();
    for viewpoint in [
        VIEWPOINT,
        Viewpoint { arc: 0.0, ..VIEWPOINT },
        Viewpoint { arc: TAU, ..VIEWPOINT },
        Viewpoint { eye: [4.0, 0.0, 3e3], up: [0.0, 0.0, 0.9995], ..VIEWPOINT },
    ] {
        let file = bytes_of(Some(viewpoint));
        assert_eq!(Blob::open(&file).unwrap().scene().unwrap().viewpoint, Some(viewpoint));
        assert_eq!(file.len(), none + 40);
        let [eye, target, up] = [viewpoint.eye, viewpoint.target, viewpoint.up].map(glam::Vec3::from);
        assert!(crate::camera::Pose::look_at(eye, target, up).is_some(), "{viewpoint:?}");
    }
    let axes =
        |axis: usize, value| core::array::from_fn(|i| if i == axis { value } else { VIEWPOINT.eye[i] });
    for bad in [
        Viewpoint { eye: [0.0; 3], ..VIEWPOINT },
        Viewpoint { eye: axes(0, f32::NAN), ..VIEWPOINT },
        Viewpoint { eye: axes(1, f32::INFINITY), ..VIEWPOINT },
        Viewpoint { eye: [f32::INFINITY; 3], target: [f32::INFINITY; 3], ..VIEWPOINT },
        Viewpoint { eye: axes(0, f32::MAX), ..VIEWPOINT },
        Viewpoint { eye: [0.0, 0.0, 4.0], ..VIEWPOINT },
        Viewpoint { eye: [0.0, 0.0, -4.0], ..VIEWPOINT },
        Viewpoint { target: [4.0, 0.0, 1.0], ..VIEWPOINT },
        Viewpoint { target: [f32::NAN; 3], ..VIEWPOINT },
        Viewpoint { up: [0.0; 3], ..VIEWPOINT },
        Viewpoint { up: [0.0, 0.0, 0.99], ..VIEWPOINT },
        Viewpoint { up: [0.0, 0.0, f32::NAN], ..VIEWPOINT },
        Viewpoint { arc: -0.1, ..VIEWPOINT },
        Viewpoint { arc: TAU.next_up(), ..VIEWPOINT },
        Viewpoint { arc: f32::NAN, ..VIEWPOINT },
    ] {
        let error = scene_refused(|s| s.viewpoint = Some(bad));
        assert_eq!(error, BlobError::Field(Section::Viewpoint), "{bad:?}");
        let said = error.to_string();
        assert!(said.starts_with("scene.viewpoint: expected an eye and a target apart"), "{said}");
    }
}

#[cfg(feature = "contraction")]
#[test]
fn unbounded_scenes_are_opened_as_they_were_written_or_refused() {
    let weights = halve(&parameters(&every_kind(), 1)).0;
    let contracted = |step, power| SceneSampling::Contracted { step, power };
    // At most 4096 steps must cover an infinite line, which is `2 (1 + power)` long in `Contraction::step_at`: steps of
    // 9.8e-4 cover 4.01, steps of 2.45e-3 cover 10.04.
    for (step, power) in [(1.0, 1), (9.8e-4, 1), (1.5e-3, 2), (2.45e-3, 4)] {
        let scene = SceneFacts { sampling: contracted(step, power), ..SCENE };
        let bytes =
            bytes(&Body { content: Content::Scene(scene.clone()), ..body(every_kind(), None, &weights) });
        let blob = Blob::open(&bytes).unwrap();
        assert_eq!(blob.scene(), Some(&scene));
        let found = scene.contraction().unwrap();
        assert_eq!((found.centre().to_array(), found.radius(), found.power()), ([0.0; 3], 0.5, power));
        assert_eq!(scene.step(), 0.5 * step);
    }
    for (step, power) in [(9.7e-4, 1), (2.4e-3, 4), (1.01, 1), (0.01, 0), (0.01, 3), (0.01, 8), (0.01, 255)]
        .into_iter()
        .chain([0.0, -0.1, 1e-45, f32::INFINITY, f32::NAN].map(|step| (step, 1)))
    {
        let error = scene_refused(|s| s.sampling = contracted(step, power));
        assert!(matches!(error, BlobError::Contraction { .. }), "{step} {power}: {error}");
        assert!(error.to_string().contains("scene.sampling: expected a contraction into a cube"));
    }
    let flat = scene_refused(|s| (s.sampling, s.max[1]) = (contracted(0.01, 1), 0.9));
    assert_eq!(flat, BlobError::Contraction { step: 0.01, power: 1 });
}

#[test]
fn occupancies_that_do_not_fit_are_refused() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let with = |resolution, bits| body(every_kind(), Some(StoredOccupancy { resolution, bits }), &weights);
    for resolution in [[0, 1, 1], [1, 513, 1], [u16::MAX; 3]] {
        assert_eq!(refused(&with(resolution, &[])), BlobError::Field(Section::OccupancyResolution));
    }
    let length = BlobError::Length { section: Section::OccupancyBits, expected: 2, found: 1 };
    assert_eq!(refused(&with([3, 3, 1], &[0xff])), length);
    assert_eq!(refused(&with([3, 3, 1], &[0xff, 0x02])), BlobError::Field(Section::OccupancyBits), "padding");
    assert!(encoded_len(&with([3, 3, 1], &[0xff, 0x01])).is_ok());
    let a = architecture(pi(2, 8), None, &[(16, false)], &[]);
    let (weights, _) = halve(&parameters(&a, 2));
    let occupancy = Some(StoredOccupancy { resolution: [1; 3], bits: &[1] });
    let picture = Body { occupancy, ..picture_body(a, &weights) };
    assert_eq!(refused(&picture), BlobError::Field(Section::OccupancyBits));
}

#[test]
fn scenes_have_a_density_head_and_three_inputs_and_pictures_neither() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let error = refused(&picture_body(every_kind(), &weights));
    assert_eq!(error, BlobError::Kind { density_head: true, scene: false });
    assert!(error.to_string().contains("expected a scene of a network with a density head, found a picture"));
    let a = architecture(pi(2, 8), None, &[(16, false)], &[]);
    let (weights, _) = halve(&parameters(&a, 2));
    let error = refused(&body(a.clone(), None, &weights));
    assert_eq!(error, BlobError::Kind { density_head: false, scene: true });
    assert!(error.to_string().contains("without a density head, found a scene"), "{error}");
    let inputs = |expected, found| {
        BlobError::Architecture(ArchitectureError::EncodingInputs { field: "position", expected, found })
    };
    let solid = Architecture { position: pi(3, 8).into(), ..a };
    assert_eq!(refused(&picture_body(solid, &weights)), inputs(2, 3));
    let flat = Architecture { position: pi(2, 4).into(), ..every_kind() };
    assert_eq!(refused(&body(flat, None, &weights)), inputs(3, 2));
}

#[test]
fn architectures_outside_the_caps_are_refused() {
    let mut a = every_kind();
    a.trunk[0].width = 0;
    let width = ArchitectureError::Width { field: "trunk", index: 0, found: 0 };
    assert_eq!(refused(&body(a, None, &[])), BlobError::Architecture(width));
}

#[test]
fn weights_must_be_as_many_as_parameters_and_finite() {
    let a = every_kind();
    let (mut weights, _) = halve(&parameters(&a, 1));
    let expected = weights.len() as u64;
    for found in [weights.len() - 1, weights.len() - 2, 0] {
        let length = BlobError::Length { section: Section::Weights, expected, found: found as u64 };
        assert_eq!(refused(&body(a.clone(), None, &weights[..found])), length);
    }
    for layer in a.layers() {
        for (at, index) in [(layer.weights, 0), (layer.bias, layer.macs())] {
            let kept = [weights[2 * at], weights[2 * at + 1]];
            for bad in [[0x00, 0x7c], [0x00, 0xfc], [0x01, 0x7e]] {
                weights[2 * at..2 * at + 2].copy_from_slice(&bad);
                let error =
                    BlobError::Weight { section: Section::Weights, role: layer.role, index: index as u32 };
                assert_eq!(refused(&body(a.clone(), None, &weights)), error);
            }
            weights[2 * at..2 * at + 2].copy_from_slice(&kept);
        }
    }
    let message = BlobError::Weight { section: Section::Weights, role: Role::Density, index: 3 }.to_string();
    assert!(message.contains("Density") && message.contains('3'));
}

/// Returns the encoded length, or the error, of a scene whose box extends to `reach` along y.
fn reaching(position: SinusoidalEncoding, reach: f32) -> Result<usize, BlobError> {
    let a: Architecture = architecture(position, None, &[(4, false)], &[]);
    let (weights, _) = halve(&parameters(&a, 1));
    let scene = SceneFacts { max: [1.0, reach, 1.0], min: [-1.0; 3], ..SCENE };
    encoded_len(&Body { content: Content::Scene(scene), ..body(a, None, &weights) })
}

#[test]
fn boxes_that_leave_the_encoding_s_domain_are_refused() {
    let one = SinusoidalEncoding { inputs: 3, levels: 10, scale: AngleScale::One, identity: true };
    // The highest level multiplies coordinates by 2^9; the product may be at most 1e5.
    assert!(reaching(one, 195.0).is_ok());
    let found = reaching(one, 196.0).unwrap_err();
    assert_eq!(found, BlobError::EncodingDomain { found: 196.0 * 512.0, limit: 1e5 });
    assert!(found.to_string().contains("100352"), "{found}");
    assert!(reaching(SinusoidalEncoding { levels: 0, ..one }, 1e5).is_ok());
    // An encoding of scale π reduces angles exactly: only an infinite product of 2^9 and a coordinate is refused.
    assert!(reaching(pi(3, 10), 1e30).is_ok());
    let found = reaching(pi(3, 10), 1e37);
    assert_eq!(found, Err(BlobError::EncodingDomain { found: f32::INFINITY, limit: f32::MAX }));
}

#[test]
fn a_scene_that_opens_can_be_planned() {
    let error = scene_refused(|s| (s.near, s.far, s.sampling) = (0.0, 1e-45, SceneSampling::Bins(64)));
    assert_eq!(error, BlobError::Bounds(BoundsError::Range { near: 0.0, far: 1e-45 }));
}

/// Bytes of the first example in `docs/blob-format.md`, up to the weights. Another program made these bytes.
const EXAMPLE: &str = "
    89 4e 45 52 46 0d 0a 1a 07 00 ff fe 00 00 00 00
    cc 00 00 00 00 00 00 00 fd ed 99 4e 00 00 00 00
    00 03 00 01 01 00 01 04 00 01 00 00 00 01 00 00
    80 bf 00 00 80 bf 00 00 80 bf 00 00 80 3f 00 00
    80 3f 00 00 80 3f 00 00 00 40 00 00 c0 40 00 40
    00 00 80 3f 00 00 80 3f 00 00 80 3f 00 01 00 00
    80 40 00 00 00 00 00 00 00 00 00 00 00 00 00 00
    00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00
    80 3f db 0f c9 40 00 00 00 03 66 6f 67 0e 62 6c
    6f 62 2d 66 6f 72 6d 61 74 2e 6d 64 00 00 00 00
    00 24 48
";

#[test]
fn the_example_of_the_specification_is_what_is_written() {
    let a = architecture(pi(3, 0), None, &[(4, false)], &[]);
    assert_eq!(a.parameters(), 36);
    let mut weights = [0; 72];
    weights[41] = 0x3c;
    let viewpoint = Some(Viewpoint { arc: TAU, ..VIEWPOINT });
    let scene = SceneFacts { sampling: SceneSampling::Bins(64), background: [1.0; 3], viewpoint, ..SCENE };
    let provenance =
        Provenance { data: "fog", made_by: "blob-format.md", trained_parameters: 36, ..PROVENANCE };
    let bytes = bytes(&Body { content: Content::Scene(scene), provenance, ..body(a, None, &weights) });
    let example = EXAMPLE.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap());
    let (head, tail) = bytes.split_at(bytes.len() - 73);
    assert!(head.iter().copied().eq(example), "{bytes:02x?}");
    assert_eq!((&tail[..72], tail[72]), (&weights[..], 0), "weights, and no tables");
}

#[test]
fn a_picture_is_what_the_specification_says_after_the_architecture() {
    let a = architecture(pi(2, 0), None, &[(1, false)], &[]);
    let (weights, _) = halve(&parameters(&a, 2));
    let content = Content::Picture(PictureFacts { width: 300, height: 20 });
    let bytes = bytes(&Body { content, ..picture_body(a, &weights) });
    // Sinusoidal position, no direction, one trunk layer of width 1, no density head, no colour layer, shading per
    // sample. Then tag 0 (2D field), the varint of 300, and 20. Then no occupancy grid, no Pareto points, no proposal.
    let expected = [0, 2, 0, 1, 1, 0, 1, 1, 0, 0, 0, 0, 0, 0xac, 0x02, 20, 0, 0, 0];
    assert_eq!(bytes[HEADER_LEN..][..expected.len()], expected);
}
