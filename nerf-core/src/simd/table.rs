//! Tables that are read by index: what an interpolation needs beside the arithmetic of vectors.

use super::MAX_LANES;

mod sealed {
    pub trait Sealed {}
    impl Sealed for super::F16Table<'_> {}
    impl Sealed for super::F32Table<'_> {}
    impl Sealed for super::Int8Table<'_> {}
}

/// The format of a table's values in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Two bytes, little-endian.
    F16,
    /// Four bytes.
    F32,
    /// One byte, signed.
    Int8,
}

impl Format {
    /// Bytes of a value.
    #[inline(always)]
    pub const fn bytes(self) -> usize {
        match self {
            Self::F16 => 2,
            Self::F32 => 4,
            Self::Int8 => 1,
        }
    }
}

/// Values that are read by index. Sealed: kernels read as many values as a table says it has.
#[allow(clippy::len_without_is_empty, reason = "who reads by index asks for the length alone")]
pub trait Table: Copy + sealed::Sealed {
    /// The format of a value.
    const FORMAT: Format;

    /// `count` values from `first` on; fewer where there are fewer.
    fn part(self, first: usize, count: usize) -> Self;
    /// Number of values.
    fn len(self) -> usize;
    /// The address of the first of `len()` values, at any alignment.
    fn start(self) -> *const u8;
    /// Value `at + plus` of each of the first `lanes`; 0 where there is none.
    fn read(self, at: &[u32; MAX_LANES], plus: usize, lanes: usize) -> [f32; MAX_LANES];
    /// The factor of a level's values; asked of a whole table, not of a part.
    #[inline(always)]
    fn scale(self, _level: usize) -> f32 {
        1.0
    }
}

/// Little-endian f16 at any alignment; finite.
#[derive(Clone, Copy, Debug)]
pub struct F16Table<'a>(&'a [[u8; 2]]);

impl<'a> F16Table<'a> {
    /// The f16 of `bytes`.
    #[inline(always)]
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes.as_chunks().0)
    }
}

impl Table for F16Table<'_> {
    const FORMAT: Format = Format::F16;

    #[inline(always)]
    fn part(self, first: usize, count: usize) -> Self {
        let rest = self.0.get(first..).unwrap_or_default();
        Self(rest.get(..count).unwrap_or(rest))
    }
    #[inline(always)]
    fn len(self) -> usize {
        self.0.len()
    }
    #[inline(always)]
    fn start(self) -> *const u8 {
        self.0.as_ptr().cast()
    }
    #[inline(always)]
    fn read(self, at: &[u32; MAX_LANES], plus: usize, lanes: usize) -> [f32; MAX_LANES] {
        let (mut bits, mut values) = ([0; MAX_LANES], [0.0; MAX_LANES]);
        for lane in 0..lanes {
            let bytes = self.0.get(at[lane] as usize + plus).copied();
            bits[lane] = u16::from_le_bytes(bytes.unwrap_or_default());
        }
        for lane in 0..lanes {
            values[lane] = widen_finite(bits[lane]);
        }
        values
    }
}

/// f32.
#[derive(Clone, Copy, Debug)]
pub struct F32Table<'a>(&'a [f32]);

impl<'a> F32Table<'a> {
    /// The f32 of `values`.
    #[inline(always)]
    pub fn new(values: &'a [f32]) -> Self {
        Self(values)
    }
}

impl Table for F32Table<'_> {
    const FORMAT: Format = Format::F32;

    #[inline(always)]
    fn part(self, first: usize, count: usize) -> Self {
        let rest = self.0.get(first..).unwrap_or_default();
        Self(rest.get(..count).unwrap_or(rest))
    }
    #[inline(always)]
    fn len(self) -> usize {
        self.0.len()
    }
    #[inline(always)]
    fn start(self) -> *const u8 {
        self.0.as_ptr().cast()
    }
    #[inline(always)]
    fn read(self, at: &[u32; MAX_LANES], plus: usize, lanes: usize) -> [f32; MAX_LANES] {
        let mut values = [0.0; MAX_LANES];
        for lane in 0..lanes {
            values[lane] = self.0.get(at[lane] as usize + plus).copied().unwrap_or_default();
        }
        values
    }
}

/// Signed bytes, with a scale for each level of a grid.
#[derive(Clone, Copy, Debug)]
pub struct Int8Table<'a> {
    values: &'a [u8],
    scales: &'a [[u8; 4]],
}

impl<'a> Int8Table<'a> {
    /// The signed bytes of `values`; `scales`: little-endian f32 at any alignment.
    #[inline(always)]
    pub fn new(values: &'a [u8], scales: &'a [u8]) -> Self {
        Self { values, scales: scales.as_chunks().0 }
    }
}

impl Table for Int8Table<'_> {
    const FORMAT: Format = Format::Int8;

    #[inline(always)]
    fn part(self, first: usize, count: usize) -> Self {
        let rest = self.values.get(first..).unwrap_or_default();
        Self { values: rest.get(..count).unwrap_or(rest), ..self }
    }
    #[inline(always)]
    fn len(self) -> usize {
        self.values.len()
    }
    #[inline(always)]
    fn start(self) -> *const u8 {
        self.values.as_ptr()
    }
    #[inline(always)]
    fn read(self, at: &[u32; MAX_LANES], plus: usize, lanes: usize) -> [f32; MAX_LANES] {
        let mut values = [0.0; MAX_LANES];
        for lane in 0..lanes {
            let byte = self.values.get(at[lane] as usize + plus).copied().unwrap_or_default();
            values[lane] = f32::from(byte.cast_signed());
        }
        values
    }
    #[inline(always)]
    fn scale(self, level: usize) -> f32 {
        f32::from_le_bytes(self.scales.get(level).copied().unwrap_or_default())
    }
}

/// A finite f16, widened without a branch.
#[inline(always)]
pub fn widen_finite(bits: u16) -> f32 {
    let (sign, magnitude) = (u32::from(bits & 0x8000) << 16, u32::from(bits & 0x7fff));
    // The difference of the exponents' biases, in place.
    let normal = (magnitude << 13) + ((127 - 15) << 23);
    // No leading 1: a multiple of 2^-24.
    let subnormal = (magnitude as f32 * (1.0 / 16_777_216.0)).to_bits();
    f32::from_bits(sign | if magnitude < 0x0400 { subnormal } else { normal })
}
