//! MP4s, where there is an ffmpeg.

use crate::cli::common::Global;
use crate::show::video::{Ffmpeg, VideoError};
use anyhow::{Context, bail};
use clap::Args;
use std::path::{Path, PathBuf};

/// The program that makes MP4s.
#[derive(Debug, Args)]
pub struct Mp4Options {
    /// Path of ffmpeg [default: the one on PATH].
    #[arg(long, value_name = "PROGRAM", env = "NERF_FFMPEG", hide_env_values = true)]
    ffmpeg: Option<PathBuf>,
    /// Write no MP4 beside a GIF.
    #[arg(long)]
    no_mp4: bool,
}

impl Mp4Options {
    /// The program, where it was named.
    pub fn program(&self) -> Option<&Path> {
        self.ffmpeg.as_deref()
    }

    /// The ffmpeg for an MP4 beside a GIF, or why there is none: empty where none is wanted.
    ///
    /// # Errors
    /// One that was named and cannot be used.
    pub fn beside_a_gif(&self) -> anyhow::Result<Result<Ffmpeg, String>> {
        if self.no_mp4 {
            return Ok(Err(String::new()));
        }
        match (Ffmpeg::find(self.ffmpeg.as_deref()), &self.ffmpeg) {
            (Ok(ffmpeg), _) => Ok(Ok(ffmpeg)),
            (Err(error), Some(_)) => Err(error).context("--ffmpeg (or NERF_FFMPEG)"),
            (Err(VideoError::Missing { .. }), None) => Ok(Err("no ffmpeg found".to_owned())),
            (Err(error), None) => Ok(Err(error.to_string())),
        }
    }

    /// The ffmpeg for an MP4 that was asked for by name.
    pub fn alone(&self, mp4: &Path) -> anyhow::Result<Ffmpeg> {
        if self.no_mp4 {
            bail!("--no-mp4: expected -o with another ending than {}", mp4.display());
        }
        Ffmpeg::find(self.ffmpeg.as_deref()).with_context(|| {
            format!(
                "{}: an MP4 needs ffmpeg: install it, name it with --ffmpeg or NERF_FFMPEG, or write {}",
                mp4.display(),
                mp4.with_extension("gif").display()
            )
        })
    }
}

/// Says why a GIF has no MP4 beside it; nothing where none was wanted.
pub fn say_no_mp4(global: &Global, why: &str, gif: &Path) {
    if !why.is_empty() {
        global.say(format!("{why}: no MP4 ({} is complete)", gif.display()));
    }
}
