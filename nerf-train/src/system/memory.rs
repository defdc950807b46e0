//! Memory limit of a command, checked before anything is allocated.

use anyhow::ensure;
use std::fmt::Display;

/// Fraction of the currently free memory that one command may use.
const SHARE: f64 = 0.8;
/// Free memory, bytes, that is assumed if the system does not state the free memory.
const UNKNOWN: u64 = 8 << 30;

/// Returns a number of bytes as text, in GB or TB.
fn in_words(bytes: u64) -> String {
    let giga = bytes as f64 / 1e9;
    if giga < 1000.0 { format!("{giga:.1} GB") } else { format!("{:.0} TB", giga / 1000.0) }
}

/// Fails if `items` × `bytes_each` bytes exceed [`limit`]. `what`: name of the request; `advice`: how to reduce it.
pub fn check(what: impl Display, items: u64, bytes_each: u64, advice: &str) -> anyhow::Result<()> {
    let (needed, limit) = (items.saturating_mul(bytes_each), limit());
    ensure!(
        needed <= limit,
        "{what}: needs about {} of memory, and {} can be had; {advice}",
        in_words(needed),
        in_words(limit)
    );
    Ok(())
}

/// Returns the memory that a command may use, bytes: 80 % of the free memory of the machine or, if less, of the cgroup.
pub fn limit() -> u64 {
    let read = |file: &str| std::fs::read_to_string(file).ok();
    let number = |file: &str| read(file)?.trim().parse::<u64>().ok();
    let free = read("/proc/meminfo").as_deref().and_then(available);
    let group = number("/sys/fs/cgroup/memory.max")
        .map(|max| max.saturating_sub(number("/sys/fs/cgroup/memory.current").unwrap_or(0)));
    let free = free.into_iter().chain(group).min().unwrap_or(UNKNOWN);
    (free as f64 * SHARE) as u64
}

/// Returns `MemAvailable` from the text of /proc/meminfo, in bytes; `None` if this line is missing or not a number.
fn available(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.split_whitespace().next()?.parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_figure_is_read_and_what_exceeds_it_is_refused_with_both() {
        assert_eq!(available("MemTotal: 9 kB\nMemAvailable:    2048 kB\n"), Some(2 << 20));
        assert_eq!(available("MemTotal: 9 kB\n"), None);
        assert!(check("a picture", 1, 1, "").is_ok());
        let error = check("--width", u64::MAX, 2, "make it smaller").expect_err("too large");
        assert!(
            error.to_string().contains("18446744 TB") && error.to_string().ends_with("make it smaller"),
            "{error}"
        );
    }
}
