//! What several commands share.

use crate::data;
pub use crate::data::pictures::colour::{name as background_name, parse as parse_background};
pub use crate::data::system::cpu::name as cpu_name;
use crate::data::system::input::{MAX_BLOB_BYTES, read_limited};
use crate::data::system::output::claims::{Claims, Existing, is_device};
use crate::data::system::printable;
use crate::data::system::progress;
use crate::data::system::progress::{Message, Progress, ProgressStyle, Total};
use crate::data::system::summary::to_json;
use crate::data::{Axes, Background, Dataset, Downscale, Layout, ReadOptions, Report, Watch, origin_in_name};
use crate::model::config::{Config, Surroundings};
use crate::show::video::{Ffmpeg, VideoError};
use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use glam::Vec3;
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::math::MathBackend;
use nerf_core::plan::{Plan, PlanError, Quality};
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::Duration;

/// What is said where a signal ends runs of which each has its own file.
pub const GO_ON: &str = "interrupted: the run that was under way is lost, the finished ones are kept; go on with the same command";

/// Threads a core beyond which more only cost memory.
const THREADS_PER_CORE: usize = 4;

/// Prints a line of the result, which stays one line whatever is in it; returns from the function where that fails.
macro_rules! outln {
    ($($arg:tt)*) => {
        $crate::cli::common::print(&$crate::data::system::printable::line(&format!($($arg)*)))?
    };
}

/// Prints lines of the result, such as a table; returns from the function where that fails.
macro_rules! outlines {
    ($text:expr) => {
        $crate::cli::common::print(&$text)?
    };
}

/// Prints lines to stdout. A reader that has seen enough and closed it is no failure.
pub fn print(lines: &str) -> anyhow::Result<()> {
    match writeln!(std::io::stdout(), "{}", printable::lines(lines)) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(error).context("cannot write to standard output")
        }
        _ => Ok(()),
    }
}

/// Prints lines of the result, each of which stays one line whatever is in it.
pub fn print_lines(lines: impl IntoIterator<Item = impl AsRef<str>>) -> anyhow::Result<()> {
    lines.into_iter().try_for_each(|line| print(&printable::line(line.as_ref())))
}

/// Prints a line to stderr, if anybody listens: `eprintln!` would panic where it is closed.
pub fn tell(line: &str) {
    let _ = writeln!(std::io::stderr(), "{}", printable::line(line));
}

/// Options every command takes.
#[derive(Debug, Args)]
#[command(next_help_heading = "Options of every command")]
pub struct Global {
    /// Print results only, no progress.
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Print the result as one JSON object; progress, on stderr, as one a line.
    #[arg(long, global = true)]
    pub json: bool,
    /// Threads, at most four for each core [default: all cores].
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<usize>,
    /// avx512, avx2, neon, portable; -f16: weights in place; -bf16: rounded [default: fastest].
    #[arg(long, global = true, value_name = "KERNEL", env = "NERF_KERNEL", hide_env_values = true, value_parser = parse_kernel)]
    pub kernel: Option<Kernel>,
}

impl Global {
    /// Sets up the thread pool.
    pub fn apply(&self) -> anyhow::Result<()> {
        if let Some(threads) = self.threads {
            if threads == 0 {
                bail!("--threads: expected at least 1, found 0");
            }
            let most = THREADS_PER_CORE * std::thread::available_parallelism().map_or(1, usize::from);
            if threads > most {
                self.say(format!(
                    "--threads: {threads} would only cost memory; taking {most}, {THREADS_PER_CORE} for each core"
                ));
            }
            let threads = threads.min(most);
            rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("--threads")?;
        }
        Ok(())
    }

    /// What to run with.
    pub fn kernel(&self) -> Kernel {
        self.kernel.unwrap_or_else(Kernel::detect)
    }

    /// How to show progress.
    pub fn style(&self) -> ProgressStyle {
        match (self.quiet, self.json) {
            (true, _) => ProgressStyle::Quiet,
            (false, true) => ProgressStyle::Json,
            (false, false) => ProgressStyle::Auto,
        }
    }

    /// Prints a line of what is going on, unless quiet.
    pub fn say(&self, line: impl AsRef<str>) {
        progress::say(self.style(), line.as_ref());
    }

    /// Says what a training runs on.
    pub fn say_training(&self, seed: u64) {
        let (cpu, kernel, threads) = (cpu_name(), self.kernel(), rayon::current_num_threads());
        self.say(format!("training on {cpu} ({kernel}, {threads} threads), seed {seed}"));
    }

    /// Says that a signal ended the command, and what is left of its work.
    pub fn interrupted(&self, message: &str) {
        if self.json { super::interrupted_json(message) } else { super::interrupted(message) }
    }

    /// Prints the result, once and last: `result` as JSON where asked for, else what `human` prints.
    ///
    /// With `--json` nothing else goes to stdout, so a command prints results nowhere but here.
    pub fn finish(
        &self,
        result: &impl Serialize,
        human: impl FnOnce() -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        if self.json { print(to_json(result)?.trim_end()) } else { human() }
    }
}

fn parse_kernel(name: &str) -> Result<Kernel, String> {
    let kernel = Kernel::by_name(name).filter(|kernel| kernel.available());
    kernel.ok_or_else(|| {
        let known: Vec<String> = Kernel::all().map(|kernel| kernel.to_string()).collect();
        format!("expected one of this machine's: {}", known.join(", "))
    })
}

/// How to read a data set.
#[derive(Debug, Args)]
#[command(next_help_heading = "Data set")]
pub struct DataOptions {
    /// Poses look down −Z (opengl) or +Z (opencv) [default: as is usual for the layout].
    #[arg(long, value_name = "CONVENTION")]
    pub axes: Option<Axes>,
    /// Where rays begin, world units along the ray.
    #[arg(long, value_name = "T")]
    pub near: Option<f32>,
    /// Where rays end, world units; in an unbounded scene counted from its middle.
    #[arg(long, value_name = "T")]
    pub far: Option<f32>,
    /// Read a folder as: transforms, colmap or llff [default: the first that fits].
    #[arg(long, value_name = "LAYOUT")]
    pub layout: Option<Layout>,
    /// Reduce photographs so many times; auto: to about 800 pixels [default: auto; Blender 1].
    #[arg(long, value_name = "N", default_value = "auto", hide_default_value = true)]
    pub downscale: Downscale,
    /// Read pictures also where `file_path` leads out of the data set's folder.
    #[arg(long)]
    pub outside_files: bool,
}

/// Where a scene ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Space {
    /// Nowhere, where the pictures do not say what is background, the preset has a learned grid, no box is given and empty
    /// space is skipped; else at a box.
    #[default]
    Auto,
    /// At a box.
    Box,
    /// Nowhere: beyond a ball around what the cameras look at it is contracted.
    Contracted,
}

impl Space {
    /// What pictures with this background say of what lies around the scene; `boxed`: whether it ends anyway.
    pub fn around(self, background: Background, boxed: bool) -> Surroundings {
        match (self, background) {
            (Self::Contracted, _) => Surroundings::Unbounded,
            (Self::Auto, Background::Unknown) if !boxed => Surroundings::Unbounded,
            (_, Background::Unknown) => Surroundings::Unknown,
            _ => Surroundings::Known,
        }
    }

    /// Lets what was asked for by name count, whatever preset and file say.
    pub fn settle(self, config: &mut Config) {
        match self {
            Self::Auto => {}
            Self::Box => config.sampling.contraction = None,
            Self::Contracted => {
                config.sampling.contraction.get_or_insert(1);
            }
        }
    }

    /// Says which was taken, and why.
    pub fn say(self, config: &Config, background: Background, global: &Global) {
        let reason = match (self, background) {
            (Self::Auto, _) if config.sampling.scene_box.is_some() => "which is given",
            (Self::Auto, Background::Unknown) if config.sampling.contraction.is_some() => {
                "since the pictures do not say what is background (--space box ends it at a box)"
            }
            (Self::Auto, Background::Unknown) => {
                "since a contraction needs a learned grid and skips empty space"
            }
            (Self::Auto, _) if config.sampling.contraction.is_some() => "as the settings say",
            (Self::Auto, _) => "since the pictures say what is background",
            _ => "as --space says",
        };
        global.say(match config.sampling.contraction {
            Some(_) => format!("unbounded space, contracted around what the cameras look at, {reason}"),
            None => format!("space ends at a box, {reason}"),
        });
    }
}

impl DataOptions {
    /// The plan with rays from --near to --far.
    ///
    /// # Errors
    /// A range that is none.
    pub fn range_of<'a>(&self, plan: Plan<'a>) -> Result<Plan<'a>, PlanError> {
        plan.with_range(self.near.unwrap_or(0.0), self.far.unwrap_or(f32::MAX))
    }

    /// Reads the data set and shows how that is getting on where it takes a while.
    pub fn read(&self, path: &Path, global: &Global) -> anyhow::Result<Dataset> {
        self.read_from(path, None, global)
    }

    /// As [`Self::read`], with coordinates that count from where those of `blob` do; any split will do.
    pub fn read_for(&self, path: &Path, blob: &Blob<'_>, global: &Global) -> anyhow::Result<Dataset> {
        let options = ReadOptions { to_fit: false, ..self.options() };
        self.read_with(
            path,
            ReadOptions { origin: Some(origin_in_name(blob.provenance().data)), ..options },
            global,
        )
    }

    /// As [`Self::read`], with coordinates that count from `origin`.
    pub fn read_from(
        &self,
        path: &Path,
        origin: Option<[f64; 3]>,
        global: &Global,
    ) -> anyhow::Result<Dataset> {
        self.read_with(path, ReadOptions { origin, ..self.options() }, global)
    }

    fn read_with(&self, path: &Path, options: ReadOptions, global: &Global) -> anyhow::Result<Dataset> {
        let (watch, style) = (Watch::default(), global.style());
        std::thread::scope(|scope| {
            let (reading, ended) = mpsc::channel::<()>();
            scope.spawn(|| show_reading(&watch, style, ended));
            let dataset = data::read_watched(path, &options, &watch);
            drop(reading);
            Ok(dataset?)
        })
    }

    fn options(&self) -> ReadOptions {
        ReadOptions {
            axes: self.axes,
            near: self.near,
            far: self.far,
            outside_files: self.outside_files,
            layout: self.layout,
            downscale: self.downscale,
            ..ReadOptions::default()
        }
    }
}

/// Shows how many pictures are read until `ended` is hung up; nothing where that is soon.
fn show_reading(watch: &Watch, style: ProgressStyle, ended: Receiver<()>) {
    const SOON: Duration = Duration::from_secs(1);
    const EVERY: Duration = Duration::from_millis(200);
    let goes_on = |wait| ended.recv_timeout(wait) == Err(RecvTimeoutError::Timeout);
    if !goes_on(SOON) {
        return;
    }
    let total = match watch.total() {
        0 => Total::Unknown,
        total => Total::Steps(total),
    };
    let mut progress = Progress::new("read", total, style).resume_at(watch.done());
    while goes_on(EVERY) {
        progress.update(watch.done(), &Message::default());
    }
    progress.finish(format!("{} pictures", watch.done()));
}

/// Makes a write beyond a limit of file sizes (`ulimit -f`) an error like that of a full disk: by default the signal
/// that comes with it ends the process without a word.
///
/// To be called before there are threads: these inherit it, and so do programs that are started, such as ffmpeg.
pub fn survive_file_size_limits() {
    #[cfg(unix)]
    {
        use nix::sys::signal::{SigSet, Signal};
        let mut signals = SigSet::empty();
        signals.add(Signal::SIGXFSZ);
        // Where that cannot be, a limit ends the process as it does any other.
        let _ = signals.thread_block();
    }
}

/// Prints what was read.
pub fn print_report(dataset: &Dataset, global: &Global) -> Report {
    let report = Report::of(dataset);
    progress::say_lines(global.style(), &report.to_string());
    report
}

/// A world axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum UpAxis {
    /// +X.
    X,
    /// +Y.
    Y,
    /// +Z.
    Z,
    /// −X.
    #[value(name = "-x")]
    NegX,
    /// −Y.
    #[value(name = "-y")]
    NegY,
    /// −Z.
    #[value(name = "-z")]
    NegZ,
}

impl UpAxis {
    /// Its unit vector.
    pub fn direction(self) -> Vec3 {
        match self {
            Self::X => Vec3::X,
            Self::Y => Vec3::Y,
            Self::Z => Vec3::Z,
            Self::NegX => Vec3::NEG_X,
            Self::NegY => Vec3::NEG_Y,
            Self::NegZ => Vec3::NEG_Z,
        }
    }
}

/// The shortcuts of a rendering.
#[derive(Debug, Args)]
#[command(next_help_heading = "Quality and speed")]
pub struct QualityOptions {
    /// Samples a ray [default: what the blob was made for].
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    pub samples: u16,
    /// A ray ends where its transmittance falls below this.
    #[arg(long, value_name = "T", default_value_t = Quality::default().transmittance_cut)]
    pub transmittance_cut: f32,
    /// Samples of at most this weight take the colour of one behind them; 0: none do.
    #[arg(long, value_name = "W", default_value_t = Quality::default().colour_cut)]
    pub colour_cut: f32,
    /// Ask the network also where the occupancy grid says that nothing is.
    #[arg(long)]
    pub no_occupancy: bool,
    /// Take even samples where a proposal network would draw them.
    #[arg(long)]
    pub no_proposal: bool,
    /// No shortcut at all: same as --no-occupancy --transmittance-cut 0 --colour-cut 0.
    #[arg(long, conflicts_with_all = ["no_occupancy", "transmittance_cut", "colour_cut"])]
    pub exact: bool,
    /// Elementary functions: polynomial, libm, micromath, recurrence.
    #[arg(long, value_name = "BACKEND", default_value = "polynomial", value_parser = parse_math)]
    pub math: MathBackend,
    /// Bins of a ray: own (near to far, as trained) or whole box [default: own in eval].
    #[arg(long, value_enum, value_name = "WHICH")]
    pub bins: Option<WhichBins>,
}

/// Which bins a ray has in a scene with fixed ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum WhichBins {
    /// Those between the scene's near and far.
    Own,
    /// As many as the scene's box needs.
    Whole,
}

/// The name of a maths backend.
pub fn parse_math(name: &str) -> Result<MathBackend, String> {
    match name {
        "polynomial" => Ok(MathBackend::Polynomial),
        "libm" => Ok(MathBackend::Libm),
        "micromath" => Ok(MathBackend::Micromath),
        "recurrence" => Ok(MathBackend::Recurrence),
        _ => Err("expected polynomial, libm, micromath or recurrence".into()),
    }
}

impl QualityOptions {
    /// The plan with the bins that are asked for.
    pub fn bins_of<'a>(&self, plan: Plan<'a>, default: WhichBins) -> Plan<'a> {
        match self.bins.unwrap_or(default) {
            WhichBins::Own => plan.with_own_bins(),
            WhichBins::Whole => plan,
        }
    }

    /// The shortcuts.
    pub fn quality(&self) -> Quality {
        let base =
            Quality { samples: self.samples, math: self.math, proposal: !self.no_proposal, ..Quality::EXACT };
        if self.exact {
            base
        } else {
            Quality {
                transmittance_cut: self.transmittance_cut,
                colour_cut: self.colour_cut,
                occupancy: !self.no_occupancy,
                ..base
            }
        }
    }
}

/// The program that makes MP4s.
#[derive(Debug, Args)]
pub struct Mp4Options {
    /// The ffmpeg that makes MP4s [default: the one on PATH].
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

/// Reads a blob, from a file or a pipe, naming it in the error.
pub fn read_file(path: &Path) -> anyhow::Result<Vec<u8>> {
    read_limited(path, MAX_BLOB_BYTES).with_context(|| format!("cannot read {}", path.display()))
}

/// Opens a blob, naming its file in the error.
pub fn open_blob<'a>(path: &Path, bytes: &'a [u8]) -> anyhow::Result<Blob<'a>> {
    Blob::open(bytes).with_context(|| path.display().to_string())
}

/// `N` numbers with commas between them, as one argument.
pub fn parse_numbers<const N: usize>(text: &str) -> Result<[f32; N], String> {
    let numbers: Option<Vec<f32>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    let numbers = numbers.and_then(|numbers| numbers.try_into().ok());
    numbers.ok_or_else(|| format!("expected {N} numbers with commas between them"))
}

/// Refuses counts of nothing, each by its flag.
pub fn check_counts<const N: usize>(counts: [(&str, usize); N]) -> anyhow::Result<()> {
    match counts.into_iter().find(|&(_, count)| count == 0) {
        Some((flag, _)) => bail!("{flag}: expected at least 1, found 0"),
        None => Ok(()),
    }
}

/// Refuses a limit in seconds that is none.
pub fn check_max_seconds(seconds: Option<f64>) -> anyhow::Result<()> {
    match seconds {
        Some(seconds) if !(seconds.is_finite() && seconds > 0.0) => {
            bail!("--max-seconds: expected a number above 0, found {seconds}")
        }
        _ => Ok(()),
    }
}

/// Refuses an interval between checkpoints that is none; an infinite one writes none on the way.
pub fn check_checkpoint_every(seconds: f64) -> anyhow::Result<()> {
    if seconds.is_nan() || seconds < 0.0 {
        bail!("--checkpoint-every: expected seconds of at least 0, found {seconds}");
    }
    Ok(())
}

/// Settles what a fit reads and writes, the checkpoint beside `output` among it; where that lies, if there is one.
pub fn claim_checkpoint(
    claims: Claims,
    output: &Path,
    resume: bool,
    restart: bool,
) -> anyhow::Result<Option<PathBuf>> {
    let existing = match resume || restart {
        true => Existing::Replace,
        false => Existing::Refuse(": --resume goes on from it, --restart replaces it"),
    };
    let checkpoint = checkpoint_path(output);
    match &checkpoint {
        Some(checkpoint) => claims.derives("the checkpoint beside -o", checkpoint, existing).settle()?,
        None => claims.settle()?,
    }
    if resume && checkpoint.is_none() {
        bail!("--resume: {} is a device, which has no checkpoint beside it", output.display());
    }
    Ok(checkpoint)
}

/// Where the checkpoint of a blob lies; a device has none.
fn checkpoint_path(output: &Path) -> Option<PathBuf> {
    let mut name = output.as_os_str().to_owned();
    name.push(".checkpoint");
    (!is_device(output)).then_some(name.into())
}
