//! The seed network with random weights, and a scene that contains it. The time of a dense frame does not depend on the
//! weights; the time of a frame that skips empty space depends on the occupancy grid.

use super::noise;
use nerf_core::blob::{
    self, Body, Content, FrontPoint, Provenance, SceneFacts, SceneSampling, StoredOccupancy,
};
use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
use nerf_core::network::{Architecture, DensityActivation, Scratch, Shading, TrunkLayer};
use nerf_core::{Camera, Intrinsics, Lens, Pose};

/// Number of cells of the occupancy grid along each axis.
const CELLS: u16 = 96;

/// Sinusoidal encoding of 3 inputs with `levels` levels. The scale `s` is π, and the inputs themselves are encoded,
/// too.
pub const fn pi(levels: u8) -> SinusoidalEncoding {
    SinusoidalEncoding { inputs: 3, levels, scale: AngleScale::Pi, identity: true }
}

/// Architecture of the seed network: 8 trunk layers of 256, with the encoded position appended after four layers; 10
/// levels of position encoding and 4 of direction encoding; a colour layer of 128.
pub fn seed() -> Architecture {
    Architecture {
        position: pi(10).into(),
        direction: Some(pi(4).into()),
        trunk: (0..8).map(|i| TrunkLayer { width: 256, skip: i == 4 }).collect(),
        density: Some(DensityActivation::Relu),
        colour: [128].into_iter().collect(),
        shading: Shading::PerSample,
    }
}

/// Random parameters as large as those of a fitted network: weights of standard deviation √(2 / inputs) (He), biases
/// around 0.1.
pub fn parameters(architecture: &Architecture) -> Vec<f32> {
    let mut all = noise(architecture.parameters(), 1);
    for layer in &architecture.layers() {
        let scale = (6.0 / layer.inputs() as f32).sqrt();
        all[layer.weights..layer.bias].iter_mut().for_each(|w| *w *= scale);
        all[layer.bias..layer.bias + layer.outputs].iter_mut().for_each(|b| *b = 0.1 + 0.1 * *b);
    }
    all
}

/// Returns [`parameters`] as little-endian f16.
pub fn halves(architecture: &Architecture) -> Vec<u8> {
    let halves = parameters(architecture).into_iter().map(half::f16::from_f32);
    halves.flat_map(|h| h.to_le_bytes()).collect()
}

/// Blob of the seed network in a box so large that it contains all samples of [`camera`]'s rays. In the occupancy grid,
/// a spherical shell is occupied, 3.2 % of the cells, as in a scene fitted with an occupancy grid.
pub fn file() -> Vec<u8> {
    let architecture = seed();
    let weights = halves(&architecture);
    let side = usize::from(CELLS);
    let mut bits = vec![0u8; StoredOccupancy::bytes([CELLS; 3])];
    for cell in 0..side.pow(3) {
        let centre = |i: usize| (i as f32 + 0.5) / f32::from(CELLS) * 2.0 - 1.0;
        let (x, y, z) = (centre(cell / side / side), centre(cell / side % side), centre(cell % side));
        let radius = (x * x + y * y + z * z).sqrt();
        if (0.33..0.46).contains(&radius) {
            bits[cell / 8] |= 1 << (cell % 8);
        }
    }
    let body = Body {
        content: Content::Scene(SceneFacts {
            min: [-6.0; 3],
            max: [6.0; 3],
            near: 2.0,
            far: 6.0,
            sampling: SceneSampling::Bins(64),
            background: [0.0; 3],
            occupancy_required: false,
            viewpoint: None,
        }),
        occupancy: Some(StoredOccupancy { resolution: [CELLS; 3], bits: &bits }),
        front: [(64, 0.0, 1.0), (32, 1.0, 0.5), (16, 3.0, 0.25)].map(point).into_iter().collect(),
        proposal: None,
        provenance: Provenance {
            data: "noise",
            made_by: "benches",
            seed: 1,
            trained_parameters: architecture.parameters() as u32,
            ..Provenance::NONE
        },
        architecture,
        weights: &weights,
        tables: None,
    };
    let mut file = vec![0; blob::encoded_len(&body).expect("a valid body")];
    blob::write(&body, &mut file).expect("a valid body");
    file
}

/// Makes a point of an invented Pareto front from its number of samples, PSNR loss in dB and relative cost.
fn point((samples, loss_db, cost): (u16, f32, f32)) -> FrontPoint {
    FrontPoint {
        samples,
        transmittance_cut: 1e-2,
        colour_cut: 1e-3,
        occupancy: true,
        math: 0,
        proposal: false,
        loss_db,
        cost,
    }
}

/// Camera that looks at the middle of the scene of [`file`]; the image has `side` × `side` pixels.
pub fn camera(side: u32) -> Camera {
    let pose = Pose::look_at([2.4, 1.6, 2.8].into(), [0.0; 3].into(), [0.0, 1.0, 0.0].into());
    let intrinsics = Intrinsics::centred(side, side, 1.39 * side as f32);
    Camera::new(intrinsics, Lens::NONE, pose.expect("a pose")).expect("a camera")
}

/// Buffers for the activations of one block of `stride` samples.
pub struct Activations {
    stride: usize,
    encoded: Vec<f32>,
    front: Vec<f32>,
    back: Vec<f32>,
}

impl Activations {
    /// Allocates the buffers of a block of `stride` samples. `encoded_rows`: number of encoded inputs.
    /// `activation_rows`: largest number of activations of a layer.
    pub fn new(stride: usize, encoded_rows: usize, activation_rows: usize) -> Self {
        let activation = vec![0.0; activation_rows * stride];
        Self {
            stride,
            encoded: vec![0.0; encoded_rows * stride],
            front: activation.clone(),
            back: activation,
        }
    }

    /// Borrows the buffers as the scratch memory of a network.
    pub fn scratch(&mut self) -> Scratch<'_> {
        Scratch {
            stride: self.stride,
            encoded: &mut self.encoded,
            front: &mut self.front,
            back: &mut self.back,
        }
    }
}
