//! Small scenes and 2D fields with pseudo-random weights.

use crate::noise::signed;
use nerf_core::Kernel;
use nerf_core::blob::{
    Blob, Body, Content, FrontPoint, ParetoFront, PictureFacts, Proposal, Provenance, SceneFacts,
    SceneSampling, StoredOccupancy, StoredTables, Viewpoint, encode_tables, encoded_len, write,
};
use nerf_core::camera::Lens;
use nerf_core::camera::{Camera, Intrinsics, Pose};
use nerf_core::encoding::{
    AngleScale, DirectionEncoding, GridEncoding, PositionEncoding, SinusoidalEncoding,
};
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::network::{Architecture, DensityActivation, Shading, TrunkLayer};
use nerf_core::plan::Batch;
use nerf_core::render::{Rect, Renderer};

/// Settings from which a scene or 2D field is made.
#[derive(Clone, Copy, Debug)]
pub struct Recipe {
    /// Number of trunk layers, and number of units in each layer.
    pub trunk: (usize, u16),
    /// True if the last trunk layer also takes the encoded position.
    pub skip: bool,
    /// True if colour depends on the viewing direction.
    pub view_dependent: bool,
    /// Number of levels of the position encoding.
    pub levels: u8,
    /// Number of features per entry of the learned grid; 0 if positions are encoded by sines and cosines.
    pub features: u8,
    /// True if the grid's tables are int8, with a scale per level; false if they are f16.
    pub int8: bool,
    /// True if the int8 tables are entropy-coded.
    pub coded: bool,
    /// True for deferred shading, where colour is evaluated once per ray. Without trunk layers, the composited features
    /// are the grid's encoding.
    pub per_ray: bool,
    /// Cells of the occupancy grid along each axis, and whether all cells are occupied; `None` without a grid.
    pub occupancy: Option<(u16, bool)>,
    /// True if the occupancy grid is part of the model.
    pub occupancy_required: bool,
    /// Number of samples of the proposal network; `None` without one. With a proposal network, the scene also has a
    /// Pareto front of two points.
    pub proposal: Option<u16>,
    /// True for a scene, which has a density head; false for a 2D field.
    pub scene: bool,
    /// Power of the contraction of an unbounded scene; 0 for a bounded scene.
    pub contraction: u8,
    /// Seed of the weights.
    pub seed: u64,
}

/// Returns the entropy-coded form of a grid's int8 values.
pub fn coded(grid: &GridEncoding, values: &[u8]) -> Vec<u8> {
    let mut symbols = vec![[0; 2]; 2 * values.len()];
    let mut out = vec![0; 4 * values.len() + 4];
    encode_tables(grid, values, &mut symbols, &mut out).expect("room for any values").to_vec()
}

impl Recipe {
    /// View-dependent scene: 4 trunk layers of 32 units, 10 levels for positions, 4 for directions; no skip layer, no
    /// occupancy grid.
    pub const PLAIN: Self = Self {
        trunk: (4, 32),
        skip: false,
        view_dependent: true,
        levels: 10,
        features: 0,
        int8: false,
        coded: false,
        per_ray: false,
        occupancy: None,
        occupancy_required: false,
        proposal: None,
        scene: true,
        contraction: 0,
        seed: 1,
    };
    /// Scene with a skip layer.
    pub const SKIP: Self = Self { skip: true, seed: 2, ..Self::PLAIN };
    /// Scene with an occupancy grid of 8³ cells, about half of them empty, and without view dependence.
    pub const OCCUPANCY: Self =
        Self { occupancy: Some((8, false)), view_dependent: false, seed: 3, ..Self::PLAIN };
    /// Scene with an occupancy grid that is part of the model.
    pub const OCCUPANCY_REQUIRED: Self = Self { occupancy_required: true, ..Self::OCCUPANCY };
    /// Scene with an occupancy grid and a proposal network.
    pub const PROPOSAL: Self = Self { proposal: Some(12), seed: 7, ..Self::OCCUPANCY };
    /// Scene with a learned grid of 4 levels, spherical harmonics and an exponential density.
    pub const LEARNED: Self = Self { features: 2, levels: 4, trunk: (1, 32), seed: 8, ..Self::PLAIN };
    /// Scene with a learned grid whose tables are int8.
    pub const LEARNED_INT8: Self = Self { int8: true, seed: 10, ..Self::LEARNED };
    /// Scene with a learned grid whose int8 tables are entropy-coded.
    pub const LEARNED_CODED: Self = Self { coded: true, ..Self::LEARNED_INT8 };
    /// Scene with deferred shading: the grid's encoding is composited along a ray, and the network runs once per ray.
    pub const DEFERRED: Self = Self { per_ray: true, trunk: (0, 32), seed: 13, ..Self::LEARNED };
    /// Scene with deferred shading of the composited output of a trunk layer, and with an occupancy grid.
    pub const DEFERRED_LAYER: Self =
        Self { per_ray: true, occupancy: Some((8, false)), seed: 14, ..Self::LEARNED_INT8 };
    /// Unbounded scene with an occupancy grid.
    pub const CONTRACTED: Self =
        Self { contraction: 2, occupancy: Some((8, false)), seed: 12, ..Self::LEARNED };
    /// 2D field with a learned grid.
    pub const LEARNED_PICTURE: Self = Self { features: 1, levels: 3, seed: 9, ..Self::PICTURE };
    /// 2D field fitted to 33x21 pixels.
    pub const PICTURE: Self = Self { scene: false, view_dependent: false, seed: 4, ..Self::PLAIN };
    /// 2D field with nearly the smallest possible file.
    pub const TINY_PICTURE: Self = Self { trunk: (1, 2), levels: 0, seed: 6, ..Self::PICTURE };
    /// Scene with nearly the smallest possible file.
    pub const TINY: Self = Self {
        trunk: (1, 2),
        view_dependent: false,
        levels: 0,
        occupancy: Some((2, false)),
        seed: 5,
        ..Self::PLAIN
    };
    /// Scene with nearly the smallest possible file that has a proposal network and a Pareto front.
    pub const TINY_PROPOSAL: Self = Self { proposal: Some(8), ..Self::TINY };

    /// Returns the architecture of the network.
    pub fn architecture(&self) -> Architecture {
        let encoding =
            |inputs, levels| SinusoidalEncoding { inputs, levels, scale: AngleScale::Pi, identity: true };
        let (layers, width) = self.trunk;
        let trunk = (0..layers).map(|i| TrunkLayer { width, skip: self.skip && i > 0 && i + 1 == layers });
        Architecture {
            position: match self.learned() {
                Some(grid) => PositionEncoding::Grid(grid),
                None => encoding(if self.scene { 3 } else { 2 }, self.levels).into(),
            },
            direction: self.view_dependent.then(|| match self.features {
                0 => encoding(3, 4).into(),
                _ => DirectionEncoding::SphericalHarmonics { degree: 4 },
            }),
            trunk: trunk.collect(),
            density: self.scene.then_some(match self.features {
                0 => DensityActivation::Relu,
                _ => DensityActivation::Exponential,
            }),
            colour: self.view_dependent.then_some(width / 2).into_iter().collect(),
            shading: if self.per_ray { Shading::PerRay } else { Shading::PerSample },
        }
    }

    /// Returns the bytes of the scene file.
    pub fn blob(&self) -> Vec<u8> {
        let architecture = self.architecture();
        let (weights, bits) = (self.weights(&architecture), self.bits());
        let tables = architecture.position.grid().map(|grid| match self.coded {
            true => coded(grid, &self.tables(grid)),
            false => self.tables(grid),
        });
        let levels = 0..architecture.position.grid().map_or(0, |grid| grid.resolutions.len());
        let scales: Vec<u8> =
            levels.flat_map(|level| (0.008 + 0.0007 * level as f32).to_le_bytes()).collect();
        let coarse =
            Self { features: 0, trunk: (2, self.trunk.1), seed: self.seed + 100, skip: true, ..*self };
        let coarse_shape =
            Architecture { direction: None, colour: [].into_iter().collect(), ..coarse.architecture() };
        let mut coarse_weights = coarse.weights(&coarse_shape);
        coarse_weights.truncate(2 * coarse_shape.density_parameters());
        let proposal = self.proposal.map(|samples| Proposal {
            position: *coarse_shape.position.sinusoidal().expect("no grid, as below"),
            trunk: coarse_shape.trunk.clone(),
            density: DensityActivation::Relu,
            samples,
            weights: &coarse_weights,
        });
        let body = Body {
            content: self.content(),
            architecture,
            occupancy: self.occupancy.map(|(side, _)| StoredOccupancy { resolution: [side; 3], bits: &bits }),
            front: if self.proposal.is_some() { front(self.occupancy.is_some()) } else { Default::default() },
            proposal,
            provenance: Provenance {
                data: "noise",
                made_by: "nerf-tests",
                steps: 7,
                seed: self.seed,
                psnr_db: Some(12.5),
                psnr_convention: "none",
                quantisation_loss_db: None,
                trained_parameters: 9,
            },
            weights: &weights,
            tables: tables.as_deref().map(|bytes| match (self.int8, self.coded) {
                (true, true) => StoredTables::Coded { scales: &scales, bytes },
                (true, false) => StoredTables::Int8 { scales: &scales, bytes },
                (false, _) => StoredTables::F16(bytes),
            }),
        };
        let mut blob = vec![0; encoded_len(&body).expect("a valid body")];
        write(&body, &mut blob).expect("a valid body");
        blob
    }

    fn content(&self) -> Content {
        if !self.scene {
            return Content::Picture(PictureFacts { width: 33, height: 21 });
        }
        let background = [1.0, 0.5, 0.25];
        if self.contraction > 0 {
            return Content::Scene(SceneFacts {
                min: [-2.0, -2.25, -2.0],
                max: [2.0, 1.75, 2.0],
                near: 0.125,
                far: 50.0,
                sampling: SceneSampling::Contracted { step: 0.0625, power: self.contraction },
                background,
                occupancy_required: self.occupancy_required,
                viewpoint: Some(Viewpoint {
                    eye: [3.0, 1.0, 0.0],
                    target: [0.0; 3],
                    up: [0.0, 1.0, 0.0],
                    arc: 2.0,
                }),
            });
        }
        Content::Scene(SceneFacts {
            min: [-1.0, -1.25, -1.0],
            max: [1.0, 1.0, 1.5],
            near: 2.0,
            far: 6.0,
            sampling: match self.features {
                0 => SceneSampling::Bins(48),
                _ => SceneSampling::March(0.08),
            },
            background,
            occupancy_required: self.occupancy_required,
            viewpoint: None,
        })
    }

    /// Returns uniform f16 weights, scaled so that a layer's output is about as large as its input. Densities reach far
    /// enough above 0 for images that are neither empty nor flat.
    fn weights(&self, architecture: &Architecture) -> Vec<u8> {
        let mut state = self.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut uniform = || signed(&mut state);
        let mut weights = Vec::new();
        for layer in architecture.layers() {
            let limit = (6.0 / layer.inputs() as f32).sqrt();
            let scale = if layer.outputs == 1 { 8.0 * limit } else { limit };
            for _ in 0..layer.inputs() * layer.outputs {
                weights.extend(f16_bits(uniform() * scale).to_le_bytes());
            }
            for _ in 0..layer.outputs {
                weights.extend(f16_bits(uniform() * 0.1).to_le_bytes());
            }
        }
        weights
    }

    /// Returns the learned grid, if the recipe has one. Its levels have 6, 9, 12, … cells along x and z, and one cell
    /// more along y. All levels but the first are hashed.
    fn learned(&self) -> Option<GridEncoding> {
        let inputs = if self.scene { 3 } else { 2 };
        let cells = (0..self.levels).map(|level| 6 + 3 * u16::from(level));
        let resolutions = cells.map(|n| [n, n + 1, if self.scene { n } else { 0 }]).collect();
        let log2_entries = if self.scene { 9 } else { 6 };
        (self.features > 0).then_some(GridEncoding {
            inputs,
            features: self.features,
            log2_entries,
            resolutions,
        })
    }

    fn tables(&self, grid: &GridEncoding) -> Vec<u8> {
        let mut state = self.seed | 1;
        let values = (0..grid.values()).map(|_| signed(&mut state));
        match self.int8 {
            true => values.map(|value| (127.0 * value) as i8 as u8).collect(),
            false => values.flat_map(|value| f16_bits(value).to_le_bytes()).collect(),
        }
    }

    fn bits(&self) -> Vec<u8> {
        let (side, full) = self.occupancy.unwrap_or((1, true));
        let cells = usize::from(side).pow(3);
        let mut bits = vec![0u8; cells.div_ceil(8)];
        for cell in (0..cells).filter(|cell| full || cell * 7 % 13 < 7) {
            bits[cell / 8] |= 1 << (cell % 8);
        }
        bits
    }
}

/// Returns a Pareto front of two points: the exact rendering, and one with cuts and the proposal network.
fn front(occupancy: bool) -> ParetoFront {
    let exact = FrontPoint {
        samples: 48,
        transmittance_cut: 0.0,
        colour_cut: 0.0,
        occupancy,
        math: MathBackend::Polynomial.tag(),
        proposal: false,
        loss_db: 0.0,
        cost: 1.0,
    };
    let cuts = FrontPoint { transmittance_cut: 0.01, colour_cut: 0.001, ..exact };
    [exact, FrontPoint { proposal: true, loss_db: 0.5, cost: 0.25, ..cuts }].into_iter().collect()
}

/// Converts a number to the bits of an f16, rounded towards zero. Subnormal results become zero; the number must not be
/// too large for an f16.
pub fn f16_bits(x: f32) -> u16 {
    let bits = x.to_bits();
    let (sign, exponent) = ((bits >> 16 & 0x8000) as u16, (bits >> 23 & 0xff) as i32 - 112);
    if exponent <= 0 { sign } else { sign | (exponent as u16) << 10 | (bits >> 13 & 0x3ff) as u16 }
}

/// Returns a camera of this image size that sees the whole scene from a corner, with slight lens distortion.
pub fn camera(width: u32, height: u32) -> Camera {
    let pose = Pose::look_at([1.5, 1.2, 3.4].into(), [0.0, 0.0, 0.1].into(), [0.0, 1.0, 0.0].into());
    let lens = Lens { k1: 0.02, k2: -0.01, p1: 0.001, p2: -0.002, ..Lens::NONE };
    let intrinsics = Intrinsics::centred(width, height, 1.2 * width as f32);
    Camera::new(intrinsics, lens, pose.expect("a pose")).expect("a camera")
}

/// Returns the kernels that this machine can run.
pub fn kernels() -> impl Iterator<Item = Kernel> {
    Kernel::all()
}

/// Renders a 2D field to an image of `size` pixels with the Rust renderer. Returns the colours, row by row.
pub fn picture(blob: &[u8], kernel: Kernel, math: MathBackend, size: [u32; 2]) -> Vec<[f32; 3]> {
    let blob = Blob::open(blob).expect("a blob");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
    let (batch, rect) = (Batch::FULL, Rect { x: 0, y: 0, width: size[0], height: size[1] });
    let mut workspace = vec![Line::UNINIT; renderer.picture_workspace_lines(batch)];
    let mut pixels = Vec::new();
    let mut put = |_: u32, _: u32, rgb: [f32; 3]| pixels.push(rgb);
    renderer.render_picture(math, batch, size, rect, &mut workspace, &mut put).expect("a picture");
    pixels
}
