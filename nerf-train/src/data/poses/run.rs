//! Runs an installed COLMAP, shows its output, and reports why it failed.

use super::Request;
use crate::data::layouts::colmap::commands::Stage;
use crate::system::child::{Heard, Helper, last_lines};
use crate::system::progress::say;
use anyhow::anyhow;
use std::io;
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Number of bytes kept from the end of each of COLMAP's output streams, to tell its progress and why it failed.
const KEPT_BYTES: usize = 32 << 10;
/// Interval at which COLMAP's output is polled.
const LOOK_EVERY: Duration = Duration::from_millis(200);
/// Minimum time between two shown lines of COLMAP's output.
const LINE_EVERY: Duration = Duration::from_secs(5);
/// Time limit for COLMAP to print the help on a command's options.
const HELP_PATIENCE: Duration = Duration::from_secs(30);

#[derive(Clone, Copy)]
pub(super) struct Runner<'a> {
    pub(super) request: &'a Request<'a>,
    pub(super) photographs: usize,
}

/// Makes the command `colmap`, which opens no window and reads an empty standard input.
fn colmap() -> Command {
    let mut command = Command::new("colmap");
    command.env("QT_QPA_PLATFORM", "offscreen");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn start(command: &mut Command) -> anyhow::Result<(Helper, Heard, Heard)> {
    let helper = Helper::spawn(command).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => anyhow!(
            "no colmap found on PATH: install it (Debian and Ubuntu: `apt-get install colmap`; macOS: \
             `brew install colmap`; elsewhere: https://colmap.github.io/install.html)"
        ),
        _ => anyhow!("colmap does not start: {error}"),
    })?;
    let (_, stdout, stderr) = helper.pipes();
    Ok((helper, Heard::of(stdout, KEPT_BYTES), Heard::of(stderr, KEPT_BYTES)))
}

impl Runner<'_> {
    /// Runs a COLMAP command to its end and shows its progress. Fails if COLMAP fails or is silent for too long.
    pub(super) fn run(&self, stage: Stage) -> anyhow::Result<()> {
        let Request { threads, patience, style, .. } = *self.request;
        let stage = match threads {
            Some(threads) => stage.with_threads(threads),
            None => stage,
        };
        let help = self.help(&stage)?;
        let (helper, out, err) = start(colmap().args(stage.arguments(&help)))?;
        say(style, &format!("colmap {}", stage.name));
        let (mut heard, mut spoke, mut shown) = ([Vec::new(), Vec::new()], Instant::now(), Instant::now());
        let status = loop {
            let status = helper.wait(LOOK_EVERY);
            let said = [out.so_far(), err.so_far()];
            if said != heard {
                if shown.elapsed() > LINE_EVERY {
                    shown = Instant::now();
                    let changed = if said[1] == heard[1] { &said[0] } else { &said[1] };
                    say(style, &format!("colmap {}: {}", stage.name, last_line(changed)));
                }
                (heard, spoke) = (said, Instant::now());
            }
            if let Some(status) = status {
                break status;
            }
            if spoke.elapsed() > patience {
                helper.kill();
                return Err(silent(&stage, patience));
            }
        };
        if status.success() {
            return Ok(());
        }
        Err(failure(&stage, status, self.photographs, &help, [out.text(), err.text()]))
    }

    /// Returns the installed COLMAP's help text on the options of the command `stage`.
    pub(super) fn help(&self, stage: &Stage) -> anyhow::Result<String> {
        let (helper, out, err) = start(colmap().arg(stage.name).arg("--help"))?;
        let patience = HELP_PATIENCE.min(self.request.patience);
        if helper.wait(patience).is_none() {
            helper.kill();
            return Err(silent(stage, patience));
        }
        Ok(String::from_utf8_lossy(&[out.text(), err.text()].concat()).into_owned())
    }
}

pub(super) fn none_registered(photographs: usize, said: &str) -> anyhow::Error {
    anyhow!(
        "colmap registered none of {photographs} photographs: each part of the scene must be in several of them, sharp and \
         taken from different places; it said: {said}"
    )
}

/// Returns the last complete, non-blank line of the output `said`, to show as progress; empty if there is none.
fn last_line(said: &[u8]) -> String {
    let text = String::from_utf8_lossy(said);
    let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
    whole.lines().rev().map(str::trim).find(|line| !line.is_empty()).unwrap_or_default().to_owned()
}

fn silent(stage: &Stage, patience: Duration) -> anyhow::Error {
    anyhow!(
        "colmap {} has said nothing for {} s and was ended; --patience gives it longer",
        stage.name,
        patience.as_secs()
    )
}

/// Makes the error of a failed command. The mapper also fails if it finds no pose for any photograph; the error then
/// says so. `help`: help text of the command, which states COLMAP's version. `said`: output on stdout and stderr.
fn failure(
    stage: &Stage,
    status: ExitStatus,
    photographs: usize,
    help: &str,
    said: [Vec<u8>; 2],
) -> anyhow::Error {
    let [out, err] = said;
    let all = [out.as_slice(), b"\n", err.as_slice()].concat();
    // Messages are on stdout or stderr, depending on the version.
    let last = last_lines(if err.trim_ascii().is_empty() { &out } else { &err });
    let text = String::from_utf8_lossy(&all);
    if stage.name == "mapper" && status.code().is_some() && text.contains("failed to create") {
        return none_registered(photographs, &last_lines(&all));
    }
    if text.contains("unrecognised option") || text.contains("unrecognized option") {
        let version = help.lines().find_map(|line| line.trim().strip_prefix("COLMAP ")?.split(' ').next());
        let version = version.unwrap_or("of unknown version");
        return anyhow!(
            "this colmap ({version}) does not know an option; expected one of versions 3.6 to 4: {last}"
        );
    }
    anyhow!("colmap {} failed ({status}): {last}", stage.name)
}
