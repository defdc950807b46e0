//! Jitter: random positions of a ray's samples inside their bins.

use super::Bins;
use super::random::{Purpose, pixel_stream, uniform};

#[cfg(test)]
mod tests;

/// Jitter of one ray's samples: the position of each sample in its bin.
#[derive(Clone, Copy)]
pub(crate) struct SampleJitter {
    seed: Option<u64>,
    stream: u64,
    /// Index of the ray's first random number in the pixel's random stream `stream`. Equals the ray's index among the
    /// rays of its pixel, shifted left by 32 bits. The sample of bin `i`, or drawn sample `i`, uses the random number
    /// of index `first + i`.
    first: u64,
}

impl SampleJitter {
    /// No jitter: samples in the middle of their bins.
    pub const MIDDLE: Self = Self { seed: None, stream: 0, first: 0 };

    /// Returns the jitter of ray `ray` of pixel `(x, y)`, where `ray` counts the pixel's rays from 0. Without a `seed`,
    /// samples lie in the middle of their bins.
    #[inline]
    pub fn of(seed: Option<u64>, x: u32, y: u32, ray: u32) -> Self {
        Self { seed, stream: pixel_stream(x, y), first: u64::from(ray) << 32 }
    }

    /// Position of the ray's drawn sample `k` in its stratum, `[0, 1)`; ½ without jitter. The compositing weights that
    /// a proposal network finds divide the ray into strata of equal weight; one sample is drawn in each stratum.
    #[inline]
    pub fn within(&self, k: u32) -> f32 {
        match self.seed {
            None => 0.5,
            Some(seed) => uniform(seed, Purpose::Jitter, self.stream, self.first | u64::from(k)),
        }
    }

    /// Position of the sample of `bin` along the ray, in the unit of `bins`; does not decrease from bin to bin.
    #[inline]
    pub fn t(&self, bins: &Bins, bin: u32) -> f32 {
        match self.seed {
            None => bins.at(bin, 0.5),
            Some(seed) => jittered(seed, self.stream, self.first | u64::from(bin), bins, bin),
        }
    }
}

/// Returns a random position in `bin`, in the unit of `bins`. `index`: index of the random number in the stream.
#[inline(never)]
fn jittered(seed: u64, stream: u64, index: u64, bins: &Bins, bin: u32) -> f32 {
    bins.within(bin, uniform(seed, Purpose::Jitter, stream, index))
}
