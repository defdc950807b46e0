//! Tests of blobs that need a feature which the build lacks.

use super::*;

#[test]
fn what_a_build_lacks_is_named_by_field_and_feature() {
    use ArchitectureError as E;
    for (error, field, feature) in [
        (BlobError::NotBuilt { feature: "grid" }, "architecture.position", "grid"),
        (BlobError::NotBuilt { feature: "contraction" }, "scene.sampling", "contraction"),
        (BlobError::Architecture(E::HarmonicsNotBuilt), "direction encoding", "grid"),
        (BlobError::Architecture(E::PerRayNotBuilt), "shading", "grid"),
    ] {
        let said = error.to_string();
        assert!(said.contains(&format!("{field}: expected a build with the feature `{feature}`")), "{said}");
        assert!(said.ends_with("found one without"), "{said}");
    }
}

#[cfg(not(feature = "contraction"))]
#[test]
fn an_unbounded_scene_says_what_the_build_lacks() {
    let error = scene_refused(|s| s.sampling = SceneSampling::Contracted { step: 0.01, power: 1 });
    assert_eq!(error, BlobError::NotBuilt { feature: "contraction" });
}

#[cfg(not(feature = "grid"))]
#[test]
fn networks_made_for_grids_say_what_the_build_lacks() {
    use crate::{encoding::DirectionEncoding, network::Shading};
    use ArchitectureError as E;
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let direction = Some(DirectionEncoding::SphericalHarmonics { degree: 4 });
    for (a, error) in [
        (Architecture { shading: Shading::PerRay, ..every_kind() }, E::PerRayNotBuilt),
        (Architecture { direction, ..every_kind() }, E::HarmonicsNotBuilt),
    ] {
        assert_eq!(refused(&body(a, None, &weights)), BlobError::Architecture(error));
    }
}
