mod shots;
mod target;

use super::common::{Global, open_blob, parse_background, parse_numbers, print_lines, read_file};
use super::eval::Split;
use super::options::data::DataOptions;
use super::options::effects::EffectOptions;
use super::options::quality::{QualityOptions, WhichBins};
use super::options::{ShardOption, UpAxis};
use crate::data::names::count;
use crate::show::render::{Ranges, Rendering, coarse, ranges, render};
use crate::show::view::Output;
use crate::show::writer::Written;
use crate::system::memory;
use crate::system::progress::Progress;
use crate::system::stop::Note;
use anyhow::Context;
use clap::{Args, ValueEnum};
use nerf_core::blob::Blob;
use nerf_core::camera::Camera;
use nerf_core::memory::Line;
use nerf_core::plan::{Outputs, Plan};
use nerf_core::render::Renderer;
use shots::Shots;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Render a view or a video of a scene.
///
/// Without --pose, --data, --path or --orbit, the view is the first of an orbit around the scene. A view is written as
/// PNG, or as EXR if its name ends in .exr. An EXR holds floats: linear colour, and z-depth in channel Z. With
/// --transparent, its colour is premultiplied, and alpha is in channel A. A video is written as GIF (`orbit.gif`), as
/// MP4 by an installed ffmpeg (`orbit.mp4`), or as numbered PNGs in a folder (`frames/`).
///
/// The first of several --outputs gets the name that -o gives. The names of the others get a suffix: with -o view.png,
/// z-depth goes to view_z_depth.png. The file that -o names is replaced. Other files (further outputs, frames in a
/// folder) are replaced only if nerf-train made them; otherwise the command is refused.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train render lego.nerf -o view.png --data lego_200x200.npz --split val --view 3 --outputs rgb,z-depth
  nerf-train render lego.nerf -o orbit.gif --orbit 60 --width 200 --background red
  nerf-train render lego.nerf -o path.gif --path lego_200x200.npz --outputs rgb,z-depth
  nerf-train render lego.nerf -o frames/ --orbit 120 --transparent
  nerf-train render lego.nerf -o view.png --antialias 64 --aperture 0.1 --focus 4 --tone-map filmic
  nerf-train render lego.nerf -o view.png --pose 1,0,0,0,0,1,0,0,0,0,1,4 --focal 277")]
pub struct Render {
    /// Scene file (.nerf).
    file: PathBuf,
    /// Output: image (.png, .exr), video (.gif, .mp4) or folder of frames.
    #[arg(long, short, value_name = "PATH")]
    output: PathBuf,
    /// Camera-to-world matrix, 3×4, row by row (OpenGL: looks down −Z, +Y up), in the coordinates of the data.
    #[arg(
        long,
        value_name = "M,M,…",
        allow_hyphen_values = true,
        value_parser = parse_numbers::<12, f64>,
        group = "what"
    )]
    pose: Option<[f64; 12]>,
    /// Data set from which --view or --keyframes selects cameras.
    #[arg(long, value_name = "DATA", groups = ["what", "dataset"])]
    data: Option<PathBuf>,
    /// Video along a camera path (nerfstudio .json), or through the cameras of a data set's split.
    #[arg(long, value_name = "DATA", groups = ["what", "dataset"])]
    path: Option<PathBuf>,
    /// Split of --data or --path [default: val with --data, test with --path].
    #[arg(long, value_enum, requires = "dataset")]
    split: Option<Split>,
    /// View index in the split, from 0.
    #[arg(long, value_name = "I", default_value_t = 0, requires = "data")]
    view: usize,
    /// Video along a smooth path through these views of --data, by index from 0.
    #[arg(long, value_name = "I,J,…", value_delimiter = ',', requires = "data", conflicts_with = "view")]
    keyframes: Vec<usize>,
    /// Number of frames of a video, with --keyframes or --path FILE.json [default: 120; with --path, the file's].
    #[arg(long, value_name = "N")]
    frames: Option<usize>,
    /// Orbit video with this many frames; swings back and forth if the photographs show only one side.
    #[arg(long, value_name = "FRAMES", group = "what")]
    orbit: Option<usize>,
    /// Elevation of the orbit, degrees [default: from the photographs, else 25].
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    elevation: Option<f32>,
    /// Radius of the orbit, world units [default: from the photographs, else midway between near and far].
    #[arg(long, value_name = "R")]
    radius: Option<f32>,
    /// Up axis of the orbit [default: from the photographs, else z].
    #[arg(long, value_enum, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<UpAxis>,
    /// Frame rate [default: the camera path's, or 20].
    #[arg(long, value_name = "N")]
    fps: Option<f64>,
    /// Width, pixels [default: from the view or path, or 400].
    #[arg(long, value_name = "N")]
    width: Option<u32>,
    /// Height, pixels [default: by the aspect ratio of the view or path, or equal to the width].
    #[arg(long, value_name = "N")]
    height: Option<u32>,
    /// Focal length, pixels [default: from the view or path, or a field of view of 40°].
    #[arg(long, value_name = "F")]
    focal: Option<f32>,
    /// Outputs to render, separated by commas; each is written to a file of its own.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "rgb")]
    outputs: Vec<Output>,
    /// Background: a name (black, white, red), #RRGGBB or R,G,B (0 to 255) [default: the scene file's].
    #[arg(long, value_name = "COLOUR", value_parser = parse_background)]
    background: Option<[f32; 3]>,
    /// Write alpha: straight in PNG, premultiplied in EXR. For a view or a folder of frames.
    #[arg(long, conflicts_with_all = ["background", "exposure", "tone_map", "linear"])]
    transparent: bool,
    /// Blur of the density before normals are computed: width in sample spacings; 0: no blur.
    #[arg(long, value_name = "BINS", default_value_t = Plan::NORMAL_BLUR)]
    normal_blur: f32,
    #[command(flatten)]
    shard: ShardOption,
    /// Path of ffmpeg, for MP4 [default: the one on PATH].
    #[arg(long, value_name = "PROGRAM", env = "NERF_FFMPEG", hide_env_values = true)]
    ffmpeg: Option<PathBuf>,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    effects: EffectOptions,
    #[command(flatten)]
    data_options: DataOptions,
}

/// Memory per pixel of a frame, bytes: the finished frame (40), and the tile that is being rendered (60).
const BYTES_PER_PIXEL: u64 = 40 + 60;
/// Memory per pixel for each output, bytes: the encoded file (8), and the colour as f32 (12) and as bytes (4). The
/// colour is counted twice, because a video buffers two frames per thread.
const BYTES_PER_OUTPUT: u64 = 2 * (12 + 4) + 8;

impl Render {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let note = Note::new("interrupted before the first view");
        let target = target::target(self)?;
        target::claims(self, &target).settle()?;
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let Shots { cameras, fps } = shots::shots(self, &blob, global)?;
        self.check_memory(&cameras)?;
        let shard = target::part(self, &target, global)?;
        let plan = self.plan(&blob)?;
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, global.kernel())];
        let renderer = Renderer::new(blob, global.kernel(), &mut memory)?;

        let start = Instant::now();
        let ranges = self.ranges(&renderer, &plan, &cameras, global)?;
        let range = |output| ranges.iter().find(|(of, _)| *of == output).map(|&(_, range)| range);
        let outputs = self.outputs().into_iter();
        let fps = self.fps.or(fps).unwrap_or(20.0);
        let writers = outputs.map(|output| target::writer(self, &target, output, range(output), shard, fps));
        let mut writers = writers.collect::<anyhow::Result<Vec<_>>>()?;
        // All shards share the colour ranges, so these are computed before the shard is selected.
        let mine = |(i, camera): (usize, Camera)| shard.takes(i).then_some(camera);
        let cameras: Vec<Camera> = cameras.into_iter().enumerate().filter_map(mine).collect();
        let mut progress = Progress::steps("render", cameras.len(), global.style());
        let counters = render(&renderer, &plan, &cameras, &mut writers, |done| {
            let (all, left) = (cameras.len(), target.left(&self.output));
            note.say(format!("interrupted after {done} of {all} views; {left}"));
            progress.reach(done);
        })?;
        progress.finish(count(cameras.len(), "view"));
        let mut files = Vec::new();
        for writer in writers {
            let Written { path, older_from } = writer.finish()?;
            if let Some(count) = older_from {
                let folder = path.display();
                global.say(format!("note: {folder} also holds frames of an earlier run, from {count} on"));
            }
            files.push(path);
        }
        let seconds = start.elapsed().as_secs_f64();
        let summary = Rendering::of(&files, &cameras, counters, &ranges, seconds);
        global.finish_with(&summary, || print_lines(&summary.files))
    }

    fn plan<'b>(&self, blob: &Blob<'b>) -> anyhow::Result<Plan<'b>> {
        let plan =
            self.quality.plan((blob, &self.file), self.wanted(), &self.data_options, WhichBins::Whole)?;
        let plan =
            plan.with_normal_blur(self.normal_blur).with_context(|| self.file.display().to_string())?;
        let plan = match self.background {
            Some(background) => plan.with_background(background)?,
            None if self.transparent => plan.with_background([0.0; 3])?,
            None => plan,
        };
        self.effects.in_light(plan, target::is_exr(self))
    }

    /// Returns the range of each distance output in a whole video, world units. Empty for a single view.
    fn ranges(
        &self,
        renderer: &Renderer<'_>,
        plan: &Plan<'_>,
        cameras: &[Camera],
        global: &Global,
    ) -> anyhow::Result<Ranges> {
        let distances: Vec<Output> =
            self.outputs().into_iter().filter(|output| output.is_distance()).collect();
        if distances.is_empty() || !target::is_sequence(self) {
            return Ok(Ranges::new());
        }
        let mut progress = Progress::steps("range of distances", cameras.len(), global.style());
        let ranges = ranges(renderer, plan, cameras, &distances, |done| progress.reach(done))?;
        progress.finish(format!("{} coarse views", cameras.len()));
        Ok(ranges)
    }

    fn outputs(&self) -> Vec<Output> {
        match self.outputs.contains(&Output::All) {
            true => Output::value_variants().iter().copied().filter(|of| *of != Output::All).collect(),
            // Each output only once, as it has one file.
            false => self.outputs.iter().fold(Vec::new(), |mut outputs, output| {
                if !outputs.contains(output) {
                    outputs.push(*output);
                }
                outputs
            }),
        }
    }

    /// Fails if memory cannot hold a frame and its outputs, or the low-resolution frames that [`ranges`] renders.
    fn check_memory(&self, cameras: &[Camera]) -> anyhow::Result<()> {
        let pixels = |camera: &Camera| {
            let size = camera.intrinsics();
            u64::from(size.width) * u64::from(size.height)
        };
        let Some(largest) = cameras.iter().max_by_key(|camera| pixels(camera)) else { return Ok(()) };
        let size = largest.intrinsics();
        let what = format!("a picture of {}x{} pixels", size.width, size.height);
        let each = BYTES_PER_PIXEL + BYTES_PER_OUTPUT * self.outputs().len() as u64;
        memory::check(what, pixels(largest), each, "choose a smaller --width")?;
        let distances = self.outputs().into_iter().filter(|output| output.is_distance()).count() as u64;
        if distances > 0 && target::is_sequence(self) {
            let coarse = coarse(largest).map_or(0, |camera| pixels(&camera)) * cameras.len() as u64;
            let what = format!("the range of distances of {} frames", cameras.len());
            memory::check(what, coarse, 2 * 4 * (1 + distances), "choose fewer frames, or colour alone")?;
        }
        Ok(())
    }

    fn wanted(&self) -> Outputs {
        let outputs = self.outputs();
        let has = |output| outputs.contains(&output);
        Outputs {
            rgb: has(Output::Rgb),
            opacity: true,
            ray_distance: has(Output::RayDistance),
            z_depth: has(Output::ZDepth),
            median_distance: has(Output::MedianDistance),
            normals: has(Output::Normals),
        }
    }
}
