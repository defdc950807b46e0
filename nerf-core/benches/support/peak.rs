//! Peak rate of a kernel's multiply-adds, measured with independent chains of operations on registers.

use nerf_core::Kernel;
use nerf_core::simd::{Lanes, Op};
use std::hint::black_box;
use std::sync::Barrier;
use std::time::Instant;

/// Length of a burst of multiply-adds, seconds.
const BURST: f64 = 1e-3;

/// Loop of multiply-adds that keeps all multiply-add units busy, on each of `threads` threads.
#[derive(Clone, Copy, Debug)]
pub struct Peak {
    kernel: Kernel,
    threads: usize,
    /// Number of independent chains: enough to hide the latency, few enough to fit in registers.
    chains: usize,
    steps: u32,
}

impl Peak {
    /// Returns the fastest loop for `kernel`, found by timing several numbers of chains.
    pub fn of(kernel: Kernel, threads: usize) -> Self {
        let with = |chains| {
            let short = Self { kernel, threads: 1, chains, steps: 10_000 };
            let steps = (short.steps as f64 * BURST / short.burst().1).clamp(1e3, 1e8);
            let long = Self { steps: steps as u32, ..short };
            ((0..5).map(|_| long.rate()).fold(0.0, f64::max), long)
        };
        let best = [2, 3, 4, 8, 12].map(with).into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
        Self { threads, ..best.expect("there are candidates").1 }
    }

    /// Measures the current rate of all threads together, floating-point operations per second.
    pub fn rate(&self) -> f64 {
        if self.threads == 1 {
            let (flop, seconds) = self.burst();
            return flop / seconds;
        }
        let start = Barrier::new(self.threads);
        let one = || {
            start.wait();
            let (flop, seconds) = self.burst();
            flop / seconds
        };
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..self.threads).map(|_| scope.spawn(one)).collect();
            threads.into_iter().map(|thread| thread.join().expect("no panic")).sum()
        })
    }

    /// Runs one burst on the current thread. Returns its number of floating-point operations and its time in seconds.
    fn burst(&self) -> (f64, f64) {
        let start = Instant::now();
        let flop = match self.chains {
            2 => self.kernel.isa.run(Chains::<2>(self.steps)),
            3 => self.kernel.isa.run(Chains::<3>(self.steps)),
            4 => self.kernel.isa.run(Chains::<4>(self.steps)),
            8 => self.kernel.isa.run(Chains::<8>(self.steps)),
            _ => self.kernel.isa.run(Chains::<12>(self.steps)),
        };
        (flop, start.elapsed().as_secs_f64())
    }
}

/// Vector loop of `N` independent chains `x = x · ½ + 1`. The field is the number of steps. Returns the number of
/// floating-point operations.
struct Chains<const N: usize>(u32);

impl<const N: usize> Op for Chains<N> {
    type Output = f64;

    #[inline(always)]
    fn run<V: Lanes>(self) -> f64 {
        // Values are different and hidden by `black_box`: otherwise the compiler would compute only one chain, or none.
        let (scale, offset) = (V::splat(black_box(0.5)), V::splat(black_box(1.0)));
        let mut chains: [V; N] = core::array::from_fn(|i| V::splat(black_box(i as f32)));
        for _ in 0..self.0 {
            for x in &mut chains {
                *x = x.mul_add(scale, offset);
            }
        }
        let sum = chains.into_iter().reduce(V::add).expect("there are chains");
        let mut lanes = [0.0; 16];
        sum.store(&mut lanes[..V::COUNT]);
        black_box(lanes);
        2.0 * f64::from(self.0) * (N * V::COUNT) as f64
    }
}
