extern crate std;

use super::*;
use crate::blob::{Body, Content, SceneFacts, StoredOccupancy};
use crate::plan::{Batch, Outputs, Plan};
use crate::testing::{SCENE, body, bytes, every_kind, halve, parameters};
use std::vec::Vec;

/// A blob whose Pareto front has the given points (loss, cost). Point `i` has 40 − `i` samples, which identify the
/// point.
fn scene(points: &[(f32, f32)]) -> Vec<u8> {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let point = |(i, &(loss_db, cost))| FrontPoint {
        samples: 40 - i as u16,
        transmittance_cut: 0.01,
        colour_cut: 0.001,
        occupancy: false,
        math: MathBackend::Recurrence.tag(),
        proposal: false,
        loss_db,
        cost,
    };
    let front = points.iter().enumerate().map(point).collect();
    bytes(&Body { front, ..body(every_kind(), None, &weights) })
}

/// Index of the chosen point on the front, and [`Choice::within`].
fn which(choice: Option<Choice>) -> Option<(u16, bool)> {
    choice.map(|choice| (40 - choice.quality.samples, choice.within))
}

const FRONT: [(f32, f32); 5] = [(-0.02, 1.2), (0.005, 0.6), (0.005, 0.5), (0.2, 0.3), (2.0, 0.1)];

#[test]
fn a_limit_of_loss_gives_the_cheapest_point_within_it() {
    let bytes = scene(&FRONT);
    let blob = Blob::open(&bytes).unwrap();
    for (db, expected) in [
        (f32::INFINITY, (4, true)),
        (2.0, (4, true)),
        (1.9, (3, true)),
        (0.005, (2, true)),
        (0.0, (0, true)),
        (-0.02, (0, true)),
        (-0.03, (0, false)),
        (f32::NEG_INFINITY, (0, false)),
        (f32::NAN, (0, false)),
    ] {
        assert_eq!(which(Quality::within_loss(&blob, db)), Some(expected), "{db} dB");
    }
    let choice = Quality::within_loss(&blob, 0.3).unwrap();
    assert_eq!((choice.loss_db, choice.cost), (0.2, 0.3));
    assert_eq!(choice.quality.math, MathBackend::Recurrence);
    assert_eq!((choice.quality.transmittance_cut, choice.quality.colour_cut), (0.01, 0.001));
}

#[test]
fn a_limit_of_cost_gives_the_best_point_within_it() {
    let bytes = scene(&FRONT);
    let blob = Blob::open(&bytes).unwrap();
    for (ratio, expected) in [
        (f32::INFINITY, (0, true)),
        (1.2, (0, true)),
        // Two points have the same loss; the cheaper is chosen.
        (1.0, (2, true)),
        (0.55, (2, true)),
        (0.3, (3, true)),
        (0.2, (4, true)),
        (0.05, (4, false)),
        (-1.0, (4, false)),
        (f32::NAN, (4, false)),
    ] {
        assert_eq!(which(Quality::within_cost(&blob, ratio)), Some(expected), "ratio {ratio}");
    }
}

#[test]
fn presets_lose_no_more_than_they_say() {
    let bytes = scene(&FRONT);
    let blob = Blob::open(&bytes).unwrap();
    let samples = Preset::ALL.map(|preset| Quality::preset(&blob, preset).samples);
    assert_eq!(samples, [40, 38, 38, 37, 37]);
    // No point meets the limits of `Exact` and `High`: these presets become the exact rendering.
    let bytes = scene(&[(0.05, 0.8), (0.5, 0.2)]);
    let blob = Blob::open(&bytes).unwrap();
    for preset in [Preset::Exact, Preset::High] {
        assert_eq!(Quality::preset(&blob, preset), Quality::EXACT);
    }
    let samples =
        [Preset::Balanced, Preset::Fast, Preset::Preview].map(|p| Quality::preset(&blob, p).samples);
    assert_eq!(samples, [40, 40, 39]);
    assert!(Preset::ALL.windows(2).all(|pair| pair[0].loss_db() < pair[1].loss_db()));
}

#[test]
fn without_a_front_there_is_no_choice_and_presets_are_rules_of_thumb() {
    let bytes = scene(&[]);
    let blob = Blob::open(&bytes).unwrap();
    assert_eq!(Quality::within_loss(&blob, 1.0), None);
    assert_eq!(Quality::within_cost(&blob, 1.0), None);
    assert_eq!(Quality::preset(&blob, Preset::Exact), Quality::EXACT);
    assert_eq!(Quality::preset(&blob, Preset::High), Quality::default());
    let [balanced, fast, preview] =
        [Preset::Balanced, Preset::Fast, Preset::Preview].map(|preset| Quality::preset(&blob, preset));
    let cuts = |quality: &Quality| (quality.transmittance_cut, quality.colour_cut, quality.samples);
    assert_eq!([&balanced, &fast].map(cuts), [(0.03, 0.03, 0), (0.1, 0.03, 0)]);
    // Four fifths of the scene's 32 samples, rounded up.
    assert_eq!(cuts(&preview), (0.1, 0.1, 26));
    for quality in [balanced, fast, preview] {
        assert!(quality.occupancy && Plan::new(&blob, &quality, Outputs::ALL, Batch::SMALLEST).is_ok());
    }
}

#[test]
fn exact_can_be_planned_where_the_occupancy_is_part_of_the_model() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let content = Content::Scene(SceneFacts { occupancy_required: true, ..SCENE });
    let occupancy = Some(StoredOccupancy { resolution: [1; 3], bits: &[1] });
    let bytes = bytes(&Body { content, ..body(every_kind(), occupancy, &weights) });
    let blob = Blob::open(&bytes).unwrap();
    let exact = Quality::preset(&blob, Preset::Exact);
    assert_eq!(exact, Quality { occupancy: true, ..Quality::EXACT });
    assert!(Plan::new(&blob, &exact, Outputs::ALL, Batch::SMALLEST).is_ok());
}

#[test]
fn a_front_point_says_what_settings_mean_in_the_scene_and_can_be_written() {
    let plain = scene(&[]);
    let blob = Blob::open(&plain).unwrap();
    let quality = Quality::default();
    let point = quality.front_point(&blob, 0.1, 0.5);
    // The scene has no occupancy grid, no proposal network and 32 samples.
    assert_eq!((point.samples, point.occupancy, point.proposal), (32, false, false));
    assert_eq!((point.loss_db, point.cost), (0.1, 0.5));
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let front = [point].into_iter().collect();
    let written = bytes(&Body { front, ..body(every_kind(), None, &weights) });
    let choice = Quality::within_loss(&Blob::open(&written).unwrap(), 0.1).unwrap();
    let expected = Quality { samples: 32, occupancy: false, proposal: false, ..quality };
    assert_eq!((choice.quality, choice.within), (expected, true));
}

#[test]
fn points_of_absent_backends_are_passed_over() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let point = |math: u8| FrontPoint {
        samples: 1 + u16::from(math),
        transmittance_cut: 0.0,
        colour_cut: 0.0,
        occupancy: false,
        math,
        proposal: false,
        loss_db: f32::from(math),
        cost: 1.0 / f32::from(1 + math),
    };
    let front = (0..MathBackend::TAGS).map(point).collect();
    let bytes = bytes(&Body { front, ..body(every_kind(), None, &weights) });
    let blob = Blob::open(&bytes).unwrap();
    for tag in 0..MathBackend::TAGS {
        let choice = Quality::within_loss(&blob, f32::from(tag)).unwrap();
        let known = (0..=tag).rev().find(|&tag| MathBackend::from_tag(tag).is_some());
        assert_eq!(choice.quality.math.tag(), known.unwrap());
    }
}
