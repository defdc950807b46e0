//! Counter-based random numbers: a value is a function of what it is for, not of a history.

/// What a number is drawn for; keeps the streams apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Purpose {
    /// Initial parameters.
    Parameters = 1,
    /// Which image a ray comes from.
    Image = 2,
    /// Which pixel a ray comes from.
    Pixel = 3,
    /// Where in its bin a sample lies.
    Jitter = 4,
    /// Background colours.
    Background = 5,
    /// Points of culled space.
    Empty = 6,
    /// Where in a cell the occupancy grid asks for density.
    Cell = 7,
    /// Where a ray goes through the aperture.
    Aperture = 8,
    /// Which samples of little weight are trained on.
    Faint = 9,
}

/// 32 random bits for the `index`-th number of `stream` (a step, a pixel) in a run.
///
/// # Source
/// SplitMix64's finaliser (Steele, Lea and Flood 2014) over the mixed counters.
#[inline]
pub fn uniform_u32(seed: u64, purpose: Purpose, stream: u64, index: u64) -> u32 {
    let mixed = mix(seed ^ mix(stream.wrapping_mul(16).wrapping_add(purpose as u64)));
    (mix(mixed.wrapping_add(index.wrapping_mul(0x9e37_79b9_7f4a_7c15))) >> 32) as u32
}

/// As [`uniform_u32`], in `[0, 1)` with 24 random bits.
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

/// The random stream of a pixel: the same whatever image, tile or thread it is in.
#[cfg(any(feature = "jitter", feature = "depth-of-field"))]
pub(crate) fn pixel_stream(x: u32, y: u32) -> u64 {
    u64::from(y) << 32 | u64::from(x)
}

/// The golden ratio's fraction, in 2^-32.
#[cfg(any(feature = "anti-aliasing", feature = "depth-of-field"))]
pub(crate) const GOLDEN: u32 = 0x9e37_79b9;

/// How many of the first `count` multiples of `ratio`, modulo 1 and in 2^-32, are below the `index`-th: an even
/// shuffle of `0..count`, exact in integers.
#[cfg(any(feature = "anti-aliasing", feature = "depth-of-field"))]
pub(crate) fn rank(ratio: u32, index: u32, count: u32) -> u32 {
    let own = index.wrapping_mul(ratio);
    (0..count).filter(|other| other.wrapping_mul(ratio) < own).count() as u32
}
