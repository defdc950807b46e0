//! Programs of the machine that a test needs and a machine may lack.

use std::io::Write;
use std::process::Command;

/// Whether all of them run; if not, as [`there_is`].
pub fn all_here(tools: &[&str]) -> bool {
    let missing: Vec<_> = tools.iter().copied().filter(|tool| !runs(&[tool])).collect();
    if missing.is_empty() {
        return true;
    }
    there_is(&missing.join(", "), false)
}

/// Whether something was found that a test needs; says so where it was not, past the capture of a test's output.
///
/// # Panics
/// Where it was not and the environment variable CI is set: CI must not pass by leaving out.
pub fn there_is(what: &str, found: bool) -> bool {
    if !found {
        assert!(std::env::var_os("CI").is_none(), "missing in CI: {what}");
        say_skipped(&format!("no {what} on this machine"));
    }
    found
}

/// Whether `command --version` works.
pub fn runs(command: &[&str]) -> bool {
    let output = Command::new(command[0]).args(&command[1..]).arg("--version").output();
    output.is_ok_and(|output| output.status.success())
}

/// Says on stderr what was left out and why.
pub fn say_skipped(why: &str) {
    // Not eprintln!, which a test that passes keeps to itself.
    let _ = writeln!(std::io::stderr(), "skipped: {why}");
}

/// Whether tests are to take the minutes that the whole of what they check takes: `NERF_LONG=1`.
pub fn long() -> bool {
    std::env::var_os("NERF_LONG").is_some_and(|value| value == "1")
}
