//! Child processes of this program. No child outlives this process or blocks it for ever.
//!
//! On Unix each child leads its own process group. A terminal's Ctrl-C reaches only this process, which first saves its
//! work ([`crate::system::stop`]). Killing a child kills its group, with all that a wrapper script started.

use crate::system::lock;
use std::io::{self, Read, Write};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Interval between two checks of whether a child has ended.
const ASK_EVERY: Duration = Duration::from_millis(5);
/// Time limit for a killed child to end. Only a process that is blocked inside the kernel takes longer.
const KILLED: Duration = Duration::from_secs(1);
/// Number of bytes written to a child at a time; the time limit of [`Helper::feed`] restarts after each part.
const PIECE_BYTES: usize = 1 << 16;

static RUNNING: Mutex<Vec<Arc<Mutex<Process>>>> = Mutex::new(Vec::new());

#[derive(Debug)]
struct Process {
    child: Child,
    /// Exit status; `None` until the child has been waited for. Until then, its process number is not reused.
    status: Option<ExitStatus>,
}

impl Process {
    fn ended(&mut self) -> Option<ExitStatus> {
        self.status = self.status.or_else(|| self.child.try_wait().ok().flatten());
        self.status
    }

    fn kill(&mut self) {
        if self.status.is_some() {
            return;
        }
        #[cfg(unix)]
        if let Ok(group) = i32::try_from(self.child.id()) {
            use nix::sys::signal::{Signal, killpg};
            // Fails if the group has ended by itself.
            let _ = killpg(nix::unistd::Pid::from_raw(group), Signal::SIGKILL);
        }
        let _ = self.child.kill();
    }
}

/// A child process; killed when dropped, or when a signal ends this process.
#[derive(Debug)]
pub struct Helper(Arc<Mutex<Process>>);

impl Helper {
    pub fn spawn(command: &mut Command) -> io::Result<Self> {
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(command, 0);
        // The lock is held while the child starts, so that the signal thread finds every child.
        let mut running = lock(&RUNNING);
        let process = Arc::new(Mutex::new(Process { child: command.spawn()?, status: None }));
        running.push(Arc::clone(&process));
        Ok(Self(process))
    }

    /// Takes the child's pipes to stdin, stdout and stderr; a second call returns `None` for each.
    pub fn pipes(&self) -> (Option<ChildStdin>, Option<ChildStdout>, Option<ChildStderr>) {
        let child = &mut lock(&self.0).child;
        (child.stdin.take(), child.stdout.take(), child.stderr.take())
    }

    /// Waits for at most `patience`; returns the exit status if the child has ended.
    pub fn wait(&self, patience: Duration) -> Option<ExitStatus> {
        let begun = Instant::now();
        loop {
            let status = lock(&self.0).ended();
            if status.is_some() || begun.elapsed() >= patience {
                return status;
            }
            std::thread::sleep(ASK_EVERY);
        }
    }

    /// Kills the child and the processes that it started. Returns its status; `None` if it does not end within 1 s.
    pub fn kill(&self) -> Option<ExitStatus> {
        lock(&self.0).kill();
        self.wait(KILLED)
    }

    /// Writes `bytes` to the child's standard input, in parts. Fails with the system's error if the child no longer
    /// reads. If a part takes longer than `patience`, kills the child and fails with [`io::ErrorKind::TimedOut`].
    pub fn feed(&self, stdin: &mut ChildStdin, bytes: &[u8], patience: Duration) -> io::Result<()> {
        let (taken, pieces) = mpsc::channel();
        std::thread::scope(|scope| {
            let writing = scope.spawn(move || {
                bytes.chunks(PIECE_BYTES).try_for_each(|piece| {
                    stdin.write_all(piece)?;
                    // Fails only if the receiver has given up and killed the child.
                    let _ = taken.send(());
                    Ok(())
                })
            });
            let hangs = loop {
                match pieces.recv_timeout(patience) {
                    Ok(()) => {}
                    Err(RecvTimeoutError::Disconnected) => break false,
                    Err(RecvTimeoutError::Timeout) => break true,
                }
            };
            if hangs {
                self.kill();
            }
            let written = writing.join().unwrap_or_else(|_| Err(io::Error::other("the writer failed")));
            if hangs { Err(io::ErrorKind::TimedOut.into()) } else { written }
        })
    }
}

impl Drop for Helper {
    fn drop(&mut self) {
        if lock(&self.0).ended().is_none() {
            self.kill();
        }
        lock(&RUNNING).retain(|running| !Arc::ptr_eq(running, &self.0));
    }
}

/// Kills all running children and prevents the start of further ones. Call this when the process ends.
pub fn end_all() {
    let running = lock(&RUNNING);
    for process in &*running {
        lock(process).kill();
    }
    let begun = Instant::now();
    while running.iter().any(|process| lock(process).ended().is_none()) && begun.elapsed() < KILLED {
        std::thread::sleep(ASK_EVERY);
    }
    // The lock is never released: a thread that wants to start another child waits until the process ends.
    std::mem::forget(running);
}

/// Output of a child on a pipe, read continuously, so that the child never waits for a reader.
#[derive(Debug)]
pub struct Heard {
    kept: Arc<Mutex<Vec<u8>>>,
    ended: mpsc::Receiver<()>,
}

impl Heard {
    /// Starts a thread that reads `stream` and keeps its last `keep` bytes; without a stream, the output is empty.
    pub fn of(stream: Option<impl Read + Send + 'static>, keep: usize) -> Self {
        let kept = Arc::new(Mutex::new(Vec::new()));
        let (ending, ended) = mpsc::channel::<()>();
        if let Some(stream) = stream {
            let kept = Arc::clone(&kept);
            std::thread::spawn(move || {
                tail(stream, keep, &kept);
                drop(ending);
            });
        }
        Self { kept, ended }
    }

    pub fn so_far(&self) -> Vec<u8> {
        lock(&self.kept).clone()
    }

    /// Returns the last bytes of the output. Call this after the child has ended. Waits at most half a second for the
    /// pipe to close: processes that the child has left behind may hold the pipe open.
    pub fn text(&self) -> Vec<u8> {
        let _ = self.ended.recv_timeout(Duration::from_millis(500));
        lock(&self.kept).clone()
    }
}

/// Reads `stream` to its end, and keeps its last `keep` bytes in `kept`.
fn tail(mut stream: impl Read, keep: usize, kept: &Mutex<Vec<u8>>) {
    let mut buffer = [0; 4096];
    loop {
        let count = match stream.read(&mut buffer) {
            Ok(count @ 1..) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => 0,
            Ok(0) | Err(_) => return,
        };
        let mut kept = lock(kept);
        kept.extend_from_slice(&buffer[..count]);
        let beyond = kept.len().saturating_sub(keep);
        kept.drain(..beyond);
    }
}

/// Returns the last four lines of `bytes` with letters or digits, joined by "; ", or "it said nothing".
pub fn last_lines(bytes: &[u8]) -> String {
    const SHOWN_LINES: usize = 4;
    let text = String::from_utf8_lossy(bytes);
    let lines: Vec<&str> =
        text.lines().map(str::trim).filter(|line| line.contains(char::is_alphanumeric)).collect();
    match lines.len() {
        0 => "it said nothing".to_owned(),
        count => lines[count.saturating_sub(SHOWN_LINES)..].join("; "),
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::process::Stdio;

    fn shell(script: &str) -> Helper {
        let mut command = Command::new("sh");
        command.args(["-c", script]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        Helper::spawn(&mut command).unwrap()
    }

    #[test]
    fn the_last_bytes_are_kept() {
        let long: Vec<u8> = (0..20_000u32).flat_map(|i| format!("line {i}\n").into_bytes()).collect();
        let kept = Mutex::new(Vec::new());
        tail(&long[..], 1000, &kept);
        let kept = kept.into_inner().unwrap();
        assert!(kept.len() == 1000 && long.ends_with(&kept));
    }

    #[test]
    fn a_child_that_reads_nothing_is_ended_with_what_it_has_started() {
        let helper = shell("sleep 1000");
        let (stdin, stdout, _) = helper.pipes();
        let begun = Instant::now();
        let bytes = vec![0; 1 << 20];
        let error = helper.feed(&mut stdin.unwrap(), &bytes, Duration::from_millis(200)).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        // The pipe closes only after the shell and its `sleep` have ended.
        Heard::of(stdout, 1).text();
        assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", begun.elapsed());
    }

    #[test]
    fn a_child_that_reads_slowly_is_waited_for() {
        let helper = shell(
            "while dd bs=65536 count=1 of=/dev/null 2>/dev/null; do sleep 0.1; i=x$i; \
                            [ $i = xxxx ] && exec cat > /dev/null; done",
        );
        let (stdin, ..) = helper.pipes();
        let bytes = vec![0; 8 * PIECE_BYTES];
        helper.feed(&mut stdin.unwrap(), &bytes, Duration::from_secs(20)).unwrap();
        assert!(helper.wait(Duration::from_secs(20)).is_some_and(|status| status.success()));
    }

    #[test]
    fn who_has_ended_is_not_killed() {
        let helper = shell("exit 3");
        assert_eq!(helper.wait(Duration::from_secs(20)).and_then(|status| status.code()), Some(3));
        assert_eq!(helper.kill().and_then(|status| status.code()), Some(3));
    }
}
