//! Vectors of `f32` and `u32`: the traits that elementary functions and kernels are generic over.

use super::table::{Table, Value};
use super::{MAX_LANES, sealed};

/// A vector of `u32`, used as indices of table entries. Arithmetic wraps.
pub trait Indices: Copy {
    /// Returns a vector with `x` in every lane.
    fn splat(x: u32) -> Self;
    /// `self + b` for each lane, modulo 2^32.
    fn add(self, b: Self) -> Self;
    /// `self * b` for each lane, modulo 2^32.
    fn mul(self, b: Self) -> Self;
    /// Bitwise exclusive or of `self` and `b`, for each lane.
    fn xor(self, b: Self) -> Self;
    /// Bitwise and of `self` and `b`, for each lane.
    fn and(self, b: Self) -> Self;
    /// The smaller of `self` and `b`, for each lane.
    fn min(self, b: Self) -> Self;
    /// Shifts each lane right by 15 bits and fills with zeros: a step of the hash of grid cells.
    fn shift_right_15(self) -> Self;
    /// Writes the lanes to the beginning of `to`.
    fn store(self, to: &mut [u32; MAX_LANES]);
}

impl Indices for u32 {
    methods! {
        fn splat(x: u32) -> Self = x;
        fn add(self, b: Self) -> Self = self.wrapping_add(b);
        fn mul(self, b: Self) -> Self = self.wrapping_mul(b);
        fn xor(self, b: Self) -> Self = self ^ b;
        fn and(self, b: Self) -> Self = self & b;
        fn min(self, b: Self) -> Self = Ord::min(self, b);
        fn shift_right_15(self) -> Self = self >> 15;
        fn store(self, to: &mut [u32; MAX_LANES]) = to[0] = self;
    }
}

/// A vector of `COUNT` f32.
///
/// `f32` is the vector of one lane, and each instruction set's module has a vector type. The trait is sealed. Every
/// operation acts on each lane alone, so that a lane's result never depends on other lanes.
pub trait Lanes: Copy + sealed::Sealed {
    /// Number of lanes, a divisor of [`MAX_LANES`].
    const COUNT: usize;
    /// Largest height, in rows, of a register tile of the matrix product: the block of the product that is accumulated
    /// in registers.
    const TILE_ROWS: usize;
    /// Largest width, in vectors, of a register tile of the matrix product.
    const TILE_COLS: usize;
    /// Result of a comparison: true or false for each lane.
    type Mask: Copy;
    /// A vector of `COUNT` u32.
    type Indices: Indices;

    /// Returns a vector with `x` in every lane.
    fn splat(x: f32) -> Self;
    /// Loads the first `COUNT` values of `from`.
    ///
    /// # Panics
    /// If `from` has fewer than `COUNT` values. The implementation for `f32`, one lane, panics only with debug
    /// assertions; without them it loads 0.
    fn load(from: &[f32]) -> Self;
    /// Writes the lanes to the first `COUNT` values of `to`.
    ///
    /// # Panics
    /// If `to` has fewer than `COUNT` values. The implementation for `f32`, one lane, panics only with debug
    /// assertions; without them it writes nothing.
    fn store(self, to: &mut [f32]);
    /// `self + b` for each lane.
    fn add(self, b: Self) -> Self;
    /// `self - b` for each lane.
    fn sub(self, b: Self) -> Self;
    /// `self * b` for each lane, rounded once.
    fn mul(self, b: Self) -> Self;
    /// `self / b` for each lane.
    fn div(self, b: Self) -> Self;
    /// `self * b + c`: fused with AVX2, AVX-512 and NEON, two roundings with other instruction sets.
    fn mul_add(self, b: Self, c: Self) -> Self;
    /// The larger value: `self` if `self > b`, else `b`. If either value is NaN, the result is `b`.
    fn max_of(self, b: Self) -> Self;
    /// The smaller value: `self` if `self < b`, else `b`. If either value is NaN, the result is `b`.
    fn min_of(self, b: Self) -> Self;
    /// Square root of each lane, correctly rounded.
    fn sqrt(self) -> Self;
    /// Absolute value of each lane.
    fn abs(self) -> Self;
    /// Rounds each lane to the nearest integer, ties to even. Valid for all finite values.
    fn round_even(self) -> Self;
    /// Rounds each lane down to an integer. Valid for all finite values.
    #[inline(always)]
    fn floor(self) -> Self {
        let nearest = self.round_even();
        Self::select(self.less(nearest), nearest.sub(Self::splat(1.0)), nearest)
    }
    /// `2^self` for each lane. Each lane must be an integer in `-126..=127`.
    fn exp2_integer(self) -> Self;
    /// Splits each positive normal number into mantissa and exponent `(m, e)`: `self = m 2^e`, `m` in `[√½, √2)`.
    fn split_exponent(self) -> (Self, Self);
    /// Mask of the lanes with `self == b`; false if either value is NaN.
    fn equals(self, b: Self) -> Self::Mask;
    /// Mask of the lanes with `self < b`.
    fn less(self, b: Self) -> Self::Mask;
    /// `a` in the lanes where `mask` is true, `b` in the other lanes.
    fn select(mask: Self::Mask, a: Self, b: Self) -> Self;

    /// Converts each lane to `u32`, to be used as an index. Each lane must be an integer in `0..=2^23`.
    fn to_indices(self) -> Self::Indices;

    /// Converts each lane to the bits of the nearest f16, ties to even. A lane too large for f16 becomes infinite.
    /// Elements of the result from index `COUNT` on are 0.
    #[inline(always)]
    fn to_f16(self) -> [u16; MAX_LANES] {
        let mut values = [0.0; MAX_LANES];
        self.store(&mut values);
        values.map(|value| half::f16::from_f32(value).to_bits())
    }

    /// Reads one bit of `bytes` for each lane. Bit `i` of the result is bit `at[i]` of `bytes`, counted from the least
    /// significant bit of each byte; 0 beyond the end of `bytes`.
    #[inline(always)]
    fn bits(bytes: &[u8], at: Self::Indices) -> u32 {
        bits_by_lane::<Self>(bytes, at)
    }

    /// Weighted sum of table rows for each lane: `Σ_r weights[r] · row r`, added to 0 in ascending order of `r`.
    ///
    /// An entry of the table has `features` values: 1, 2 or 4. A row is two neighbouring entries, thus `2 · features`
    /// values. Vector `i` of the result holds, for each lane, the weighted sum over the rows of value `i` of the row.
    /// Only the first `2 · features` vectors are valid.
    ///
    /// `rows`: for each row and lane, the index of the row's first entry. A row that does not fit into the table is
    /// read as arbitrary values of the table, or as zeros.
    #[inline(always)]
    fn weighted_rows<T: Value, const ROWS: usize>(
        table: Table<'_, T>,
        rows: &[Self::Indices; ROWS],
        weights: &[Self; ROWS],
        features: usize,
    ) -> [Self; 8] {
        weighted_rows_by_lane(table, rows, weights, features)
    }

    /// Negation of each lane; 0 becomes −0.
    #[inline(always)]
    fn neg(self) -> Self {
        Self::splat(-0.0).sub(self)
    }

    /// Applies `f` to every lane, one by one.
    #[inline(always)]
    fn map(self, f: impl Fn(f32) -> f32) -> Self {
        let mut lanes = [0.0; MAX_LANES];
        self.store(&mut lanes);
        for x in &mut lanes[..Self::COUNT] {
            *x = f(*x);
        }
        Self::load(&lanes)
    }
}

/// Reads bits as [`Lanes::bits`] does, one lane after the other.
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

/// Returns sums of weighted table rows as [`Lanes::weighted_rows`] does, with a separate read for each lane and value.
#[inline(always)]
pub fn weighted_rows_by_lane<V: Lanes, T: Value, const ROWS: usize>(
    table: Table<'_, T>,
    rows: &[V::Indices; ROWS],
    weights: &[V; ROWS],
    features: usize,
) -> [V; 8] {
    let mut sums = [V::splat(0.0); 8];
    for (row, &weight) in rows.iter().zip(weights) {
        let mut at = [0; MAX_LANES];
        row.mul(V::Indices::splat(features as u32)).store(&mut at);
        for (plus, sum) in sums.iter_mut().enumerate().take(2 * features) {
            *sum = weight.mul_add(V::load(&table.read(&at, plus, V::COUNT)), *sum);
        }
    }
    sums
}

/// Indices of the lanes, 0 to 15, as f32.
pub(crate) const LANES: [f32; MAX_LANES] =
    [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

/// Bits of the f32 nearest to √½, the lower bound of the mantissa in `split_exponent`.
pub(crate) const SQRT_HALF_BITS: u32 = 0x3f35_04f3;

#[cfg(not(any(target_arch = "x86_64", all(target_arch = "arm", target_abi = "eabihf"))))]
use libm::sqrtf as square_root;

// The crate `libm` writes the instruction without AVX's prefix, which takes 20 ns more inside of AVX code.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn square_root(x: f32) -> f32 {
    use core::arch::x86_64::{_mm_cvtss_f32, _mm_set_ss, _mm_sqrt_ss};
    // SAFETY: every x86-64 CPU has SSE.
    unsafe { _mm_cvtss_f32(_mm_sqrt_ss(_mm_set_ss(x))) }
}

// On ARM, the crate `libm` computes square roots in software, in 500 bytes of flash.

// SAFETY: this ABI passes the argument and the result in s0, a register of an FPU that has the instruction. `.fpu`
// states this to the assembler, which does not know the target's features.
#[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
#[unsafe(naked)]
extern "C" fn square_root(x: f32) -> f32 {
    core::arch::naked_asm!(".fpu vfpv2", "vsqrt.f32 s0, s0", "bx lr")
}

impl Lanes for f32 {
    const COUNT: usize = 1;
    const TILE_ROWS: usize = 4;
    const TILE_COLS: usize = 1;
    type Mask = bool;
    type Indices = u32;

    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        debug_assert!(!from.is_empty(), "expected a value, found none");
        from.first().copied().unwrap_or_default()
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        debug_assert!(!to.is_empty(), "expected room for a value, found none");
        if let Some(first) = to.first_mut() {
            *first = self;
        }
    }
    methods! {
        fn splat(x: f32) -> Self = x;
        fn add(self, b: Self) -> Self = self + b;
        fn sub(self, b: Self) -> Self = self - b;
        fn mul(self, b: Self) -> Self = self * b;
        fn div(self, b: Self) -> Self = self / b;
        fn mul_add(self, b: Self, c: Self) -> Self = self * b + c;
        fn max_of(self, b: Self) -> Self = if self > b { self } else { b };
        fn min_of(self, b: Self) -> Self = if self < b { self } else { b };
        fn sqrt(self) -> Self = square_root(self);
        fn abs(self) -> Self = f32::from_bits(self.to_bits() & 0x7fff_ffff);
        fn exp2_integer(self) -> Self = f32::from_bits(((self as i32 + 127) as u32) << 23);
        fn equals(self, b: Self) -> bool = self == b;
        fn less(self, b: Self) -> bool = self < b;
        fn select(mask: bool, a: Self, b: Self) -> Self = if mask { a } else { b };
        fn to_indices(self) -> u32 = self as u32;
    }
    // Ten inlined copies would take 0.7 KiB of a microcontroller's flash.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    #[cfg_attr(target_os = "none", inline(never))]
    fn round_even(self) -> Self {
        // At 2^23 and above, f32 has no fraction bits, so that adding 2^23 to a smaller number rounds to an integer.
        const MAGIC: f32 = 8_388_608.0;
        let magic = if self < 0.0 { -MAGIC } else { MAGIC };
        let rounded = (self + magic) - magic;
        if self.abs() < MAGIC { rounded } else { self }
    }
    #[inline(always)]
    fn split_exponent(self) -> (Self, Self) {
        let shifted = self.to_bits().wrapping_sub(SQRT_HALF_BITS);
        let exponent = (shifted as i32) >> 23;
        let mantissa = (shifted & 0x007f_ffff).wrapping_add(SQRT_HALF_BITS);
        (f32::from_bits(mantissa), exponent as f32)
    }
}
