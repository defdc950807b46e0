//! A coarse network beside the fine one: its densities become the scene's proposal.

use super::made::{Checkpoint, Shape};
use super::{read, wide};
use crate::tools::data;
use nerf_core::blob::{Blob, Content, Provenance};
use nerf_core::network::Role;
use nerf_train::measure::import::Imported;
use nerf_train::measure::import::Settings;
use nerf_train::measure::import::Tensors;
use nerf_train::model::export::Coarse;
use nerf_train::model::export::Contents;
use nerf_train::model::export::ExportError;
use nerf_train::model::export::Exported;
use nerf_train::model::export::Tables;
use nerf_train::model::export::export;
use nerf_train::model::export::export_with;
use safetensors::Dtype;
use std::path::Path;

/// The blob of a network, alone or with a coarse one.
fn exported(
    fine: &Imported,
    coarse: Option<&Imported>,
    settings: &Settings,
) -> Result<Exported, ExportError> {
    let parameters = fine.folded();
    let contents = Contents {
        architecture: &fine.model.architecture,
        parameters: &parameters,
        tables: Tables::None,
        content: Content::Scene(settings.facts(false, false)),
        occupancy: None,
        provenance: Provenance { data: "", made_by: "", ..Provenance::NONE },
    };
    let Some(coarse) = coarse else { return export(&contents) };
    let parameters = coarse.folded();
    let architecture = &coarse.model.architecture;
    export_with(&contents, Some(&Coarse { architecture, parameters: &parameters, samples: 24 }))
}

/// The proposal is what the coarse network is as a scene of its own, up to its heads of colour.
fn assert_proposal(fine: &Imported, coarse: &Imported, what: &str) {
    let together = exported(fine, Some(coarse), &wide()).expect("a blob").bytes;
    let alone = exported(coarse, None, &wide()).expect("a blob").bytes;
    let (together, alone) = (Blob::open(&together).expect("a blob"), Blob::open(&alone).expect("a blob"));
    let proposal = together.proposal().expect("a proposal");
    assert_eq!(proposal.samples, 24);
    let (found, expected) = (proposal.architecture(), alone.architecture());
    assert_eq!(
        (&found.position, &found.trunk, found.density),
        (&expected.position, &expected.trunk, expected.density)
    );
    assert_eq!((found.direction, found.colour.len()), (None, 0));
    let layers = alone.layers();
    let density = layers.iter().find(|layer| layer.role == Role::Density).expect("a head");
    assert_eq!(proposal.weights, &alone.weights()[..2 * (density.bias + 1)], "{what}");
    let fine = exported(fine, None, &wide()).expect("a blob").bytes;
    let fine = Blob::open(&fine).expect("a blob");
    assert_eq!(
        (together.weights(), together.architecture()),
        (fine.weights(), fine.architecture()),
        "{what}"
    );
    assert!(fine.proposal().is_none());
}

#[test]
fn the_proposal_has_the_densities_of_the_coarse_network_and_nothing_else_of_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let made = |name: &str, shape: Shape, seed| {
        read(&shape.checkpoint(seed).npz(&folder.path().join(name), "<f4"), &wide())
    };
    let small = Shape::small();
    let fine = made("fine.npz", small.clone(), 1);
    for (what, shape) in [
        ("the same shape", small.clone()),
        ("another depth and encoding", Shape { trunk: vec![9, 7], position: 3 + 6 * 4, ..small.clone() }),
        ("no directions", Shape { direction: None, ..small.clone() }),
        ("deep colours", Shape { views: vec![8, 7, 6], ..small }),
    ] {
        assert_proposal(&fine, &made("coarse.npz", shape, 2), what);
    }
}

#[test]
fn the_original_coarse_network_becomes_the_proposal_of_the_fine_one() {
    let Some(nets) = data("nets") else { return };
    // That the coarse network alone answers as the original code did, `reference.rs` shows.
    let [coarse, fine] =
        ["coarse", "fine"].map(|it| read(&nets.join(format!("lego_200k_{it}.npz")), &wide()));
    assert_proposal(&fine, &coarse, "lego");
}

#[test]
fn a_weight_that_does_not_fit_is_said_to_be_the_coarse_network_s() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("coarse.npz");
    let fine = read(&Shape::small().checkpoint(1).npz(&path, "<f4"), &wide());
    let spoilt = |name: &str| {
        let mut checkpoint = Shape::small().checkpoint(2);
        checkpoint.0.get_mut(name).expect("a tensor").1[0] = 70_000.0;
        read(&checkpoint.npz(&path, "<f4"), &wide())
    };
    let error = exported(&fine, Some(&spoilt("alpha_linear.bias")), &wide()).expect_err("too large");
    assert_eq!(error, ExportError::CoarseWeight { role: Role::Density, index: 10, found: 70_000.0 });
    assert!(error.to_string().contains("coarse network") && error.to_string().contains("70000"), "{error}");
    // What is not used is not asked to fit.
    assert!(exported(&fine, Some(&spoilt("rgb_linear.bias")), &wide()).is_ok());
}

#[test]
fn of_a_file_of_both_each_is_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let (coarse, fine) = (Shape::small().checkpoint(1), Shape::small().checkpoint(2));
    let both = |a: &str, b: &str| -> Checkpoint {
        Checkpoint(coarse.prefixed(a).0.into_iter().chain(fine.prefixed(b).0).collect())
    };
    let write =
        |checkpoint: Checkpoint| checkpoint.safetensors(&folder.path().join("both.safetensors"), Dtype::F32);
    let file = write(both("network_fn.", "network_fine."));
    let prefix = |tensors: Tensors| (tensors.prefix, tensors.others);
    let (a, b) = ("network_fn.".to_owned(), "network_fine.".to_owned());
    assert_eq!(prefix(Tensors::read(&file, None).expect("fine")), (b.clone(), vec![a.clone()]));
    assert_eq!(prefix(Tensors::read_coarse(&file, None).expect("coarse")), (a, vec![b.clone()]));
    assert_eq!(prefix(Tensors::read_coarse(&file, Some("network_fine.")).expect("as asked")).0, b);
    // Neither is called fine: a coarse one must be named.
    let file: &Path = &write(both("a.", "b."));
    let error = Tensors::read_coarse(file, None).expect_err("two").to_string();
    assert!(error.contains("`a.`, `b.`"), "{error}");
    assert_eq!(Tensors::read_coarse(file, Some("a.")).expect("named").prefix, "a.");
}
