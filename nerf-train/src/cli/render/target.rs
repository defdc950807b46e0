//! Outputs of a rendering: an image, a video, or a folder of numbered images.

use super::Render;
use crate::cli::common::Global;
use crate::cli::places;
use crate::data::reads_data;
use crate::lab::Shard;
use crate::show::video::Ffmpeg;
use crate::show::view::{self, Output};
use crate::show::writer::{Film, Sink, Writer};
use crate::system::output::claims::{Claims, Existing};
use anyhow::{Context, bail};
use std::path::{Path, PathBuf};

pub(super) enum Target {
    Still,
    /// A video: an MP4 that this ffmpeg encodes; `None`: a GIF.
    Film(Option<Ffmpeg>),
    /// A folder of `frame_0000.png`, `frame_0001.png`, ….
    Frames,
}

impl Target {
    /// Returns the last part of the message about an interruption: which images are kept, and where. `output`: `-o`.
    pub(super) fn left(&self, output: &Path) -> String {
        match self {
            Self::Still => "no picture is written".to_owned(),
            Self::Film(_) => "no film is left of them".to_owned(),
            Self::Frames => format!("their pictures are in {}", output.display()),
        }
    }
}

pub(super) fn is_sequence(render: &Render) -> bool {
    render.orbit.is_some() || render.path.is_some() || !render.keyframes.is_empty()
}

/// Whether the output is an EXR file, whose colour is linear light.
pub(super) fn is_exr(render: &Render) -> bool {
    !is_sequence(render) && view::is_exr(&render.output)
}

/// Returns the kind of output that `-o` names. Fails if other flags exclude this kind, or if ffmpeg for MP4 is missing.
pub(super) fn target(render: &Render) -> anyhow::Result<Target> {
    let name = render.output.display();
    let extension = places::extension(&render.output);
    let extension = extension.as_deref();
    if !is_sequence(render) {
        if let Some("gif" | "mp4") = extension {
            bail!(
                "-o: expected a picture (.png, .exr), found {name}; --orbit, --path and --keyframes make videos"
            );
        }
        places::check_extension("-o", &render.output, places::VIEW)?;
        return Ok(Target::Still);
    }
    let ends_in_slash = render.output.as_os_str().as_encoded_bytes().ends_with(b"/");
    let target = if ends_in_slash || render.output.is_dir() {
        Target::Frames
    } else {
        match extension {
            Some("gif") => Target::Film(None),
            Some("mp4") => Target::Film(Some(find_ffmpeg(render)?)),
            None => Target::Frames,
            Some(_) => bail!("-o: expected .gif, .mp4 or a folder for frames, found {name}"),
        }
    };
    if render.transparent && !matches!(target, Target::Frames) {
        bail!(
            "--transparent: {name} cannot hold it: expected a folder for PNG frames, for example -o {}",
            render.output.with_extension("").join("").display()
        );
    }
    Ok(target)
}

fn find_ffmpeg(render: &Render) -> anyhow::Result<Ffmpeg> {
    Ffmpeg::find(render.ffmpeg.as_deref()).with_context(|| {
        format!(
            "{}: an MP4 needs ffmpeg: install it, name it with --ffmpeg or NERF_FFMPEG, or write {}",
            render.output.display(),
            render.output.with_extension("gif").display()
        )
    })
}

/// Returns the path of the file for `output`: the path of `-o`, with a suffix for all outputs but the first.
fn place_of(render: &Render, output: Output) -> PathBuf {
    if render.outputs().first() == Some(&output) {
        return render.output.clone();
    }
    let mut name = render.output.file_stem().unwrap_or_default().to_owned();
    name.push(format!("_{}", output.suffix()));
    if let Some(extension) = render.output.extension() {
        name.push(".");
        name.push(extension);
    }
    render.output.with_file_name(name)
}

pub(super) fn claims(render: &Render, target: &Target) -> Claims {
    let claims = render.data_options.claims(render.data.as_deref());
    let claims = reads_data(claims, render.path.as_deref())
        .reads("the blob", &render.file)
        .reads("the program", render.ffmpeg.as_deref());
    render.outputs().into_iter().fold(claims, |claims, output| {
        let place = place_of(render, output);
        let named = place == render.output;
        let flag = if named { "-o".to_owned() } else { format!("{} beside -o", output.suffix()) };
        match target {
            Target::Frames => claims.writes_frames(&flag, &place),
            _ if named => claims.writes(&flag, &place),
            _ => claims.derives(&flag, &place, Existing::ReplaceOwn),
        }
    })
}

/// Returns the part of the frames that this process renders. For a folder of frames, `--shard` or the index of an array
/// job selects the part. Otherwise, the part is all frames, and `--shard` is an error.
pub(super) fn part(render: &Render, target: &Target, global: &Global) -> anyhow::Result<Shard> {
    match target {
        Target::Frames => render.shard.choose(global),
        _ if render.shard.shard.is_some() => {
            bail!("--shard: expected a folder for frames (-o frames/), found {}", render.output.display())
        }
        _ => Ok(Shard::WHOLE),
    }
}

/// Returns a writer of `output`. `range`: ends of the colour map, world units; `None`: each picture has its own range.
pub(super) fn writer(
    render: &Render,
    target: &Target,
    output: Output,
    range: Option<(f32, f32)>,
    shard: Shard,
    fps: f64,
) -> anyhow::Result<Writer> {
    let place = place_of(render, output);
    let sink = match target {
        Target::Still => Sink::Still(place),
        Target::Frames => Sink::Frames(place, shard.index - 1, shard.count),
        Target::Film(ffmpeg) => Sink::Film(Box::new(Film::new(place, ffmpeg.clone(), fps)?)),
    };
    Ok(Writer { output, range, transparent: render.transparent, sink })
}
