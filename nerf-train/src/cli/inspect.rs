//! `nerf-train inspect`

use super::common::{Global, background_name, open_blob, read_file};
use super::grid;
use super::grid::GridSummary;
use crate::show::summary::Short;
use clap::Args;
use nerf_core::blob::{Blob, FrontPoint, SceneSampling};
use nerf_core::encoding::DirectionEncoding;
use nerf_core::network::Layer;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Print everything a blob says of itself.
#[derive(Debug, Args)]
#[command(after_help = "Example: nerf-train inspect lego.nerf")]
pub struct Inspect {
    /// The blob.
    file: PathBuf,
}

impl Inspect {
    /// Runs the command.
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        global.finish(&Summary::of(&self.file, &bytes, &blob), || print(&self.file, &bytes, &blob))?;
        Ok(ExitCode::SUCCESS)
    }
}

/// The blob's own words as lines.
fn print(file: &Path, bytes: &[u8], blob: &Blob<'_>) -> anyhow::Result<()> {
    let a = blob.architecture();
    outln!(
        "file          {} ({} bytes, format {})",
        file.display(),
        bytes.len(),
        nerf_core::blob::FORMAT_VERSION
    );
    match blob.picture() {
        Some(picture) => {
            outln!("kind          {} of {}x{} pixels", kind(blob), picture.width, picture.height)
        }
        None => outln!("kind          {}", kind(blob)),
    }
    match grid::describe(blob) {
        Some(grid) => outln!("learned grid  {grid}"),
        None => outln!("position      {:?}", a.position),
    }
    match &a.direction {
        Some(DirectionEncoding::SphericalHarmonics { degree }) => {
            outln!("direction     spherical harmonics of degree {degree}")
        }
        Some(direction) => outln!("direction     {direction:?}"),
        None if blob.scene().is_some() => outln!("direction     none: colour does not depend on it"),
        None => {}
    }
    for layer in &blob.layers() {
        outln!("layer         {}", describe(layer));
    }
    if let Some(density) = a.density {
        outln!("density       {density:?}");
    }
    outln!("parameters    {} as f16 ({} bytes)", a.parameters(), blob.weights().len());
    let (density, colour) = (a.density_macs(), a.colour_macs());
    match blob.picture() {
        Some(_) => outln!("work          {} multiply-adds a pixel", density + colour),
        None => outln!("work          {density} multiply-adds for density, {colour} more for colour"),
    }
    if let Some(scene) = blob.scene() {
        outln!("box           {:?} .. {:?}", scene.min, scene.max);
        match scene.sampling {
            SceneSampling::Bins(samples) => {
                outln!("near, far     {} .. {}, {samples} samples a ray", scene.near, scene.far);
            }
            SceneSampling::Contracted { step, power } => {
                let radius = scene.contraction().map_or(0.0, |contraction| contraction.radius());
                outln!("space         unbounded, contracted around the middle of the box beyond {radius}");
                outln!("near, far     {} of the cameras, {} of the middle", scene.near, scene.far);
                outln!("march         steps of {} there, growing with power {power} beyond", step * radius);
            }
            SceneSampling::March(step) => {
                outln!("near, far     {} .. {} of the cameras it was fitted to", scene.near, scene.far);
                outln!("march         steps of {step} in the box, {} at most", scene.samples());
            }
        }
        outln!("background    {}", background_name(scene.background));
        let role = if scene.occupancy_required { "part of the model" } else { "only skips what is empty" };
        match blob.occupancy() {
            Some(occupancy) => outln!(
                "occupancy     {:?} cells, {:.2} % occupied; {role}",
                occupancy.resolution(),
                100.0 * occupancy.occupied_share()
            ),
            None => outln!("occupancy     none"),
        }
        if let Some(proposal) = blob.proposal() {
            let a = proposal.architecture();
            outln!(
                "proposal      {} samples a ray, {} layers, {} multiply-adds for density ({} bytes)",
                proposal.samples,
                a.trunk.len(),
                a.density_macs(),
                proposal.weights.len()
            );
        }
        for point in blob.front() {
            outln!("front         {}", front_point(point));
        }
    }
    let p = blob.provenance();
    outln!("data          {}", p.data);
    outln!("made by       {}, {} steps, seed {}", p.made_by, p.steps, p.seed);
    outln!("trained       {} parameters before folding", p.trained_parameters);
    match p.psnr_db {
        Some(db) => outln!("PSNR          {db:.3} dB ({})", p.psnr_convention),
        None => outln!("PSNR          not measured"),
    }
    if let Some(db) = p.quantisation_loss_db {
        outln!("rounding      {db:.4} dB lost");
    }
    Ok(())
}

/// The same for scripts; what a file has none of is left out.
#[derive(Debug, Serialize)]
struct Summary<'b> {
    file: String,
    blob_bytes: usize,
    format_version: u16,
    kind: &'static str,
    position_levels: u8,
    direction_levels: u8,
    view_dependent: bool,
    layers: Vec<LayerSummary>,
    parameters: usize,
    weight_bytes: usize,
    density_macs: usize,
    colour_macs: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    harmonics_degree: Option<u8>,
    #[serde(flatten)]
    grid: Option<GridSummary>,
    #[serde(flatten)]
    scene: Option<SceneSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    width_px: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    height_px: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    occupancy_resolution: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    occupied_share: Option<Short>,
    #[serde(flatten)]
    proposal: Option<ProposalSummary>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    front: Vec<PointSummary>,
    data: &'b str,
    made_by: &'b str,
    steps: u32,
    seed: u64,
    trained_parameters: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    psnr_db: Option<Short>,
    #[serde(skip_serializing_if = "Option::is_none")]
    psnr_convention: Option<&'b str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    quantisation_loss_db: Option<Short>,
}

#[derive(Debug, Serialize)]
struct SceneSummary {
    box_min: [Short; 3],
    box_max: [Short; 3],
    near: Short,
    far: Short,
    samples_per_ray: u16,
    step: Short,
    background: String,
    occupancy_required: bool,
}

#[derive(Debug, Serialize)]
struct ProposalSummary {
    proposal_samples_per_ray: u16,
    proposal_macs: usize,
    proposal_weight_bytes: usize,
}

impl<'b> Summary<'b> {
    fn of(file: &Path, bytes: &[u8], blob: &'b Blob<'_>) -> Self {
        let (a, p) = (blob.architecture(), blob.provenance());
        let harmonics_degree = match a.direction {
            Some(DirectionEncoding::SphericalHarmonics { degree }) => Some(degree),
            _ => None,
        };
        let (picture, occupancy) = (blob.picture(), blob.occupancy());
        Self {
            file: file.display().to_string(),
            blob_bytes: bytes.len(),
            format_version: nerf_core::blob::FORMAT_VERSION,
            kind: kind(blob),
            position_levels: a.position.sinusoidal().map_or(0, |encoding| encoding.levels),
            direction_levels: a.direction.and_then(|d| d.sinusoidal().copied()).map_or(0, |e| e.levels),
            view_dependent: a.direction.is_some(),
            layers: blob.layers().iter().map(LayerSummary::of).collect(),
            parameters: a.parameters(),
            weight_bytes: blob.weights().len(),
            density_macs: a.density_macs(),
            colour_macs: a.colour_macs(),
            harmonics_degree,
            grid: GridSummary::of(blob),
            scene: blob.scene().map(|scene| SceneSummary {
                box_min: scene.min.map(Short),
                box_max: scene.max.map(Short),
                near: Short(scene.near),
                far: Short(scene.far),
                samples_per_ray: scene.samples(),
                step: Short(scene.step()),
                background: background_name(scene.background),
                occupancy_required: scene.occupancy_required,
            }),
            width_px: picture.map(|picture| picture.width),
            height_px: picture.map(|picture| picture.height),
            occupancy_resolution: occupancy.map(|occupancy| occupancy.resolution().map(f64::from)),
            occupied_share: occupancy.map(|occupancy| Short(occupancy.occupied_share())),
            proposal: blob.proposal().map(|proposal| ProposalSummary {
                proposal_samples_per_ray: proposal.samples,
                proposal_macs: proposal.architecture().density_macs(),
                proposal_weight_bytes: proposal.weights.len(),
            }),
            front: blob.front().iter().map(PointSummary::of).collect(),
            data: p.data,
            made_by: p.made_by,
            steps: p.steps,
            seed: p.seed,
            trained_parameters: p.trained_parameters,
            psnr_db: p.psnr_db.map(Short),
            psnr_convention: p.psnr_db.map(|_| p.psnr_convention),
            quantisation_loss_db: p.quantisation_loss_db.map(Short),
        }
    }
}

/// A point of the front in words.
fn front_point(p: &FrontPoint) -> String {
    let switch = |on: bool, name: &str| if on { format!(", {name}") } else { String::new() };
    format!(
        "{:+.3} dB lost at {:.4} of the work: {} samples, cuts {} and {}, maths {}{}{}",
        p.loss_db,
        p.cost,
        p.samples,
        p.transmittance_cut,
        p.colour_cut,
        p.math,
        switch(p.occupancy, "occupancy"),
        switch(p.proposal, "proposal")
    )
}

/// The same for scripts.
#[derive(Debug, Serialize)]
struct PointSummary {
    samples_per_ray: u16,
    transmittance_cut: Short,
    colour_cut: Short,
    occupancy: bool,
    math: u8,
    proposal: bool,
    loss_db: Short,
    cost: Short,
}

impl PointSummary {
    fn of(p: &FrontPoint) -> Self {
        Self {
            samples_per_ray: p.samples,
            transmittance_cut: Short(p.transmittance_cut),
            colour_cut: Short(p.colour_cut),
            occupancy: p.occupancy,
            math: p.math,
            proposal: p.proposal,
            loss_db: Short(p.loss_db),
            cost: Short(p.cost),
        }
    }
}

fn kind(blob: &Blob<'_>) -> &'static str {
    if blob.scene().is_some() { "scene" } else { "2D field" }
}

#[derive(Debug, Serialize)]
struct LayerSummary {
    role: String,
    main_inputs: usize,
    extra_inputs: usize,
    outputs: usize,
}

impl LayerSummary {
    fn of(layer: &Layer) -> Self {
        Self {
            role: format!("{:?}", layer.role),
            main_inputs: layer.main,
            extra_inputs: layer.extra,
            outputs: layer.outputs,
        }
    }
}

fn describe(layer: &Layer) -> String {
    let Layer { role, main, extra, outputs, .. } = layer;
    if *extra > 0 {
        format!("{role:?}: {main} + {extra} → {outputs}")
    } else {
        format!("{role:?}: {main} → {outputs}")
    }
}
