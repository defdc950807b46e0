//! `nerf-train inspect`

use super::common::{background_name, open_blob, read_file};
use clap::Args;
use nerf_core::network::Layer;
use std::path::PathBuf;
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
    pub fn run(&self) -> anyhow::Result<ExitCode> {
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let a = blob.architecture();
        outln!(
            "file          {} ({} bytes, format {})",
            self.file.display(),
            bytes.len(),
            nerf_core::blob::FORMAT_VERSION
        );
        match blob.picture() {
            Some(picture) => outln!("kind          picture of {}x{} pixels", picture.width, picture.height),
            None => outln!("kind          scene"),
        }
        outln!("position      {:?}", a.position);
        match &a.direction {
            Some(direction) => outln!("direction     {direction:?}"),
            None if blob.scene().is_some() => outln!("direction     none: colour does not depend on it"),
            None => {}
        }
        for layer in blob.layers() {
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
            outln!("near, far     {} .. {}, {} samples a ray", scene.near, scene.far, scene.samples);
            outln!("background    {}", background_name(scene.background));
            let role = if scene.grid_required { "part of the model" } else { "only skips what is empty" };
            match blob.grid() {
                Some(grid) => outln!(
                    "skip grid     {:?} cells, {:.2} % live; {role}",
                    grid.resolution(),
                    100.0 * grid.occupancy()
                ),
                None => outln!("skip grid     none"),
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
            outln!("f16 rounding  {db:.4} dB lost");
        }
        Ok(ExitCode::SUCCESS)
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
