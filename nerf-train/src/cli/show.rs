use super::common::{Global, parse_numbers, print_lines};
use super::eval::Split;
use super::options::UpAxis;
use super::options::data::{DataOptions, Space, print_report};
use super::places;
use crate::data::Background;
use crate::model::config::{Config, Preset};
use crate::show::cameras::{Request, Scene, Summary, page};
use crate::system::output::write_atomic;
use crate::system::progress::Progress;
use crate::system::summary::write;
use anyhow::bail;
use clap::Args;
use clap::builder::RangedU64ValueParser;
use std::path::PathBuf;
use std::process::ExitCode;

/// Draw a data set's cameras, and the rays and samples of one training step, in 3D.
///
/// Writes show.html (rotate with the mouse; works offline) and summary.json into a folder. Rays and samples come
/// from the code that samples training batches, with the occupancy grid that training starts with.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train show lego_200x200.npz -o out/show
  nerf-train show lego_200x200.npz -o out/camera3 --camera 3 --rays 40
  nerf-train show lego_200 --split val --step 500 --preset seed --up z")]
pub struct Show {
    /// Data set: a .npz file or a folder, as for `fit`.
    data: PathBuf,
    /// Output folder.
    #[arg(long, short, value_name = "DIR", default_value = "out/show")]
    output: PathBuf,
    /// Split whose cameras and rays are drawn.
    #[arg(long, value_enum, default_value = "train")]
    split: Split,
    /// Show only this camera of the split, from 0.
    #[arg(long, value_name = "I")]
    camera: Option<usize>,
    /// Maximum number of rays to draw.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = within(1, 5000))]
    rays: usize,
    /// Samples per ray (networks without a grid) [default: the preset's].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    samples: Option<u16>,
    /// Training step whose rays are shown.
    #[arg(long, value_name = "N", default_value_t = 0)]
    step: u32,
    /// Preset: grid (hash grid), small (small network, sinusoidal encoding), seed (classic NeRF, 8 layers of 256).
    #[arg(long, value_enum, default_value = "grid", hide_possible_values = true)]
    preset: Preset,
    /// Seed of the random choices in training, which select the rays [default: the preset's].
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Depth of the drawn camera frusta, world units [default: from the camera spacing].
    #[arg(long, value_name = "LENGTH", value_parser = parse_length)]
    frustum: Option<f32>,
    /// Up axis [default: the axis nearest to the cameras' mean up].
    #[arg(long, value_enum, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<UpAxis>,
    /// Scene box: lowest and highest corner, in the coordinates of the data [default: found from the data].
    #[arg(
        long = "box",
        value_name = "X0,Y0,Z0,X1,Y1,Z1",
        value_parser = parse_numbers::<6, f32>,
        allow_hyphen_values = true
    )]
    scene_box: Option<[f32; 6]>,
    /// Scene extent: box (bounded), contracted (unbounded, by scene contraction) or auto (box with --box, or if the
    /// background of the photographs is transparent or of one colour; else contracted).
    #[arg(long, value_enum, default_value_t)]
    space: Space,
    #[command(flatten)]
    data_options: DataOptions,
}

fn within(low: u64, high: u64) -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(low..=high)
}

fn parse_length(text: &str) -> Result<f32, String> {
    let length = text.parse().ok().filter(|&length: &f32| length > 0.0 && length.is_finite());
    length.ok_or_else(|| "expected a length above 0, in world units".into())
}

impl Show {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let html = self.output.join("show.html");
        places::check_folder("-o", &self.output)?;
        if self.samples.is_some() && self.preset.config().network.grid.is_some() {
            bail!(
                "--samples: expected none with --preset grid, whose rays are marched at a fixed step; expected --preset small or seed"
            );
        }
        self.data_options.claims(&*self.data).writes_folder("-o", &self.output).settle()?;
        let dataset = self.data_options.read(&self.data, global)?;
        print_report(&dataset, global);
        let views = self.split.of(&dataset);
        let request = Request {
            views,
            split: self.split.name(),
            camera: self.camera,
            rays: self.rays,
            step: self.step,
            up: self.up.map(UpAxis::direction),
            frustum: self.frustum,
        };
        let config = self.config(dataset.background);
        let progress = Progress::steps("show", 1, global.style());
        let scene = Scene::new(&dataset, &config, &request)?;
        write_atomic(&html, page::page(&scene)?.as_bytes())?;
        progress.finish(format!("{}; {}", scene.title(), scene.facts()));
        if self.camera.is_none() && scene.rays.len() < self.rays {
            let (asked, found) = (self.rays, scene.rays.len());
            global
                .say(format!("--rays: expected {asked}, found {found} in step {}: all are shown", self.step));
        }
        let summary = Summary::of(&scene);
        let json = write(&summary, &self.output)?;
        global.finish_with(&summary, || print_lines([&html, &json].map(|path| path.display().to_string())))
    }

    /// Returns the settings that training would start with.
    fn config(&self, background: Background) -> Config {
        let around = self.space.around(background, self.scene_box.is_some());
        let mut config = self.preset.config().around(around);
        self.space.settle(&mut config);
        let s = &mut config.sampling;
        s.samples = self.samples.unwrap_or(s.samples);
        s.scene_box = self.scene_box;
        s.near = self.data_options.near;
        s.far = self.data_options.far;
        config.seed = self.seed.unwrap_or(config.seed);
        config
    }
}
