//! Options and functions that several commands share.

use super::lines::lines;
pub use crate::data::pictures::colour::{name as background_name, parse as parse_background};
use crate::fit::finish::Outcome;
pub use crate::system::cpu::name as cpu_name;
pub use crate::system::input::parse_numbers;
use crate::system::input::{MAX_BLOB_BYTES, read_limited};
use crate::system::printable;
use crate::system::progress::{self, ProgressStyle};
use crate::system::summary::to_json;
use anyhow::{Context, bail};
use clap::Args;
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use serde::Serialize;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

/// Message when a signal interrupts a sequence of training runs. Finished runs have already stored their results.
pub const GO_ON: &str = "interrupted: the run that was under way is lost, the finished ones are kept; go on with the same command";

/// Largest number of threads per core: more would only take memory.
const THREADS_PER_CORE: usize = 4;

/// Prints lines to stdout. A closed pipe is no error.
pub fn print(lines: &str) -> anyhow::Result<()> {
    match writeln!(std::io::stdout(), "{}", printable::lines(lines)) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(error).context("cannot write to standard output")
        }
        _ => Ok(()),
    }
}

/// Prints each line of a result to stdout, with its control characters escaped.
pub fn print_lines(lines: impl IntoIterator<Item = impl AsRef<str>>) -> anyhow::Result<()> {
    lines.into_iter().try_for_each(|line| print(&printable::line(line.as_ref())))
}

/// Prints a line to stderr and ignores errors: `eprintln!` would panic if stderr is closed.
pub fn tell(line: &str) {
    let _ = writeln!(std::io::stderr(), "{}", printable::line(line));
}

/// Options of every command.
#[derive(Debug, Args)]
#[command(next_help_heading = "Options of every command")]
pub struct Global {
    /// Print results only, no progress.
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Print the result as JSON; progress on stderr as JSON lines.
    #[arg(long, global = true)]
    pub json: bool,
    /// Number of threads [default: all cores].
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<usize>,
    /// Compute kernel: avx512, avx2, neon or portable, with suffix -f16 or -bf16 for 16-bit weights [default: fastest without suffix].
    #[arg(long, global = true, value_name = "KERNEL", env = "NERF_KERNEL", hide_env_values = true, value_parser = parse_kernel)]
    pub kernel: Option<Kernel>,
}

impl Global {
    pub fn apply(&self) -> anyhow::Result<()> {
        let mut pool = rayon::ThreadPoolBuilder::new();
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
            pool = pool.num_threads(threads.min(most));
        }
        // This thread is part of the pool, so that a training step begins and ends without waking another.
        pool.use_current_thread()
            .build_global()
            .context("cannot start the threads; --threads sets their number")
    }

    pub fn kernel(&self) -> Kernel {
        self.kernel.unwrap_or_else(Kernel::detect)
    }

    pub fn style(&self) -> ProgressStyle {
        match (self.quiet, self.json) {
            (true, _) => ProgressStyle::Quiet,
            (false, true) => ProgressStyle::Json,
            (false, false) => ProgressStyle::Auto,
        }
    }

    /// Prints a message about progress to stderr, unless `--quiet` is given.
    pub fn say(&self, line: impl AsRef<str>) {
        progress::say(self.style(), line.as_ref());
    }

    pub fn say_training(&self, seed: u64) {
        let (cpu, kernel, threads) = (cpu_name(), self.kernel(), rayon::current_num_threads());
        self.say(format!("training on {cpu} ({kernel}, {threads} threads), seed {seed}"));
    }

    /// Reports that a signal ended the command. `message` says which results are kept.
    pub fn interrupted(&self, message: &str) {
        if self.json { super::interrupted_json(message) } else { super::interrupted(message) }
    }

    /// Prints the result to stdout: as JSON with `--json`, else its fields as lines. A command must print its result by
    /// one call of this function or of [`Self::finish_with`]: with `--json`, stdout must hold one JSON object.
    pub fn finish(&self, result: &impl Serialize) -> anyhow::Result<ExitCode> {
        self.finish_with(result, || print(lines(result)?.trim_end()))
    }

    /// Prints the result to stdout: as JSON with `--json`, else by calling `human`.
    pub fn finish_with(
        &self,
        result: &impl Serialize,
        human: impl FnOnce() -> anyhow::Result<()>,
    ) -> anyhow::Result<ExitCode> {
        if self.json { print(to_json(result)?.trim_end()) } else { human() }?;
        Ok(ExitCode::SUCCESS)
    }
}

fn parse_kernel(name: &str) -> Result<Kernel, String> {
    let kernel = Kernel::by_name(name).filter(|kernel| kernel.available());
    kernel.ok_or_else(|| {
        let known: Vec<String> = Kernel::all().map(|kernel| kernel.to_string()).collect();
        format!("expected one of this machine's: {}", known.join(", "))
    })
}

/// Blocks SIGXFSZ, so that a write beyond the file size limit (`ulimit -f`) returns an error instead of ending the
/// process. Call this before any thread starts: threads and child processes, such as ffmpeg, inherit the signal mask.
pub fn survive_file_size_limits() {
    #[cfg(unix)]
    {
        use nix::sys::signal::{SigSet, Signal};
        let mut signals = SigSet::empty();
        signals.add(Signal::SIGXFSZ);
        // If blocking fails, the signal ends the process as by default.
        let _ = signals.thread_block();
    }
}

/// Returns the bytes of a .nerf file, which may be a pipe. Errors name the path.
pub fn read_file(path: &Path) -> anyhow::Result<Vec<u8>> {
    read_limited(path, MAX_BLOB_BYTES).with_context(|| format!("cannot read {}", path.display()))
}

/// Opens `bytes`, the contents of the .nerf file `path`. Errors name the path.
pub fn open_blob<'a>(path: &Path, bytes: &'a [u8]) -> anyhow::Result<Blob<'a>> {
    Blob::open(bytes).with_context(|| path.display().to_string())
}

pub fn check_counts<const N: usize>(counts: [(&str, usize); N]) -> anyhow::Result<()> {
    match counts.into_iter().find(|&(_, count)| count == 0) {
        Some((flag, _)) => bail!("{flag}: expected at least 1, found 0"),
        None => Ok(()),
    }
}

pub fn check_max_seconds(seconds: Option<f64>) -> anyhow::Result<()> {
    match seconds {
        Some(seconds) if !(seconds.is_finite() && seconds > 0.0) => {
            bail!("--max-seconds: expected a number above 0, found {seconds}")
        }
        _ => Ok(()),
    }
}

pub fn tell_flat(outcome: &Outcome) {
    if outcome.flat {
        let views = if outcome.scores.views.is_empty() { "training" } else { "validation" };
        tell(&format!(
            "nothing was learned: a flat colour has {:.2} dB on {views} views; lower --rate, or give it more \
             --steps",
            outcome.flat_psnr_db
        ));
    }
}

/// Reports why steps of `--snapshots` were `missed`: the run ended at step `last`, or was resumed from a later step.
pub fn tell_missed(last: u32, missed: &[u32]) {
    let (beyond, passed): (Vec<u32>, Vec<u32>) = missed.iter().partition(|&&step| step > last);
    let say = |steps: &[u32], why: String| {
        if !steps.is_empty() {
            let steps: Vec<String> = steps.iter().map(u32::to_string).collect();
            tell(&format!("--snapshots: no picture of step {}: {why}", steps.join(", ")));
        }
    };
    say(&beyond, format!("the run ended at step {last}"));
    say(&passed, "the run had passed it when it was taken up again".into());
}
