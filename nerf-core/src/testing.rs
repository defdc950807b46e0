//! Small networks and blobs for the unit tests.

extern crate std;

use crate::Kernel;
use crate::blob::{
    self, Body, Content, ParetoFront, PictureFacts, Provenance, SceneFacts, SceneSampling, StoredOccupancy,
};
use crate::encoding::{AngleScale, PositionEncoding, SinusoidalEncoding};
use crate::network::{Architecture, DensityActivation, Shading, TrunkLayer};
use std::vec;
use std::vec::Vec;

/// Makes a sinusoidal encoding of scale π: the outputs are the inputs `x` themselves, then sine and cosine of `2^k π x`
/// for each level `k`.
pub const fn pi(inputs: u8, levels: u8) -> SinusoidalEncoding {
    SinusoidalEncoding { inputs, levels, scale: AngleScale::Pi, identity: true }
}

/// Makes a network architecture: a radiance field, with a density head, if `position` has 3 inputs; else a 2D field.
/// `trunk`: width of each layer, and whether the layer is a skip layer. `colour`: widths of the colour layers.
pub fn architecture(
    position: impl Into<PositionEncoding>,
    direction: Option<SinusoidalEncoding>,
    trunk: &[(u16, bool)],
    colour: &[u16],
) -> Architecture {
    let position = position.into();
    Architecture {
        density: (position.inputs() == 3).then_some(DensityActivation::Relu),
        position,
        direction: direction.map(Into::into),
        trunk: trunk.iter().map(|&(width, skip)| TrunkLayer { width, skip }).collect(),
        colour: colour.iter().copied().collect(),
        shading: Shading::PerSample,
    }
}

/// Architecture of a small scene network with every kind of layer, such as a skip layer and a colour branch.
pub fn every_kind() -> Architecture {
    architecture(pi(3, 4), Some(pi(3, 2)), &[(24, false), (20, false), (17, true)], &[12, 9])
}

/// Error bound for tests with `kernel`: `exact`, but at least 0.01 if the kernel rounds weights and activations to bf16
/// (8 significant bits).
pub fn tolerance(kernel: Kernel, exact: f64) -> f64 {
    if kernel.rounds() { exact.max(1e-2) } else { exact }
}

/// Comparison of errors that treats NaN as the largest error.
pub trait Worse: Sized {
    /// Returns the larger of two errors. NaN counts as larger than any number, whereas `max` would drop it.
    fn worse(self, other: Self) -> Self;
}

impl<T: Copy + PartialOrd + Into<f64>> Worse for T {
    fn worse(self, other: Self) -> Self {
        let is_nan = other.into().is_nan();
        if other > self || is_nan { other } else { self }
    }
}

#[test]
fn what_is_no_number_is_worst() {
    assert_eq!([1.0f32, 3.0, 2.0].into_iter().fold(0.0, Worse::worse), 3.0);
    for all in [[f64::NAN, 1.0, 2.0], [1.0, f64::NAN, 2.0], [1.0, 2.0, f64::NAN]] {
        assert!(all.into_iter().fold(0.0, Worse::worse).is_nan(), "{all:?}");
    }
}

/// `n` reproducible pseudo-random values in [-1, 1).
pub fn noise(n: usize, seed: u32) -> Vec<f32> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 8_388_608.0 - 1.0
    };
    (0..n).map(|_| next()).collect()
}

/// Random parameters of the magnitude of trained ones: weights with He's standard deviation, biases around 0.1.
pub fn parameters(architecture: &Architecture, seed: u32) -> Vec<f32> {
    let mut all = noise(architecture.parameters(), seed);
    for layer in &architecture.layers() {
        let scale = (6.0 / layer.inputs() as f32).sqrt();
        all[layer.weights..layer.bias].iter_mut().for_each(|w| *w *= scale);
        all[layer.bias..layer.bias + layer.outputs].iter_mut().for_each(|b| *b = 0.1 + 0.1 * *b);
    }
    all
}

/// Rounds parameters to f16. Returns the rounded values twice: as the bytes of little-endian f16, and as f32.
pub fn halve(parameters: &[f32]) -> (Vec<u8>, Vec<f32>) {
    let halves = parameters.iter().map(|&p| half::f16::from_f32(p));
    (halves.clone().flat_map(|h| h.to_le_bytes()).collect(), halves.map(|h| h.to_f32()).collect())
}

/// The scene of the tests: box `[-1, 1]³`, near 2, far 6, 32 bins.
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

/// Image size of the 2D field that the tests use.
pub const PICTURE: PictureFacts = PictureFacts { width: 30, height: 20 };

pub const PROVENANCE: Provenance<'static> =
    Provenance { data: "none", made_by: "unit tests", ..Provenance::NONE };

/// Makes a blob body for [`SCENE`], without proposal network, Pareto front and tables.
pub fn body<'a>(
    architecture: Architecture,
    occupancy: Option<StoredOccupancy<'a>>,
    weights: &'a [u8],
) -> Body<'a> {
    Body {
        architecture,
        content: Content::Scene(SCENE),
        occupancy,
        front: ParetoFront::new(),
        proposal: None,
        provenance: PROVENANCE,
        weights,
        tables: None,
    }
}

/// Makes a blob body for a 2D field with the image size [`PICTURE`].
pub fn picture_body(architecture: Architecture, weights: &[u8]) -> Body<'_> {
    Body { content: Content::Picture(PICTURE), ..body(architecture, None, weights) }
}

/// Encodes `body` as a blob and returns the blob's bytes.
pub fn bytes(body: &Body<'_>) -> Vec<u8> {
    let mut out = vec![0; blob::encoded_len(body).unwrap()];
    blob::write(body, &mut out).unwrap();
    out
}
