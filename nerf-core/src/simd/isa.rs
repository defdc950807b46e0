//! Detection of instruction sets, and execution of an [`Op`] with the vectors of an instruction set.

use super::portable::Portable;
use super::{MAX_LANES, Op};
use crate::names::names;

names! {
    /// Instruction set that the inner loops use. Of the variants that a machine supports, the last one is the fastest.
    #[derive(PartialOrd, Ord)]
    #[non_exhaustive]
    pub enum Isa {
        /// Plain f32 without fused multiply-adds. Results are bit-identical on every target, and are the reference for
        /// the results of all other variants.
        Portable = "portable",
        /// AVX2, FMA and F16C, eight lanes.
        Avx2 = "avx2",
        /// AVX-512 F, sixteen lanes.
        Avx512 = "avx512",
        /// WebAssembly SIMD, four lanes, without fused multiply-adds: results are bit-identical to `Portable`.
        /// Available if the build has the target feature `simd128`: a module cannot query the engine's instructions.
        Simd128 = "simd128",
        /// NEON, four lanes, fused multiply-adds; every 64-bit ARM processor has NEON.
        Neon = "neon",
    }
}

/// Whether this target is assumed to have vector instructions.
///
/// Microcontrollers and WebAssembly without `simd128` have none. Their builds contain the portable instruction set
/// alone, and read weights directly from the scene file's bytes.
pub const VECTORS: bool = if cfg!(target_arch = "wasm32") {
    cfg!(target_feature = "simd128")
} else {
    // Targets with an operating system count as having vectors: trainers need f32 weights, which need [`VECTORS`].
    !cfg!(target_os = "none") || cfg!(any(target_arch = "x86_64", target_arch = "aarch64"))
};

impl Isa {
    /// Returns the fastest instruction set that this build and this machine support.
    pub fn detect() -> Self {
        Self::ALL.into_iter().rev().find(|isa| isa.available()).unwrap_or(Self::Portable)
    }

    /// Whether this build and this machine support the instruction set.
    pub fn available(self) -> bool {
        match self {
            Self::Portable => true,
            Self::Simd128 => cfg!(all(target_arch = "wasm32", target_feature = "simd128")),
            Self::Neon => cfg!(all(target_arch = "aarch64", target_feature = "neon")),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => cpu::has(cpu::AVX2),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => cpu::has(cpu::AVX512),
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }

    /// Whether this machine has bf16 dot products for this instruction set: AVX-512 with AVX-512 BF16.
    pub fn multiplies_bf16(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => cpu::has(cpu::AVX512_BF16),
            _ => false,
        }
    }

    /// Whether a grid's f16 tables are read directly from the scene file's bytes. If not, a renderer converts these
    /// tables to f32 once, when it is created.
    ///
    /// `Simd128` requires conversion, since WebAssembly has no f16 instruction. `Portable` has none either, but reads
    /// f16 directly: conversion would double the tables' memory to save 2 % of a frame's time (`docs/kernels.md`).
    pub const fn reads_f16_tables(self) -> bool {
        !matches!(self, Self::Simd128)
    }

    /// Granularity of [`Isa::run_columns`], in samples: 8 or 16. If the number of samples is a multiple of this
    /// granularity, the samples are processed in vectors. Otherwise all samples are processed one by one.
    #[inline]
    pub fn columns(self) -> usize {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 | Self::Avx512 if self.available() => 8,
            Self::Simd128 | Self::Neon if self.available() => 8,
            _ => MAX_LANES,
        }
    }

    /// Whether `columns` is a multiple of [`Isa::columns`].
    #[inline]
    pub fn fills(self, columns: usize) -> bool {
        // A division by a constant is a bit mask.
        if self.columns() == 8 { columns.is_multiple_of(8) } else { columns.is_multiple_of(MAX_LANES) }
    }

    /// Returns the number of columns, a multiple of [`Isa::columns`], with which a block of `n` samples takes the least
    /// time; at least `n`.
    #[inline]
    pub fn padded(self, n: usize) -> usize {
        // More than half a vector of AVX-512 fills a whole one.
        let half = self.columns() == 8 && (self != Self::Avx512 || n <= 8);
        if half { n.next_multiple_of(8) } else { n.next_multiple_of(MAX_LANES) }
    }

    /// Runs `op`, a loop over `columns` samples: in vectors ([`Isa::run`]) if `columns` is a multiple of
    /// [`Isa::columns`], else one sample at a time. Builds without `VECTORS` always take one sample at a time.
    #[inline]
    pub fn run_columns<O: Op>(self, columns: usize, op: O) -> O::Output {
        match self {
            _ if !VECTORS || !self.fills(columns) => op.run::<f32>(),
            // Half a vector of AVX-512 is a vector of AVX2, whose results have the same bits.
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 if !columns.is_multiple_of(MAX_LANES) => Self::Avx2.run(op),
            _ => self.run(op),
        }
    }

    /// Runs `op` over `columns` samples in the widest vectors that give results bit-identical to [`Isa::Portable`].
    #[inline]
    pub(crate) fn run_portable<O: Op>(self, columns: usize, op: O) -> O::Output {
        match self {
            // SAFETY: `available` checked that the CPU and the OS support AVX2.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 | Self::Avx512 if columns.is_multiple_of(16) && Self::Avx2.available() => unsafe {
                super::avx2::run_portable(op)
            },
            _ => Self::Portable.run_columns(columns, op),
        }
    }

    /// Runs `op` with this instruction set, or with the portable set if build or machine does not support this one.
    #[inline]
    pub fn run<O: Op>(self, op: O) -> O::Output {
        match self {
            // SAFETY: `available` checked that the CPU and the OS support AVX2, FMA and F16C.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 if self.available() => unsafe { super::avx2::run(op) },
            // SAFETY: `available` checked that the CPU and the OS support AVX-512 F.
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 if self.available() => unsafe { super::avx512::run(op) },
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            Self::Simd128 => super::simd128::run(op),
            #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
            Self::Neon => super::neon::run(op),
            // Without vector instructions, the sixteen lanes of `Portable` would be much code. One lane gives the same
            // bits.
            _ if !VECTORS => op.run::<f32>(),
            _ => op.run::<Portable>(),
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod cpu {
    use core::arch::x86_64::{__cpuid_count, _xgetbv};
    use core::sync::atomic::{AtomicU8, Ordering};

    pub const AVX2: u8 = 1;
    pub const AVX512: u8 = 2;
    pub const AVX512_BF16: u8 = 4;
    /// Bit that marks `FEATURES` as valid: set after CPU and OS have been queried.
    const ASKED: u8 = 0x80;

    static FEATURES: AtomicU8 = AtomicU8::new(0);

    #[inline]
    pub fn has(feature: u8) -> bool {
        let mut features = FEATURES.load(Ordering::Relaxed);
        if features == 0 {
            features = ask_once();
        }
        features & feature != 0
    }

    #[cold]
    fn ask_once() -> u8 {
        let features = ASKED | ask();
        FEATURES.store(features, Ordering::Relaxed);
        features
    }

    fn ask() -> u8 {
        let leaf = |leaf, sub| __cpuid_count(leaf, sub);
        if leaf(0, 0).eax < 7 {
            return 0;
        }
        let (one, seven) = (leaf(1, 0), leaf(7, 0));
        let has = |word: u32, bit: u32| word >> bit & 1 == 1;
        // Bit 27 is OSXSAVE. Without OSXSAVE, the instruction `xgetbv` in `xcr0` is invalid.
        if !has(one.ecx, 27) {
            return 0;
        }
        // SAFETY: OSXSAVE is set, as `xcr0` requires.
        let saved = unsafe { xcr0() };
        let ymm = saved & 0b110 == 0b110;
        let zmm = saved & 0b1110_0110 == 0b1110_0110;
        // Bits 12, 28 and 29 are FMA, AVX and F16C.
        let fma = has(one.ecx, 12) && has(one.ecx, 28) && has(one.ecx, 29);
        let avx2 = ymm && fma && has(seven.ebx, 5);
        let avx512 = zmm && fma && has(seven.ebx, 16);
        // `seven.eax` is the index of the last subleaf of leaf 7; bit 5 of subleaf 1 is AVX-512 BF16.
        let bf16 = avx512 && seven.eax >= 1 && has(leaf(7, 1).eax, 5);
        (u8::from(avx2) * AVX2) | (u8::from(avx512) * AVX512) | (u8::from(bf16) * AVX512_BF16)
    }

    #[target_feature(enable = "xsave")]
    unsafe fn xcr0() -> u64 {
        // SAFETY: the caller checked OSXSAVE, which makes `xgetbv` valid.
        unsafe { _xgetbv(0) }
    }
}
