//! What the commands say of the blob of a picture (a 2D field).

use super::made::Folder;
use super::{fails, has, ok};
use nerf_core::blob::{Content, PictureFacts, Provenance};
use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
use nerf_core::network::{Architecture, Shading, TrunkLayer};
use nerf_train::model::export::Contents;
use nerf_train::model::export::Tables;
use nerf_train::model::export::export;

/// A grey picture of 30×20 pixels: 2×4 + 4 parameters in the trunk, 4×3 + 3 in rgb.
fn blob() -> Vec<u8> {
    let architecture = Architecture {
        position: SinusoidalEncoding { inputs: 2, levels: 0, scale: AngleScale::Pi, identity: true }.into(),
        direction: None,
        trunk: [TrunkLayer { width: 4, skip: false }].into_iter().collect(),
        density: None,
        colour: [].into_iter().collect(),
        shading: Shading::PerSample,
    };
    let provenance = Provenance { data: "grey", made_by: "test", trained_parameters: 27, ..Provenance::NONE };
    let contents = Contents {
        architecture: &architecture,
        parameters: &[0.0; 27],
        tables: Tables::None,
        content: Content::Picture(PictureFacts { width: 30, height: 20 }),
        occupancy: None,
        provenance,
    };
    export(&contents).expect("a blob").bytes
}

#[test]
fn inspect_says_how_large_a_picture_was_and_nothing_of_scenes() {
    let folder = Folder::new();
    let file = folder.file("grey.nerf", blob());
    let said = ok(["inspect", &file]);
    for (field, value) in [
        ("kind", "2D field"),
        ("width_px", "30"),
        ("height_px", "20"),
        ("density_macs", "8"),
        ("colour_macs", "12"),
    ] {
        assert!(has(&said, field, value), "{field}: {said}");
    }
    for word in ["box", "near", "background", "occupancy"] {
        assert!(!said.contains(word), "{word}: {said}");
    }
}

#[test]
fn a_picture_is_not_evaluated_on_views_of_a_scene() {
    let folder = Folder::new();
    let (file, views) = (folder.file("grey.nerf", blob()), folder.npz("scene.npz"));
    fails(["eval", &file, &views], &["expected a scene, found a 2D field"]);
}
