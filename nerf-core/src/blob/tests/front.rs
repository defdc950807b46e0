//! The Pareto front: valid points are written and read back, all others refused.

use super::*;
use crate::math::MathBackend;
use std::vec::Vec;

/// A valid point for a Pareto front of the tests' scene.
const POINT: FrontPoint = FrontPoint {
    samples: 32,
    transmittance_cut: 0.0,
    colour_cut: 0.0,
    occupancy: false,
    math: 0,
    proposal: false,
    loss_db: 0.0,
    cost: 1.0,
};

/// A Pareto front of the maximum number of points.
fn longest() -> Vec<FrontPoint> {
    let point = |i: u16| FrontPoint {
        samples: 64 - i,
        transmittance_cut: f32::from(i) / 100.0,
        colour_cut: f32::from(i) / 1000.0,
        math: (i % 4) as u8,
        loss_db: f32::from(i / 2) - 0.5,
        cost: 1.5 / f32::from(1 + i),
        ..POINT
    };
    (0..MAX_FRONT as u16).map(point).collect()
}

/// Returns the error of writing the tests' scene with `points` as its Pareto front.
fn refused_with(points: &[FrontPoint]) -> BlobError {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let front = points.iter().copied().collect();
    refused(&Body { front, ..body(every_kind(), None, &weights) })
}

/// Returns the fault of the second point of a Pareto front. The first point is valid; the second is valid until altered
/// by `change`.
fn fault(change: impl FnOnce(&mut FrontPoint)) -> FrontFault {
    let mut point = FrontPoint { loss_db: 0.1, cost: 0.5, ..POINT };
    change(&mut point);
    match refused_with(&[POINT, point]) {
        BlobError::Front { index: 1, fault } => fault,
        other => panic!("{other}"),
    }
}

#[test]
fn a_front_round_trips_in_order() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    for points in [&longest()[..], &[POINT], &[]] {
        let front = points.iter().copied().collect();
        let bytes = bytes(&Body { front, ..body(every_kind(), None, &weights) });
        assert_eq!(Blob::open(&bytes).unwrap().front(), points);
    }
}

#[test]
fn a_seventeenth_point_is_no_body_of_this_format() {
    // Each point takes 20 bytes: four f32, and four other fields of one byte.
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let points = longest();
    let with = |n: usize| {
        let front = points[..n].iter().copied().collect();
        bytes(&Body { front, ..body(every_kind(), None, &weights) })
    };
    let (most, one_less) = (with(16), with(15));
    assert_eq!(most.len() - one_less.len(), 20);
    let body = &most[HEADER_LEN..];
    let at = body.iter().zip(&one_less[HEADER_LEN..]).position(|(a, b)| a != b).unwrap();
    assert_eq!(body[at], 16, "the length of the sequence");
    let end = at + 1 + 16 * 20;
    let mut longer = body[..end].to_vec();
    longer[at] = 17;
    longer.extend_from_slice(&body[end - 20..]);
    let mut file = header::write(&longer).to_vec();
    file.extend(longer);
    assert_eq!(Blob::open(&file).unwrap_err(), BlobError::Body(Section::Front));
}

#[test]
fn settings_that_cannot_be_planned_are_refused() {
    for found in [0, MAX_SAMPLES + 1] {
        assert_eq!(fault(|p| p.samples = found), FrontFault::Samples { found });
    }
    for found in [-0.1, 1.0, f32::INFINITY] {
        assert_eq!(fault(|p| p.transmittance_cut = found), FrontFault::TransmittanceCut { found });
        assert_eq!(fault(|p| p.colour_cut = found), FrontFault::ColourCut { found });
    }
    assert!(matches!(fault(|p| p.colour_cut = f32::NAN), FrontFault::ColourCut { .. }));
    assert_eq!(fault(|p| p.occupancy = true), FrontFault::Occupancy { found: true });
    assert_eq!(fault(|p| p.proposal = true), FrontFault::Proposal);
    for found in [MathBackend::TAGS, u8::MAX] {
        assert_eq!(fault(|p| p.math = found), FrontFault::Math { found });
    }
}

#[test]
fn an_occupancy_that_is_part_of_the_model_is_in_every_point() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let content = Content::Scene(SceneFacts { occupancy_required: true, ..SCENE });
    let occupancy = Some(StoredOccupancy { resolution: [1; 3], bits: &[1] });
    let body = Body { content, ..body(every_kind(), occupancy, &weights) };
    let with =
        |occupancy| Body { front: [FrontPoint { occupancy, ..POINT }].into_iter().collect(), ..body.clone() };
    assert!(encoded_len(&with(true)).is_ok());
    let fault = FrontFault::Occupancy { found: false };
    assert_eq!(refused(&with(false)), BlobError::Front { index: 0, fault });
}

#[test]
fn losses_and_costs_are_numbers_and_a_front() {
    for found in [f32::INFINITY, f32::NEG_INFINITY] {
        assert_eq!(fault(|p| p.loss_db = found), FrontFault::LossDb { found });
    }
    assert!(matches!(fault(|p| p.loss_db = f32::NAN), FrontFault::LossDb { .. }));
    for found in [0.0, -1.0, f32::INFINITY] {
        assert_eq!(fault(|p| p.cost = found), FrontFault::Cost { found });
    }
    assert!(matches!(fault(|p| p.cost = f32::NAN), FrontFault::Cost { .. }));
    for found in [1.0, 1.5] {
        assert_eq!(fault(|p| p.cost = found), FrontFault::CostOrder { before: 1.0, found });
    }
    assert_eq!(fault(|p| p.loss_db = -0.01), FrontFault::LossOrder { before: 0.0, found: -0.01 });
    let text = refused_with(&[FrontPoint { cost: 0.0, ..POINT }]).to_string();
    assert_eq!(text, "front point 0: cost: expected a finite value above 0, found 0");
}

#[test]
fn a_picture_has_no_front() {
    let a = architecture(pi(2, 8), None, &[(16, false)], &[]);
    let (weights, _) = halve(&parameters(&a, 2));
    let front = [POINT].into_iter().collect();
    let body = Body { front, ..picture_body(a, &weights) };
    assert_eq!(refused(&body), BlobError::Field(Section::Front));
}
