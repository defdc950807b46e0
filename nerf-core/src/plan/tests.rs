extern crate std;

use super::*;
use crate::blob::{Body, Content, SceneFacts, StoredOccupancy};
use crate::testing::{SCENE, architecture, body, bytes, every_kind, halve, parameters, pi, picture_body};
use std::string::ToString;
use std::vec::Vec;

fn scene(occupancy_required: bool) -> Vec<u8> {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let content = Content::Scene(SceneFacts { occupancy_required, ..SCENE });
    let occupancy = Some(StoredOccupancy { resolution: [1; 3], bits: &[1] });
    bytes(&Body { content, ..body(every_kind(), occupancy, &weights) })
}

fn plan(bytes: &[u8], quality: Quality, batch: Batch) -> Result<Plan<'_>, PlanError> {
    Plan::new(&Blob::open(bytes).unwrap(), &quality, Outputs::ALL, batch)
}

const BATCH: Batch = Batch::FULL;

#[test]
fn a_plan_takes_the_scene_s_own_settings_where_nothing_is_asked() {
    let bytes = scene(false);
    let exact = plan(&bytes, Quality::EXACT, BATCH).unwrap();
    assert_eq!((exact.bins.count(), exact.near, exact.far), (32, 2.0, 6.0));
    assert_eq!(exact.background, SCENE.background);
    assert!(exact.occupancy.is_none(), "no shortcut, no occupancy grid");
    let default = plan(&bytes, Quality { samples: 7, ..Quality::default() }, BATCH).unwrap();
    assert!(default.occupancy.is_some() && default.samples_per_ray() == 7);
}

#[test]
fn requests_that_do_not_go_with_the_scene_are_refused() {
    let bytes = scene(true);
    assert!(plan(&bytes, Quality::default(), BATCH).is_ok());
    assert_eq!(plan(&bytes, Quality::EXACT, BATCH).unwrap_err(), PlanError::OccupancyRequired);
    let quality = Quality { samples: MAX_SAMPLES + 1, ..Quality::default() };
    assert_eq!(plan(&bytes, quality, BATCH).unwrap_err(), PlanError::Samples { found: 4097 });
    for found in [-0.1, 1.0, f32::INFINITY] {
        let quality = Quality { transmittance_cut: found, ..Quality::default() };
        assert_eq!(plan(&bytes, quality, BATCH).unwrap_err(), PlanError::TransmittanceCut { found });
    }
    let quality = Quality { transmittance_cut: f32::NAN, ..Quality::default() };
    assert!(plan(&bytes, quality, BATCH).unwrap_err().to_string().contains("NaN"));
}

#[test]
fn backgrounds_outside_the_gamut_are_refused() {
    let bytes = scene(false);
    let plan = plan(&bytes, Quality::EXACT, BATCH).unwrap();
    assert_eq!(plan.with_background([0.0, 1.0, 0.5]).unwrap().background, [0.0, 1.0, 0.5]);
    for bad in [-0.01, 1.01, f32::NAN] {
        let found = plan.with_background([0.0, bad, 0.5]).unwrap_err();
        assert!(matches!(found, PlanError::Background { .. }) && found.to_string().contains("0..=1"));
    }
}

#[test]
fn batches_of_nothing_or_of_more_than_fits_are_refused() {
    let bytes = scene(false);
    for (rays, samples) in [
        (0, 1),
        (1, 0),
        (1, BLOCK + 1),
        (1, usize::MAX),
        (usize::MAX, 1),
        (usize::MAX - 63, 64),
        (Batch::MAX_RAYS + 1, 64),
    ] {
        let batch = Batch { rays, samples };
        assert_eq!(plan(&bytes, Quality::EXACT, batch).unwrap_err(), PlanError::Batch { found: batch });
    }
    for batch in [Batch::SMALLEST, Batch { rays: Batch::MAX_RAYS, samples: 3 }] {
        assert!(plan(&bytes, Quality::EXACT, batch).is_ok());
    }
}

#[test]
fn a_2d_field_is_not_planned() {
    let a = architecture(pi(2, 8), None, &[(16, false)], &[]);
    let (weights, _) = halve(&parameters(&a, 2));
    let bytes = bytes(&picture_body(a, &weights));
    assert_eq!(plan(&bytes, Quality::EXACT, BATCH).unwrap_err(), PlanError::NotAScene);
}
