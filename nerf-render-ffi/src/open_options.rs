//! How a scene is opened.

use crate::boundary::{Versioned, by_width, read_versioned};
use crate::failure::Failure;
use nerf_core::Isa;

/// Which instructions the inner loops use.
///
/// With one of them and one storage pictures are the same bit for bit, whatever the rectangles and threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Kernel {
    /// The fastest of this machine, or what the environment variable `NERF_KERNEL` names ("portable", "avx2", "avx512",
    /// "simd128", "neon", each with "-f16" or "-bf16" behind it where weights are not f32) where the library was built
    /// with std.
    Auto = 0,
    /// Plain, unfused f32: on every machine.
    Portable = 1,
    /// AVX2, FMA and F16C.
    Avx2 = 2,
    /// AVX-512 F.
    Avx512 = 3,
    /// WebAssembly SIMD: the portable bits, faster; there in a library built with `simd128`.
    Simd128 = 4,
    /// NEON: on every 64-bit ARM processor.
    Neon = 5,
}

impl Kernel {
    pub(crate) fn of(isa: Isa) -> Self {
        match isa {
            Isa::Avx2 => Self::Avx2,
            Isa::Avx512 => Self::Avx512,
            Isa::Simd128 => Self::Simd128,
            Isa::Neon => Self::Neon,
            _ => Self::Portable,
        }
    }
}

/// How the weights of a scene lie in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Storage {
    /// f32; read in place where a build has no vectors, as on microcontrollers.
    Auto = 0,
    /// f16, read in place: the scene takes no memory for them.
    F16 = 1,
    /// f32, unpacked when the scene is opened: the same products, faster. A grid's tables are read in place nevertheless,
    /// but for WebAssembly's kernel, which unpacks f16 ones.
    F32 = 2,
    /// Pairs of bf16, as are the activations: rounded to 8 significant bits. With AVX-512 BF16 alone.
    Bf16 = 3,
}

impl Storage {
    pub(crate) fn of(storage: nerf_core::Storage) -> Self {
        match storage {
            nerf_core::Storage::F32 => Self::F32,
            nerf_core::Storage::Bf16 => Self::Bf16,
            _ => Self::F16,
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
    /// A `nerf_storage`.
    pub storage: u32,
    /// Zeros.
    pub reserved: [u32; 6],
}

// SAFETY: `repr(C)`, `struct_size` comes first, and integers have no invalid bytes.
unsafe impl Versioned for OpenOptions {
    const NAME: &'static str = "options";
    const SIZE_V2: usize = by_width(36, 40);
}

/// What the caller asks for.
///
/// # Safety
/// `options` is NULL or points to `struct_size` readable bytes.
pub(crate) unsafe fn read_kernel(options: *const OpenOptions) -> Result<nerf_core::Kernel, Failure> {
    if options.is_null() {
        return automatic();
    }
    // SAFETY: `options` is as this function's `# Safety` has it.
    let options = unsafe { read_versioned(options)? };
    if options.reserved != [0; 6] {
        return Err(Failure::Reserved("options.reserved"));
    }
    let isa = match options.kernel {
        0 => None,
        1 => Some(Isa::Portable),
        2 => Some(Isa::Avx2),
        3 => Some(Isa::Avx512),
        4 => Some(Isa::Simd128),
        5 => Some(Isa::Neon),
        found => {
            return Err(Failure::Setting { name: "options.kernel", expected: "a nerf_kernel", found });
        }
    };
    let storage = match options.storage {
        0 => None,
        1 => Some(nerf_core::Storage::F16),
        2 => Some(nerf_core::Storage::F32),
        3 => Some(nerf_core::Storage::Bf16),
        found => {
            return Err(Failure::Setting { name: "options.storage", expected: "a nerf_storage", found });
        }
    };
    // The environment speaks where the caller does not.
    let open = if isa.is_some() { nerf_core::Kernel::detect() } else { automatic()? };
    available(nerf_core::Kernel::new(isa.unwrap_or(open.isa), storage.unwrap_or(open.storage)))
}

fn available(kernel: nerf_core::Kernel) -> Result<nerf_core::Kernel, Failure> {
    if kernel.available() { Ok(kernel) } else { Err(Failure::Kernel(kernel)) }
}

#[cfg(feature = "std")]
fn automatic() -> Result<nerf_core::Kernel, Failure> {
    match std::env::var_os("NERF_KERNEL") {
        Some(name) if !name.is_empty() => {
            let kernel = name.to_str().and_then(nerf_core::Kernel::by_name).ok_or(Failure::KernelVariable)?;
            available(kernel)
        }
        _ => Ok(nerf_core::Kernel::detect()),
    }
}

#[cfg(not(feature = "std"))]
fn automatic() -> Result<nerf_core::Kernel, Failure> {
    Ok(nerf_core::Kernel::detect())
}
