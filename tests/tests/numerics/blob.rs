//! Scene files of networks that a case makes itself.

use nerf_core::blob::{
    Body, Content, ParetoFront, Provenance, SceneFacts, SceneSampling, encoded_len, write,
};
use nerf_core::network::Architecture;

/// Box, sampling and background of [`body`].
pub const SCENE: SceneFacts = SceneFacts {
    min: [-1.0; 3],
    max: [1.0; 3],
    near: 2.0,
    far: 6.0,
    sampling: SceneSampling::Bins(32),
    background: [0.25, 0.5, 1.0],
    occupancy_required: false,
    viewpoint: None,
};

/// Returns a scene without occupancy grid and proposal network.
pub fn body<'a>(architecture: Architecture, weights: &'a [u8]) -> Body<'a> {
    Body {
        content: Content::Scene(SCENE),
        architecture,
        occupancy: None,
        front: ParetoFront::new(),
        proposal: None,
        provenance: Provenance { data: "none", made_by: "nerf-tests", ..Provenance::NONE },
        weights,
        tables: None,
    }
}

/// Returns the scene file of [`body`].
pub fn bytes(architecture: &Architecture, weights: &[u8]) -> Vec<u8> {
    let body = body(architecture.clone(), weights);
    let mut blob = vec![0; encoded_len(&body).expect("a valid body")];
    write(&body, &mut blob).expect("a valid body");
    blob
}

/// Returns parameters as little-endian f16. `value` gives the bits of each from its layer, row and column; without a
/// column, of the row's bias.
pub fn weights(shape: &Architecture, value: impl Fn(usize, usize, Option<usize>) -> u16) -> Vec<u8> {
    let mut all = Vec::new();
    for (index, layer) in shape.layers().iter().enumerate() {
        for row in 0..layer.outputs {
            (0..layer.inputs()).for_each(|column| all.extend(value(index, row, Some(column)).to_le_bytes()));
        }
        (0..layer.outputs).for_each(|row| all.extend(value(index, row, None).to_le_bytes()));
    }
    all
}
