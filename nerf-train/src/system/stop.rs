//! Handling of signals that ask the process to end (SIGINT, SIGTERM, SIGHUP).
//!
//! A separate thread, the signal thread, waits for signals, so that a thread that renders a tile or reads a fifo cannot
//! delay their handling. What the signal thread does depends on the work that would be lost:
//!
//! - Nothing would be lost: the thread runs the task of the [`Note`], if there is one, ends child processes, removes
//!   temporary files, prints the note's message, and ends the process with status `128 + signal`.
//! - A loop has unsaved work, which it saves after its current step ([`Claim`]): the thread waits for the loop, which
//!   polls [`requested`]. After dropping its claim, the loop has the time [`LAST_WORD`] to report the save and to end
//!   the process with [`status`].
//! - The loop is in a long operation ([`Claim::cover`]): the thread writes the loop's files and ends the process.
//!
//! A further signal changes nothing: a save that the first signal has begun is completed. A signal that the process was
//! started to ignore, such as SIGHUP under `nohup`, stays ignored.
//!
//! The signals are blocked in all threads but the signal thread. Child processes inherit the blocking, and do not see a
//! terminal's Ctrl-C (`crate::system::child`): the code that started a child, or the signal thread, ends it.

use crate::system::lock;
use crate::system::output::{remove_temporaries, write_atomic};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicI32, Ordering};
use std::sync::{Condvar, Mutex, PoisonError, mpsc};
use std::time::Duration;

/// Time that a loop has, after it drops its [`Claim`] on a signal, to report what it saved and to end the process.
pub const LAST_WORD: Duration = Duration::from_millis(800);
/// Time limit for the task of a [`Note`].
const NOTE_WORK: Duration = Duration::from_millis(1000);
/// Time limit for ending child processes. Also the limit for printing the message, which a full pipe may block.
const TIDYING: Duration = Duration::from_millis(200);
/// Time limit for removing temporary files and folders; a folder may hold many files.
const REMOVING: Duration = Duration::from_millis(600);

/// The system's number of the first signal received, such as 2 for SIGINT; 0 before any signal.
static SIGNAL: AtomicI32 = AtomicI32::new(0);
static STATE: Mutex<State> = Mutex::new(State::Nothing);
static CHANGED: Condvar = Condvar::new();
static NOTE: Mutex<Option<Words>> = Mutex::new(None);

/// State of the unsaved work: whether the process has any, and which thread saves it on a signal.
enum State {
    Nothing,
    /// The owner of a [`Claim`], a loop that polls [`requested`], will save the work.
    Claimed,
    /// The signal thread will save the work, by writing the files of the [`Cover`].
    Covered(Cover),
    /// The owner has saved its work after a signal, and will end the process.
    Answered,
}

/// Files to write and message to print on a signal, while the owner of a [`Claim`] is in a long operation.
#[derive(Clone, Debug, Default)]
pub struct Cover {
    /// Paths and contents of files that are not on the disk yet.
    pub files: Vec<(PathBuf, Vec<u8>)>,
    /// Message on stderr: what was saved and how to go on.
    pub message: String,
}

pub fn requested() -> bool {
    SIGNAL.load(Ordering::Relaxed) != 0
}

/// Returns the exit status after a signal: 128 plus the signal's number, for example 130 after Ctrl-C.
pub fn status() -> ExitCode {
    // Signal numbers end at 64.
    u8::try_from(128 + SIGNAL.load(Ordering::Relaxed)).map_or(ExitCode::FAILURE, ExitCode::from)
}

fn set(new: State) {
    *lock(&STATE) = new;
    CHANGED.notify_all();
}

/// Guard that declares unsaved work. Its owner polls [`requested`], saves the work after a signal, and drops the guard.
/// Only one claim exists at a time: fits do not run in parallel.
#[derive(Debug)]
pub struct Claim(());

impl Claim {
    /// Creates a claim. Until the claim is dropped, a signal ends the process only during [`Self::cover`].
    #[allow(clippy::new_without_default, reason = "it is a guard, not a value")]
    pub fn new() -> Self {
        set(State::Claimed);
        Self(())
    }

    /// Runs `work`, which may take long. A signal during `work` writes the files of `cover` and ends the process.
    pub fn cover<T>(&self, cover: Cover, work: impl FnOnce() -> T) -> T {
        set(State::Covered(cover));
        let done = work();
        set(State::Claimed);
        done
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        // The signal thread waits for this lock. If it then finds `Nothing`, it ends the process at once; if it finds
        // `Answered`, it first waits for the owner.
        let mut now = lock(&STATE);
        *now = if requested() { State::Answered } else { State::Nothing };
        drop(now);
        CHANGED.notify_all();
    }
}

/// Contents of a [`Note`]: message to print on a signal if no work is claimed, and task to run before printing.
struct Words {
    message: String,
    /// Name and function of a task that runs before printing. Its name and result are appended to `message`.
    last: Option<(&'static str, LastWork)>,
}

type LastWork = Box<dyn FnOnce() -> Result<(), String> + Send>;

/// Guard that sets the message to print on a signal if no work is claimed. At most one exists. Without a guard, the
/// message is "interrupted".
#[derive(Debug)]
pub struct Note(());

impl Note {
    pub fn new(message: impl Into<String>) -> Self {
        let note = Self(());
        note.say(message);
        note
    }

    pub fn say(&self, message: impl Into<String>) {
        let mut words = lock(&NOTE);
        let last = words.take().and_then(|words| words.last);
        *words = Some(Words { message: message.into(), last });
    }

    /// Registers a task that runs on a signal, before the message is printed. The task must take less than a second.
    /// `what`: name of the task in the message.
    pub fn before(&self, what: &'static str, work: impl FnOnce() -> Result<(), String> + Send + 'static) {
        if let Some(words) = lock(&NOTE).as_mut() {
            words.last = Some((what, Box::new(work)));
        }
    }
}

impl Drop for Note {
    fn drop(&mut self) {
        *lock(&NOTE) = None;
    }
}

/// Runs `work` on another thread and returns its result; `None` if `work` takes longer than `limit` or no thread
/// starts. A disk, pipe or lock that never answers must not keep the process from ending.
fn within<T: Send + 'static>(limit: Duration, work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    let (done, result) = mpsc::channel();
    std::thread::Builder::new().spawn(move || done.send(work())).ok()?;
    result.recv_timeout(limit).ok()
}

fn noted() -> String {
    let Some(Words { message, last }) = lock(&NOTE).take() else { return "interrupted".to_owned() };
    let Some((what, work)) = last else { return message };
    let end = match within(NOTE_WORK, work) {
        Some(Ok(())) => "is written".to_owned(),
        Some(Err(error)) => format!("is not written: {error}"),
        None => format!("is not written: that takes more than {} s", NOTE_WORK.as_secs()),
    };
    format!("{message}; {what} {end}")
}

/// Writes the files of a cover. Returns the message to print: the cover's or, if a file fails, the first error.
fn saved(cover: &Cover) -> String {
    // All files are tried, even if one cannot be written.
    let written: Vec<_> = cover.files.iter().map(|(path, bytes)| write_atomic(path, bytes)).collect();
    match written.into_iter().find_map(Result::err) {
        None => cover.message.clone(),
        Some(error) => format!("interrupted, and {error}"),
    }
}

/// Handles a signal, then exits with status `128 + signal`. Waits until claimed work is saved, or writes the files of a
/// [`Cover`]; then prints the message. Keeps `STATE` locked: the [`Claim`]'s loop must not write the same files.
fn end(signal: i32, say: fn(&str)) -> ! {
    SIGNAL.store(signal, Ordering::Relaxed);
    let claimed = |state: &mut State| matches!(state, State::Claimed);
    let answered = |state: &mut State| matches!(state, State::Answered);
    let now = CHANGED.wait_while(lock(&STATE), claimed).unwrap_or_else(PoisonError::into_inner);
    // An owner that has saved its work ends the process itself. After `LAST_WORD`, the process is ended here.
    let waited = CHANGED.wait_timeout_while(now, LAST_WORD, answered);
    let (now, _) = waited.unwrap_or_else(PoisonError::into_inner);
    let said = match &*now {
        State::Covered(cover) => saved(cover),
        _ => noted(),
    };
    // Children first: they write into temporaries.
    within(TIDYING, crate::system::child::end_all);
    within(REMOVING, remove_temporaries);
    within(TIDYING, move || say(&said));
    std::process::exit(128 + signal)
}

/// Blocks until the process ends, if the signal thread is about to end it. Call this before reporting an error of the
/// command: the signal thread may have caused the error, by ending a child process or removing a temporary file.
pub fn leave_to_signal() {
    while requested() && !matches!(*lock(&STATE), State::Answered) {
        std::thread::park();
    }
}

/// Returns the signals to handle: SIGINT, SIGTERM and SIGHUP, except those that the process was started to ignore.
#[cfg(unix)]
pub fn answered() -> Vec<nix::sys::signal::Signal> {
    use nix::sys::signal::Signal;
    // Linux queues a blocked signal even if it is ignored, so an ignored signal must not be waited for. Other systems
    // drop such signals, and have no `/proc/self/status`.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    let is_answered = |signal: &Signal| ignored >> (*signal as i32 - 1) & 1 == 0;
    [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP].into_iter().filter(is_answered).collect()
}

/// Starts the thread that handles signals and prints messages with `say`. Call this once, before any other thread
/// starts: threads inherit the blocking of the signals.
#[cfg(unix)]
pub fn watch(say: fn(&str)) -> std::io::Result<()> {
    let signals: nix::sys::signal::SigSet = answered().into_iter().collect();
    signals.thread_block()?;
    let wait = move || {
        loop {
            if let Ok(signal) = signals.wait() {
                end(signal as i32, say);
            }
        }
    };
    std::thread::Builder::new().name("signals".into()).spawn(wait).map(|_| ())
}

/// Handles the system's interrupt, such as Ctrl-C, as SIGINT, and prints messages with `say`.
#[cfg(not(unix))]
pub fn watch(say: fn(&str)) -> std::io::Result<()> {
    ctrlc::set_handler(move || end(2, say)).map_err(std::io::Error::other)
}
