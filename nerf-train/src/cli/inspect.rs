//! `nerf-train inspect`

use super::common::{Global, background_name, open_blob, read_file};
use super::grid;
use crate::show::summary::Summary;
use clap::Args;
use nerf_core::blob::{Blob, FrontPoint, SceneSampling};
use nerf_core::encoding::DirectionEncoding;
use nerf_core::network::Layer;
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
        global.finish(&summary(&self.file, &bytes, &blob), || print(&self.file, &bytes, &blob))?;
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

/// The same as fields.
fn summary(file: &Path, bytes: &[u8], blob: &Blob<'_>) -> Summary {
    let a = blob.architecture();
    let mut summary = Summary::new();
    summary
        .text("file", file.display().to_string())
        .integer("blob_bytes", bytes.len() as u64)
        .integer("format_version", u64::from(nerf_core::blob::FORMAT_VERSION))
        .text("kind", kind(blob))
        .integer("position_levels", a.position.sinusoidal().map_or(0, |encoding| u64::from(encoding.levels)))
        .integer(
            "direction_levels",
            a.direction.and_then(|d| d.sinusoidal().copied()).map_or(0, |e| u64::from(e.levels)),
        )
        .flag("view_dependent", a.direction.is_some())
        .sections("layers", blob.layers().iter().map(layer_fields).collect())
        .integer("parameters", a.parameters() as u64)
        .integer("weight_bytes", blob.weights().len() as u64)
        .integer("density_macs", a.density_macs() as u64)
        .integer("colour_macs", a.colour_macs() as u64);
    if let Some(DirectionEncoding::SphericalHarmonics { degree }) = a.direction {
        summary.integer("harmonics_degree", u64::from(degree));
    }
    grid::summarise(blob, &mut summary);
    if let Some(scene) = blob.scene() {
        summary
            .numbers_f32("box_min", &scene.min)
            .numbers_f32("box_max", &scene.max)
            .number_f32("near", scene.near)
            .number_f32("far", scene.far)
            .integer("samples_per_ray", u64::from(scene.samples()))
            .number_f32("step", scene.step())
            .text("background", background_name(scene.background))
            .flag("occupancy_required", scene.occupancy_required);
    }
    if let Some(picture) = blob.picture() {
        summary.integer("width_px", u64::from(picture.width)).integer("height_px", u64::from(picture.height));
    }
    if let Some(occupancy) = blob.occupancy() {
        summary
            .numbers("occupancy_resolution", &occupancy.resolution().map(f64::from))
            .number_f32("occupied_share", occupancy.occupied_share());
    }
    if let Some(proposal) = blob.proposal() {
        summary
            .integer("proposal_samples_per_ray", u64::from(proposal.samples))
            .integer("proposal_macs", proposal.architecture().density_macs() as u64)
            .integer("proposal_weight_bytes", proposal.weights.len() as u64);
    }
    if !blob.front().is_empty() {
        summary.sections("front", blob.front().iter().map(point_fields).collect());
    }
    let p = blob.provenance();
    summary
        .text("data", p.data)
        .text("made_by", p.made_by)
        .integer("steps", u64::from(p.steps))
        .integer("seed", p.seed)
        .integer("trained_parameters", u64::from(p.trained_parameters));
    if let Some(db) = p.psnr_db {
        summary.number_f32("psnr_db", db).text("psnr_convention", p.psnr_convention);
    }
    if let Some(db) = p.quantisation_loss_db {
        summary.number_f32("quantisation_loss_db", db);
    }
    summary
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

/// The same as fields.
fn point_fields(p: &FrontPoint) -> Summary {
    let mut fields = Summary::new();
    fields
        .integer("samples_per_ray", u64::from(p.samples))
        .number_f32("transmittance_cut", p.transmittance_cut)
        .number_f32("colour_cut", p.colour_cut)
        .flag("occupancy", p.occupancy)
        .integer("math", u64::from(p.math))
        .flag("proposal", p.proposal)
        .number_f32("loss_db", p.loss_db)
        .number_f32("cost", p.cost);
    fields
}

fn kind(blob: &Blob<'_>) -> &'static str {
    if blob.scene().is_some() { "scene" } else { "2D field" }
}

fn layer_fields(layer: &Layer) -> Summary {
    let mut fields = Summary::new();
    fields
        .text("role", format!("{:?}", layer.role))
        .integer("main_inputs", layer.main as u64)
        .integer("extra_inputs", layer.extra as u64)
        .integer("outputs", layer.outputs as u64);
    fields
}

fn describe(layer: &Layer) -> String {
    let Layer { role, main, extra, outputs, .. } = layer;
    if *extra > 0 {
        format!("{role:?}: {main} + {extra} → {outputs}")
    } else {
        format!("{role:?}: {main} → {outputs}")
    }
}
