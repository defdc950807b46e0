//! Everything a blob says of itself.

mod grid;

use crate::data::pictures::colour;
use crate::system::summary::Short;
pub use grid::{GridSummary, describe as describe_grid};
use nerf_core::blob::{Blob, FrontPoint, SceneFacts, SceneSampling, Viewpoint};
use nerf_core::encoding::DirectionEncoding;
use nerf_core::network::Layer;
use serde::Serialize;
use std::path::Path;

/// Everything a blob says of itself, as lines for people; `bytes` is all of `file`.
pub fn lines(file: &Path, bytes: &[u8], blob: &Blob<'_>) -> Vec<String> {
    let mut lines = network_lines(file, bytes, blob);
    if let Some(scene) = blob.scene() {
        lines.extend(space_lines(scene));
        lines.extend(shortcut_lines(scene, blob));
    }
    lines.extend(provenance_lines(blob));
    lines
}

/// The file, the network and its work.
fn network_lines(file: &Path, bytes: &[u8], blob: &Blob<'_>) -> Vec<String> {
    let mut lines = Vec::new();
    let a = blob.architecture();
    lines.push(format!(
        "file          {} ({} bytes, format {})",
        file.display(),
        bytes.len(),
        nerf_core::blob::FORMAT_VERSION
    ));
    match blob.picture() {
        Some(picture) => {
            lines.push(format!("kind          {} of {}x{} pixels", kind(blob), picture.width, picture.height))
        }
        None => lines.push(format!("kind          {}", kind(blob))),
    }
    match describe_grid(blob) {
        Some(grid) => lines.push(format!("learned grid  {grid}")),
        None => lines.push(format!("position      {:?}", a.position)),
    }
    match &a.direction {
        Some(DirectionEncoding::SphericalHarmonics { degree }) => {
            lines.push(format!("direction     spherical harmonics of degree {degree}"))
        }
        Some(direction) => lines.push(format!("direction     {direction:?}")),
        None if blob.scene().is_some() => {
            lines.push("direction     none: colour does not depend on it".to_owned())
        }
        None => {}
    }
    for layer in &blob.layers() {
        lines.push(format!("layer         {}", describe(layer)));
    }
    if let Some(density) = a.density {
        lines.push(format!("density       {density:?}"));
    }
    lines.push(format!("parameters    {} as f16 ({} bytes)", a.parameters(), blob.weights().len()));
    let (density, colour) = (a.density_macs(), a.colour_macs());
    match blob.picture() {
        Some(_) => lines.push(format!("work          {} multiply-adds a pixel", density + colour)),
        None => {
            lines.push(format!("work          {density} multiply-adds for density, {colour} more for colour"))
        }
    }
    lines
}

/// Where the scene is, and where its rays are sampled.
fn space_lines(scene: &SceneFacts) -> Vec<String> {
    let mut lines = Vec::new();
    lines.push(format!("box           {:?} .. {:?}", scene.min, scene.max));
    match scene.sampling {
        SceneSampling::Bins(samples) => {
            lines.push(format!("near, far     {} .. {}, {samples} samples a ray", scene.near, scene.far));
        }
        SceneSampling::Contracted { step, power } => {
            let radius = scene.contraction().map_or(0.0, |contraction| contraction.radius());
            lines.push(format!(
                "space         unbounded, contracted around the middle of the box beyond {radius}"
            ));
            lines.push(format!("near, far     {} of the cameras, {} of the middle", scene.near, scene.far));
            lines.push(format!(
                "march         steps of {} there, growing with power {power} beyond",
                step * radius
            ));
        }
        SceneSampling::March(step) => {
            lines.push(format!(
                "near, far     {} .. {} of the cameras it was fitted to",
                scene.near, scene.far
            ));
            lines.push(format!("march         steps of {step} in the box, {} at most", scene.samples()));
        }
    }
    lines.push(format!("background    {}", colour::name(scene.background)));
    if let Some(Viewpoint { eye, target, up, arc }) = scene.viewpoint {
        let arc = arc.to_degrees();
        lines
            .push(format!("viewpoint     from {eye:?} to {target:?}, up {up:?}, an arc of {arc:.0} degrees"));
    }
    lines
}

/// What spares work: occupancy grid, proposal network, front.
fn shortcut_lines(scene: &SceneFacts, blob: &Blob<'_>) -> Vec<String> {
    let mut lines = Vec::new();
    let role = if scene.occupancy_required { "part of the model" } else { "only skips what is empty" };
    match blob.occupancy() {
        Some(occupancy) => lines.push(format!(
            "occupancy     {:?} cells, {:.2} % occupied; {role}",
            occupancy.resolution(),
            100.0 * occupancy.occupied_share()
        )),
        None => lines.push("occupancy     none".to_owned()),
    }
    if let Some(proposal) = blob.proposal() {
        let a = proposal.architecture();
        lines.push(format!(
            "proposal      {} samples a ray, {} layers, {} multiply-adds for density ({} bytes)",
            proposal.samples,
            a.trunk.len(),
            a.density_macs(),
            proposal.weights.len()
        ));
    }
    for point in blob.front() {
        lines.push(format!("front         {}", front_point(point)));
    }
    lines
}

/// Where it comes from.
fn provenance_lines(blob: &Blob<'_>) -> Vec<String> {
    let mut lines = Vec::new();
    let p = blob.provenance();
    lines.push(format!("data          {}", p.data));
    lines.push(format!("made by       {}, {} steps, seed {}", p.made_by, p.steps, p.seed));
    lines.push(format!("trained       {} parameters before folding", p.trained_parameters));
    match p.psnr_db {
        Some(db) => lines.push(format!("PSNR          {db:.3} dB ({})", p.psnr_convention)),
        None => lines.push("PSNR          not measured".to_owned()),
    }
    if let Some(db) = p.quantisation_loss_db {
        lines.push(format!("rounding      {db:.4} dB lost"));
    }
    lines
}

/// The same for scripts; what a file has none of is left out.
#[derive(Debug, Serialize)]
#[allow(missing_docs, reason = "the names say what they are, and in which unit")]
pub struct Inspection<'b> {
    pub file: String,
    pub blob_bytes: usize,
    pub format_version: u16,
    pub kind: &'static str,
    pub position_levels: u8,
    pub direction_levels: u8,
    pub view_dependent: bool,
    pub layers: Vec<LayerSummary>,
    pub parameters: usize,
    pub weight_bytes: usize,
    pub density_macs: usize,
    pub colour_macs: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub harmonics_degree: Option<u8>,
    #[serde(flatten)]
    pub grid: Option<GridSummary>,
    #[serde(flatten)]
    pub scene: Option<SceneSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width_px: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height_px: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub occupancy_resolution: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub occupied_share: Option<Short>,
    #[serde(flatten)]
    pub proposal: Option<ProposalSummary>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub front: Vec<PointSummary>,
    pub data: &'b str,
    pub made_by: &'b str,
    pub steps: u32,
    pub seed: u64,
    pub trained_parameters: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psnr_db: Option<Short>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psnr_convention: Option<&'b str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quantisation_loss_db: Option<Short>,
}

#[derive(Debug, Serialize)]
#[allow(missing_docs, reason = "the names say what they are, and in which unit")]
pub struct SceneSummary {
    pub box_min: [Short; 3],
    pub box_max: [Short; 3],
    pub near: Short,
    pub far: Short,
    pub samples_per_ray: u16,
    pub step: Short,
    pub background: String,
    pub occupancy_required: bool,
    #[serde(flatten)]
    pub viewpoint: Option<ViewpointSummary>,
}

#[derive(Debug, Serialize)]
#[allow(missing_docs, reason = "the names say what they are, and in which unit")]
pub struct ViewpointSummary {
    pub viewpoint_eye: [Short; 3],
    pub viewpoint_target: [Short; 3],
    pub viewpoint_up: [Short; 3],
    pub viewpoint_arc_deg: Short,
}

#[derive(Debug, Serialize)]
#[allow(missing_docs, reason = "the names say what they are, and in which unit")]
pub struct ProposalSummary {
    pub proposal_samples_per_ray: u16,
    pub proposal_macs: usize,
    pub proposal_weight_bytes: usize,
}

impl<'b> Inspection<'b> {
    /// Of a blob that is all of `file`.
    pub fn of(file: &Path, bytes: &[u8], blob: &'b Blob<'_>) -> Self {
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
                background: colour::name(scene.background),
                occupancy_required: scene.occupancy_required,
                viewpoint: scene.viewpoint.map(|viewpoint| ViewpointSummary {
                    viewpoint_eye: viewpoint.eye.map(Short),
                    viewpoint_target: viewpoint.target.map(Short),
                    viewpoint_up: viewpoint.up.map(Short),
                    viewpoint_arc_deg: Short(viewpoint.arc.to_degrees()),
                }),
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
#[allow(missing_docs, reason = "the names say what they are, and in which unit")]
pub struct PointSummary {
    pub samples_per_ray: u16,
    pub transmittance_cut: Short,
    pub colour_cut: Short,
    pub occupancy: bool,
    pub math: u8,
    pub proposal: bool,
    pub loss_db: Short,
    pub cost: Short,
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
#[allow(missing_docs, reason = "the names say what they are, and in which unit")]
pub struct LayerSummary {
    pub role: String,
    pub main_inputs: usize,
    pub extra_inputs: usize,
    pub outputs: usize,
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
