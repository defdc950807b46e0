//! Support for the benchmarks: time measurement relative to the FMA peak, and networks to run.
//!
//! The peak is the measured rate of pure multiply-adds. A share of the peak is meaningful only if work and peak are
//! measured under the same conditions, and a machine's clock frequency drifts by more than the speeds of kernels
//! differ. Each line of a table therefore alternates short bursts of multiply-adds with bursts of the work. The printed
//! share compares the fastest burst of each kind; criterion and divan cannot print such a share. The median share over
//! all pairs of bursts is printed next to it. If the two differ much, other programs were running.
#![allow(dead_code, reason = "every benchmark uses its own part")]

pub mod networks;
pub mod peak;

use nerf_core::Kernel;
use nerf_core::sampling::{Purpose, uniform};
use peak::Peak;
use std::hint::black_box;
use std::time::Instant;

/// Number of pairs of bursts (multiply-adds, then work) per line.
const ROUNDS: usize = 15;
/// Least length of a burst of the work, seconds. Shorter calls are repeated.
const BURST: f64 = 4e-3;
/// Length of a call, seconds, above which it is measured in only 3 rounds.
const LONG: f64 = 0.1;

/// Results of one benchmark, printed as a Markdown table to standard output.
///
/// Command-line arguments: words, of which the name of a line must contain at least one, else the line is skipped.
/// `--smoke` runs each line once, as a test that the benchmark works; the printed time is not a measurement.
pub struct Table {
    filters: Vec<String>,
    smoke: bool,
    peaks: Vec<((Kernel, usize), Peak)>,
}

impl Table {
    /// Reads the command-line arguments and prints the header of the table.
    pub fn new() -> Self {
        let arguments: Vec<String> = std::env::args().skip(1).collect();
        let filters = arguments.iter().filter(|word| !word.starts_with('-')).cloned().collect();
        println!("| what | time a call | GFLOP/s | peak | share (median) |");
        println!("| --- | ---: | ---: | ---: | ---: |");
        Self { filters, smoke: arguments.iter().any(|word| word == "--smoke"), peaks: Vec::new() }
    }

    /// Whether the line `name` is requested: if `name` contains a word of the arguments, or if the arguments have no
    /// words.
    pub fn wants(&self, name: &str) -> bool {
        self.filters.is_empty() || self.filters.iter().any(|word| name.contains(word))
    }

    /// Measures `work` and prints the line `name`: time per call, and rate as a share of the peak of `kernel` on
    /// `threads` threads. `flop`: floating-point operations per call.
    pub fn line(&mut self, name: &str, kernel: Kernel, threads: usize, flop: f64, mut work: impl FnMut()) {
        if !self.wants(name) || !kernel.available() {
            return;
        }
        let mut time = |calls: u32| {
            let start = Instant::now();
            (0..calls).for_each(|_| work());
            start.elapsed().as_secs_f64() / f64::from(calls)
        };
        if self.smoke {
            return println!("| {name} | {} | | | |", seconds(time(1)));
        }
        let peak = self.peak(kernel, threads);
        let cold = time(1); // caches, pages and branch predictors
        let once = if cold > LONG { cold } else { time(1) };
        let calls = (BURST / once).ceil().clamp(1.0, 1e6) as u32;
        let rounds = if once > LONG { 3 } else { ROUNDS };
        let (mut times, mut peaks, mut shares) = (vec![], vec![], vec![]);
        for _ in 0..rounds {
            let (rate, call) = (peak.rate(), time(calls));
            times.push(call);
            peaks.push(rate);
            shares.push(flop / call / rate);
        }
        let fastest = times.into_iter().fold(f64::INFINITY, f64::min);
        let peak = peaks.into_iter().fold(0.0, f64::max);
        shares.sort_by(f64::total_cmp);
        println!(
            "| {name} | {} | {:.1} | {:.1} | {:.1} % ({:.1} %) |",
            seconds(fastest),
            flop / fastest * 1e-9,
            peak * 1e-9,
            100.0 * flop / fastest / peak,
            100.0 * shares[shares.len() / 2],
        );
    }

    fn peak(&mut self, kernel: Kernel, threads: usize) -> Peak {
        let known = self.peaks.iter().find(|(of, _)| *of == (kernel, threads)).map(|(_, peak)| *peak);
        known.unwrap_or_else(|| {
            let peak = Peak::of(kernel, threads);
            self.peaks.push(((kernel, threads), peak));
            peak
        })
    }
}

/// Iterates over the kernels that this machine supports.
pub fn kernels() -> impl Iterator<Item = Kernel> {
    Kernel::all()
}

/// Returns `n` pseudorandom values in `[-1, 1)`; equal seeds give equal values.
pub fn noise(n: usize, seed: u32) -> Vec<f32> {
    let unit = |i| uniform(seed.into(), Purpose::Parameters, 0, i as u64);
    black_box((0..n).map(|i| 2.0 * unit(i) - 1.0).collect())
}

/// Formats a duration of `s` seconds in ns, µs, ms or s.
fn seconds(s: f64) -> String {
    match s {
        s if s < 1e-6 => format!("{:.1} ns", s * 1e9),
        s if s < 1e-3 => format!("{:.2} µs", s * 1e6),
        s if s < 1.0 => format!("{:.2} ms", s * 1e3),
        s => format!("{s:.2} s"),
    }
}
