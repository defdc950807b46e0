//! Signals that ask the process to end (SIGINT, SIGTERM, SIGHUP), answered at once wherever it is.
//!
//! A thread of its own waits for them, so that the answer does not depend on what the others are at: a tile of a
//! frame, a decoder, a read from a fifo. What a command would lose decides what the thread does:
//!
//! - nothing: it removes temporary files, ends child processes and then the process;
//! - work that a loop saves between two steps ([`Claim`]): the thread waits for the loop, which asks [`requested`];
//! - the same, while the loop is busy for longer ([`Claim::cover`]): the thread writes what the loop has lent it.
//!
//! A further signal changes nothing: what the first has begun to save is saved. A signal that the process was
//! started to ignore, such as SIGHUP under `nohup`, stays ignored.

use crate::output::write_atomic;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Set by the first signal.
static REQUESTED: AtomicBool = AtomicBool::new(false);
static STATE: Mutex<State> = Mutex::new(State::Nothing);
static CHANGED: Condvar = Condvar::new();

/// What would be lost if the process ended now.
enum State {
    Nothing,
    /// Work that somebody saves who asks [`requested`].
    Claimed,
    /// Work that is saved by writing these.
    Covered(Cover),
}

/// What a signal leaves behind while the loop that owns the work is busy.
#[derive(Clone, Debug, Default)]
pub struct Cover {
    /// A file to write and its bytes, if what it saves is not on the disk yet.
    pub file: Option<(PathBuf, Vec<u8>)>,
    /// Said on stderr: what was saved and how to go on.
    pub message: String,
}

/// Whether a signal asked the process to end.
pub fn requested() -> bool {
    REQUESTED.load(Ordering::Relaxed)
}

/// The flag behind [`requested`].
pub fn flag() -> &'static AtomicBool {
    &REQUESTED
}

fn state() -> MutexGuard<'static, State> {
    // A panic elsewhere leaves the state whole: it is only ever replaced.
    STATE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn set(new: State) {
    *state() = new;
    CHANGED.notify_all();
}

/// Says that there is work to save, and that its owner asks [`requested`] often and saves it; ends when dropped.
///
/// One at a time: fits do not run beside each other.
#[derive(Debug)]
pub struct Claim(());

impl Claim {
    /// From now on a signal waits for the owner.
    #[allow(clippy::new_without_default, reason = "it is a guard, not a value")]
    pub fn new() -> Self {
        set(State::Claimed);
        Self(())
    }

    /// Runs `work`, which may take long; a signal on the way writes `cover` and ends the process.
    pub fn cover<T>(&self, cover: Cover, work: impl FnOnce() -> T) -> T {
        set(State::Covered(cover));
        let done = work();
        set(State::Claimed);
        done
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        set(State::Nothing);
    }
}

/// Saves what is lent, says so, and ends the process with `128 + signal`.
///
/// Holds the state meanwhile, so that nobody goes on to write what is being written.
fn end(signal: i32) -> ! {
    REQUESTED.store(true, Ordering::Relaxed);
    let mut now = state();
    while matches!(*now, State::Claimed) {
        now = CHANGED.wait(now).unwrap_or_else(PoisonError::into_inner);
    }
    let mut said = "interrupted".to_owned();
    if let State::Covered(cover) = &*now {
        said.clone_from(&cover.message);
        if let Some((path, bytes)) = &cover.file
            && let Err(error) = write_atomic(path, bytes)
        {
            said = format!("interrupted, and {error}");
        }
    }
    crate::cli::tell(&said);
    std::process::exit(128 + signal)
}

/// Starts the thread that answers signals. To be called once, before there are other threads: they inherit that the
/// signals are left to it.
///
/// # Errors
/// What the system says where there can be no such thread.
#[cfg(unix)]
pub fn watch() -> std::io::Result<()> {
    use nix::sys::signal::{SigSet, Signal};
    let mut signals = SigSet::empty();
    for signal in [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP] {
        signals.add(signal);
    }
    signals.thread_block()?;
    let wait = move || {
        loop {
            if let Ok(signal) = signals.wait() {
                end(signal as i32);
            }
        }
    };
    std::thread::Builder::new().name("signals".into()).spawn(wait).map(|_| ())
}

/// As on unix, for the signals that there are.
///
/// # Errors
/// What the system says where there can be no such thread.
#[cfg(not(unix))]
pub fn watch() -> std::io::Result<()> {
    ctrlc::set_handler(|| end(2)).map_err(std::io::Error::other)
}
