//! How a scene is opened.

use crate::boundary::{Versioned, read_versioned};
use crate::failure::Failure;
use nerf_core::simd::Tier;

/// A kernel tier: which instructions the inner loops use.
///
/// Within one tier pictures are the same bit for bit, whatever the rectangles and threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Kernel {
    /// The fastest of this machine that computes in f32, or the one named by the environment variable
    /// `NERF_KERNEL` ("scalar", "avx2", "avx512", "avx512bf16", "simd128", "neon") where the library was built with std.
    Auto = 0,
    /// Plain f32: on every machine; weights are read in place and take no memory.
    Scalar = 1,
    /// AVX2 and FMA.
    Avx2 = 2,
    /// AVX-512 F.
    Avx512 = 3,
    /// AVX-512 BF16: faster, with weights and activations rounded to 8 significant bits; never chosen by
    /// itself.
    Avx512Bf16 = 4,
    /// WebAssembly SIMD: the scalar tier's bits, faster; there in a library built with `simd128`.
    Simd128 = 5,
    /// NEON: on every 64-bit ARM processor.
    Neon = 6,
}

impl Kernel {
    pub(crate) fn of(tier: Tier) -> Self {
        match tier {
            Tier::Avx2 => Self::Avx2,
            Tier::Avx512 => Self::Avx512,
            Tier::Avx512Bf16 => Self::Avx512Bf16,
            Tier::Simd128 => Self::Simd128,
            Tier::Neon => Self::Neon,
            _ => Self::Scalar,
        }
    }
}

/// How a scene is opened; NULL in its place means all zeros.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct OpenOptions {
    /// `sizeof(nerf_open_options)`.
    pub struct_size: usize,
    /// A `nerf_kernel`.
    pub kernel: u32,
    /// Zeros.
    pub reserved: [u32; 7],
}

// SAFETY: `repr(C)`, `struct_size` comes first, and integers have no invalid bytes.
unsafe impl Versioned for OpenOptions {
    const NAME: &'static str = "options";
}

/// The tier the caller asks for.
///
/// # Safety
/// `options` is NULL or points to `struct_size` readable bytes.
pub(crate) unsafe fn read_tier(options: *const OpenOptions) -> Result<Tier, Failure> {
    if options.is_null() {
        return automatic();
    }
    // SAFETY: `options` is as this function's `# Safety` has it.
    let options = unsafe { read_versioned(options)? };
    if options.reserved != [0; 7] {
        return Err(Failure::Reserved("options.reserved"));
    }
    const AUTO: u32 = Kernel::Auto as u32;
    const SCALAR: u32 = Kernel::Scalar as u32;
    const AVX2: u32 = Kernel::Avx2 as u32;
    const AVX512: u32 = Kernel::Avx512 as u32;
    const AVX512_BF16: u32 = Kernel::Avx512Bf16 as u32;
    const SIMD128: u32 = Kernel::Simd128 as u32;
    const NEON: u32 = Kernel::Neon as u32;
    match options.kernel {
        AUTO => automatic(),
        SCALAR => available(Tier::Scalar),
        AVX2 => available(Tier::Avx2),
        AVX512 => available(Tier::Avx512),
        AVX512_BF16 => available(Tier::Avx512Bf16),
        SIMD128 => available(Tier::Simd128),
        NEON => available(Tier::Neon),
        found => Err(Failure::Setting { name: "options.kernel", expected: "a nerf_kernel", found }),
    }
}

fn available(tier: Tier) -> Result<Tier, Failure> {
    if tier.available() { Ok(tier) } else { Err(Failure::Kernel(tier.name())) }
}

#[cfg(feature = "std")]
fn automatic() -> Result<Tier, Failure> {
    match std::env::var_os("NERF_KERNEL") {
        Some(name) if !name.is_empty() => {
            let tier = name.to_str().and_then(Tier::by_name).ok_or(Failure::KernelVariable)?;
            available(tier)
        }
        _ => Ok(Tier::detect()),
    }
}

#[cfg(not(feature = "std"))]
fn automatic() -> Result<Tier, Failure> {
    Ok(Tier::detect())
}
