//! What the benchmarks share: a clock that runs against the FMA peak, and networks to run.
//!
//! A share of the peak only means something if both were measured under the same conditions, and a
//! machine's clock drifts by more than kernels differ. So every line alternates short bursts of pure
//! multiply-adds with bursts of the work, and sets the fastest of one against the fastest of the other:
//! what neither criterion nor divan can print, and why this harness is its own. The median over the pairs
//! stands beside it; where the two are far apart, the machine was not quiet.
#![allow(dead_code, reason = "every benchmark uses its own part")]

pub mod networks;
pub mod peak;

use nerf_core::Kernel;
use nerf_core::sampling::{Purpose, uniform};
use peak::Peak;
use std::hint::black_box;
use std::time::Instant;

/// Pairs of bursts behind a line.
const ROUNDS: usize = 15;
/// Length of a burst of the work, seconds, where one call is shorter.
const BURST: f64 = 4e-3;
/// A call longer than this is measured in fewer rounds.
const LONG: f64 = 0.1;

/// The lines of one benchmark, as a Markdown table on standard output.
///
/// Arguments: words, of which a line's name must contain one; `--smoke` runs everything once and
/// measures nothing worth reading.
pub struct Table {
    filters: Vec<String>,
    smoke: bool,
    peaks: Vec<((Kernel, usize), Peak)>,
}

impl Table {
    /// Reads the arguments and prints the head of the table.
    pub fn new() -> Self {
        let arguments: Vec<String> = std::env::args().skip(1).collect();
        let filters = arguments.iter().filter(|word| !word.starts_with('-')).cloned().collect();
        println!("| what | time a call | GFLOP/s | peak | share (median) |");
        println!("| --- | ---: | ---: | ---: | ---: |");
        Self { filters, smoke: arguments.iter().any(|word| word == "--smoke"), peaks: Vec::new() }
    }

    /// Whether the arguments ask for the line of that name.
    pub fn wants(&self, name: &str) -> bool {
        self.filters.is_empty() || self.filters.iter().any(|word| name.contains(word))
    }

    /// Measures `work`, `flop` operations a call, against the peak of `kernel` on `threads` threads.
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

/// The kernels of this machine.
pub fn kernels() -> impl Iterator<Item = Kernel> {
    Kernel::all()
}

/// Repeatable values in [-1, 1).
pub fn noise(n: usize, seed: u32) -> Vec<f32> {
    let unit = |i| uniform(seed.into(), Purpose::Parameters, 0, i as u64);
    black_box((0..n).map(|i| 2.0 * unit(i) - 1.0).collect())
}

/// A duration in the unit that suits it.
fn seconds(s: f64) -> String {
    match s {
        s if s < 1e-6 => format!("{:.1} ns", s * 1e9),
        s if s < 1e-3 => format!("{:.2} µs", s * 1e6),
        s if s < 1.0 => format!("{:.2} ms", s * 1e3),
        s => format!("{s:.2} s"),
    }
}
