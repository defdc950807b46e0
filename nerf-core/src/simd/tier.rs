//! Which tiers this machine has, and the one place where a tier becomes a function.

use super::Op;
use super::portable::Portable;

/// A kernel tier: which instructions the inner loops use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Tier {
    /// Plain, unfused f32: the oracle, the same on every target.
    Scalar,
    /// AVX2, FMA and F16C, eight lanes.
    Avx2,
    /// AVX-512 F, sixteen lanes.
    Avx512,
    /// AVX-512 BF16: weights and activations are rounded to bf16 and summed in f32. Only by name:
    /// [`Tier::detect`] never chooses a tier that rounds.
    Avx512Bf16,
    /// WebAssembly SIMD, four lanes, unfused: the scalar tier's bits. There if the build has the target
    /// feature `simd128`, since a module cannot ask.
    Simd128,
    /// NEON, four lanes, fused: what every 64-bit ARM processor has.
    Neon,
}

/// Whether this target is taken to have vectors, the compiler's or a tier's own.
///
/// Where there are none, as on microcontrollers and in WebAssembly without `simd128`, every tier is the scalar one,
/// weights are read in place, and a build has no code for anything else.
pub const VECTORS: bool = if cfg!(target_arch = "wasm32") {
    cfg!(target_feature = "simd128")
} else {
    // Machines with an operating system, where trainers keep their weights in f32, too.
    !cfg!(target_os = "none") || cfg!(any(target_arch = "x86_64", target_arch = "aarch64"))
};

impl Tier {
    /// Every tier, slowest first among those of one machine.
    pub const ALL: [Self; 6] =
        [Self::Scalar, Self::Avx2, Self::Avx512, Self::Avx512Bf16, Self::Simd128, Self::Neon];

    /// The fastest tier of this machine that computes in f32.
    pub fn detect() -> Self {
        let wanted = |tier: &Self| !tier.rounds() && tier.available();
        Self::ALL.into_iter().rev().find(wanted).unwrap_or(Self::Scalar)
    }

    /// Whether weights and activations are rounded to fewer bits than f32 has.
    pub const fn rounds(self) -> bool {
        matches!(self, Self::Avx512Bf16)
    }

    /// Whether this build and this machine have the tier.
    pub fn available(self) -> bool {
        match self {
            Self::Scalar => true,
            Self::Simd128 => cfg!(all(target_arch = "wasm32", target_feature = "simd128")),
            Self::Neon => cfg!(all(target_arch = "aarch64", target_feature = "neon")),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => cpu::features().avx2,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => cpu::features().avx512,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512Bf16 => cpu::features().avx512_bf16,
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }

    /// Its name in `NERF_KERNEL`, flags and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
            Self::Avx512Bf16 => "avx512bf16",
            Self::Simd128 => "simd128",
            Self::Neon => "neon",
        }
    }

    /// The tier of that name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|tier| tier.name() == name)
    }

    /// As [`Tier::run`], for an op over `columns` samples: one by one where they fill no vector.
    #[inline]
    pub fn run_columns<O: Op>(self, columns: usize, op: O) -> O::Output {
        if VECTORS && columns.is_multiple_of(16) { self.run(op) } else { op.run::<f32>() }
    }

    /// Runs `op` on this tier, or on the scalar one where the machine lacks it.
    #[inline]
    pub fn run<O: Op>(self, op: O) -> O::Output {
        match self {
            // SAFETY: the CPU and the OS have what the leaf needs; `available` asked them.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 if self.available() => unsafe { super::avx2::run(op) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 | Self::Avx512Bf16 if self.available() => unsafe { super::avx512::run(op) },
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            Self::Simd128 => super::simd128::run(op),
            #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
            Self::Neon => super::neon::run(op),
            // Bit for bit the same; sixteen lanes of code are many where no vector holds them.
            _ if !VECTORS => op.run::<f32>(),
            _ => op.run::<Portable>(),
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod cpu {
    use core::arch::x86_64::{__cpuid_count, _xgetbv};
    use core::sync::atomic::{AtomicU8, Ordering};

    pub struct Features {
        pub avx2: bool,
        pub avx512: bool,
        /// AVX-512 F and BF16.
        pub avx512_bf16: bool,
    }

    const NONE: Features = Features { avx2: false, avx512: false, avx512_bf16: false };

    /// What `cpuid` and the OS say, asked once: bit 7 marks the answer as known.
    static KNOWN: AtomicU8 = AtomicU8::new(0);

    pub fn features() -> Features {
        let mut bits = KNOWN.load(Ordering::Relaxed);
        if bits == 0 {
            let asked = ask();
            bits =
                0x80 | u8::from(asked.avx2) | u8::from(asked.avx512) << 1 | u8::from(asked.avx512_bf16) << 2;
            KNOWN.store(bits, Ordering::Relaxed);
        }
        Features { avx2: bits & 1 != 0, avx512: bits & 2 != 0, avx512_bf16: bits & 4 != 0 }
    }

    fn ask() -> Features {
        let leaf = |leaf, sub| __cpuid_count(leaf, sub);
        if leaf(0, 0).eax < 7 {
            return NONE;
        }
        let (one, seven) = (leaf(1, 0), leaf(7, 0));
        let has = |word: u32, bit: u32| word >> bit & 1 == 1;
        // XSAVE in use by the OS: only then does the next instruction exist.
        if !has(one.ecx, 27) {
            return NONE;
        }
        // SAFETY: OSXSAVE is set.
        let saved = unsafe { xcr0() };
        let ymm = saved & 0b110 == 0b110;
        let zmm = saved & 0b1110_0110 == 0b1110_0110;
        // FMA, AVX and F16C.
        let fma = has(one.ecx, 12) && has(one.ecx, 28) && has(one.ecx, 29);
        let avx512 = zmm && fma && has(seven.ebx, 16);
        // The subleaf exists where the first says so.
        let bf16 = seven.eax >= 1 && has(leaf(7, 1).eax, 5);
        Features { avx2: ymm && fma && has(seven.ebx, 5), avx512, avx512_bf16: avx512 && bf16 }
    }

    #[target_feature(enable = "xsave")]
    unsafe fn xcr0() -> u64 {
        // SAFETY: the caller checked OSXSAVE.
        unsafe { _xgetbv(0) }
    }
}
