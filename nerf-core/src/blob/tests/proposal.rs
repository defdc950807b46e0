//! Tests that the proposal network is checked by the same rules as the scene's network.

use super::*;
use crate::network::{DensityActivation, TrunkLayer};
use std::vec::Vec;

/// A proposal network whose shape differs from the scene's network.
fn coarse(weights: &[u8]) -> Proposal<'_> {
    Proposal {
        position: SinusoidalEncoding { inputs: 3, levels: 6, scale: AngleScale::One, identity: false },
        trunk: [(8, false), (12, true)].map(|(width, skip)| TrunkLayer { width, skip }).into_iter().collect(),
        density: DensityActivation::ShiftedSoftplus,
        samples: 24,
        weights,
    }
}

/// Weights of the trunk and density head of the proposal network, little-endian f16.
fn coarse_weights() -> Vec<u8> {
    let a = coarse(&[]).architecture();
    let (mut weights, _) = halve(&parameters(&a, 3));
    weights.truncate(2 * a.density_parameters());
    weights
}

fn refused_with(proposal: Proposal<'_>) -> BlobError {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    refused(&Body { proposal: Some(proposal), ..body(every_kind(), None, &weights) })
}

#[test]
fn a_proposal_round_trips_without_colours() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let coarse_weights = coarse_weights();
    // Parameters with 36 encoded inputs: first layer 36 x 8 + 8, second (8 + 36) x 12 + 12, density head 12 + 1.
    assert_eq!(coarse_weights.len(), 2 * (296 + 540 + 13));
    let proposal = coarse(&coarse_weights);
    let bytes = bytes(&Body { proposal: Some(proposal.clone()), ..body(every_kind(), None, &weights) });
    for shift in 0..4 {
        let mut moved = vec![0; shift];
        moved.extend(&bytes);
        let blob = Blob::open(&moved[shift..]).unwrap();
        assert_eq!(blob.proposal(), Some(&proposal));
        assert_eq!(blob.weights(), &weights);
    }
}

#[test]
fn architectures_outside_the_caps_are_refused_by_name() {
    let weights = coarse_weights();
    let mut flat = coarse(&weights);
    flat.position.inputs = 2;
    let inputs = ArchitectureError::EncodingInputs { field: "position", expected: 3, found: 2 };
    let error = refused_with(flat);
    assert_eq!(error, BlobError::ProposalArchitecture(inputs));
    assert_eq!(error.to_string(), "proposal: position encoding: expected 3 inputs, found 2");
    let mut empty = coarse(&weights);
    empty.trunk.clear();
    assert_eq!(refused_with(empty), BlobError::ProposalArchitecture(ArchitectureError::NoTrunk));
}

#[test]
fn samples_of_a_proposal_can_be_planned() {
    let weights = coarse_weights();
    let (fine, _) = halve(&parameters(&every_kind(), 1));
    for sampling in [SceneSampling::March(0.1), SceneSampling::Contracted { step: 0.1, power: 1 }] {
        if matches!(sampling, SceneSampling::Contracted { .. }) && !cfg!(feature = "contraction") {
            continue;
        }
        let content = Content::Scene(SceneFacts { sampling, ..SCENE });
        let error =
            refused(&Body { content, proposal: Some(coarse(&weights)), ..body(every_kind(), None, &fine) });
        assert_eq!(error, BlobError::Field(Section::ProposalSamples));
    }
    for samples in [0, MAX_SAMPLES + 1] {
        let error = refused_with(Proposal { samples, ..coarse(&weights) });
        assert_eq!(error, BlobError::Field(Section::ProposalSamples));
        assert_eq!(
            error.to_string(),
            "proposal.samples: expected 1 to 4096 samples, in bins that f32 tells apart, of a scene with bins, found otherwise"
        );
    }
}

#[test]
fn the_scene_box_is_in_the_domain_of_both_encodings() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let coarse_weights = coarse_weights();
    let proposal = Some(coarse(&coarse_weights));
    let reaching = |reach| {
        let content = Content::Scene(SceneFacts { max: [reach; 3], ..SCENE });
        encoded_len(&Body { content, proposal: proposal.clone(), ..body(every_kind(), None, &weights) })
    };
    // The proposal's encoding (scale 1, 6 levels) requires 2^5 x <= 1e5. The scene's own encoding has no such limit.
    assert!(reaching(3125.0).is_ok());
    let error = BlobError::EncodingDomain { found: 3126.0 * 32.0, limit: 1e5 };
    assert_eq!(reaching(3126.0), Err(error));
}

#[test]
fn weights_of_a_proposal_are_as_many_as_its_densities_need_and_finite() {
    let weights = coarse_weights();
    let expected = weights.len() as u64;
    let mut longer = weights.clone();
    longer.extend([0; 2]);
    for found in [&weights[..weights.len() - 2], &weights[..weights.len() - 1], &longer, &[]] {
        let (section, found_len) = (Section::ProposalWeights, found.len() as u64);
        let error = BlobError::Length { section, expected, found: found_len };
        assert_eq!(refused_with(coarse(found)), error);
    }
    let architecture = coarse(&[]).architecture();
    for layer in architecture.layers().iter().filter(|layer| layer.role != Role::Rgb) {
        let mut bad = weights.clone();
        bad[2 * layer.bias..2 * layer.bias + 2].copy_from_slice(&[0x00, 0x7c]);
        let error = refused_with(coarse(&bad));
        let index = layer.macs() as u32;
        assert_eq!(error, BlobError::Weight { section: Section::ProposalWeights, role: layer.role, index });
        assert!(error.to_string().contains("proposal.weights"), "{error}");
    }
}

#[test]
fn a_picture_has_no_proposal() {
    let a = architecture(pi(2, 8), None, &[(16, false)], &[]);
    let (weights, _) = halve(&parameters(&a, 2));
    let coarse_weights = coarse_weights();
    let body = Body { proposal: Some(coarse(&coarse_weights)), ..picture_body(a, &weights) };
    assert_eq!(refused(&body), BlobError::Field(Section::Proposal));
}
