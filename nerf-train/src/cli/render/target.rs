//! What a rendering writes: a picture, a film, or a folder of numbered pictures.

use super::Output;
use super::Render;
use crate::cli::common::{Global, say_no_mp4};
use crate::cli::places;
use crate::data::rgb::{Picture, write_grey16_png, write_rgba_png};
use crate::data::system::output::claims::{Claims, Existing};
use crate::measure::frame;
use crate::measure::frame::Frame;
use crate::show::colour_map::{depth_picture_with_legend, normal_picture};
use crate::show::exr::write_exr;
use crate::show::film::{Files, Film, beside};
use crate::show::video::Ffmpeg;
use anyhow::bail;
use std::path::{Path, PathBuf};

/// What `-o` names.
pub(super) enum Target {
    /// One picture.
    Still,
    /// A GIF, and an MP4 beside it where there is an ffmpeg, else why not.
    Gif(Result<Ffmpeg, String>),
    /// An MP4.
    Mp4(Ffmpeg),
    /// `frame_0000.png` and on in a folder.
    Frames,
}

impl Target {
    /// What a signal leaves of it, where `-o` is `output`.
    pub(super) fn left(&self, output: &Path) -> String {
        match self {
            Self::Still => "no picture is written".to_owned(),
            Self::Gif(_) | Self::Mp4(_) => "no film is left of them".to_owned(),
            Self::Frames => format!("their pictures are in {}", output.display()),
        }
    }
}

/// One output on its way to its files.
pub(super) struct Writer {
    output: Output,
    /// Of a distance in a video: the range of its colours, world units.
    range: Option<(f32, f32)>,
    transparent: bool,
    sink: Sink,
}

enum Sink {
    Still(PathBuf),
    Film(Box<Film>),
    /// A folder, and how many frames are in it.
    Frames(PathBuf, usize),
}

impl Render {
    /// Whether there are frames in time.
    pub(super) fn is_sequence(&self) -> bool {
        self.orbit.is_some() || self.path.is_some()
    }

    /// Whether floats are written: then colour is linear light.
    pub(super) fn is_exr(&self) -> bool {
        !self.is_sequence() && is_exr(&self.output)
    }

    /// What `-o` names; refuses what cannot be before any work is done.
    pub(super) fn target(&self) -> anyhow::Result<Target> {
        let name = self.output.display();
        let extension = places::extension(&self.output);
        let extension = extension.as_deref();
        if !self.is_sequence() {
            if let Some("gif" | "mp4") = extension {
                bail!("-o: expected a picture (.png, .exr), found {name}; --orbit and --path make videos");
            }
            places::check_extension("-o", &self.output, places::VIEW)?;
            return Ok(Target::Still);
        }
        let ends_in_slash = self.output.as_os_str().as_encoded_bytes().ends_with(b"/");
        let target = if ends_in_slash || self.output.is_dir() {
            Target::Frames
        } else {
            match extension {
                Some("gif") => Target::Gif(self.mp4.beside_a_gif()?),
                Some("mp4") => Target::Mp4(self.mp4.alone(&self.output)?),
                None => Target::Frames,
                Some(_) => bail!("-o: expected .gif, .mp4 or a folder for frames, found {name}"),
            }
        };
        if self.transparent && !matches!(target, Target::Frames) {
            bail!(
                "--transparent: {name} cannot hold it: expected a folder for PNG frames, for example -o {}",
                self.output.with_extension("").join("").display()
            );
        }
        Ok(target)
    }

    /// The file or folder of an output: the first one has the name that was given.
    fn place_of(&self, output: Output) -> PathBuf {
        if self.outputs().first() == Some(&output) {
            return self.output.clone();
        }
        let mut name = self.output.file_stem().unwrap_or_default().to_owned();
        name.push(format!("_{}", output.suffix()));
        if let Some(extension) = self.output.extension() {
            name.push(".");
            name.push(extension);
        }
        self.output.with_file_name(name)
    }

    /// What it reads and writes.
    pub(super) fn claims(&self, target: &Target) -> Claims {
        let claims = Claims::new()
            .reads("the blob", &self.file)
            .reads_if("the program", self.mp4.program())
            .reads_data_if(self.data.as_deref())
            .reads_data_if(self.path.as_deref());
        self.outputs().into_iter().fold(claims, |claims, output| {
            let place = self.place_of(output);
            let named = place == self.output;
            let flag = if named { "-o".to_owned() } else { format!("{} beside -o", output.suffix()) };
            let claims = match target {
                Target::Frames => return claims.writes_frames(&flag, &place, &places::FRAME),
                _ if named => claims.writes(&flag, &place),
                _ => claims.derives(&flag, &place, Existing::ReplaceOwn),
            };
            match target {
                Target::Gif(Ok(_)) => {
                    claims.derives("the MP4 beside a GIF", &beside(&place), Existing::ReplaceOwn)
                }
                _ => claims,
            }
        })
    }

    /// A writer for an output; `range` is that of a distance's colours, world units.
    pub(super) fn writer(
        &self,
        target: &Target,
        output: Output,
        range: Option<(f32, f32)>,
    ) -> anyhow::Result<Writer> {
        let place = self.place_of(output);
        let film = |files| Film::new(files, self.fps).map(|film| Sink::Film(Box::new(film)));
        let sink = match target {
            Target::Still => Sink::Still(place),
            Target::Frames => Sink::Frames(place, 0),
            Target::Gif(ffmpeg) => film(Files::gif(place, ffmpeg.as_ref().ok()))?,
            Target::Mp4(ffmpeg) => film(Files::Mp4(place, ffmpeg.clone()))?,
        };
        Ok(Writer { output, range, transparent: self.transparent, sink })
    }
}

impl Writer {
    /// Takes the next frame.
    pub(super) fn push(&mut self, frame: &Frame) -> anyhow::Result<()> {
        let (output, range) = (self.output, self.range);
        match &mut self.sink {
            Sink::Still(path) => write_still(path, frame, output, range, self.transparent)?,
            Sink::Film(film) => film.push(picture_of(frame, output, range)?)?,
            Sink::Frames(folder, count) => {
                write_still(&numbered(folder, *count), frame, output, range, self.transparent)?;
                *count += 1;
            }
        }
        Ok(())
    }

    /// Completes the files and names them: a folder by itself.
    pub(super) fn finish(self, global: &Global) -> anyhow::Result<Vec<PathBuf>> {
        match self.sink {
            Sink::Still(path) => Ok(vec![path]),
            Sink::Film(film) => {
                let finished = film.finish()?;
                if let (Some(why), Some(gif)) = (finished.given_up, finished.files.first()) {
                    say_no_mp4(global, &why.to_string(), gif);
                }
                Ok(finished.files)
            }
            Sink::Frames(folder, count) => {
                if numbered(&folder, count).exists() {
                    global.say(format!(
                        "note: {} also holds frames of an earlier run, from {count} on",
                        folder.display()
                    ));
                }
                Ok(vec![folder])
            }
        }
    }
}

fn numbered(folder: &Path, index: usize) -> PathBuf {
    folder.join(format!("frame_{index:04}.png"))
}

fn write_still(
    path: &Path,
    frame: &Frame,
    output: Output,
    range: Option<(f32, f32)>,
    transparent: bool,
) -> anyhow::Result<()> {
    match output {
        _ if is_exr(path) => {
            write_exr(path, frame.width, frame.height, &channels_of(frame, output, transparent))?;
        }
        Output::Rgb if transparent => {
            write_rgba_png(path, &frame.rgb, &frame.opacity, frame.width, frame.height)?;
        }
        Output::Opacity => {
            write_grey16_png(path, &frame.opacity, frame.width, frame.height, (0.0, 1.0))?;
        }
        _ => picture_of(frame, output, range)?.write_png(path)?,
    }
    Ok(())
}

fn is_exr(path: &Path) -> bool {
    places::extension(path).as_deref() == Some("exr")
}

/// The channels of an output, by the names that compositors know where there are such.
fn channels_of(frame: &Frame, output: Output, transparent: bool) -> Vec<(&'static str, Vec<f32>)> {
    let axis = |of: &[[f32; 3]], axis: usize| of.iter().map(|value| value[axis]).collect();
    match output {
        Output::Rgb | Output::All => {
            let mut channels =
                vec![("R", axis(&frame.rgb, 0)), ("G", axis(&frame.rgb, 1)), ("B", axis(&frame.rgb, 2))];
            if transparent {
                channels.push(("A", frame.opacity.clone()));
            }
            channels
        }
        Output::Opacity => vec![("A", frame.opacity.clone())],
        Output::ZDepth => vec![("Z", frame.z_depth.clone())],
        Output::RayDistance => vec![("ray_distance", frame.ray_distance.clone())],
        Output::MedianDistance => vec![("median_distance", frame.median_distance.clone())],
        Output::Normals => vec![
            ("N.X", axis(&frame.normals, 0)),
            ("N.Y", axis(&frame.normals, 1)),
            ("N.Z", axis(&frame.normals, 2)),
        ],
    }
}

fn picture_of(frame: &Frame, output: Output, range: Option<(f32, f32)>) -> anyhow::Result<Picture> {
    let with_legend = |values: &[f32], title| {
        depth_picture_with_legend(values, &frame.opacity, frame.width, frame.height, range, title)
    };
    Ok(match output {
        Output::Rgb | Output::All => frame::picture(frame),
        Output::Opacity => {
            let grey = frame.opacity.iter().map(|&opacity| [opacity; 3]).collect();
            Picture::new(frame.width, frame.height, grey)?
        }
        Output::RayDistance => with_legend(&frame.ray_distance, "ray_distance, world units")?,
        Output::ZDepth => with_legend(&frame.z_depth, "z_depth, world units")?,
        Output::MedianDistance => with_legend(&frame.median_distance, "median_distance, world units")?,
        Output::Normals => normal_picture(&frame.normals, &frame.opacity, frame.width, frame.height)?,
    })
}
