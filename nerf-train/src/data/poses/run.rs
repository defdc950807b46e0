//! Runs an installed COLMAP, shows how far it is, and says why it failed.

use super::PosesError;
use crate::data::layouts::colmap::commands::Stage;
use crate::system::child::{Heard, Helper, last_lines};
use crate::system::progress::{Message, Progress, ProgressStyle, Total};
use std::io;
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// What is kept of COLMAP's messages, bytes: the last ones say how far it is and why it failed.
const KEPT_BYTES: usize = 32 << 10;
/// How often it is asked how far it is.
const LOOK_EVERY: Duration = Duration::from_millis(200);
/// How long it may take to list its options.
const HELP_PATIENCE: Duration = Duration::from_secs(30);

/// How COLMAP is run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Runner {
    /// Photographs in all.
    pub(super) photographs: usize,
    pub(super) threads: Option<usize>,
    /// How long it may say nothing.
    pub(super) patience: Duration,
    pub(super) style: ProgressStyle,
}

/// `colmap`, without a window and without input.
fn colmap() -> Command {
    let mut command = Command::new("colmap");
    command.env("QT_QPA_PLATFORM", "offscreen");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn start(command: &mut Command) -> Result<(Helper, Heard, Heard), PosesError> {
    let helper = Helper::spawn(command).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => PosesError::Missing,
        _ => PosesError::Start(error),
    })?;
    let (_, stdout, stderr) = helper.pipes();
    Ok((helper, Heard::of(stdout, KEPT_BYTES), Heard::of(stderr, KEPT_BYTES)))
}

impl Runner {
    /// Runs a command to its end and shows how far it is.
    pub(super) fn run(&self, stage: Stage) -> Result<(), PosesError> {
        let stage = match self.threads {
            Some(threads) => stage.with_threads(threads),
            None => stage,
        };
        let help = self.help(&stage)?;
        let photographs = self.photographs;
        let (helper, out, err) = start(colmap().args(stage.arguments(&help)))?;
        let (what, whole) = match stage.name {
            "feature_extractor" => ("features", "photographs"),
            "mapper" => ("poses", "photographs"),
            _ => ("matches", "blocks of photographs"),
        };
        // Into how many parts matching goes is known when it begins.
        let mut progress: Option<(u64, Progress)> = None;
        let (mut heard, mut spoke) = ([Vec::new(), Vec::new()], Instant::now());
        let status = loop {
            let status = helper.wait(LOOK_EVERY);
            let said = [out.so_far(), err.so_far()];
            if said != heard {
                (heard, spoke) = (said, Instant::now());
            }
            let at =
                heard.iter().find_map(|said| position(&String::from_utf8_lossy(said), photographs as u64));
            if let Some((done, total)) = at {
                let fresh = || (total, Progress::new(what, Total::Steps(total), self.style));
                let (_, shown) = match &mut progress {
                    Some(shown) if shown.0 == total => shown,
                    other => other.insert(fresh()),
                };
                shown.update(done, &Message::default());
            }
            if let Some(status) = status {
                break status;
            }
            if spoke.elapsed() > self.patience {
                helper.kill();
                return Err(PosesError::Silent { stage: stage.name, seconds: self.patience.as_secs() });
            }
        };
        if !status.success() {
            return Err(failure(&stage, status, photographs, &help, [out.text(), err.text()]));
        }
        if let Some((total, progress)) = progress {
            let total = if what == "poses" { photographs as u64 } else { total };
            progress.finish(format!("{total} {whole}"));
        }
        Ok(())
    }

    /// What the installed version says of a command's options.
    pub(super) fn help(&self, stage: &Stage) -> Result<String, PosesError> {
        let (helper, out, err) = start(colmap().arg(stage.name).arg("--help"))?;
        let patience = HELP_PATIENCE.min(self.patience);
        if helper.wait(patience).is_none() {
            helper.kill();
            return Err(PosesError::Silent { stage: stage.name, seconds: patience.as_secs() });
        }
        Ok(String::from_utf8_lossy(&[out.text(), err.text()].concat()).into_owned())
    }
}

/// Why it failed: that no pair of photographs fits is an error to COLMAP, too.
fn failure(
    stage: &Stage,
    status: ExitStatus,
    photographs: usize,
    help: &str,
    said: [Vec<u8>; 2],
) -> PosesError {
    let [out, err] = said;
    let all = [out.as_slice(), b"\n", err.as_slice()].concat();
    // Messages are on one of the two, by version.
    let last = last_lines(if err.trim_ascii().is_empty() { &out } else { &err });
    let text = String::from_utf8_lossy(&all);
    if stage.name == "mapper" && status.code().is_some() && text.contains("failed to create") {
        return PosesError::NoneRegistered { photographs, said: last_lines(&all) };
    }
    if text.contains("unrecognised option") || text.contains("unrecognized option") {
        let version = help.lines().find_map(|line| line.trim().strip_prefix("COLMAP ")?.split(' ').next());
        return PosesError::Version { version: version.unwrap_or("of unknown version").into(), said: last };
    }
    PosesError::Failed { stage: stage.name, status: status.to_string(), said: last }
}

/// How far COLMAP is, of how much, by the last that it has said: `[3/77]`, of blocks `[1/2, 2/2]`, and of the mapper
/// `Registering image #65 (3)`, or `(num_reg_frames=3)`, of all `photographs`.
fn position(said: &str, photographs: u64) -> Option<(u64, u64)> {
    let number = |text: &str| {
        let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
        text[..digits].parse::<u64>().ok()
    };
    let pair = |text: &str| {
        let (a, b) = text.split_once('/')?;
        Some((a.trim().parse::<u64>().ok()?, b.trim().parse::<u64>().ok()?))
    };
    said.lines().rev().find_map(|line| {
        if let Some((_, rest)) = line.split_once("Registering image #") {
            let (_, rest) = rest.split_once('(')?;
            return Some((number(rest.trim_start_matches("num_reg_frames="))?, photographs));
        }
        let (_, rest) = line.split_once('[')?;
        let (inner, _) = rest.split_once(']')?;
        match inner.split_once(',') {
            Some((row, column)) => {
                let ((i, rows), (j, columns)) = (pair(row)?, pair(column)?);
                Some((i.checked_sub(1)?.checked_mul(columns)?.checked_add(j)?, rows.checked_mul(columns)?))
            }
            None => pair(inner),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::position;

    #[test]
    fn the_last_of_what_it_said_tells_how_far_it_is() {
        let position = |said| position(said, 77);
        assert_eq!(position("Processed file [1/12]\n  Name: a\nProcessed file [2/12]\n  Dim"), Some((2, 12)));
        assert_eq!(position("I2025 12:00 feature_matching.cc:4] Processing block [2/3, 1/3]"), Some((4, 9)));
        assert_eq!(position("Matching block [2/2, 1/2] in 0.4s\nMatching bl"), Some((3, 4)));
        assert_eq!(position("Registering image #5 (8)\n  => Image sees 3 / 4 points"), Some((8, 77)));
        assert_eq!(position("Registering image #5 (num_reg_frames=9)"), Some((9, 77)));
        assert_eq!(position("Elapsed time: 0.041 [minutes]"), None);
        assert_eq!(position("[18446744073709551615/3, 9/18446744073709551615]"), None);
    }
}
