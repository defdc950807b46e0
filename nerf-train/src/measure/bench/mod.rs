//! Benchmark: renders and times frames of a scene file and of its variants.

pub mod size;
pub mod source;

use crate::measure::frame::{self, Frame};
use crate::measure::point::{Precision, Settings};
use crate::model::export::{Contents, Tables, export};
use crate::model::quantise::{Quantised, TableStorage, values_of};
use crate::train::occupancy::{DensityQuery, Occupancy, OccupiedCells};
use anyhow::Context;
use nerf_core::Kernel;
use nerf_core::blob::{
    Blob, BlobError, Body, Content, FrontPoint, MAX_FRONT, SceneFacts, SceneSampling, StoredTables,
    encoded_len, write,
};
use nerf_core::camera::Camera;
use nerf_core::encoding::{GridTables, TableValues};
use nerf_core::memory::Line;
use nerf_core::network::{Architecture, unpack};
use nerf_core::plan::{Batch, Effects, Outputs, Plan};
use nerf_core::render::Renderer;
use source::other_source;
use std::time::Instant;

const NOT_A_SCENE: &str = "blob: expected a scene, found a 2D field";

/// Copy of the scene file, unchanged or modified, for example with another occupancy grid.
#[derive(Clone, Debug)]
pub struct Variant {
    pub name: String,
    pub bytes: Vec<u8>,
    pub has_occupancy: bool,
}

/// Scene file (`blob`) to measure, and its variants. Variant 0 is the unchanged file.
#[derive(Clone, Debug)]
pub struct Variants<'b> {
    pub blob: Blob<'b>,
    pub scene: SceneFacts,
    cells: Option<OccupiedCells>,
    pub variants: Vec<Variant>,
    /// The f32 weights before rounding, in the order of the blob's weights; `None` if not available.
    pub source: Option<Vec<f32>>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clocked {
    /// Wall-clock seconds.
    pub wall: f64,
    /// CPU seconds of all cores together; NaN if the system does not report them.
    pub cpu: f64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    pub workspace: usize,
    /// Bytes of memory, shared by all threads, for unpacked values, which the kernel cannot read from the blob.
    pub prepared: usize,
    pub file: usize,
}

impl<'b> Variants<'b> {
    pub fn new(bytes: &'b [u8]) -> anyhow::Result<Self> {
        let blob = Blob::open(bytes)?;
        let scene = blob.scene().context(NOT_A_SCENE)?.clone();
        let cells = cells(&blob);
        let variants =
            vec![Variant { name: "as it is".into(), bytes: bytes.to_vec(), has_occupancy: cells.is_some() }];
        Ok(Self { blob, scene, cells, variants, source: None })
    }

    /// Whether rays are marched with the scene's step; otherwise samples lie in bins between near and far.
    pub fn is_marched(&self) -> bool {
        !matches!(self.scene.sampling, SceneSampling::Bins(_))
    }

    /// Returns the distance between samples with `settings`, divided by the distance between samples in training.
    pub fn step_share(&self, settings: &Settings) -> f64 {
        let own = self.scene.samples();
        let samples = if settings.quality.samples == 0 { own } else { settings.quality.samples };
        f64::from(own) / f64::from(samples)
    }

    pub fn has_occupancy(&self, variant: usize) -> bool {
        self.variants[variant].has_occupancy
    }

    pub fn has_proposal(&self) -> bool {
        self.blob.proposal().is_some()
    }

    pub fn add(&mut self, variant: Variant) -> usize {
        self.variants.push(variant);
        self.variants.len() - 1
    }

    /// Adds a variant with an occupancy grid built from the network, and returns the variant's index. Adds nothing and
    /// returns `None` if no cell is occupied, or if the same variant exists.
    ///
    /// `resolution`: number of cells along the longest side of the scene box. A grid that is part of the model keeps
    /// its own resolution. `threshold`: a cell is occupied if density times the distance between samples is above this.
    pub fn add_occupancy(&mut self, resolution: u16, threshold: f32) -> anyhow::Result<Option<usize>> {
        // If the occupancy grid is part of the model, the field was trained only in the grid's occupied cells.
        let own = self.cells.as_ref().filter(|_| self.scene.occupancy_required);
        let resolution = own.map_or(resolution, |own| own.resolution().into_iter().fold(0, u16::max));
        let name = format!("with occupancy of {resolution} cells, density above {threshold}");
        if self.variants.iter().any(|variant| variant.name == name) {
            return Ok(None);
        }
        let parameters = [self.parameters(), self.table_values()].concat();
        let (architecture, kernel) = (self.blob.architecture(), Kernel::detect());
        let contraction = self.blob.scene().and_then(|scene| scene.contraction());
        let ask =
            DensityQuery { isa: kernel.isa, architecture, parameters: &parameters, seed: 0, contraction };
        let bounds = self.blob.scene_box().context(NOT_A_SCENE)?;
        let sigma = threshold / self.scene.step();
        let cells = match own {
            Some(own) => Occupancy::asked_within(own, &ask, sigma),
            None => Occupancy::asked(bounds, resolution, &ask, sigma),
        };
        let cells = cells.into_live();
        if cells.lookup().occupied_share() == 0.0 {
            return Ok(None);
        }
        let bytes = written(&Body { occupancy: Some(cells.stored()), ..self.body() })?;
        Ok(Some(self.add(Variant { name, bytes, has_occupancy: true })))
    }

    /// Adds a variant with int8 grid tables, and returns its index; `None` unless the blob's tables are in f16.
    pub fn add_int8(&mut self) -> anyhow::Result<Option<usize>> {
        let (Some(grid), Some(StoredTables::F16(_))) =
            (self.blob.architecture().position.grid(), self.blob.tables())
        else {
            return Ok(None);
        };
        // The values of a valid blob are finite, so quantisation does not fail.
        let Ok(rounded) = Quantised::new(grid, &self.table_values(), TableStorage::Int8, &[]) else {
            return Ok(None);
        };
        let bytes = written(&Body { tables: Some(rounded.stored()), ..self.body() })?;
        let (name, has_occupancy) = ("with int8 tables".into(), self.has_occupancy(0));
        Ok(Some(self.add(Variant { name, bytes, has_occupancy })))
    }

    /// Returns the feature values of the blob's grid tables; empty for a sinusoidal network.
    fn table_values(&self) -> Vec<f32> {
        match (self.blob.tables(), self.blob.architecture().position.grid()) {
            (Some(tables), Some(grid)) => values_of(grid, tables),
            _ => Vec::new(),
        }
    }

    /// Returns the scene file's weights as f32, in the file's order.
    pub fn parameters(&self) -> Vec<f32> {
        let mut parameters = vec![0.0; self.blob.architecture().parameters()];
        unpack(self.blob.weights(), &mut parameters);
        parameters
    }

    /// Adds a variant with another network, whose parameters are rounded to f16, and returns the variant's index.
    pub fn add_network(
        &mut self,
        name: &str,
        architecture: &Architecture,
        parameters: &[f32],
    ) -> anyhow::Result<usize> {
        let alone = export(&Contents {
            architecture,
            parameters,
            tables: self.blob.tables().map_or(Tables::None, Tables::Stored),
            content: Content::Scene(SceneFacts { occupancy_required: false, ..self.scene.clone() }),
            occupancy: None,
            provenance: self.blob.provenance().clone(),
        })?;
        let rounded = Blob::open(&alone.bytes)?;
        // The occupancy grid and all other parts of the blob stay.
        let body = Body { architecture: architecture.clone(), weights: rounded.weights(), ..self.body() };
        let (name, bytes, has_occupancy) = (name.to_owned(), written(&body)?, self.has_occupancy(0));
        Ok(self.add(Variant { name, bytes, has_occupancy }))
    }

    fn body(&self) -> Body<'_> {
        Body {
            architecture: self.blob.architecture().clone(),
            content: Content::Scene(self.scene.clone()),
            occupancy: self.cells.as_ref().map(OccupiedCells::stored),
            front: heapless::Vec::new(),
            proposal: self.blob.proposal().cloned(),
            provenance: self.blob.provenance().clone(),
            weights: self.blob.weights(),
            tables: self.blob.tables(),
        }
    }

    /// Returns the encoded blob with `front` as its Pareto front.
    pub fn with_front(&self, front: heapless::Vec<FrontPoint, MAX_FRONT>) -> anyhow::Result<Vec<u8>> {
        Ok(written(&Body { front, ..self.body() })?)
    }

    /// Creates the renderers that `settings` need, passes them to `work`, and returns the result of `work`.
    pub fn prepared<T>(
        &self,
        settings: &[Settings],
        work: impl FnOnce(&Bench<'_, '_>) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let mut keys: Vec<Key> = Vec::new();
        for s in settings {
            if !keys.contains(&Key::of(s)) {
                keys.push(Key::of(s));
            }
        }
        let open = |key: &Key| Blob::open(&self.variants[key.variant].bytes);
        let blobs: Vec<Blob<'_>> = keys.iter().map(open).collect::<Result<_, _>>()?;
        let lines = |(key, blob): (&Key, &Blob<'_>)| match key.precision {
            Precision::Rounded => Renderer::prepared_lines(blob, key.kernel),
            Precision::Unrounded => 0,
        };
        let mut memory: Vec<Vec<Line>> =
            keys.iter().zip(&blobs).map(|pair| vec![Line::UNINIT; lines(pair)]).collect();
        let own = self.table_values();
        let mut renderers = Vec::new();
        for ((key, blob), memory) in keys.iter().zip(blobs).zip(&mut memory) {
            let prepared = memory.len() * size_of::<Line>();
            let renderer = match (key.precision, &self.source) {
                (Precision::Unrounded, Some(source)) => {
                    let bounds = blob.scene_box();
                    // Entropy-coded tables cannot be read from the blob's bytes: the renderer reads decoded values.
                    let tables = GridTables::new(TableValues::F32(&own), bounds.as_ref());
                    let tables = (blob.decoded_len() > 0).then_some(tables);
                    Renderer::with_parameters(blob, key.kernel, source, tables)
                        .ok_or_else(|| other_source(format_args!("{} parameters", source.len())))?
                }
                _ => Renderer::new(blob, key.kernel, memory)?,
            };
            renderers.push((renderer, prepared));
        }
        work(&Bench { lab: self, keys, renderers })
    }
}

/// Settings on which a renderer depends. All other settings change only the plan or the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Key {
    variant: usize,
    kernel: Kernel,
    precision: Precision,
}

impl Key {
    fn of(settings: &Settings) -> Self {
        Self { variant: settings.variant, kernel: settings.kernel, precision: settings.precision }
    }
}

pub struct Bench<'l, 'b> {
    lab: &'l Variants<'b>,
    keys: Vec<Key>,
    renderers: Vec<(Renderer<'l>, usize)>,
}

impl Bench<'_, '_> {
    /// Renders the view of `camera` with `settings` over `background`, and measures memory and time. A frame rendered
    /// at reduced size is enlarged to `camera`'s size; the time includes the enlargement.
    pub fn render(
        &self,
        settings: &Settings,
        camera: &Camera,
        background: [f32; 3],
    ) -> anyhow::Result<(Frame, Clocked, Memory)> {
        let &(ref renderer, prepared) = self.renderer(settings);
        let batch = Batch::FULL;
        let plan = Plan::new(renderer.blob(), &settings.quality, Outputs::ALL, batch)?;
        let effects = Effects { anti_aliasing: settings.rays, ..Effects::NONE };
        let plan = plan.with_background(background)?.with_effects(effects)?.with_own_bins();
        let workspace = renderer.workspace_lines(&plan) * size_of::<Line>();
        let small = size::scaled(camera, settings.quarters)?;
        let (cpu, start) = (cpu_seconds(), Instant::now());
        let frame = frame::render(renderer, &plan, &small)?;
        let frame = size::enlarged(frame, camera);
        let clocked = Clocked { wall: start.elapsed().as_secs_f64(), cpu: cpu_seconds() - cpu };
        let file = self.lab.variants[settings.variant].bytes.len();
        Ok((frame, clocked, Memory { workspace, prepared, file }))
    }

    fn renderer(&self, settings: &Settings) -> &(Renderer<'_>, usize) {
        let key = Key::of(settings);
        let place = self.keys.iter().position(|k| *k == key);
        debug_assert!(place.is_some() && self.lab.variants.len() > key.variant, "not prepared: {key:?}");
        &self.renderers[place.unwrap_or(0)]
    }
}

fn cells(blob: &Blob<'_>) -> Option<OccupiedCells> {
    let (occupancy, bounds) = blob.occupancy().zip(blob.scene_box())?;
    let count: u32 = occupancy.resolution().iter().map(|&side| u32::from(side)).product();
    let live = (0..count).filter(|&cell| occupancy.bit(cell as usize));
    Some(OccupiedCells::of(bounds, occupancy.resolution(), live))
}

pub fn written(body: &Body<'_>) -> Result<Vec<u8>, BlobError> {
    let mut bytes = vec![0; encoded_len(body)?];
    write(body, &mut bytes)?;
    Ok(bytes)
}

/// Returns the CPU seconds of this process's running threads, all cores together, from `/proc` on Linux; elsewhere NaN.
fn cpu_seconds() -> f64 {
    let seconds = || -> Option<f64> {
        let mut nanoseconds = 0u64;
        for task in std::fs::read_dir("/proc/self/task").ok()? {
            // A thread that has ended since the folder was listed counts as 0.
            let text = std::fs::read_to_string(task.ok()?.path().join("schedstat")).unwrap_or_default();
            nanoseconds +=
                text.split_whitespace().next().and_then(|first| first.parse().ok()).unwrap_or(0u64);
        }
        Some(nanoseconds as f64 * 1e-9)
    };
    seconds().filter(|seconds| *seconds > 0.0).unwrap_or(f64::NAN)
}
