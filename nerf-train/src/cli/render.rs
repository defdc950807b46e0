//! `nerf-train render`

use super::common::{
    DataOptions, Global, QualityOptions, open_blob, parse_background, parse_numbers, read_file,
};
use super::eval::Split;
use crate::frame::{self, Frame};
use crate::orbit::Orbit;
use crate::report::animation::write_gif;
use crate::report::colour_map::{depth_picture_with_legend, robust_range};
use crate::report::picture::{Picture, write_grey16_png, write_rgba_png};
use crate::report::progress::{Message, Progress, Total};
use crate::report::summary::Summary;
use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use glam::Vec3;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Intrinsics, Pose};
use nerf_core::kernels::Line;
use nerf_core::lens::Lens;
use nerf_core::plan::{Batch, Outputs, Plan};
use nerf_core::render::Renderer;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What a pixel shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Output {
    /// Colour over the background.
    Rgb,
    /// Opacity, 16-bit grey, 0 to 1.
    Opacity,
    /// Distance along the ray, with a legend.
    RayDistance,
    /// Distance along the view axis, with a legend.
    ZDepth,
    /// All of these.
    All,
}

/// Render views of a blob: a given pose, one view of a data set, or an orbit.
///
/// One view becomes a PNG; an orbit becomes a GIF. Further outputs get their name appended: with
/// -o view.png, z_depth goes to view_z_depth.png.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train render lego.nerf -o view.png --data lego_200x200.npz --split val --view 3 --outputs rgb,z-depth
  nerf-train render lego.nerf -o orbit.gif --orbit 60 --width 200 --height 200
  nerf-train render lego.nerf -o view.png --pose 1,0,0,0,0,1,0,0,0,0,1,4 --focal 277")]
pub struct Render {
    /// The blob.
    file: PathBuf,
    /// The picture (.png) or animation (.gif) to write.
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// Upper three rows of the camera-to-world matrix, row by row (looks down −Z, +Y up).
    #[arg(
        long,
        value_name = "M,M,…",
        allow_hyphen_values = true,
        value_parser = parse_numbers::<12>,
        group = "what"
    )]
    pose: Option<[f32; 12]>,
    /// Data set that the camera comes from.
    #[arg(long, value_name = "DATA", group = "what")]
    data: Option<PathBuf>,
    /// Split of the data set.
    #[arg(long, value_enum, default_value = "val", requires = "data")]
    split: Split,
    /// View of the split.
    #[arg(long, value_name = "I", default_value_t = 0, requires = "data")]
    view: usize,
    /// Circle around the scene in so many frames.
    #[arg(long, value_name = "FRAMES", group = "what")]
    orbit: Option<usize>,
    /// Height of the orbit above the scene's middle, degrees.
    #[arg(long, value_name = "DEG", default_value_t = 25.0, allow_hyphen_values = true)]
    elevation: f32,
    /// Radius of the orbit, world units [default: half way between near and far].
    #[arg(long, value_name = "R")]
    radius: Option<f32>,
    /// World axis that is up in an orbit.
    #[arg(long, value_name = "AXIS", default_value = "z", value_parser = parse_axis)]
    up: Vec3,
    /// Frames a second of an animation.
    #[arg(long, value_name = "N", default_value_t = 20.0)]
    fps: f64,
    /// Width, pixels [default: the data set's view, or 400].
    #[arg(long, value_name = "N")]
    width: Option<u32>,
    /// Height, pixels [default: the data set's view, or the width].
    #[arg(long, value_name = "N")]
    height: Option<u32>,
    /// Focal length, pixels [default: the data set's view, or a field of view of 40 degrees].
    #[arg(long, value_name = "F")]
    focal: Option<f32>,
    /// What to write.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "rgb")]
    outputs: Vec<Output>,
    /// black, white, red or R,G,B (0 to 255) [default: the blob's own].
    #[arg(long, value_name = "COLOUR", value_parser = parse_background)]
    background: Option<[f32; 3]>,
    /// Write colour as a PNG with straight alpha instead of over a background.
    #[arg(long, conflicts_with_all = ["background", "orbit"])]
    transparent: bool,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    data_options: DataOptions,
}

fn parse_axis(text: &str) -> Result<Vec3, String> {
    match text {
        "x" => Ok(Vec3::X),
        "y" => Ok(Vec3::Y),
        "z" => Ok(Vec3::Z),
        "-x" => Ok(Vec3::NEG_X),
        "-y" => Ok(Vec3::NEG_Y),
        "-z" => Ok(Vec3::NEG_Z),
        _ => Err("expected x, y, z, -x, -y or -z".into()),
    }
}

impl Render {
    /// Runs the command.
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let cameras = self.cameras(&blob)?;
        let tier = global.tier();
        let plan = Plan::new(&blob, &self.quality.quality(), self.wanted(), Batch::for_tier(tier))
            .with_context(|| self.file.display().to_string())?;
        let plan = match self.background {
            Some(background) => plan.with_background(background)?,
            None if self.transparent => plan.with_background([0.0; 3])?,
            None => plan,
        };
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, tier)];
        let renderer = Renderer::new(blob, tier, &mut memory)?;
        for output in self.outputs() {
            crate::output::ensure_file(self.path_of(output))?;
        }
        let mut progress = Progress::new("render", Total::Steps(cameras.len() as u64), global.style());
        let mut frames = Vec::new();
        for camera in &cameras {
            frames.push(frame::render(&renderer, &plan, camera)?);
            progress.update(frames.len() as u64, &Message::default());
        }
        progress.finish(format!("{} views", frames.len()));
        let mut written = Vec::new();
        for output in self.outputs() {
            let path = self.path_of(output);
            if self.orbit.is_some() {
                write_animation(&path, &frames, output, self.fps)?;
            } else {
                self.write_still(&path, &frames[0], output)?;
            }
            written.push(path);
        }
        let mut summary = Summary::new();
        summary
            .texts("files", written.iter().map(|path| path.display().to_string()))
            .integer("frames", frames.len() as u64);
        global.finish(&summary, || {
            for path in &written {
                outln!("{}", path.display());
            }
            Ok(())
        })?;
        Ok(ExitCode::SUCCESS)
    }

    /// What to write, in order.
    fn outputs(&self) -> Vec<Output> {
        match self.outputs.contains(&Output::All) {
            true => vec![Output::Rgb, Output::Opacity, Output::RayDistance, Output::ZDepth],
            false => self.outputs.clone(),
        }
    }

    fn wanted(&self) -> Outputs {
        let outputs = self.outputs();
        let has = |output| outputs.contains(&output);
        Outputs {
            rgb: has(Output::Rgb),
            opacity: true,
            ray_distance: has(Output::RayDistance),
            z_depth: has(Output::ZDepth),
        }
    }

    fn cameras(&self, blob: &Blob<'_>) -> anyhow::Result<Vec<Camera>> {
        let (Some(scene), Some(bounds)) = (blob.scene(), blob.scene_box()) else {
            bail!("{}: expected a scene, found a 2D field", self.file.display());
        };
        let width = self.width.unwrap_or(400);
        let height = self.height.unwrap_or(width);
        let orbit = Orbit::around(bounds, scene.near, scene.far);
        let orbit = Orbit {
            elevation: self.elevation,
            up: self.up,
            radius: self.radius.unwrap_or(orbit.radius),
            ..orbit
        };
        let fov = match self.focal {
            Some(focal) if focal > 0.0 => 2.0 * (0.5 * width as f32 / focal).atan().to_degrees(),
            Some(focal) => bail!("--focal: expected a length above 0, found {focal}"),
            None => 40.0,
        };
        if let Some(frames) = self.orbit {
            if frames == 0 {
                bail!("--orbit: expected at least 1 frame, found 0");
            }
            let at = |i| orbit.camera(i as f32 / frames as f32, width, height, fov);
            return Ok((0..frames).map(at).collect::<Result<_, _>>()?);
        }
        if let Some(data) = &self.data {
            return Ok(vec![self.camera_of(data)?]);
        }
        match &self.pose {
            Some(m) => {
                let rows = [[m[0], m[1], m[2], m[3]], [m[4], m[5], m[6], m[7]], [m[8], m[9], m[10], m[11]]];
                let focal = 0.5 * width as f32 / (0.5 * fov.to_radians()).tan();
                let intrinsics = Intrinsics::centred(width, height, focal);
                Ok(vec![Camera::new(intrinsics, Lens::NONE, Pose::from_rows(rows)).context("--pose")?])
            }
            None => Ok(vec![orbit.camera(0.0, width, height, fov)?]),
        }
    }

    /// The camera of a view, scaled to the size that was asked for.
    fn camera_of(&self, data: &Path) -> anyhow::Result<Camera> {
        let dataset = self.data_options.read(data)?;
        let views = self.split.of(&dataset);
        let Some(view) = views.get(self.view) else {
            bail!(
                "--view: expected less than {} (split `{}`), found {}",
                views.len(),
                self.split.name(),
                self.view
            );
        };
        let old = *view.camera.intrinsics();
        let (width, height) = match (self.width, self.height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => {
                (width, (u64::from(width) * u64::from(old.height) / u64::from(old.width)) as u32)
            }
            (None, Some(height)) => {
                ((u64::from(height) * u64::from(old.width) / u64::from(old.height)) as u32, height)
            }
            (None, None) => (old.width, old.height),
        };
        let (sx, sy) = (width as f32 / old.width as f32, height as f32 / old.height as f32);
        let mut new =
            Intrinsics { width, height, fx: old.fx * sx, fy: old.fy * sy, cx: old.cx * sx, cy: old.cy * sy };
        if let Some(focal) = self.focal {
            (new.fx, new.fy) = (focal, focal);
        }
        Ok(Camera::new(new, *view.camera.lens(), *view.camera.pose())?)
    }

    /// The file of an output: the first one has the name that was given.
    fn path_of(&self, output: Output) -> PathBuf {
        if self.outputs().first() == Some(&output) {
            return self.output.clone();
        }
        let suffix = match output {
            Output::Rgb | Output::All => "rgb",
            Output::Opacity => "opacity",
            Output::RayDistance => "ray_distance",
            Output::ZDepth => "z_depth",
        };
        let mut name = self.output.file_stem().unwrap_or_default().to_owned();
        name.push(format!("_{suffix}"));
        if let Some(extension) = self.output.extension() {
            name.push(".");
            name.push(extension);
        }
        self.output.with_file_name(name)
    }

    fn write_still(&self, path: &Path, frame: &Frame, output: Output) -> anyhow::Result<()> {
        match output {
            Output::Rgb if self.transparent => {
                write_rgba_png(path, &frame.rgb, &frame.opacity, frame.width, frame.height)?;
            }
            Output::Opacity => {
                write_grey16_png(path, &frame.opacity, frame.width, frame.height, (0.0, 1.0))?;
            }
            _ => picture_of(frame, output, None)?.write_png(path)?,
        }
        Ok(())
    }
}

fn picture_of(frame: &Frame, output: Output, range: Option<(f32, f32)>) -> anyhow::Result<Picture> {
    let with_legend = |values: &[f32], title| {
        depth_picture_with_legend(values, &frame.opacity, frame.width, frame.height, range, title)
    };
    Ok(match output {
        Output::Rgb | Output::All => frame.picture(),
        Output::Opacity => {
            let grey = frame.opacity.iter().map(|&opacity| [opacity; 3]).collect();
            Picture::new(frame.width, frame.height, grey)?
        }
        Output::RayDistance => with_legend(&frame.ray_distance, "ray_distance, world units")?,
        Output::ZDepth => with_legend(&frame.z_depth, "z_depth, world units")?,
    })
}

/// Writes an animation; all frames of a distance share one range.
fn write_animation(path: &Path, frames: &[Frame], output: Output, fps: f64) -> anyhow::Result<()> {
    let all =
        |of: fn(&Frame) -> &Vec<f32>| frames.iter().flat_map(|f| of(f).iter().copied()).collect::<Vec<f32>>();
    let opacity = all(|f| &f.opacity);
    let range = match output {
        Output::RayDistance => robust_range(&all(|f| &f.ray_distance), &opacity),
        Output::ZDepth => robust_range(&all(|f| &f.z_depth), &opacity),
        _ => None,
    };
    let pictures: Vec<Picture> =
        frames.iter().map(|frame| picture_of(frame, output, range)).collect::<anyhow::Result<_>>()?;
    Ok(write_gif(path, pictures.into_iter(), fps)?)
}
