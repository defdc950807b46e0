//! Tables that are read by index, for interpolation.

use super::MAX_LANES;

/// The format of a table's values in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// f16: two bytes, little-endian.
    F16,
    /// f32: four bytes.
    F32,
    /// Signed 8-bit integer in two's complement.
    Int8,
}

/// A value of a table, as stored in memory. Sealed, since kernels read as many bytes as the format says.
pub trait Value: Copy + Default + super::sealed::Sealed {
    /// Format of the value in memory.
    const FORMAT: Format;
    /// Converts the stored value to f32. Integers are not multiplied by [`Table::scale`].
    fn widen(self) -> f32;
}

impl Value for [u8; 2] {
    const FORMAT: Format = Format::F16;

    /// Returns the value of a finite f16, without a branch.
    #[inline(always)]
    fn widen(self) -> f32 {
        let bits = u16::from_le_bytes(self);
        let (sign, magnitude) = (u32::from(bits & 0x8000) << 16, u32::from(bits & 0x7fff));
        // Adds the difference of the exponent biases, shifted to the exponent's position.
        let normal = (magnitude << 13) + ((127 - 15) << 23);
        // A subnormal f16 has no leading 1: its value is `magnitude` times 2^-24.
        let subnormal = (magnitude as f32 * (1.0 / 16_777_216.0)).to_bits();
        f32::from_bits(sign | if magnitude < 0x0400 { subnormal } else { normal })
    }
}

impl Value for f32 {
    const FORMAT: Format = Format::F32;

    #[inline(always)]
    fn widen(self) -> f32 {
        self
    }
}

/// A table value of type `u8` is a signed 8-bit integer: the byte is its two's complement.
impl Value for u8 {
    const FORMAT: Format = Format::Int8;

    #[inline(always)]
    fn widen(self) -> f32 {
        f32::from(self.cast_signed())
    }
}

/// Table of values that are read by index. A table of integers also has a factor for each level: [`Table::scale`].
#[derive(Clone, Copy, Debug)]
pub struct Table<'a, T> {
    pub(super) values: &'a [T],
    scales: &'a [[u8; 4]],
}

impl<'a, T: Value> Table<'a, T> {
    /// Makes a table of `values`, which must be finite. `scales`: the factors of the grid levels ([`Table::scale`]),
    /// little-endian f32 at any alignment; used only if the values are integers.
    #[inline(always)]
    pub fn new(values: &'a [T], scales: &'a [u8]) -> Self {
        Self { values, scales: scales.as_chunks().0 }
    }

    /// Returns the part of the table with the `count` values from index `first` on; fewer if the table ends before.
    #[inline(always)]
    pub fn part(self, first: usize, count: usize) -> Self {
        let rest = self.values.get(first..).unwrap_or_default();
        Self { values: rest.get(..count).unwrap_or(rest), ..self }
    }

    /// Reads the value with index `at[lane] + plus` for each of the first `lanes` lanes; 0 beyond the table's end. Does
    /// not multiply by [`Table::scale`].
    #[inline(always)]
    pub fn read(self, at: &[u32; MAX_LANES], plus: usize, lanes: usize) -> [f32; MAX_LANES] {
        let (mut found, mut values) = ([T::default(); MAX_LANES], [0.0; MAX_LANES]);
        for lane in 0..lanes {
            found[lane] = self.values.get(at[lane] as usize + plus).copied().unwrap_or_default();
        }
        for lane in 0..lanes {
            values[lane] = found[lane].widen();
        }
        values
    }

    /// Returns the factor by which the integers of grid level `level` are multiplied; 1 for a table of floats.
    #[inline(always)]
    pub fn scale(self, level: usize) -> f32 {
        match T::FORMAT {
            Format::Int8 => f32::from_le_bytes(self.scales.get(level).copied().unwrap_or_default()),
            Format::F16 | Format::F32 => 1.0,
        }
    }
}
