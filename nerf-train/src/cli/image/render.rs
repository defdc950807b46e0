use crate::cli::common::{Global, open_blob, read_file};
use crate::cli::options::quality::parse_math;
use crate::cli::places;
use crate::data::pictures::photograph::MAX_SIDE;
use crate::measure::frame::{PictureSummary, render_picture};
use crate::system::memory;
use crate::system::output::claims::Claims;
use crate::system::progress::{Message, Progress, Total};
use anyhow::{Context, bail};
use clap::Args;
use nerf_core::blob::PictureFacts;
use nerf_core::math::MathBackend;
use nerf_core::memory::Line;
use nerf_core::render::Renderer;
use std::path::PathBuf;
use std::process::ExitCode;

/// Render a 2D field at any size.
///
/// The default size is the trained image's size. If only --width or only --height is given, the aspect ratio is kept.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train image render fox.nerf -o fox.png
  nerf-train image render fox.nerf -o large.png --width 4096")]
pub struct Render {
    /// File of a 2D field (.nerf).
    file: PathBuf,
    /// Output image (.png).
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// Width, pixels [default: the trained image's, or in proportion to --height].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SIDE)))]
    width: Option<u32>,
    /// Height, pixels [default: the trained image's, or in proportion to --width].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SIDE)))]
    height: Option<u32>,
    /// Implementation of exp, sin and other functions: polynomial (fast), libm (reference), micromath (small code),
    /// recurrence (as polynomial, but sines of an encoding by angle doubling).
    #[arg(long, value_name = "BACKEND", default_value = "polynomial", value_parser = parse_math)]
    math: MathBackend,
}

/// Memory per pixel until the image is written, bytes: colour as f32 (12) and as bytes (3), and the encoded file (8).
const BYTES_PER_PIXEL: u64 = 12 + 3 + 2 * 4;

impl Render {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        places::check_extension("-o", &self.output, places::PICTURE)?;
        Claims::default().reads("the blob", &self.file).writes("-o", &self.output).settle()?;
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let Some(facts) = blob.picture() else {
            bail!("{}: expected a 2D field, found a scene: render it with `render`", self.file.display());
        };
        let size = self.size(facts);
        let flag = if self.width.is_some() || self.height.is_none() { "--width" } else { "--height" };
        if size[0].max(size[1]) > MAX_SIDE {
            bail!("{flag}: expected at most {MAX_SIDE} pixels a side, found {}x{}", size[0], size[1]);
        }
        let [width, height] = size.map(u64::from);
        let what = format!("{}: a picture of {width}x{height} pixels", self.file.display());
        memory::check(what, width * height, BYTES_PER_PIXEL, &format!("choose a smaller {flag}"))?;
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, global.kernel())];
        let renderer = Renderer::new(blob, global.kernel(), &mut memory)?;
        let mut progress = Progress::new("render", Total::Steps(size[1].into()), global.style());
        let (picture, counters) = render_picture(&renderer, self.math, size, |rows| {
            progress.update(rows, &Message { note: "rows".into(), ..Message::default() });
        })
        .with_context(|| self.file.display().to_string())?;
        progress.finish(format!("{} rows", size[1]));
        picture.write_png(&self.output)?;
        let summary = PictureSummary {
            file: self.output.display().to_string(),
            width_px: size[0],
            height_px: size[1],
            colour_evaluations: counters.colour_evaluations,
            macs: counters.macs,
            invalid_samples: counters.invalid_samples,
        };
        global.finish(&summary)
    }

    /// Returns width and height, pixels, as set by the flags. Without flags, returns the size of the trained image.
    /// With one flag, keeps the aspect ratio.
    fn size(&self, facts: PictureFacts) -> [u32; 2] {
        let along = |side: u32, of: u32, to: u32| {
            // Rounded, at least 1. The result fits u32, since `side` and `to` are below 2^16.
            ((u64::from(side) * u64::from(to) + u64::from(of) / 2) / u64::from(of)).max(1) as u32
        };
        match (self.width, self.height) {
            (Some(width), Some(height)) => [width, height],
            (Some(width), None) => [width, along(width, facts.width, facts.height)],
            (None, Some(height)) => [along(height, facts.height, facts.width), height],
            (None, None) => [facts.width, facts.height],
        }
    }
}
