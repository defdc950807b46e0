//! Counter-based random numbers: a value depends on seed, purpose, stream and index, not on earlier calls.

/// Purpose of a random number. Numbers of different purposes are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Purpose {
    /// Initial values of the trained parameters.
    Parameters = 1,
    /// Choice of the photograph of a training ray.
    Image = 2,
    /// Choice of the pixel of a training ray.
    Pixel = 3,
    /// Position of a sample inside its bin.
    Jitter = 4,
    /// Random background colours of training rays.
    Background = 5,
    /// Positions of the points in empty cells at which training pushes the density to 0.
    Empty = 6,
    /// Points at which density is evaluated to update the occupancy grid, one point in each evaluated cell.
    Cell = 7,
    /// Point of the lens aperture through which a ray passes.
    Aperture = 8,
    /// Russian roulette, which decides which samples of low weight are trained on.
    Roulette = 9,
    /// Direction and spacing of a line of pixels, whose rays are trained with the smoothness loss.
    Line = 10,
}

/// Returns 32 random bits: value `index` of the sequence that `seed`, `purpose` and `stream` identify. `stream`: for
/// example the number of a training step or of a pixel.
///
/// # Source
/// SplitMix64's finaliser (Steele, Lea and Flood 2014) over the mixed counters.
#[inline]
pub fn uniform_u32(seed: u64, purpose: Purpose, stream: u64, index: u64) -> u32 {
    let mixed = mix(seed ^ mix(stream.wrapping_mul(16).wrapping_add(purpose as u64)));
    (mix(mixed.wrapping_add(index.wrapping_mul(0x9e37_79b9_7f4a_7c15))) >> 32) as u32
}

/// Returns a random number in `[0, 1)`: the upper 24 bits of [`uniform_u32`], scaled.
#[inline]
pub fn uniform(seed: u64, purpose: Purpose, stream: u64, index: u64) -> f32 {
    (uniform_u32(seed, purpose, stream, index) >> 8) as f32 / 16_777_216.0
}

#[inline]
fn mix(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Number of a pixel's random stream ([`uniform_u32`]), the same in every image, tile and thread.
pub(crate) fn pixel_stream(x: u32, y: u32) -> u64 {
    u64::from(y) << 32 | u64::from(x)
}

/// Fractional part of the golden ratio, in units of 2^-32.
pub(crate) const GOLDEN: u32 = 0x9e37_79b9;

/// Sorts the numbers `i` in `0..count` by `i · ratio` modulo 2^32, and returns the position of `index` in the sorted
/// order. The first position is 0. With a `ratio` such as [`GOLDEN`], the positions are a low-discrepancy permutation of
/// `0..count`: it distributes rays evenly over a pixel.
pub(crate) fn rank(ratio: u32, index: u32, count: u32) -> u32 {
    let own = index.wrapping_mul(ratio);
    (0..count).filter(|other| other.wrapping_mul(ratio) < own).count() as u32
}
