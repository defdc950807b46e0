//! Display of the progress of long tasks, in one of the styles of [`ProgressStyle`]: a bar, lines or nothing.
//!
//! All output goes to stderr, so that stdout stays free for results. A closed stderr is ignored.

use crate::system::{lock, printable};
use indicatif::{HumanCount, ProgressBar, ProgressDrawTarget};
use serde::Serialize;
use std::fmt::Write as _;
use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Time between two lines of progress, in plain text or JSON.
const LINE_EVERY: Duration = Duration::from_secs(5);
/// Length of the bar. Its position is a fraction of the work, because a time budget has no number of steps.
const BAR_LENGTH: u64 = 10_000;
/// Time that must elapse before the remaining time is estimated.
const EARLIEST_ESTIMATE: Duration = Duration::from_secs(1);

/// End of the work: at a number of steps, after some time, or at whichever comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Total {
    Steps(u64),
    Time(Duration),
    StepsOrTime(u64, Duration),
    /// The end is not known: a bar stays at 0 %, and no remaining time is shown.
    Unknown,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProgressStyle {
    /// Shows a bar if stderr is a terminal, else plain lines every five seconds.
    Auto,
    /// Shows plain lines every five seconds, also on a terminal.
    Plain,
    /// Prints one JSON object per line, every five seconds, for another program to read.
    ///
    /// Progress: `{"event":"progress","what":"render","position":3,"total":60,"elapsed_s":5.2,"left_s":98.8}`. Unknown
    /// values of `total` and `left_s` are null. The keys `rays_per_s`, `train_psnr_db`, `val_psnr_db` and `note` follow
    /// if their values are known. The end of a task is `{"event":"done","what":…,"text":…,"elapsed_s":…}`. A line of
    /// any other kind is `{"event":"note","text":…}`.
    Json,
    Quiet,
}

/// Values that a progress display shows next to the number of steps done. A value that is `None` is left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Message {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rays_per_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub train_psnr_db: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub val_psnr_db: Option<f64>,
    /// Further text, shown after the values; may be empty.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// One JSON line for another program to read; numbers that are not finite are null.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "lowercase")]
enum Event<'a> {
    Progress {
        what: &'a str,
        position: u64,
        /// Total number of steps; null if the end of the work is given by time alone, or is unknown.
        total: Option<u64>,
        elapsed_s: f64,
        left_s: Option<f64>,
        #[serde(flatten)]
        message: &'a Message,
    },
    Done {
        what: &'a str,
        text: &'a str,
        elapsed_s: f64,
    },
    Note {
        text: &'a str,
    },
}

impl Event<'_> {
    fn line(&self) -> String {
        // Serialising strings and numbers cannot fail.
        let json = serde_json::to_string(self).unwrap_or_default();
        printable::json(&json).into_owned()
    }
}

/// Progress display of one task. If dropped without [`Self::finish`], leaves the bar on the screen in its last state.
#[derive(Debug)]
pub struct Progress {
    what: String,
    total: Total,
    started: Instant,
    /// Position at which this run started. Earlier steps do not enter the estimate of the remaining time.
    first: u64,
    display: Display,
}

#[derive(Debug)]
enum Display {
    Bar(ProgressBar),
    Lines { last: Option<Instant>, json: bool },
    Quiet,
}

impl Progress {
    /// Creates a display and starts its clock; the first update shows the bar or a line. `what`: name of the work.
    pub fn new(what: impl Into<String>, total: Total, style: ProgressStyle) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let display = match style {
            ProgressStyle::Quiet => Display::Quiet,
            ProgressStyle::Auto if terminal => {
                let bar = new_bar();
                *lock(&BAR) = Some(bar.clone());
                Display::Bar(bar)
            }
            ProgressStyle::Auto | ProgressStyle::Plain => Display::Lines { last: None, json: false },
            ProgressStyle::Json => Display::Lines { last: None, json: true },
        };
        Self { what: what.into(), total, started: Instant::now(), first: 0, display }
    }

    /// Creates a display, as [`Self::new`] does, for the work named `what`, which ends after `total` steps.
    pub fn steps(what: impl Into<String>, total: usize, style: ProgressStyle) -> Self {
        Self::new(what, Total::Steps(total as u64), style)
    }

    /// Sets the position at which work resumes. The remaining time is estimated from the steps of this run only.
    pub fn resume_at(mut self, position: u64) -> Self {
        self.first = position;
        self
    }

    /// Shows that `position` steps are done. Cheap to call in every step: a bar is redrawn at most 20 times a second.
    pub fn update(&mut self, position: u64, message: &Message) {
        let now = Instant::now();
        match &mut self.display {
            Display::Quiet => return,
            Display::Lines { last, .. } => {
                if last.is_some_and(|last| now.duration_since(last) < LINE_EVERY) {
                    return;
                }
                *last = Some(now);
            }
            Display::Bar(_) => {}
        }
        let elapsed = now.duration_since(self.started);
        match &self.display {
            Display::Bar(bar) => {
                let share = self.share(position, elapsed).unwrap_or(0.0);
                bar.set_position((share * BAR_LENGTH as f64) as u64);
                bar.set_prefix(printable::line(&self.standing(position, elapsed)).into_owned());
                bar.set_message(printable::line(&details(message)).into_owned());
            }
            Display::Lines { json: true, .. } => print_line(&self.event(position, elapsed, message).line()),
            _ => print_line(&self.describe(position, elapsed, message)),
        }
    }

    pub fn reach(&mut self, position: usize) {
        self.update(position as u64, &Message::default());
    }

    /// Prints a separate line, above the bar if there is one. Prints nothing in quiet mode.
    pub fn println(&self, line: impl AsRef<str>) {
        match &self.display {
            Display::Bar(bar) => bar.suspend(|| print_line(line.as_ref())),
            Display::Lines { json: true, .. } => say(ProgressStyle::Json, line.as_ref()),
            Display::Lines { .. } => print_line(line.as_ref()),
            Display::Quiet => {}
        }
    }

    /// Prints a line, such as a warning, also in quiet mode.
    pub fn warn(&self, line: impl AsRef<str>) {
        match &self.display {
            Display::Quiet => print_line(line.as_ref()),
            _ => self.println(line),
        }
    }

    /// Removes the bar, and prints `line` with the time that the work took. Prints nothing in quiet mode.
    pub fn finish(self, line: impl AsRef<str>) {
        let (line, elapsed) = (line.as_ref(), self.started.elapsed());
        let text = format!("{}: {line} ({})", self.what, in_words(elapsed));
        match &self.display {
            Display::Bar(bar) => {
                bar.finish_and_clear();
                print_line(&text);
            }
            Display::Lines { json: true, .. } => {
                let (what, elapsed_s) = (&self.what, rounded_seconds(elapsed));
                print_line(&Event::Done { what, text: line, elapsed_s }.line());
            }
            Display::Lines { .. } => print_line(&text),
            Display::Quiet => {}
        }
    }

    /// Returns the fraction of the work that is done, 0 to 1; `None` if unknown. If the work ends by steps or by time,
    /// returns the larger of the two fractions.
    fn share(&self, position: u64, elapsed: Duration) -> Option<f64> {
        let steps = |total: u64| if total == 0 { 1.0 } else { position as f64 / total as f64 };
        let time = |budget: Duration| {
            if budget.is_zero() { 1.0 } else { elapsed.as_secs_f64() / budget.as_secs_f64() }
        };
        let share = match self.total {
            Total::Steps(total) => steps(total),
            Total::Time(budget) => time(budget),
            Total::StepsOrTime(total, budget) => steps(total).max(time(budget)),
            Total::Unknown => return None,
        };
        Some(share.clamp(0.0, 1.0))
    }

    /// Returns the remaining time, estimated from this run's speed and limited by the time budget; `None` if unknown.
    fn remaining(&self, position: u64, elapsed: Duration) -> Option<Duration> {
        let done = position.saturating_sub(self.first);
        let steps = |total: u64| {
            let left = total.saturating_sub(position);
            if left == 0 {
                return Some(Duration::ZERO);
            }
            let known = done > 0 && elapsed >= EARLIEST_ESTIMATE;
            let seconds = elapsed.as_secs_f64() * left as f64 / done as f64;
            known.then(|| Duration::try_from_secs_f64(seconds).ok())?
        };
        let time = |budget: Duration| budget.saturating_sub(elapsed);
        match self.total {
            Total::Steps(total) => steps(total),
            Total::Time(budget) => Some(time(budget)),
            Total::StepsOrTime(total, budget) => {
                Some(steps(total).map_or(time(budget), |left| left.min(time(budget))))
            }
            Total::Unknown => None,
        }
    }

    fn event<'a>(&'a self, position: u64, elapsed: Duration, message: &'a Message) -> Event<'a> {
        let total = match self.total {
            Total::Steps(total) | Total::StepsOrTime(total, _) => Some(total),
            Total::Time(_) | Total::Unknown => None,
        };
        Event::Progress {
            what: &self.what,
            position,
            total,
            elapsed_s: rounded_seconds(elapsed),
            left_s: self.remaining(position, elapsed).map(rounded_seconds),
            message,
        }
    }

    /// Returns a line of progress: "25 % · train 1,250/5,000 · 0:41, 2:03 left · 31.4 k rays/s · train 24.10 dB".
    fn describe(&self, position: u64, elapsed: Duration, message: &Message) -> String {
        let mut text = self.standing(position, elapsed);
        if let Some(share) = self.share(position, elapsed) {
            text = format!("{:.0} % · {text}", (share * 100.0).floor());
        }
        let details = details(message);
        if details.is_empty() { text } else { format!("{text} · {details}") }
    }

    /// Returns the position in steps and time as text: "train 1,250/5,000 · 0:41, 2:03 left".
    fn standing(&self, position: u64, elapsed: Duration) -> String {
        let mut text = format!("{} {}", self.what, HumanCount(position));
        // Writing into a String cannot fail.
        if let Total::Steps(total) | Total::StepsOrTime(total, _) = self.total {
            let _ = write!(text, "/{}", HumanCount(total));
        }
        let _ = write!(text, " · {}", in_words(elapsed));
        if let Some(left) = self.remaining(position, elapsed) {
            let _ = write!(text, ", {} left", in_words(left));
        }
        text
    }
}

/// Returns the values of a message as text: "31.4 k rays/s · train 24.10 dB · val 23.87 dB".
fn details(message: &Message) -> String {
    let parts = [
        message.rays_per_s.filter(|rate| rate.is_finite()).map(|rate| format!("{} rays/s", scaled(rate))),
        message.train_psnr_db.map(|db| format!("train {db:.2} dB")),
        message.val_psnr_db.map(|db| format!("val {db:.2} dB")),
        (!message.note.is_empty()).then(|| message.note.clone()),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(" · ")
}

/// The progress bar that was started last, which [`abandon`] leaves on the screen when a signal ends the process.
static BAR: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// Leaves a running bar on the screen and moves the cursor to a new line, for a last message before the process ends.
pub fn abandon() {
    if let Some(bar) = lock(&BAR).take()
        && !bar.is_finished()
    {
        bar.abandon();
        // Threads that still work would draw over the last message.
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        // The bar's last state stays, also after an error, and the cursor is on a new line.
        if let Display::Bar(bar) = &self.display
            && !bar.is_finished()
        {
            bar.abandon();
        }
    }
}

fn new_bar() -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(BAR_LENGTH), ProgressDrawTarget::stderr());
    // Two lines, as 80 columns cannot hold times and figures. If the template does not parse, the default bar is shown.
    match indicatif::ProgressStyle::with_template("{bar:24.cyan/white} {percent:>3} % {prefix}\n{wide_msg}") {
        Ok(style) => bar.with_style(style.progress_chars("━╸─")),
        Err(_) => bar,
    }
}

/// Prints to stderr a line that belongs to no task, in the format of `style`. Prints nothing in quiet mode.
pub fn say(style: ProgressStyle, line: &str) {
    match style {
        ProgressStyle::Json => say_lines(style, line),
        _ => say_lines(style, &printable::line(line)),
    }
}

/// Prints `lines` as [`say`] prints one line. Callers must escape names in `lines` with [`printable::line`].
pub fn say_lines(style: ProgressStyle, lines: &str) {
    match style {
        ProgressStyle::Quiet => {}
        ProgressStyle::Json => print_lines(&Event::Note { text: lines }.line()),
        ProgressStyle::Auto | ProgressStyle::Plain => print_lines(lines),
    }
}

fn print_line(line: &str) {
    print_lines(&printable::line(line));
}

fn print_lines(lines: &str) {
    // eprintln! would panic where stderr is closed.
    let _ = writeln!(std::io::stderr(), "{}", printable::lines(lines));
}

/// Returns `time` in seconds, rounded to the millisecond.
fn rounded_seconds(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e3).round() / 1e3
}

/// Returns a value as text with three digits and a unit prefix: "31.4 k" for 31,400, "2.50 M" for 2,500,000.
fn scaled(value: f64) -> String {
    let (value, unit) = match value.abs() {
        size if size >= 1e9 => (value / 1e9, " G"),
        size if size >= 1e6 => (value / 1e6, " M"),
        size if size >= 1e3 => (value / 1e3, " k"),
        _ => (value, ""),
    };
    let decimals = match value.abs() {
        size if size >= 99.95 => 0,
        size if size >= 9.995 => 1,
        _ => 2,
    };
    format!("{value:.decimals$}{unit}")
}

/// Returns a duration as minutes and seconds, with hours from one hour on: "0:07", "12:41", "3:05:09".
fn in_words(time: Duration) -> String {
    let seconds = time.as_secs();
    let (hours, minutes, seconds) = (seconds / 3_600, seconds / 60 % 60, seconds % 60);
    if hours > 0 { format!("{hours}:{minutes:02}:{seconds:02}") } else { format!("{minutes}:{seconds:02}") }
}

#[cfg(test)]
mod tests;
