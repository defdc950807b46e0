//! Reading tables by index: what an interpolation needs beside [`Lanes`]' arithmetic.

use super::lanes::{Lanes, MAX_LANES};

/// A `u32` a lane: what table entries are counted by. Arithmetic wraps.
pub trait Indices: Copy {
    /// `x` in every lane.
    fn splat(x: u32) -> Self;
    /// `self + b`.
    fn add(self, b: Self) -> Self;
    /// `self · b`.
    fn mul(self, b: Self) -> Self;
    /// The bits that differ.
    fn xor(self, b: Self) -> Self;
    /// The bits that both have.
    fn and(self, b: Self) -> Self;
    /// The smaller.
    fn min(self, b: Self) -> Self;
    /// The upper 17 bits.
    fn shift_right_15(self) -> Self;
    /// Writes the lanes to the first of `to`.
    fn store(self, to: &mut [u32; MAX_LANES]);
}

impl Indices for u32 {
    #[inline(always)]
    fn splat(x: u32) -> Self {
        x
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        self.wrapping_add(b)
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        self.wrapping_mul(b)
    }
    #[inline(always)]
    fn xor(self, b: Self) -> Self {
        self ^ b
    }
    #[inline(always)]
    fn and(self, b: Self) -> Self {
        self & b
    }
    #[inline(always)]
    fn min(self, b: Self) -> Self {
        Ord::min(self, b)
    }
    #[inline(always)]
    fn shift_right_15(self) -> Self {
        self >> 15
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; MAX_LANES]) {
        to[0] = self;
    }
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for super::F16Table<'_> {}
    impl Sealed for super::F32Table<'_> {}
    impl Sealed for super::Int8Table<'_> {}
}

/// How a table's values lie in memory.
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
    /// What a value is.
    const FORMAT: Format;

    /// `count` values from `first` on; fewer where there are fewer.
    fn part(self, first: usize, count: usize) -> Self;
    /// Number of values.
    fn len(self) -> usize;
    /// Where the values begin: `len()` of them, at any alignment.
    fn start(self) -> *const u8;
    /// Value `at + plus` of each lane; 0 where there is none.
    fn lanes<V: Lanes>(self, at: &[u32; MAX_LANES], plus: usize) -> V;
    /// What the values of a level count; asked of a whole table, not of a part.
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
    fn lanes<V: Lanes>(self, at: &[u32; MAX_LANES], plus: usize) -> V {
        let mut bits = [0; MAX_LANES];
        for lane in 0..V::COUNT {
            let bytes = self.0.get(at[lane] as usize + plus).copied();
            bits[lane] = u16::from_le_bytes(bytes.unwrap_or_default());
        }
        V::from_f16(&bits)
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
    fn lanes<V: Lanes>(self, at: &[u32; MAX_LANES], plus: usize) -> V {
        let mut values = [0.0; MAX_LANES];
        for lane in 0..V::COUNT {
            values[lane] = self.0.get(at[lane] as usize + plus).copied().unwrap_or_default();
        }
        V::load(&values)
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
    fn lanes<V: Lanes>(self, at: &[u32; MAX_LANES], plus: usize) -> V {
        let mut values = [0.0; MAX_LANES];
        for lane in 0..V::COUNT {
            let byte = self.values.get(at[lane] as usize + plus).copied().unwrap_or_default();
            values[lane] = f32::from(byte.cast_signed());
        }
        V::load(&values)
    }
    #[inline(always)]
    fn scale(self, level: usize) -> f32 {
        f32::from_le_bytes(self.scales.get(level).copied().unwrap_or_default())
    }
}

/// [`Lanes::bits`], bit by bit.
#[inline(always)]
pub fn bits_by_lane<V: Lanes>(bytes: &[u8], at: V::Indices) -> u32 {
    let mut bits = [0; MAX_LANES];
    at.store(&mut bits);
    let mut found = 0;
    for (lane, &bit) in bits.iter().enumerate().take(V::COUNT) {
        if let Some(&byte) = bytes.get(bit as usize / 8) {
            found |= (u32::from(byte) >> (bit % 8) & 1) << lane;
        }
    }
    found
}

/// [`Lanes::weighted_rows`], value by value.
#[inline(always)]
pub fn weighted_rows_by_lane<V: Lanes, T: Table, const ROWS: usize>(
    table: T,
    rows: &[V::Indices; ROWS],
    weights: &[V; ROWS],
    features: usize,
) -> [V; 8] {
    let mut sums = [V::splat(0.0); 8];
    for (row, &weight) in rows.iter().zip(weights) {
        let mut at = [0; MAX_LANES];
        row.mul(V::Indices::splat(features as u32)).store(&mut at);
        for (plus, sum) in sums.iter_mut().enumerate().take(2 * features) {
            *sum = weight.mul_add(table.lanes(&at, plus), *sum);
        }
    }
    sums
}

/// A finite f16, widened without a branch.
#[inline(always)]
pub fn widen_finite(bits: u16) -> f32 {
    let (sign, magnitude) = (u32::from(bits & 0x8000) << 16, u32::from(bits & 0x7fff));
    // What the exponents' biases differ by, in place.
    let normal = (magnitude << 13) + ((127 - 15) << 23);
    // No leading 1: a multiple of 2^-24.
    let subnormal = (magnitude as f32 * (1.0 / 16_777_216.0)).to_bits();
    f32::from_bits(sign | if magnitude < 0x0400 { subnormal } else { normal })
}
